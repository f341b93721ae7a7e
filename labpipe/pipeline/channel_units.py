"""The unit of a channel: what the export states against what protocol and test sheet say."""

from __future__ import annotations

from math import isclose
from pathlib import Path
from types import MappingProxyType

from labpipe.errors import complaint
from labpipe.protocol.overrides import in_test_sheet
from labpipe.protocol.source import ChannelSource
from labpipe.readers.cells import is_unit
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel
from labpipe.units import si_factor

_WORDS = (("newton", "N"), ("kilonewton", "kN"), ("lb", "lbf"), ("pound", "lbf"), ("inch", "in"))
_SILENT = frozenset({"", "-", "1", "count"})
"""What programs write in the place of a unit where they know none."""
_SPELT = MappingProxyType(
    {
        **{unit.casefold(): unit for unit in ("N", "kN", "lbf", "kgf", "mm", "cm", "um", "in")},
        **{f"{word}{s}": unit for word, unit in _WORDS for s in ("", "s")},
    }
)
"""Spellings that are no units to labpipe, and the units that they can only mean."""


def unit_factor(channel: Channel, source: ChannelSource) -> float:
    """Factor from the numbers of a channel to SI.

    Parameters
    ----------
    channel : as a reader gives it; `unit_fault` finds nothing wrong with it
    source : of the protocol
    """
    return si_factor(source.unit or channel.unit_in_file, _si_unit(source))


def unit_fault(channel: Channel, source: ChannelSource, path: Path) -> str:
    """Word what is wrong with the unit of a channel; empty if nothing is.

    Parameters
    ----------
    channel : as a reader gives it, with the unit that the export states
    source : of the protocol, with the unit that protocol or test sheet say
    path : of the export

    Returns
    -------
    The message: nobody says a unit, the export's is unknown or of another quantity, or `unit`
    contradicts it and `wrong_unit_in_file` does not name it.
    """
    stated, said = channel.unit_in_file, source.unit
    if said is None:
        return _stated_fault(channel, source, path)
    if stated == source.wrong_unit_in_file or not _contradicts(stated, said, _si_unit(source)):
        return ""
    key, meant = source.key, _meant(stated)
    is_alike = _same(meant, meant, _si_unit(source))
    remedy = f"Write {meant} there" if is_alike else _another_channel(source)
    wrong = in_test_sheet(f"{key}.wrong_unit_in_file", stated)
    return complaint(
        path,
        f"channel {channel.path!r}",
        expected=f"the unit that the export states, {stated!r}",
        found=f"'{key}.unit: {said}'",
        remedy=f"{remedy}. Only if the export's own unit is wrong, add {wrong}.",
    )


def unit_notes(channel: Channel, source: ChannelSource) -> list[QualityNote]:
    """Say where another unit was taken than the one that the export states.

    Parameters
    ----------
    channel : in SI, with the unit that the export states
    source : of the protocol
    """
    said, stated = source.unit, channel.unit_in_file
    if said is None or not stated or said == stated or _same(said, stated, _si_unit(source)):
        return []
    message = f"the export says {stated!r}, the protocol {said!r}: the protocol was followed"
    return [QualityNote("unit_overridden", Severity.WARNING, channel.name, message)]


def _si_unit(source: ChannelSource) -> str:
    return source.channel_unit or source.target_unit


def _stated_fault(channel: Channel, source: ChannelSource, path: Path) -> str:
    """Word what is wrong with the unit of the export, which is all that is known."""
    stated, target = channel.unit_in_file, source.target_unit
    if stated and _same(stated, stated, target):
        return ""
    expected, found = f"a unit of the dimension of {target}", repr(stated)
    meant = _meant(stated) if _same(_meant(stated), _meant(stated), target) else "..."
    remedy = f"Write {in_test_sheet(f'{source.key}.unit', meant)}."
    if not stated:
        expected, found = "a unit", "none in the file and none in the protocol"
        unit = in_test_sheet(f"{source.key}.unit", target)
        remedy = f"Write the unit of its numbers, such as {unit}."
    elif stated not in _SILENT and is_unit(stated):
        remedy = f"{_another_channel(source)}, or give '{source.key}.calibration'."
    place = f"channel {channel.path!r}"
    return complaint(path, place, expected=expected, found=found, remedy=remedy)


def _another_channel(source: ChannelSource) -> str:
    return f"Name another channel with {in_test_sheet(f'{source.key}.channel', '...')}"


def _contradicts(stated: str, said: str, si_unit: str) -> bool:
    """Tell whether two units cannot both be right; one that nobody can make out says nothing."""
    if stated in _SILENT or _same(stated, said, si_unit):
        return False
    meant = _meant(stated)
    return is_unit(meant) and not _same(meant, said, si_unit)


def _meant(stated: str) -> str:
    """The unit that an export means, whether it writes kN or KN."""
    return stated if is_unit(stated) else _SPELT.get(stated.casefold(), stated)


def _same(one: str, other: str, si_unit: str) -> bool:
    """Tell whether two units of a dimension are one and the same."""
    try:
        return isclose(si_factor(one, si_unit), si_factor(other, si_unit), rel_tol=1e-9)
    except ValueError:
        return False
