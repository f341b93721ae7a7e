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
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import InputFile
from labpipe.units import get_conversion_factor

_UNKNOWN_UNITS = frozenset({"", "-", "1", "count"})
"""Units in exports that mean that the unit is unknown."""
_UNIT_SPELLINGS = MappingProxyType(
    {unit.casefold(): unit for unit in ("N", "kN", "lbf", "kgf", "mm", "cm", "um", "in")}
    | {"newton": "N", "kilonewton": "kN", "lb": "lbf", "pound": "lbf", "inch": "in"}
)
"""Unit of each spelling that the unit parser does not know, in lower case without a plural s."""


def _check_unit(channel: Channel, source: ChannelSource, path: Path) -> None:
    """Raise a `ReadError` for a channel whose unit is not certain.

    The unit is not certain if neither export nor protocol states a unit, if only the export states
    one, which is unknown or of another quantity, or if the unit of the protocol contradicts that of
    the export, and `wrong_unit_in_file` does not name it.
    """
    file_unit, key, place = channel.unit_in_file, source.key, f"channel {channel.path!r}"
    si_unit = _choose_si_unit(source, source.unit or file_unit)
    likely_unit = file_unit
    if not is_unit(file_unit):
        spelling = file_unit.casefold()
        likely_unit = _UNIT_SPELLINGS.get(spelling.removesuffix("s"), file_unit)
        likely_unit = _UNIT_SPELLINGS.get(spelling, likely_unit)
    is_known = file_unit not in _UNKNOWN_UNITS and is_unit(likely_unit)
    has_dimension = _are_equal_units(likely_unit, likely_unit, si_unit)
    other_channel, unit_key = format_overrides(f"{key}.channel", "..."), f"{key}.unit"
    if source.unit is not None:
        is_same = _are_equal_units(likely_unit, source.unit, si_unit)
        if is_same or not is_known or file_unit == source.wrong_unit_in_file:
            return
        facts = {
            "file_unit": file_unit,
            "key": f"{unit_key}: {source.unit}",
            "correction": f"Name another channel with {other_channel}",
            "wrong": format_overrides(f"{key}.wrong_unit_in_file", file_unit),
        }
        facts |= {"correction": f"Write {likely_unit} there"} if has_dimension else {}
        raise ReadError.about("process.unit_contradicts", path, place, **facts)
    if not file_unit:
        unit = format_overrides(unit_key, source.target_unit)
        raise ReadError.about("process.no_unit", path, place, unit=unit)
    if has_dimension and likely_unit == file_unit:
        return
    calibration = f"{key}.calibration"
    if source.target_unit == "N" and has_dimension_of(file_unit, "kg"):
        facts = {"file_unit": file_unit, "unit": format_overrides(unit_key, file_unit)}
        remedy = format_sentence("process.unit_of_mass", calibration=calibration, **facts)
    elif is_known and likely_unit == file_unit:
        facts = {"channel": other_channel, "calibration": calibration}
        remedy = format_sentence("process.unit_of_another_quantity", **facts)
    else:
        is_likely = _are_equal_units(likely_unit, likely_unit, source.target_unit)
        unit = format_overrides(unit_key, likely_unit if is_likely else "...")
        remedy = format_sentence("process.unit_unknown", unit=unit)
    facts = {"si_unit": si_unit, "file_unit": file_unit, "remedy": remedy}
    raise ReadError.about("process.wrong_unit", path, place, **facts)


def _choose_si_unit(source: ChannelSource, unit: str) -> str:
    """Choose the SI unit of a channel, which is 1 for an extensometer that gives strain."""
    is_strain = source.is_extension and _are_equal_units(unit, unit, "1")
    return "1" if is_strain else source.channel_unit or source.target_unit


def _are_equal_units(unit: str, other_unit: str, si_unit: str) -> bool:
    """Return whether two units are equal, and have the dimension of an SI unit."""
    try:
        factors = [get_conversion_factor(name, si_unit) for name in (unit, other_unit)]
    except ValueError:
        return False
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
    files = list_named_exports(sheet, protocol)
    # Hashing takes as long as reading. It runs in a thread, because it releases the GIL.
    with ThreadPoolExecutor(max_workers=1) as executor:
        fingerprints = [
            executor.submit(fingerprint, folder / name, role, name) for role, name in files
        ]
        recordings = dict[str, Recording]()
        for role, source in protocol.sources.items():
            parts = [read_role(folder / name, source) for name in sheet.files[role]]
            recordings[role] = join_exports(parts, sheet.files[role], folder)
        inputs = tuple(future.result() for future in fingerprints)
    return recordings, (*inputs, *fingerprint_dialect_cards(protocol))


def list_named_exports(sheet: TestSheet, protocol: Protocol) -> list[tuple[str, str]]:
    """List the exports of a test in the order of its protocol.

    Parameters
    ----------
    sheet : test sheet with the names of the exports
    protocol : resolved protocol

    Returns
    -------
    Role and file name of each export.
    """
    return [(role, name) for role in protocol.sources for name in sheet.files[role]]


def fingerprint_dialect_cards(protocol: Protocol) -> tuple[InputFile, ...]:
    """Compute the SHA-256 of the dialect cards of the lab, which define how exports are read.

    Parameters
    ----------
    protocol : resolved protocol

    Returns
    -------
    All cards as inputs of the role ``dialect`` if a source may be a load-frame export, since any of
    them may fit it best; empty otherwise.

    Raises
    ------
    ReadError
        If a card cannot be read.
    """
    if not any("load-frame" in source.reader for source in protocol.sources.values()):
        return ()
    return tuple(fingerprint(file, "dialect", file.name) for file in list_lab_card_files())


def join_exports(parts: Sequence[Recording], names: Sequence[str], folder: Path) -> Recording:
    """Join the parts of one recording in order of time.

    Parameters
    ----------
    parts : recordings of one role with the same channels, in any order
    names : names of the files of the parts
    folder : folder of the test, for messages

    Returns
    -------
    One recording with the metadata of the first part with samples, and the notes of all parts.

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
            _require_time(path, part)
        parts_with_samples.sort(key=lambda path_and_part: float(path_and_part[1].clocks[0].time[0]))
    for (path, part), (next_path, next_part) in pairwise(parts_with_samples):
        end, start = float(part.clocks[0].time[-1]), float(next_part.clocks[0].time[0])
        if start <= end:
            facts = {"end": end, "part": path, "start": start}
            raise ReadError.about("process.parts_overlap", next_path, "time", **facts)
    ordered_parts = [part for _, part in parts_with_samples]
    notes = [note for part in (*ordered_parts, *filter(is_empty, parts)) for note in part.notes]
    recording = replace(ordered_parts[0], notes=tuple(notes))
    if len(ordered_parts) == 1:
        return recording
    clock = recording.clocks[0].name
    time = np.concatenate([part.clocks[0].time for part in ordered_parts])
    channels = tuple(
        replace(channels[0], clock=clock, values=np.concatenate([x.values for x in channels]))
        for channels in zip(*(part.channels for part in ordered_parts), strict=True)
    )
    return replace(recording, clocks=(Clock(clock, time),), channels=channels)


def _require_time(path: Path, part: Recording) -> None:
    """Raise an error for a part that cannot be put in order of time."""
    if part.markers is not None or len(part.clocks) != 1:
        content = "marker tracks" if part.markers is not None else f"{len(part.clocks)} clocks"
        raise ReadError.about("process.part_of_no_recording", path, found=content)
    if part.clocks[0].unit != "s":
        raise ReadError.about("process.part_without_time", path)


def is_empty(recording: Recording) -> bool:
    """Return whether an export has neither samples nor marker tracks, as after an abort."""
    return recording.markers is None and not any(len(clock.time) for clock in recording.clocks)


def read_role(path: Path, source: Source) -> Recording:
    """Read one export for one role of a protocol.

    Parameters
    ----------
    path : path of the export
    source : source of the protocol

    Returns
    -------
    The recording with the channels of the protocol, which have its names and SI units; a recording
    without samples is unchanged.

    Raises
    ------
    ReadError
        As in `read_inputs`; also if neither file nor protocol states a unit, or if they contradict
        each other.
    """
    channel_names = [channel.names for channel in source.all_channels.values()]
    try:
        recording = read_export(
            path, source.reader, channels=channel_names, dialect=source.dialect, part=source.part
        )
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except NoChannelError as error:
        raise ReadError(_describe_channel_fault(error, source, path), code=error.code) from error


def _describe_channel_fault(error: NoChannelError, source: Source, path: Path) -> str:
    """Describe an error, with the override that selects the channel or the part of the export."""
    max_listed = 8  # parts of the export
    if error.parts:
        names, count = ", ".join(map(repr, error.parts[:max_listed])), len(error.parts)
        names += " ..." if count > max_listed else ""
        part = format_overrides(f"{source.key}.part", error.parts[0])
        fault = ReadError.about("process.several_parts", path, count=count, names=names, part=part)
        return str(fault)
    keys = [channel.key for channel in source.all_channels.values() if channel.names == error.names]
    name = format_overrides(f"{keys[0]}.channel", "...") if keys else ""
    return f"{error} Name the right one with {name}." if keys else str(error)


def name_channels(recording: Recording, source: Source, path: Path) -> Recording:
    """Select the channels of a protocol, and convert them to its names and to SI units.

    Parameters
    ----------
    recording : recording as a reader returns it
    source : source of the protocol
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
        stated_unit = tracks.unit_in_file
        _check_size(tracks.positions, "m", limit, place, stated=stated_unit, remedy=remedy)
    channels, notes, faults = list[Channel](), list[QualityNote](), list[str]()
    code = ""
    for name, spec in source.all_channels.items():
        try:
            channel = select_channel(recording, spec.names, path)
            _check_unit(channel, spec, path)
            converted = _convert_to_si(channel, name, spec)
            _check_channel_size(converted, spec, path)
        except NoChannelError as error:
            faults.append(_describe_channel_fault(error, source, path))
            code = error.code
        except ReadError as error:
            faults.append(str(error))
        else:
            channels.append(converted)
            notes += _make_naming_notes(channel, name, spec)
    if faults:
        raise ReadError("\n".join(dict.fromkeys(faults)), code=code)
    used_clocks = {channel.clock for channel in channels}
    return replace(
        recording,
        channels=tuple(channels),
        clocks=tuple(clock for clock in recording.clocks if clock.name in used_clocks),
        notes=(*recording.notes, *notes),
    )


def _check_channel_size(channel: Channel, source: ChannelSource, path: Path) -> None:
    """Raise an error for values above both the largest value of the unit and the plausible peak."""
    stated_unit, key = source.unit or channel.unit_in_file, source.key
    keys = format_overrides(f"{key}.unit", "...", **{f"{key}.wrong_unit_in_file": stated_unit})
    remedy = format_sentence("process.size_of_channel", unit=keys, peak=f"'{key}.plausible_peak'")
    values, unit = source.gain * channel.values + source.offset, source.target_unit
    limit = max(LARGEST_VALUES.get(unit, np.inf), *(source.peak_range or (0.0, 0.0)))
    place = path, f"channel {channel.path!r}"
    _check_size(values, unit, limit, place, stated=stated_unit, remedy=remedy)


def _check_size(
    values: Floats, unit: str, limit: float, place: tuple[Path, str], *, stated: str, remedy: str
) -> None:
    """Raise an error if a tenth of the values is too large; fewer ones are damaged samples."""
    quantile = 0.9
    if max(np.nanmax(values, initial=0.0), -np.nanmin(values, initial=0.0)) <= limit:
        return
    value = float(np.nanquantile(np.abs(values), quantile))
    if value > limit:
        facts = {"limit": f"{limit:g} {unit}", "found": f"{value:.3g} {unit}", "remedy": remedy}
        raise ReadError.about("process.implausible_size", *place, stated=repr(stated), **facts)


def _make_naming_notes(channel: Channel, name: str, spec: ChannelSource) -> Iterator[QualityNote]:
    """Yield a note on a unit that the protocol overrides, and on a name with another spelling."""
    unit, file_unit = spec.unit, channel.unit_in_file
    if unit and file_unit and not _are_equal_units(unit, file_unit, _choose_si_unit(spec, unit)):
        yield QualityNote.of("process.unit_overridden", name, file_unit=file_unit, unit=unit)
    if not is_exact_name(spec.names, channel):
        max_listed, path = 3, channel.path
        names = " or ".join(map(repr, spec.names[:max_listed]))
        names += " ..." if len(spec.names) > max_listed else ""
        yield QualityNote.of("process.channel_spelt_otherwise", name, names=names, path=path)


def _convert_to_si(channel: Channel, name: str, source: ChannelSource) -> Channel:
    """Rename a channel, and convert its values to SI units."""
    unit = _choose_si_unit(source, source.unit or channel.unit_in_file)
    factor = get_conversion_factor(source.unit or channel.unit_in_file, unit)
    calibration = source.calibration.gain if source.calibration is not None else ""
    values = channel.values if factor == 1.0 else factor * channel.values
    return replace(channel, name=name, values=values, unit=unit, calibration=calibration)


def fingerprint(path: Path, role: str, name: str) -> InputFile:
    """Compute the SHA-256 of an input file.

    Parameters
    ----------
    path : path of the file
    role, name : see `InputFile`

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
