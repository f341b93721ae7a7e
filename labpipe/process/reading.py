"""Read the exports of a test sheet into recordings with the names and units of the protocol."""

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

_NO_UNIT = frozenset({"", "-", "1", "count"})
"""Entries of programs for an unknown unit."""
_UNIT_SPELLINGS = MappingProxyType(
    {unit.casefold(): unit for unit in ("N", "kN", "lbf", "kgf", "mm", "cm", "um", "in")}
    | {"newton": "N", "kilonewton": "kN", "lb": "lbf", "pound": "lbf", "inch": "in"}
)
"""Spellings that labpipe does not know, also with an s, and the only unit that each can mean."""


def _unit_fault(channel: Channel, source: ChannelSource, path: Path) -> str:
    """Describe what is wrong with the unit of a channel; empty if nothing is.

    No unit is stated, that of the export is unknown or of another quantity, or `unit` contradicts
    it and `wrong_unit_in_file` does not name it.
    """
    stated, si_unit = channel.unit_in_file, _si_unit(source)
    likely = _known_unit(stated)
    if source.unit is None:
        if stated and _same_unit(stated, stated, si_unit):
            return ""
        expected, found = f"a unit of the dimension of {si_unit}", repr(stated)
        remedy = _unit_remedy(stated, likely, source)
        if not stated:
            expected, found = "a unit", "none in the file and none in the protocol"
    else:
        is_known = stated not in _NO_UNIT and is_unit(likely)
        is_same = _same_unit(likely, source.unit, si_unit)
        if is_same or not is_known or stated == source.wrong_unit_in_file:
            return ""
        expected = f"the unit that the export states, {stated!r}"
        found = f"'{source.key}.unit: {source.unit}'"
        is_alike = _same_unit(likely, likely, si_unit)
        remedy = f"Write {likely} there" if is_alike else _another_channel(source)
        wrong = in_test_sheet(f"{source.key}.wrong_unit_in_file", stated)
        remedy += f". Only if the export's own unit is wrong, add {wrong}."
    place = f"channel {channel.path!r}"
    return error_text(path, place, expected=expected, found=found, remedy=remedy)


def _unit_remedy(stated: str, likely: str, source: ChannelSource) -> str:
    """Say what to do about the unit of an export, if the protocol states none."""
    key, target = source.key, source.target_unit
    if not stated:
        unit = in_test_sheet(f"{key}.unit", target)
        return f"Write the unit of its numbers, such as {unit}."
    if has_dimension_of(stated, "kg") and target == "N":
        unit = in_test_sheet(f"{key}.unit", stated)
        weight = in_test_sheet(f"{key}.calibration", f"{{gain: {GRAVITY} N/kg}}")
        return f"{stated} is a unit of mass. To take its weight, write {unit} and {weight}."
    if stated not in _NO_UNIT and is_unit(stated):
        return f"{_another_channel(source)}, or give '{key}.calibration'."
    unit = likely if _same_unit(likely, likely, target) else "..."
    return f"Write {in_test_sheet(f'{key}.unit', unit)}."


def _unit_notes(channel: Channel, source: ChannelSource) -> list[QualityNote]:
    """Note that the unit of the protocol replaced that of the export."""
    own, stated = source.unit, channel.unit_in_file
    if own is None or not stated or own == stated or _same_unit(own, stated, _si_unit(source)):
        return []
    message = f"the export says {stated!r}, the protocol {own!r}: that of the protocol was used"
    return [QualityNote("unit_overridden", Severity.WARNING, channel.name, message)]


def _si_unit(source: ChannelSource) -> str:
    return source.channel_unit or source.target_unit


def _another_channel(source: ChannelSource) -> str:
    return f"Name another channel with {in_test_sheet(f'{source.key}.channel', '...')}"


def _known_unit(stated: str) -> str:
    """Return the known unit for the spelling of an export, such as kN for KN."""
    word = stated.casefold()
    spelt = _UNIT_SPELLINGS.get(word) or _UNIT_SPELLINGS.get(word.removesuffix("s"), stated)
    return stated if is_unit(stated) else spelt


def _same_unit(one: str, other: str, si_unit: str) -> bool:
    """Check whether two units of a dimension are equal."""
    try:
        return isclose(si_factor(one, si_unit), si_factor(other, si_unit), rel_tol=1e-9)
    except ValueError:
        return False


_TWO_TESTS = (
    "If these are two tests, use a folder for each; else name only one of the files under"
    f" 'files' in {SHEET_NAME}."
)
DIALECT = "dialect"
"""Role of dialect cards of the lab among the inputs of a test."""


def read_inputs(
    folder: Path, sheet: TestSheet, protocol: Protocol
) -> tuple[dict[str, Recording], tuple[InputFile, ...]]:
    """Read the exports of a test sheet, reduced to the channels of the protocol.

    Parameters
    ----------
    folder : of the test
    sheet : its files by role
    protocol : resolved

    Returns
    -------
    recordings : by role; channels have the names of the protocol and SI units
    inputs : the files with their fingerprints, in the same order; then the dialect cards of the lab

    Raises
    ------
    ReadError
        If a file is missing, is not of the format that the protocol names, or lacks a channel.
    """
    files = named_exports(sheet, protocol)
    # Hashing runs in a thread: it takes as long as reading and releases the GIL.
    with ThreadPoolExecutor(max_workers=1) as executor:
        fingerprints = [
            executor.submit(fingerprint, folder / name, role, name) for role, name in files
        ]
        recordings: dict[str, Recording] = {
            role: join_exports(
                [read_role(folder / name, source) for name in sheet.files[role]],
                sheet.files[role],
                folder,
            )
            for role, source in protocol.sources.items()
        }
        inputs = tuple(future.result() for future in fingerprints)
    return recordings, (*inputs, *dialect_cards(protocol))


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


def dialect_cards(protocol: Protocol) -> tuple[InputFile, ...]:
    """Take fingerprints of the dialect cards of the lab, which define how an export is read.

    Parameters
    ----------
    protocol : resolved

    Returns
    -------
    All cards, as inputs of the role `DIALECT`, if a source may be a load-frame export: a new card
    may fit better. None otherwise.

    Raises
    ------
    ReadError
        If a card cannot be read.
    """
    if not any("load-frame" in source.reader for source in protocol.sources.values()):
        return ()
    return tuple(fingerprint(file, DIALECT, file.name) for file in lab_card_files())


def join_exports(parts: Sequence[Recording], names: Sequence[str], folder: Path) -> Recording:
    """Join the parts of one recording in order of time; of empty parts, only the notes are kept.

    Parameters
    ----------
    parts : of one role, with the same channels, in any order
    names : of their files
    folder : of the test, for messages

    Returns
    -------
    One recording with the metadata of the first part and the notes of all.

    Raises
    ------
    ReadError
        If there are no samples at all; if one of several parts holds marker tracks, several clocks,
        or rows without time; or if two parts overlap.
    """
    named = zip(names, parts, strict=False)
    filled = [(folder / name, part) for name, part in named if not is_empty(part)]
    if not filled:
        found = "none in this file" if len(parts) == 1 else "none in any of the parts"
        remedy = "The test was aborted before its first sample; leave it out."
        raise _refused(folder / names[0], "samples", found, remedy)
    if len(filled) > 1:
        for path, part in filled:
            _require_time(path, part)
        filled.sort(key=lambda path_and_part: float(path_and_part[1].clocks[0].time[0]))
    for (path, before), (later_path, after) in pairwise(filled):
        ends, begins = float(before.clocks[0].time[-1]), float(after.clocks[0].time[0])
        if begins <= ends:
            expected = f"a start after {ends:.6f} s, where {path.name} ends"
            remedy = f"Parts of one recording share one clock. {_TWO_TESTS}"
            raise _refused(later_path, expected, f"{begins:.6f} s", remedy, place="time")
    ordered = [part for _, part in filled]
    notes = [note for part in (*ordered, *filter(is_empty, parts)) for note in part.notes]
    first = replace(ordered[0], notes=tuple(notes))
    if len(ordered) == 1:
        return first
    clock = first.clocks[0].name
    time = np.concatenate([part.clocks[0].time for part in ordered])
    channels = tuple(
        replace(
            channel,
            clock=clock,
            values=np.concatenate([part.channels[place].values for part in ordered]),
        )
        for place, channel in enumerate(first.channels)
    )
    return replace(first, clocks=(Clock(clock, time),), channels=channels)


def _refused(path: Path, expected: str, found: str, remedy: str, *, place: str = "") -> ReadError:
    return ReadError(error_text(path, place, expected=expected, found=found, remedy=remedy))


def _require_time(path: Path, part: Recording) -> None:
    """Refuse a part that cannot be put in order of time."""
    if part.markers is not None or len(part.clocks) != 1:
        expected = "a part of a recording: channels on one clock"
        found = "marker tracks" if part.markers is not None else f"{len(part.clocks)} clocks"
        raise _refused(path, expected, found, "Name one export for this role.")
    if part.clocks[0].unit != "s":
        expected = "a part of a recording with times, by which parts are put in order"
        remedy = f"Export the test in one piece, or with its time. {_TWO_TESTS}"
        raise _refused(path, expected, "rows without time", remedy)


def is_empty(recording: Recording) -> bool:
    """Check whether an export holds neither samples nor marker tracks, as after an abort."""
    return recording.markers is None and not any(len(clock.time) for clock in recording.clocks)


def read_role(path: Path, source: Source) -> Recording:
    """Read one export for one role of a protocol.

    Parameters
    ----------
    path : the export
    source : of the protocol

    Returns
    -------
    The recording with only the channels of the protocol, with its names, in SI units; an empty one
    unchanged.

    Raises
    ------
    ReadError
        As `read_inputs`; also if neither file nor protocol states a unit, or they contradict.
    """
    channel_names = [channel.channel for channel in source.all_channels.values()]
    try:
        recording = read_export(
            path, source.reader, channels=channel_names, dialect=source.dialect, part=source.part
        )
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except NoChannelError as error:
        raise ReadError(_channel_fault(error, source, path), code=error.code) from error


def _channel_fault(error: NoChannelError, source: Source, path: Path) -> str:
    """Complete an error with the key that names the channel, or the specimen."""
    max_listed = 8
    if error.parts:
        listed = ", ".join(map(repr, error.parts[:max_listed]))
        more = " ..." if len(error.parts) > max_listed else ""
        part = in_test_sheet(f"{source.key}.part", error.parts[0])
        found, remedy = f"{len(error.parts)}: {listed}{more}", f"Choose one with {part}."
        return error_text(path, "", expected="one specimen", found=found, remedy=remedy)
    keys = [
        channel.key for channel in source.all_channels.values() if channel.channel == error.wanted
    ]
    name = in_test_sheet(f"{keys[0]}.channel", "...") if keys else ""
    return f"{error} Name the right one with {name}." if keys else str(error)


def name_channels(recording: Recording, source: Source, path: Path) -> Recording:
    """Reduce a recording to the channels of a protocol, with its names, in SI units.

    Parameters
    ----------
    recording : from a reader
    source : of the protocol
    path : of the export, for messages

    Returns
    -------
    The recording without channels and clocks that the protocol does not use.

    Raises
    ------
    ReadError
        If channels are missing, or their units are unknown or of another dimension; all faults are
        in one message.
    """
    channels, notes, spelling_notes = list[Channel](), list[QualityNote](), list[QualityNote]()
    faults, code = list[str](), ""
    for name, spec in source.all_channels.items():
        try:
            channel = select_channel(recording, spec.channel, path)
        except NoChannelError as error:
            faults.append(_channel_fault(error, source, path))
            code = error.code
            continue
        if fault := _unit_fault(channel, spec, path):
            faults.append(fault)
            continue
        channels.append(_in_si(channel, name, spec))
        notes += _unit_notes(channels[-1], spec)
        if not is_exact_name(spec.channel, channel):
            wanted = " or ".join(map(repr, spec.channel[:3]))
            wanted += " ..." if len(spec.channel) > 3 else ""
            message = f"the export has none called {wanted}: {channel.path!r} was used"
            spelling_notes.append(
                QualityNote("channel_spelt_otherwise", Severity.INFO, name, message)
            )
    if faults:
        raise ReadError("\n".join(dict.fromkeys(faults)), code=code)
    used_clocks = {channel.clock for channel in channels}
    return replace(
        recording,
        channels=tuple(channels),
        clocks=tuple(clock for clock in recording.clocks if clock.name in used_clocks),
        notes=(*recording.notes, *notes, *spelling_notes),
    )


def _in_si(channel: Channel, name: str, source: ChannelSource) -> Channel:
    """Rename a channel and convert its numbers to SI."""
    unit = _si_unit(source)
    factor = si_factor(source.unit or channel.unit_in_file, unit)
    calibration = source.calibration.gain if source.calibration is not None else ""
    values = channel.values if factor == 1.0 else factor * channel.values
    return replace(channel, name=name, values=values, unit=unit, calibration=calibration)


def fingerprint(path: Path, role: str, name: str) -> InputFile:
    """Take the fingerprint of an input file.

    Parameters
    ----------
    path : of the file
    role, name : see `InputFile`

    Raises
    ------
    ReadError
        If it cannot be read, or is not a regular file.
    """
    try:
        if path.exists() and not path.is_file():  # reading a pipe would never end
            raise OSError(errno.EINVAL, "not a regular file")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return InputFile(role, name, digest, path.stat().st_size)
    except OSError as error:
        found, remedy = error.strerror or "an error", "Check files: in test.yaml."
        raise _refused(path, "an export that can be read", found, remedy) from error
