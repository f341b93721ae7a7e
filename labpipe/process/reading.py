"""Read the exports of a test sheet into recordings with the names and units of the protocol."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import isclose
from pathlib import Path
from types import MappingProxyType

import numpy as np

from labpipe.errors import ReadError, format_overrides
from labpipe.messages import format_sentence
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.source import LARGEST_VALUES, ChannelSource, Source
from labpipe.readers import read_export
from labpipe.readers.channels import NoChannelError, is_exact_name, select_channel
from labpipe.readers.load_frame.cards import list_lab_card_files
from labpipe.readers.number_table import has_dimension_of, is_unit
from labpipe.readers.recording_checks import TIME_VARIABLE, make_clock_notes
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import InputFile
from labpipe.units import get_conversion_factor

_UNKNOWN_UNITS = frozenset({"", "-", "1", "count"})
"""Units in exports that mean that the unit is unknown."""
_UNIT_SPELLINGS = MappingProxyType(
    {unit.casefold(): unit for unit in ("N", "kN", "lbf", "kgf", "mm", "cm", "um", "in")}
    | {"newton": "N", "kilonewton": "kN", "lb": "lbf", "pound": "lbf", "inch": "in"}
)
"""Unit of each spelling that `labpipe.units` does not accept, in lower case without a plural s."""


def _check_unit(channel: Channel, channel_source: ChannelSource, path: Path) -> None:
    """Raise a `ReadError` for a channel whose unit is not certain.

    The unit is not certain in three cases: Neither export nor protocol states a unit. Only the
    export states a unit, and this unit is unknown or of another quantity. The unit of the protocol
    contradicts that of the export, and is not confirmed by `wrong_unit_in_file`.
    """
    file_unit, key, place = channel.unit_in_file, channel_source.key, f"channel {channel.path!r}"
    si_unit = _choose_si_unit(channel_source, channel_source.unit or file_unit)
    spelling = file_unit.casefold()
    singular_unit = _UNIT_SPELLINGS.get(spelling.removesuffix("s"), file_unit)
    likely_unit = file_unit if is_unit(file_unit) else _UNIT_SPELLINGS.get(spelling, singular_unit)
    is_known = file_unit not in _UNKNOWN_UNITS and is_unit(likely_unit)
    has_dimension = has_dimension_of(likely_unit, si_unit)
    other_channel, unit_key = format_overrides(f"{key}.channel", "..."), f"{key}.unit"
    if channel_source.unit is not None:
        is_same_unit = _are_equal_units(likely_unit, channel_source.unit, si_unit)
        if is_same_unit or not is_known or file_unit == channel_source.wrong_unit_in_file:
            return
        correction = f"Write {likely_unit} there"
        correction = correction if has_dimension else f"Name another channel with {other_channel}"
        wrong = format_overrides(f"{key}.wrong_unit_in_file", file_unit)
        facts = {"file_unit": file_unit, "correction": correction, "wrong": wrong}
        facts |= {"key": f"{unit_key}: {channel_source.unit}"}
        raise ReadError.about("process.unit_contradicts", path, place, **facts)
    if not file_unit:
        unit = format_overrides(unit_key, channel_source.target_unit)
        raise ReadError.about("process.no_unit", path, place, unit=unit)
    if has_dimension and likely_unit == file_unit:
        return
    calibration = f"{key}.calibration"
    if channel_source.target_unit == "N" and has_dimension_of(file_unit, "kg"):
        facts = {"file_unit": file_unit, "unit": format_overrides(unit_key, file_unit)}
        remedy = format_sentence("process.unit_of_mass", calibration=calibration, **facts)
    elif is_known and likely_unit == file_unit:
        facts = {"channel": other_channel, "calibration": calibration}
        remedy = format_sentence("process.unit_of_another_quantity", **facts)
    else:
        is_likely = has_dimension_of(likely_unit, channel_source.target_unit)
        unit = format_overrides(unit_key, likely_unit if is_likely else "...")
        remedy = format_sentence("process.unit_unknown", unit=unit)
    facts = {"si_unit": si_unit, "file_unit": file_unit, "remedy": remedy}
    raise ReadError.about("process.wrong_unit", path, place, **facts)


def _choose_si_unit(channel_source: ChannelSource, unit: str) -> str:
    """Choose the SI unit of a channel, which is 1 for an extensometer that gives strain."""
    is_strain = channel_source.is_extension and has_dimension_of(unit, "1")
    return "1" if is_strain else channel_source.channel_unit or channel_source.target_unit


def _are_equal_units(unit: str, other_unit: str, si_unit: str) -> bool:
    """Return whether two units are equal and have the dimension of an SI unit."""
    if not (has_dimension_of(unit, si_unit) and has_dimension_of(other_unit, si_unit)):
        return False
    factors = [get_conversion_factor(name, si_unit) for name in (unit, other_unit)]
    return isclose(*factors, rel_tol=1e-9)


def read_inputs(
    folder: Path, sheet: TestSheet, protocol: Protocol
) -> tuple[dict[str, Recording], tuple[InputFile, ...]]:
    """Read the channels of the protocol from the exports of a test sheet.

    Parameters
    ----------
    folder : folder of the test
    sheet : test sheet with the names of the exports
    protocol : resolved protocol

    Returns
    -------
    recordings : recordings, keyed by role; channels have the names of the protocol and SI units
    inputs : exports with their SHA-256 in the order of the protocol, then the dialect cards of the
        lab

    Raises
    ------
    ReadError
        If a file is missing, is not of the format that the protocol names, or lacks a channel.
    """
    # Hashing takes as long as reading. It runs in a thread, because it releases the GIL.
    with ThreadPoolExecutor(max_workers=1) as executor:
        input_files = executor.submit(fingerprint_inputs, folder, sheet, protocol)
        recordings = dict[str, Recording]()
        for role, source in protocol.sources.items():
            parts = [read_role_export(folder / name, source) for name in sheet.files[role]]
            recordings[role] = join_exports(parts, sheet.files[role], folder)
        return recordings, input_files.result()


def fingerprint_inputs(folder: Path, sheet: TestSheet, protocol: Protocol) -> tuple[InputFile, ...]:
    """Compute the SHA-256 of the inputs of a test.

    Parameters
    ----------
    folder, sheet, protocol : as for `read_inputs`

    Returns
    -------
    The exports in the order of the protocol, then the dialect cards of the lab.

    Raises
    ------
    ReadError
        If an export or a card cannot be read.
    """
    fingerprints = [
        fingerprint(folder / name, role, name)
        for role in protocol.sources
        for name in sheet.files[role]
    ]
    return (*fingerprints, *fingerprint_dialect_cards(protocol))


def fingerprint_dialect_cards(protocol: Protocol) -> tuple[InputFile, ...]:
    """Compute the SHA-256 of the dialect cards of the lab, which define how exports are read.

    Parameters
    ----------
    protocol : resolved protocol

    Returns
    -------
    All cards as inputs of the role ``dialect`` if a source may be a load-frame export, because any
    card may fit the export best; empty otherwise.

    Raises
    ------
    ReadError
        If a card cannot be read.
    """
    if not any("load-frame" in source.reader for source in protocol.sources.values()):
        return ()
    return tuple(fingerprint(file, "dialect", file.name) for file in list_lab_card_files())


def join_exports(parts: Sequence[Recording], names: Sequence[str], folder: Path) -> Recording:
    """Join the parts of one recording, sorted by time.

    Parameters
    ----------
    parts : recordings of one role with the same channels, in any order
    names : names of the files of the parts
    folder : folder of the test, for messages

    Returns
    -------
    One recording with the metadata of the earliest part with samples, and the notes of all parts.
    If several parts have samples, the notes on their time axes are replaced by those on the joined
    axis, which report gaps between parts.

    Raises
    ------
    ReadError
        If no part has samples, if two parts overlap in time, or if one of several parts with
        samples has marker tracks, several clocks, or rows without time.
    """
    named_parts = zip(names, parts, strict=False)
    parts_with_samples = [(folder / name, part) for name, part in named_parts if not is_empty(part)]
    if not parts_with_samples:
        where = "this file" if len(parts) == 1 else "any of the parts"
        raise ReadError.about("process.no_samples", folder / names[0], where=where)
    if len(parts_with_samples) > 1:
        for path, part in parts_with_samples:
            _check_sortable(path, part)
        parts_with_samples.sort(key=lambda path_and_part: float(path_and_part[1].clocks[0].time[0]))
    for (path, part), (next_path, next_part) in pairwise(parts_with_samples):
        part_end, next_start = float(part.clocks[0].time[-1]), float(next_part.clocks[0].time[0])
        if next_start <= part_end:
            facts = {"end": part_end, "part": path, "start": next_start}
            raise ReadError.about("process.parts_overlap", next_path, "time", **facts)
    ordered_parts = [part for _, part in parts_with_samples]
    notes = [note for part in ordered_parts for note in part.notes]
    empty_part_notes = [note for part in filter(is_empty, parts) for note in part.notes]
    first_part = ordered_parts[0]
    if len(ordered_parts) == 1:
        return replace(first_part, notes=(*notes, *empty_part_notes))
    times = [part.clocks[0].time for part in ordered_parts]
    clock = Clock(first_part.clocks[0].name, np.concatenate(times))
    channels = tuple(
        replace(channels[0], clock=clock.name, values=np.concatenate([x.values for x in channels]))
        for channels in zip(*(part.channels for part in ordered_parts), strict=True)
    )
    is_variable = any((x.code, x.severity) == (TIME_VARIABLE, Severity.INFO) for x in notes)
    clock_notes = make_clock_notes(clock, is_variable=is_variable)
    notes = [note for note in notes if not note.where.startswith("clock ")]
    notes += [*clock_notes, *empty_part_notes]
    return replace(first_part, clocks=(clock,), channels=channels, notes=tuple(notes))


def _check_sortable(path: Path, part: Recording) -> None:
    """Raise an error for a part that cannot be sorted by time."""
    if part.markers is not None or len(part.clocks) != 1:
        content = "marker tracks" if part.markers is not None else f"{len(part.clocks)} clocks"
        raise ReadError.about("process.part_of_no_recording", path, found=content)
    if part.clocks[0].unit != "s":
        raise ReadError.about("process.part_without_time", path)


def is_empty(recording: Recording) -> bool:
    """Return whether a recording has neither samples nor marker tracks, as after an abort."""
    return recording.markers is None and not any(len(clock.time) for clock in recording.clocks)


def read_role_export(path: Path, source: Source) -> Recording:
    """Read one export for one role of a protocol.

    Parameters
    ----------
    path : path of the export
    source : source of the protocol for the role

    Returns
    -------
    The recording with the channels of the protocol, in SI units and under the names of the
    protocol. A recording without samples is unchanged.

    Raises
    ------
    ReadError
        As in `read_inputs`; also if neither file nor protocol states a unit, or if they contradict
        each other.
    """
    channel_names = [channel_source.names for channel_source in source.all_channels.values()]
    try:
        recording = read_export(
            path, source.reader, channels=channel_names, dialect=source.dialect, part=source.part
        )
        return recording if is_empty(recording) else convert_channels(recording, source, path)
    except NoChannelError as error:
        raise ReadError(_describe_channel_fault(error, source, path), code=error.code) from error


def _describe_channel_fault(error: NoChannelError, source: Source, path: Path) -> str:
    """Describe a missing channel or several parts, and the override that selects the right one."""
    max_listed = 8  # parts of the export
    if error.parts:
        names, count = ", ".join(map(repr, error.parts[:max_listed])), len(error.parts)
        names += " ..." if count > max_listed else ""
        part = format_overrides(f"{source.key}.part", error.parts[0])
        fault = ReadError.about("process.several_parts", path, count=count, names=names, part=part)
        return str(fault)
    keys = [x.key for x in source.all_channels.values() if x.names == error.names]
    override = format_overrides(f"{keys[0]}.channel", "...") if keys else ""
    return f"{error} Name the right one with {override}." if keys else str(error)


def convert_channels(recording: Recording, source: Source, path: Path) -> Recording:
    """Convert the channels of a protocol to its names and to SI units.

    Parameters
    ----------
    recording : recording as a reader returns it
    source : source of the protocol for the role of the recording
    path : path of the export, for messages

    Returns
    -------
    The recording without channels and clocks that the protocol does not use.

    Raises
    ------
    ReadError
        If channels are missing, or their units are unknown, of another dimension or wrong by
        orders of magnitude. The message lists all faults.
    """
    if recording.markers is not None:
        tracks, remedy = recording.markers, format_sentence("process.size_of_markers")
        limit, place = LARGEST_VALUES["m"], (path, "markers")
        raw_unit = tracks.unit_in_file
        _check_magnitude(tracks.positions, "m", limit, place, raw_unit=raw_unit, remedy=remedy)
    channels, notes, faults = list[Channel](), list[QualityNote](), list[str]()
    code = ""
    for name, channel_source in source.all_channels.items():
        try:
            channel = select_channel(recording, channel_source.names, path)
            _check_unit(channel, channel_source, path)
            converted_channel = _convert_to_si(channel, name, channel_source)
            _check_channel_magnitude(converted_channel, channel_source, path)
        except NoChannelError as error:
            faults.append(_describe_channel_fault(error, source, path))
            code = error.code
        except ReadError as error:
            faults.append(str(error))
        else:
            channels.append(converted_channel)
            notes += _make_notes(channel, name, channel_source)
    if faults:
        raise ReadError("\n".join(dict.fromkeys(faults)), code=code)
    used_clocks = {channel.clock for channel in channels}
    return replace(
        recording,
        channels=tuple(channels),
        clocks=tuple(clock for clock in recording.clocks if clock.name in used_clocks),
        notes=(*recording.notes, *notes),
    )


def _check_channel_magnitude(channel: Channel, channel_source: ChannelSource, path: Path) -> None:
    """Raise an error for values above both the largest value of the unit and the plausible peak."""
    raw_unit, key = channel_source.unit or channel.unit_in_file, channel_source.key
    keys = format_overrides(f"{key}.unit", "...", **{f"{key}.wrong_unit_in_file": raw_unit})
    remedy = format_sentence("process.size_of_channel", unit=keys, peak=f"'{key}.plausible_peak'")
    values = channel_source.gain * channel.values + channel_source.offset
    unit, place = channel_source.target_unit, (path, f"channel {channel.path!r}")
    limit = max(LARGEST_VALUES.get(unit, np.inf), *(channel_source.peak_range or (0.0, 0.0)))
    _check_magnitude(values, unit, limit, place, raw_unit=raw_unit, remedy=remedy)


def _check_magnitude(
    values: Floats, unit: str, limit: float, place: tuple[Path, str], *, raw_unit: str, remedy: str
) -> None:
    """Raise an error if a tenth of the values exceeds a limit; a smaller part may be damaged.

    The message states `raw_unit`, which is the unit before the conversion to `unit`.
    """
    quantile = 0.9
    if max(np.nanmax(values, initial=0.0), -np.nanmin(values, initial=0.0)) <= limit:
        return
    value = float(np.nanquantile(np.abs(values), quantile))
    if value > limit:
        facts = {"limit": f"{limit:g} {unit}", "found": f"{value:.3g} {unit}", "remedy": remedy}
        raise ReadError.about("process.implausible_size", *place, stated=repr(raw_unit), **facts)


def _make_notes(
    channel: Channel, name: str, channel_source: ChannelSource
) -> Iterator[QualityNote]:
    """Yield a note on a unit that the protocol overrides, and one on a name spelt differently."""
    unit, file_unit, names = channel_source.unit or "", channel.unit_in_file, channel_source.names
    si_unit = _choose_si_unit(channel_source, unit)
    if unit and file_unit and not _are_equal_units(unit, file_unit, si_unit):
        yield QualityNote.of("process.unit_overridden", name, file_unit=file_unit, unit=unit)
    if not is_exact_name(names, channel):
        max_listed, path = 3, channel.path
        name_list = " or ".join(map(repr, names[:max_listed]))
        name_list += " ..." if len(names) > max_listed else ""
        yield QualityNote.of("process.channel_spelt_otherwise", name, names=name_list, path=path)


def _convert_to_si(channel: Channel, name: str, channel_source: ChannelSource) -> Channel:
    """Rename a channel, and convert its values to SI units."""
    stated_unit = channel_source.unit or channel.unit_in_file
    unit = _choose_si_unit(channel_source, stated_unit)
    factor = get_conversion_factor(stated_unit, unit)
    gain = "" if channel_source.calibration is None else channel_source.calibration.gain
    values = channel.values if factor == 1.0 else factor * channel.values
    return replace(channel, name=name, values=values, unit=unit, calibration=gain)


def fingerprint(path: Path, role: str, name: str) -> InputFile:
    """Compute the SHA-256 and the size of an input file.

    Parameters
    ----------
    path : path of the file
    role, name : role and name under which the file is listed, see `InputFile`

    Raises
    ------
    ReadError
        If the file cannot be read, or is not a regular file.
    """
    try:
        if path.exists() and not path.is_file():  # reading a pipe may never end
            raise OSError(errno.EINVAL, "not a regular file")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return InputFile(role, name, digest, path.stat().st_size)
    except OSError as error:
        reason = error.strerror or "an error"
        raise ReadError.about("process.export_unreadable", path, found=reason) from error
