"""Channels of an export: found by the name that a person wrote, and what is odd about them."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from typing import TypeAlias

from labpipe.errors import ReadError, error_text, nearest
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Recording

ReportOptions: TypeAlias = str | tuple[str, ...]
"""A channel by its name or path, or by several of which the first that the export has is meant."""

_BEFORE = re.compile(r"(?:_+|(?:channel|ch|kanal|canale|canal|voie|c)[\s._]*\d+[\s._:-]+)+")
"""What stands before the name of a channel: an underscore, or the number of the channel."""
_NOTED = 3
"""Channels that a note lists."""
_SHOWN = 6
"""Names that a message lists."""
_INSPECT = "`labpipe inspect` lists them all."


class NoChannelError(ReadError):
    """No channel of an export, or more than one, is meant by a name.

    Parameters
    ----------
    message : for people
    wanted : the names that were asked for
    parts : the specimens or sheets of a load frame's export that each have such a channel; empty
        where that is not why
    """

    code = "missing_channel"

    def __init__(self, message: str, wanted: tuple[str, ...], parts: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.wanted, self.parts = wanted, parts

    def __reduce__(self) -> tuple[type[NoChannelError], tuple[object, ...]]:
        """Let it pass from one process to another."""
        return type(self), (str(self), self.wanted, self.parts)


def select_channel(recording: Recording, wanted: ReportOptions, file: object) -> Channel:
    """Find the one channel that a name stands for.

    Parameters
    ----------
    recording : what a reader made of the export
    wanted : full path and name (``Model Root/Load Cell/Out1``), or the name alone where no other
        channel has it; quotes and the two characters backslash-n may be left out. Of several
        names the first one that the export has counts. Where it has none of them as written, one
        is looked for that differs by the number of a channel before it (``Ch 1 Kraft``,
        ``C_1_Force``, ``_Load``), by case, accents, or underscores for blanks.
    file : named in the errors

    Returns
    -------
    The channel.

    Raises
    ------
    NoChannelError
        If no channel is meant by that name (the nearest are listed), or more than one.
    """
    if recording.reader == "load-frame":
        (found,) = find_in_parts([wanted], recording.channels, file)
    else:
        known = [(channel.name, channel.path) for channel in recording.channels]
        found = find_channel(wanted, known, file)
    return recording.channels[found]


def find_in_parts(
    wanted: Sequence[ReportOptions], channels: Sequence[Channel], file: object
) -> list[int]:
    """Find channels among those of a load frame's export, whose specimens have a clock each.

    Parameters
    ----------
    wanted : as for `select_channel`
    channels : of all specimens
    file : named in the errors

    Returns
    -------
    Their indices.

    Raises
    ------
    NoChannelError
        As `find_channel`; with the specimens that have the channel where several do.
    """
    known = [(channel.name, channel.path) for channel in channels]
    try:
        return [find_channel(wanted, known, file) for wanted in wanted]
    except NoChannelError as error:
        clocks = dict.fromkeys(channel.clock for channel in channels)
        parts = tuple(part for part in clocks if _has(error.wanted, part, channels))
        raise NoChannelError(str(error), error.wanted, parts if len(parts) > 1 else ()) from error


def _has(wanted: tuple[str, ...], part: str, channels: Sequence[Channel]) -> bool:
    names = [(channel.name, channel.name) for channel in channels if channel.clock == part]
    return any(meant(name, names) for meant in (_meant, _meant_loosely) for name in wanted)


def find_channel(wanted: ReportOptions, known: Sequence[tuple[str, str]], file: object) -> int:
    """Find which of the (name, path) pairs a name stands for.

    Parameters
    ----------
    wanted : as for `select_channel`
    known : name and path of each channel of the export
    file : named in the errors

    Returns
    -------
    Its index.

    Raises
    ------
    NoChannelError
        If it stands for none of them, or for more than one.
    """
    names = (wanted,) if isinstance(wanted, str) else wanted
    paths = [path for _, path in known]
    for meant in (_meant, _meant_loosely):
        for name in names:
            found = meant(name, known)
            if len(found) == 1:
                return found[0]
            if found:
                raise NoChannelError(_ambiguous(name, [paths[i] for i in found], file), names)
    raise NoChannelError(_unknown(names, paths, file), names)


def is_as_written(wanted: ReportOptions, channel: Channel) -> bool:
    """Check whether a channel has one of the names as they are written, not just nearly.

    Parameters
    ----------
    wanted : as for `select_channel`, which found the channel
    channel : of the export
    """
    names = (wanted,) if isinstance(wanted, str) else wanted
    return any(_meant(name, [(channel.name, channel.path)]) for name in names)


def plain_name(name: str) -> str:
    """Take off a name what programs put before it, and how they spell it.

    Parameters
    ----------
    name : of a channel, without its unit

    Examples
    --------
    >>> plain_name("Ch 1 Kraft"), plain_name("C_1_Déplacement"), plain_name("_Load")
    ('kraft', 'deplacement', 'load')
    """
    spelt = unicodedata.normalize("NFKD", name)
    bare = "".join(sign for sign in spelt if not unicodedata.combining(sign)).casefold()
    before = _BEFORE.match(bare)
    rest = bare[before.end() :] if before else bare
    return " ".join(rest.replace("_", " ").rstrip(" .").split())


def _meant(wanted: str, known: Sequence[tuple[str, str]]) -> list[int]:
    """Which of the (name, path) pairs one name may stand for."""
    exact = [i for i, (_, path) in enumerate(known) if path == wanted]
    spelt = [i for i, (_, path) in enumerate(known) if _spellings(path) & _spellings(wanted)]
    named = [i for i, (name, _) in enumerate(known) if name == wanted]
    return exact or spelt or named


def _meant_loosely(wanted: str, known: Sequence[tuple[str, str]]) -> list[int]:
    """Which of the (name, path) pairs one name nearly stands for."""
    plain = plain_name(wanted)
    return [i for i, (name, _) in enumerate(known) if plain and plain_name(name) == plain]


def _spellings(path: str) -> set[str]:
    """Ways to write one path: with or without quotes and Simulink's line breaks."""
    bare = path.replace('"', "")
    unbroken = {text.replace("\\n", "").replace("\n", "") for text in (path, bare)}
    return {path, bare} | unbroken


def _ambiguous(wanted: str, paths: list[str], file: object) -> str:
    return error_text(
        file,
        f"channel {wanted!r}",
        expected="a name that only one channel has",
        found=f"{len(paths)} channels of that name",
        remedy=f"Give the full path, one of: {_listed(paths)}.",
    )


def _unknown(names: tuple[str, ...], paths: list[str], file: object) -> str:
    close = list(dict.fromkeys(near for name in names for near in nearest(name, paths)))[:5]
    remedy = f"Nearest: {_listed(close)}. {_INSPECT}" if close else "The file holds no channels."
    expected = f"one of the {len(paths)} channels of the file"
    place = f"channel {' or '.join(map(repr, names[:_SHOWN]))}"
    if len(names) > _SHOWN:
        place += f" or {len(names) - _SHOWN} more"
    return error_text(file, place, expected=expected, found="no such channel", remedy=remedy)


def _listed(paths: list[str]) -> str:
    return ", ".join(f"'{path}'" for path in paths)


def unique_names(names: Sequence[str]) -> list[str]:
    """Number the names that occur more than once, and name the columns without one."""
    called = [name or f"column {i + 1}" for i, name in enumerate(names)]
    return [
        f"{name} [{called[: i + 1].count(name)}]" if called.count(name) > 1 else name
        for i, name in enumerate(called)
    ]


def channel_notes(channels: Sequence[Channel]) -> list[QualityNote]:
    """Say what is odd about the channels of an export, whatever wrote it.

    Parameters
    ----------
    channels : of the recording

    Returns
    -------
    Notes ``constant_channel``, ``units_not_stated`` and ``names_not_unique``.
    """
    constant = [channel.path for channel in channels if _is_constant(channel.values)]
    silent = [channel.path for channel in channels if not channel.unit_in_file]
    names = Counter(channel.name for channel in channels)
    shared = [f"{count} are called '{name}'" for name, count in names.items() if count > 1]
    total, notes = len(channels), []
    if constant:
        message = f"{len(constant)} of {total} channels never change: {_some(constant)}"
        notes.append(QualityNote("constant_channel", Severity.INFO, "channels", message))
    if silent:
        message = f"no unit is stated for {len(silent)} of {total} channels: {_some(silent)}"
        if len(silent) == total:
            message = "the export states no units; the protocol must"
        notes.append(QualityNote("units_not_stated", Severity.INFO, "channels", message))
    if shared:
        message = f"of {total} channels {', '.join(shared[:_NOTED])}: tell them apart by path"
        notes.append(QualityNote("names_not_unique", Severity.INFO, "channels", message))
    return notes


def _some(paths: list[str]) -> str:
    return _listed(paths[:_NOTED]) + (" ..." if len(paths) > _NOTED else "")


def _is_constant(values: Floats) -> bool:
    """Check whether at least two samples are all alike; the ends spare a look at most channels."""
    alike = len(values) > 1 and values[0] == values[-1]
    return alike and bool(values.min() == values.max())
