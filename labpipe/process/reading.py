"""From the exports that a test sheet names to recordings in the protocol's words and units."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import isclose
from pathlib import Path
from types import MappingProxyType

import numpy as np

from labpipe.errors import ReadError, error_text, in_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet
from labpipe.protocol.source import ChannelSource, Source
from labpipe.readers import read_export
from labpipe.readers.channels import NoChannelError, is_exact_name, select_channel
from labpipe.readers.load_frame.cards import lab_card_files
from labpipe.readers.text_cells import has_dimension_of, is_unit
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import InputFile
from labpipe.units import GRAVITY, si_factor

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


def unit_fault(channel: Channel, source: ChannelSource, path: Path) -> str:
    """Word what is wrong with the unit of a channel; empty if nothing is.

    Parameters
    ----------
    channel : as a reader gives it, with the unit that the export states
    source : of the protocol, with the unit that protocol or test sheet say
    path : of the export

    Returns
    -------
    The message: no unit is stated, the export's is unknown or of another quantity, or `unit`
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
    return error_text(
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
    elif has_dimension_of(stated, "kg") and target == "N":
        unit = in_test_sheet(f"{source.key}.unit", stated)
        weight = in_test_sheet(f"{source.key}.calibration", f"{{gain: {GRAVITY} N/kg}}")
        remedy = f"{stated} is a unit of mass. To take its weight, write {unit} and {weight}."
    elif stated not in _SILENT and is_unit(stated):
        remedy = f"{_another_channel(source)}, or give '{source.key}.calibration'."
    place = f"channel {channel.path!r}"
    return error_text(path, place, expected=expected, found=found, remedy=remedy)


def _another_channel(source: ChannelSource) -> str:
    return f"Name another channel with {in_test_sheet(f'{source.key}.channel', '...')}"


def _contradicts(stated: str, said: str, si_unit: str) -> bool:
    """Tell whether two units cannot both be right; one that is unknown says nothing."""
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


_LISTED = 8
"""Specimens that a message lists."""
_TWO_TESTS = (
    "If these are two tests, give each a folder of its own; else name only one of the files under"
    f" 'files' in {SHEET_NAME}."
)
DIALECT = "dialect"
"""Role of a lab's dialect card among the inputs of a test."""


def read_inputs(
    folder: Path, sheet: TestSheet, protocol: Protocol
) -> tuple[dict[str, Recording], tuple[InputFile, ...]]:
    """Read what a test sheet names, reduced to what the protocol asks for.

    Parameters
    ----------
    folder : of the test
    sheet : its files by role
    protocol : resolved

    Returns
    -------
    recordings : by role; channels carry the protocol's names and SI units
    inputs : the files with their fingerprints, in the same order; then the lab's `cards_in_play`

    Raises
    ------
    ReadError
        If a file is missing, is not of the format that the protocol names, or lacks a channel.
    """
    files = named_exports(sheet, protocol)
    # Hashing runs beside reading: it takes as long and lets go of the interpreter.
    with ThreadPoolExecutor(max_workers=1) as beside:
        waiting = [beside.submit(fingerprint, folder / name, role, name) for role, name in files]
        recordings: dict[str, Recording] = {
            role: joined(
                [read_role(folder / name, source) for name in sheet.files[role]],
                sheet.files[role],
                folder,
            )
            for role, source in protocol.sources.items()
        }
        inputs = tuple(each.result() for each in waiting)
    return recordings, (*inputs, *cards_in_play(protocol))


def named_exports(sheet: TestSheet, protocol: Protocol) -> list[tuple[str, str]]:
    """List the exports of a test, in the order of its protocol.

    Parameters
    ----------
    sheet : its files by role
    protocol : resolved

    Returns
    -------
    Role and file of each.
    """
    return [(role, name) for role in protocol.sources for name in sheet.files[role]]


def cards_in_play(protocol: Protocol) -> tuple[InputFile, ...]:
    """Take fingerprints of the lab's own dialect cards, which say how an export is read.

    Parameters
    ----------
    protocol : resolved

    Returns
    -------
    All of them, as inputs of the role `DIALECT`, where a source may be the export of a load frame:
    a card that is added may fit better than the one before. None elsewhere.

    Raises
    ------
    ReadError
        If a card cannot be read.
    """
    if not any("load-frame" in source.reader for source in protocol.sources.values()):
        return ()
    return tuple(fingerprint(file, DIALECT, file.name) for file in lab_card_files())


def joined(parts: Sequence[Recording], names: Sequence[str], folder: Path) -> Recording:
    """Make one recording of all parts; those that took no samples only leave their notes.

    Parameters
    ----------
    parts : of one role, in any order
    names : of their files
    folder : of the test, for messages

    Raises
    ------
    ReadError
        If there are no samples at all, or the parts do not fit together (`join_parts`).
    """
    filled = [number for number, part in enumerate(parts) if not is_empty(part)]
    if not filled:
        message = error_text(
            folder / names[0],
            "",
            expected="samples",
            found="none in this file" if len(parts) == 1 else "none in any of the parts",
            remedy="The test was aborted before its first sample; leave it out.",
        )
        raise ReadError(message)
    whole = parts[filled[0]]
    if len(filled) > 1:
        whole = join_parts([parts[i] for i in filled], [str(folder / names[i]) for i in filled])
    notes = [note for part in parts if is_empty(part) for note in part.notes]
    return replace(whole, notes=(*whole.notes, *notes))


def is_empty(recording: Recording) -> bool:
    """Whether an export holds neither samples nor marker tracks, as an aborted step leaves it."""
    return recording.markers is None and not any(len(clock.time) for clock in recording.clocks)


def read_role(path: Path, source: Source) -> Recording:
    """Read one export for one role of a protocol.

    Parameters
    ----------
    path : the export
    source : of the protocol

    Returns
    -------
    The recording with just the channels that the protocol names, under its names, in SI units;
    one without samples as it is.

    Raises
    ------
    ReadError
        As `read_inputs`; also when neither file nor protocol says a unit, or they contradict.
    """
    wanted = [channel.channel for channel in source.all_channels.values()]
    try:
        recording = read_export(
            path, source.reader, channels=wanted, dialect=source.dialect, part=source.part
        )
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except NoChannelError as error:
        raise ReadError(where_to_name(error, source, path), code=error.code) from error


def where_to_name(error: NoChannelError, source: Source, path: Path) -> str:
    """Say with which key a test sheet names a channel that was not found, or its specimen.

    Parameters
    ----------
    error : of the channel
    source : of the protocol
    path : of the export
    """
    if error.parts:
        listed = ", ".join(map(repr, error.parts[:_LISTED]))
        more = " ..." if len(error.parts) > _LISTED else ""
        part = in_test_sheet(f"{source.key}.part", error.parts[0])
        return error_text(
            path,
            "",
            expected="one specimen",
            found=f"{len(error.parts)}: {listed}{more}",
            remedy=f"Choose one with {part}.",
        )
    keys = [
        all_channel.key
        for all_channel in source.all_channels.values()
        if all_channel.channel == error.wanted
    ]
    name = in_test_sheet(f"{keys[0]}.channel", "...") if keys else ""
    return f"{error} Name the right one with {name}." if keys else str(error)


def name_channels(recording: Recording, source: Source, path: Path) -> Recording:
    """Reduce a recording to the channels of a protocol, under its names, in SI units.

    Parameters
    ----------
    recording : as a reader gives it
    source : of the protocol
    path : of the export, for messages

    Returns
    -------
    The recording without the channels, and the clocks, that are not asked for.

    Raises
    ------
    ReadError
        If a channel is missing, or its unit is unknown or of another dimension.
    """
    found = [
        (select_channel(recording, said.channel, path), name, said)
        for name, said in source.all_channels.items()
    ]
    channels = tuple(_in_si(channel, name, said, path) for channel, name, said in found)
    clocks = {channel.clock for channel in channels}
    kept = tuple(clock for clock in recording.clocks if clock.name in clocks)
    named = zip(channels, source.all_channels.values(), strict=True)
    notes = [note for channel, said in named for note in unit_notes(channel, said)]
    notes += [
        _spelt_note(channel, name, said)
        for channel, name, said in found
        if not is_exact_name(said.channel, channel)
    ]
    return replace(recording, channels=channels, clocks=kept, notes=(*recording.notes, *notes))


def _spelt_note(channel: Channel, name: str, said: ChannelSource) -> QualityNote:
    wanted = " or ".join(map(repr, said.channel[:3])) + (" ..." if len(said.channel) > 3 else "")
    message = f"the export has none called {wanted}: {channel.path!r} was taken"
    return QualityNote("channel_spelt_otherwise", Severity.INFO, name, message)


def join_parts(parts: Sequence[Recording], names: Sequence[str]) -> Recording:
    """Join the parts of one recording, one after the other in time.

    Parameters
    ----------
    parts : recordings with the same channels, in any order
    names : of their files, for messages

    Returns
    -------
    One recording; what the export says of itself is that of the first part, notes are of all.

    Raises
    ------
    ReadError
        If a part holds marker tracks, several clocks, or no sample, or if two parts overlap.
    """
    for part, name in zip(parts, names, strict=True):
        if part.markers is not None or len(part.clocks) != 1 or not len(part.clocks[0].time):
            message = error_text(
                name,
                "",
                expected="a part of a recording: channels on one clock",
                found="marker tracks" if part.markers is not None else f"{len(part.clocks)} clocks",
                remedy="Name one export for this role.",
            )
            raise ReadError(message)
        if part.clocks[0].unit != "s":
            message = error_text(
                name,
                "",
                expected="a part of a recording with times, by which parts are put in order",
                found="rows without time",
                remedy=f"Export the test in one piece, or with its time. {_TWO_TESTS}",
            )
            raise ReadError(message)
    order = sorted(range(len(parts)), key=lambda index: float(parts[index].clocks[0].time[0]))
    for first, second in pairwise(order):
        _refuse_overlap(parts[first], parts[second], names[first], names[second])
    ordered = [parts[index] for index in order]
    clock = ordered[0].clocks[0].name
    time = np.concatenate([part.clocks[0].time for part in ordered])
    channels = tuple(
        replace(
            channel,
            clock=clock,
            values=np.concatenate([part.channels[place].values for part in ordered]),
        )
        for place, channel in enumerate(ordered[0].channels)
    )
    notes = tuple(note for part in ordered for note in part.notes)
    return replace(ordered[0], clocks=(Clock(clock, time),), channels=channels, notes=notes)


def _refuse_overlap(first: Recording, second: Recording, one: str, other: str) -> None:
    ends, begins = float(first.clocks[0].time[-1]), float(second.clocks[0].time[0])
    if begins > ends:
        return
    message = error_text(
        other,
        "time",
        expected=f"a start after {ends:.6f} s, where {Path(one).name} ends",
        found=f"{begins:.6f} s",
        remedy=f"Parts of one recording share one clock. {_TWO_TESTS}",
    )
    raise ReadError(message)


def _in_si(channel: Channel, name: str, source: ChannelSource, path: Path) -> Channel:
    """Rename a channel and turn its numbers into SI, once."""
    if fault := unit_fault(channel, source, path):
        raise ReadError(fault)
    factor = si_factor(source.unit or channel.unit_in_file, _si_unit(source))
    calibration = source.calibration.gain if source.calibration is not None else ""
    values = channel.values if factor == 1.0 else factor * channel.values
    unit = _si_unit(source)
    return replace(channel, name=name, values=values, unit=unit, calibration=calibration)


def fingerprint(path: Path, role: str, name: str) -> InputFile:
    """Take the fingerprint of a file that goes into a test.

    Parameters
    ----------
    path : of the file
    role, name : as `InputFile` has them

    Raises
    ------
    ReadError
        If it cannot be read, or is no plain file.
    """
    try:
        if path.exists() and not path.is_file():  # of a pipe one would wait for the end
            raise OSError(errno.EINVAL, "what is no plain file")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return InputFile(role, name, digest, path.stat().st_size)
    except OSError as error:
        message = error_text(
            path,
            "",
            expected="an export that can be read",
            found=error.strerror or "an error",
            remedy="Look at files: in test.yaml.",
        )
        raise ReadError(message) from error
