"""Finding a channel by the name that a person wrote."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from labpipe.errors import ReadError, complaint, nearest
from labpipe.records.recording import Channel, Recording

Wanted: TypeAlias = str | tuple[str, ...]
"""A channel by its name or path, or by several of which the first that the export has is meant."""

_INSPECT = "`labpipe inspect` lists them all."


class NoChannelError(ReadError):
    """No channel of an export, or more than one, is meant by a name.

    Parameters
    ----------
    message : for people
    wanted : the names that were asked for
    """

    def __init__(self, message: str, wanted: tuple[str, ...]) -> None:
        super().__init__(message)
        self.wanted = wanted

    def __reduce__(self) -> tuple[type[NoChannelError], tuple[str, tuple[str, ...]]]:
        """Let it pass from one process to another."""
        return type(self), (str(self), self.wanted)


def select_channel(recording: Recording, wanted: Wanted, file: object) -> Channel:
    """Find the one channel that a name stands for.

    Parameters
    ----------
    recording : what a reader made of the export
    wanted : full path and name (``Model Root/Load Cell/Out1``), or the name alone where no other
        channel has it; quotes and the two characters backslash-n may be left out. Of several
        names the first one that the export has counts.
    file : named in the errors

    Returns
    -------
    The channel.

    Raises
    ------
    NoChannelError
        If no channel is meant by that name (the nearest are listed), or more than one.
    """
    known = [(channel.name, channel.path) for channel in recording.channels]
    return recording.channels[find_channel(wanted, known, file)]


def find_channel(wanted: Wanted, known: Sequence[tuple[str, str]], file: object) -> int:
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
    for name in names:
        found = _meant(name, known)
        if len(found) == 1:
            return found[0]
        if found:
            raise NoChannelError(_ambiguous(name, [paths[i] for i in found], file), names)
    raise NoChannelError(_unknown(names, paths, file), names)


def _meant(wanted: str, known: Sequence[tuple[str, str]]) -> list[int]:
    """Which of the (name, path) pairs one name may stand for."""
    exact = [i for i, (_, path) in enumerate(known) if path == wanted]
    spelt = [i for i, (_, path) in enumerate(known) if _spellings(path) & _spellings(wanted)]
    named = [i for i, (name, _) in enumerate(known) if name == wanted]
    return exact or spelt or named


def _spellings(path: str) -> set[str]:
    """Ways to write one path: with or without quotes and Simulink's line breaks."""
    bare = path.replace('"', "")
    unbroken = {text.replace("\\n", "").replace("\n", "") for text in (path, bare)}
    return {path, bare} | unbroken


def _ambiguous(wanted: str, paths: list[str], file: object) -> str:
    return complaint(
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
    place = f"channel {' or '.join(map(repr, names))}"
    return complaint(file, place, expected=expected, found="no such channel", remedy=remedy)


def _listed(paths: list[str]) -> str:
    return ", ".join(f"'{path}'" for path in paths)
