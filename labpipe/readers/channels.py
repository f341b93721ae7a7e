"""Find channels by name, make names of channels unique, and make quality notes on channels."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import product
from typing import TypeAlias

import numpy as np

from labpipe.errors import ReadError, sort_by_likeness
from labpipe.records.arrays import Floats, drop_missing
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Recording
from labpipe.units import get_conversion_factor

ChannelChoice: TypeAlias = str | tuple[str, ...]
"""Name or path of a channel, or several, of which the first one in the export is used."""

_CHANNEL_PREFIX = re.compile(r"(?:_+|(?:channel|ch|kanal|canale|canal|voie|c)[\s._]*\d+[\s._:-]+)+")
"""Prefix of a channel name: underscores, or the number of the channel."""
_MAX_LISTED_NAMES = 3
"""Largest number of channels that a note lists."""


class NoChannelError(ReadError):
    """Error of a channel choice that matches no channel of an export, or several channels.

    Attributes
    ----------
    names : the wanted name, or all names of the choice
    parts : specimens or sheets of a load-frame export that each have such a channel; empty if the
        error has another cause
    """

    code = "missing_channel"
    names: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()


def select_channel(recording: Recording, choice: ChannelChoice, file: object) -> Channel:
    """Select a channel by its name or path.

    Parameters
    ----------
    recording : the export
    choice : full path and name (``Model Root/Load Cell/Out1``), or only the name if it is unique;
        quotes and the two characters backslash-n may be omitted. The first of several names that
        exists is used. If none exists as written, the search ignores case, accents, a prefix such
        as the number of the channel (``Ch 1 Kraft``, ``C_1_Force``, ``_Load``), and the difference
        between underscores and blanks.
    file : file that error messages name

    Returns
    -------
    The channel.

    Raises
    ------
    NoChannelError
        If no channel has that name, or more than one. The message lists the nearest names.
    """
    if recording.reader == "load-frame":
        (index,) = find_channels([choice], recording.channels, file)
    else:
        pairs = [(channel.name, channel.path) for channel in recording.channels]
        index = find_channel(choice, pairs, file)
    return recording.channels[index]


def find_channels(
    choices: Sequence[ChannelChoice], channels: Sequence[Channel], file: object
) -> list[int]:
    """Find channels of a load-frame export, in which each specimen has its own clock.

    Parameters
    ----------
    choices : names or paths of the channels, see `select_channel`
    channels : channels of all specimens
    file : file that error messages name

    Returns
    -------
    Indices of the channels.

    Raises
    ------
    NoChannelError
        If a choice matches no channel, or more than one. If several specimens have such a channel,
        `parts` of the error names them.
    """
    pairs = [(channel.name, channel.path) for channel in channels]
    try:
        return [find_channel(choice, pairs, file) for choice in choices]
    except NoChannelError as error:
        clocks = dict.fromkeys(channel.clock for channel in channels)
        parts = tuple(clock for clock in clocks if _has_channel(error.names, clock, channels))
        error.parts = parts if len(parts) > 1 else ()
        raise


def _has_channel(choice: tuple[str, ...], clock: str, channels: Sequence[Channel]) -> bool:
    """Return whether one of the names matches a channel on a clock."""
    pairs = [(channel.name, channel.name) for channel in channels if channel.clock == clock]
    return any(find(name, pairs) for find in (_find_exact, _find_similar) for name in choice)


def find_channel(choice: ChannelChoice, pairs: Sequence[tuple[str, str]], file: object) -> int:
    """Find the channel that a choice matches, among pairs of name and path.

    Parameters
    ----------
    choice : name or path, see `select_channel`
    pairs : name and path of each channel of the export
    file : file that error messages name

    Returns
    -------
    Index of the channel.

    Raises
    ------
    NoChannelError
        If the choice matches no channel, or more than one.
    """
    names = (choice,) if isinstance(choice, str) else choice
    paths = [path for _, path in pairs]
    for find_matches, name in product((_find_exact, _find_similar), names):
        indices = find_matches(name, pairs)
        if len(indices) == 1:
            return indices[0]
        if indices:
            matches, place = _quote_paths([paths[i] for i in indices]), f"channel {name!r}"
            error = NoChannelError.about("readers.ambiguous_channel", file, place, paths=matches)
            break
    else:
        nearest = dict.fromkeys(path for name in names for path in sort_by_likeness(name, paths))
        facts = {"count": len(paths), "near": _quote_paths([*nearest][:5]) or "none"}
        place = f"channel {' or '.join(map(repr, names[:6]))}"
        error = NoChannelError.about("readers.no_channel", file, place, **facts)
    error.names = names
    raise error


def find_alternatives(
    choice: ChannelChoice, pairs: Sequence[tuple[str, str]], chosen_index: int
) -> list[int]:
    """Find the channels, other than the chosen one, that a choice matches.

    Parameters
    ----------
    choice : names or path, see `select_channel`
    pairs : name and path of each channel of the export
    chosen_index : index of the channel that `find_channel` finds

    Returns
    -------
    Indices of the other channels, ascending.
    """
    names = (choice,) if isinstance(choice, str) else choice
    finders = product((_find_exact, _find_similar), names)
    indices = {index for find_matches, name in finders for index in find_matches(name, pairs)}
    return sorted(indices - {chosen_index})


def make_alternative_notes(
    choices: Sequence[ChannelChoice], channels: Sequence[Channel]
) -> Iterator[QualityNote]:
    """Make notes on channels that match one choice, but whose samples differ.

    Parameters
    ----------
    choices : names or paths of the wanted channels, each of which selects one channel
    channels : all channels of one table

    Yields
    ------
    Notes ``columns_disagree``, if the central 95 % of the differences between samples extend over
    more than 1 % of the range of the chosen channel. Channels that another choice selects, and
    channels of another quantity, are not compared.
    """
    max_range_fraction = 0.01
    pairs = [(channel.name, channel.path) for channel in channels]
    chosen_indices = [find_channel(choice, pairs, "") for choice in choices]
    for choice, index in zip(choices, chosen_indices, strict=True):
        chosen = channels[index]
        for alternative in (channels[i] for i in find_alternatives(choice, pairs, index)):
            if alternative.path in {channels[i].path for i in chosen_indices}:
                continue
            units = alternative.unit_in_file, chosen.unit_in_file
            try:
                factor = 1.0 if units[0] == units[1] else get_conversion_factor(*units)
            except ValueError:
                continue
            differences = drop_missing(factor * alternative.values - chosen.values)
            if not len(differences):
                continue
            spread = float(np.subtract(*np.quantile(differences, (0.975, 0.025))))
            full_range = np.nanmax(chosen.values) - np.nanmin(chosen.values)
            if spread > max_range_fraction * full_range > 0.0:
                paths = {"chosen": chosen.path, "other": alternative.path}
                percent = 100.0 * spread / full_range
                yield QualityNote.of(
                    "readers.columns_disagree", chosen.path, **paths, share=percent
                )


def is_exact_name(choice: ChannelChoice, channel: Channel) -> bool:
    """Return whether a channel has a name of a choice, except for quotes and line breaks.

    Parameters
    ----------
    choice : name or path, see `select_channel`
    channel : channel of the export
    """
    names = (choice,) if isinstance(choice, str) else choice
    return any(_find_exact(name, [(channel.name, channel.path)]) for name in names)


def normalise_name(name: str) -> str:
    """Remove prefixes that programs add to a channel name, and normalise its spelling.

    Parameters
    ----------
    name : name of the channel, without its unit

    Returns
    -------
    The name in lower case, without accents, prefix and underscores.

    Examples
    --------
    >>> normalise_name("Ch 1 Kraft"), normalise_name("C_1_Déplacement"), normalise_name("_Load")
    ('kraft', 'deplacement', 'load')
    """
    decomposed = unicodedata.normalize("NFKD", name)
    letters = "".join(
        character for character in decomposed if not unicodedata.combining(character)
    ).casefold()
    prefix = _CHANNEL_PREFIX.match(letters)
    remainder = letters[prefix.end() :] if prefix else letters
    return " ".join(remainder.replace("_", " ").rstrip(" .").split())


def _find_exact(wanted_name: str, pairs: Sequence[tuple[str, str]]) -> list[int]:
    """Find the channels with a path, else with a spelling of this path, else with a name.

    The result has the indices of the channels.
    """
    path_matches = [i for i, (_, path) in enumerate(pairs) if path == wanted_name]
    spellings = _list_spellings(wanted_name)
    near_matches = [i for i, (_, path) in enumerate(pairs) if _list_spellings(path) & spellings]
    name_matches = [i for i, (name, _) in enumerate(pairs) if name == wanted_name]
    return path_matches or near_matches or name_matches


def _find_similar(wanted_name: str, pairs: Sequence[tuple[str, str]]) -> list[int]:
    """Find the indices of the channels whose normalised names are equal to that of a name."""
    key = normalise_name(wanted_name)
    return [i for i, (name, _) in enumerate(pairs) if key and normalise_name(name) == key]


def _list_spellings(path: str) -> set[str]:
    """List the spellings of a path with or without quotes and Simulink's line breaks."""
    unquoted = path.replace('"', "")
    unbroken = {text.replace("\\n", "").replace("\n", "") for text in (path, unquoted)}
    return {path, unquoted} | unbroken


def _quote_paths(paths: list[str]) -> str:
    """Join paths in quotes for a message."""
    return ", ".join(f"'{path}'" for path in paths)


def make_names_unique(names: Sequence[str]) -> list[str]:
    """Append a number to repeated names, and replace empty names by the number of the column."""
    labels = [name or f"column {i + 1}" for i, name in enumerate(names)]
    return [
        f"{name} [{labels[: i + 1].count(name)}]" if labels.count(name) > 1 else name
        for i, name in enumerate(labels)
    ]


def make_channel_notes(channels: Sequence[Channel]) -> Iterator[QualityNote]:
    """Make notes on the channels of an export.

    Parameters
    ----------
    channels : channels of the recording

    Yields
    ------
    Notes ``constant_channel``, ``units_not_stated`` and ``names_not_unique``.
    """
    total = len(channels)
    if constant_paths := [channel.path for channel in channels if _is_constant(channel.values)]:
        summary = _describe_paths(constant_paths, total)
        yield QualityNote.of("readers.constant_channel", "channels", which=summary)
    if unitless_paths := [channel.path for channel in channels if not channel.unit_in_file]:
        summary = _describe_paths(unitless_paths, total)
        yield QualityNote.of("readers.units_not_stated", "channels", which=summary)
    names = Counter(channel.name for channel in channels)
    if repeats := [f"{count} are called '{name}'" for name, count in names.items() if count > 1]:
        summary = f"of {total} channels {', '.join(repeats[:_MAX_LISTED_NAMES])}"
        yield QualityNote.of("readers.names_not_unique", "channels", which=summary)


def _describe_paths(paths: list[str], total: int) -> str:
    """Describe the channels that have a property, among `total` channels, for a note."""
    if len(paths) == total:
        return "any channel"
    ending = " ..." if len(paths) > _MAX_LISTED_NAMES else ""
    return f"{len(paths)} of {total} channels: {_quote_paths(paths[:_MAX_LISTED_NAMES])}{ending}"


def _is_constant(values: Floats) -> bool:
    """Return whether all of at least two samples are equal."""
    has_equal_ends = len(values) > 1 and values[0] == values[-1]
    return has_equal_ends and bool(values.min() == values.max())
