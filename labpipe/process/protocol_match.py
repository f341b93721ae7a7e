"""Match protocols to the exports of a folder by formats, channels, bodies and motion."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isclose

import numpy as np

from labpipe.errors import LabpipeError, ReadError
from labpipe.process.raw_folder import InspectedExport
from labpipe.process.reading import is_empty, join_exports, name_channels
from labpipe.protocol.load import known_protocols, load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.readers import read_export
from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks, Recording

_Format = Callable[[float], str]
_DECISIVE_WEIGHT = 2
"""Weight of a sign that decides alone; two weak signs weigh as much."""


@dataclass(frozen=True, slots=True)
class Sign:
    """A sign for or against a protocol.

    Parameters
    ----------
    text : for people
    weight : 1, or 2 for a decisive sign; negative for a sign against the protocol
    """

    text: str
    weight: int


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How a protocol fits the exports of a folder.

    Parameters
    ----------
    protocol : without a test's own values
    files : names of the exports by role
    faults : those that `labpipe check` would find
    signs : for and against the protocol
    uses : number of files and named rigid bodies that it uses
    unclear : roles with several possible exports, which are all in `files`
    """

    protocol: Protocol
    files: Mapping[str, tuple[str, ...]]
    faults: tuple[str, ...]
    signs: tuple[Sign, ...]
    uses: int
    unclear: frozenset[str] = frozenset()

    @property
    def weight(self) -> int:
        """Return the sum of the weights of all signs."""
        return sum(sign.weight for sign in self.signs)


@dataclass(frozen=True, slots=True)
class KnownFacts:
    """Facts about a test before its exports are inspected.

    Parameters
    ----------
    names : of the folder, of its exports and of the specimen's type
    length : m, free length in the name of the folder; None if there is none
    of_type, of_campaign : number of other tests by protocol, of this type and of all types; those
        without a protocol under an empty name
    roles : files by role that the user named
    """

    names: tuple[str, ...] = ()
    length: float | None = None
    of_type: Mapping[str, int] = field(default_factory=dict)
    of_campaign: Mapping[str, int] = field(default_factory=dict)
    roles: Mapping[str, tuple[str, ...]] | None = None


def all_protocols() -> list[Protocol]:
    """Load all valid protocols; `labpipe check` reports the others."""
    loaded = []
    for path in known_protocols().values():
        with suppress(LabpipeError):
            loaded.append(load_protocol(path))
    return loaded


def match_protocols(
    exports: Sequence[InspectedExport], protocols: Sequence[Protocol], facts: KnownFacts
) -> list[Fit]:
    """Find the protocols that fit the exports best.

    Parameters
    ----------
    exports : of one test
    protocols : candidates
    facts : of the test

    Returns
    -------
    One protocol if it fits better than all others; several that fit equally, by name; none if
    every protocol needs an export that is missing.

    Notes
    -----
    Signs in the exports and their names have priority. If several protocols are left, the one of
    the majority of tests of this type is chosen, or else of all tests of the campaign.
    """
    fits = [
        fit
        for protocol in protocols
        if (fit := _fit_protocol(exports, protocol, facts)) is not None
    ]
    if not fits:
        return []
    best = max(_rank(fit) for fit in fits)
    alike = [fit for fit in fits if _rank(fit) == best]
    likely = [fit for fit in alike if fit.weight >= 0] or alike
    if len(likely) == 1:
        return likely
    first, second, *_ = sorted(likely, key=lambda fit: -fit.weight)
    if first.weight >= _DECISIVE_WEIGHT and first.weight > second.weight:
        return [first]
    for counts in (facts.of_type, facts.of_campaign):
        name = majority(counts)
        for fit in likely:
            if fit.protocol.name == name:
                share = f"{counts[name]} of {sum(counts.values())} other tests here have it"
                return [replace(fit, signs=(*fit.signs, Sign(share, _DECISIVE_WEIGHT)))]
    return sorted(likely, key=lambda fit: fit.protocol.name)


def majority(counts: Mapping[str, int]) -> str:
    """Find the protocol of more than half of the tests; empty if there is none.

    Parameters
    ----------
    counts : number of tests by protocol; under an empty name those without one

    Examples
    --------
    >>> majority({"tensile": 3, "pet-tape": 1, "": 1}), majority({"tensile": 6, "": 15})
    ('tensile', '')
    """
    return next((name for name in counts if 2 * counts[name] > sum(counts.values())), "")


def _rank(fit: Fit) -> tuple[bool, int]:
    return not fit.faults, fit.uses


def _fit_protocol(
    exports: Sequence[InspectedExport], protocol: Protocol, facts: KnownFacts
) -> Fit | None:
    """Assign the exports to the roles of a protocol; None if a role stays empty."""
    stated_roles = facts.roles or {}
    if set(stated_roles) - set(protocol.sources):
        return None
    unused = list(exports)
    by_role: dict[str, _RoleExports] = {}
    for role, source in protocol.sources.items():
        candidates = (
            [export for export in unused if export.name in stated_roles[role]]
            if role in stated_roles
            else unused
        )
        for_role = _exports_of_role(candidates, source)
        if for_role.exports:
            by_role[role] = for_role
            unused = [export for export in unused if export not in for_role.exports]
        elif not source.optional:
            return None
    recordings = {
        role: finding.recording
        for role, finding in by_role.items()
        if finding.recording is not None
    }
    takes = [export.markers for export in recordings.values() if export.markers is not None]
    clamp = None if protocol.markers is None else protocol.markers.clamp
    bodies = [body.name for take in takes for body in take.bodies]
    faults = [finding.fault for finding in by_role.values() if finding.fault]
    if clamp is not None and takes and clamp not in bodies:
        faults.append(f"the take has no rigid body {clamp!r}, which 'markers.clamp' names")
    files = {
        role: tuple(export.name for export in finding.exports) for role, finding in by_role.items()
    }
    return Fit(
        protocol,
        files,
        tuple(faults),
        tuple(_signs(protocol, recordings, facts)),
        uses=sum(map(len, files.values())) + (clamp in bodies),
        unclear=frozenset(role for role, finding in by_role.items() if finding.is_unclear),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _RoleExports:
    """The exports of a role, their recording, and what is wrong with them."""

    exports: Sequence[InspectedExport] = ()
    recording: Recording | None = None
    fault: str = ""
    is_unclear: bool = False


def _exports_of_role(pool: Sequence[InspectedExport], source: Source) -> _RoleExports:
    """Find the exports of a role: one, or the parts of one recording."""
    of_kind = [
        export
        for export in pool
        if export.reader in source.reader
        and (source.dialect is None or export.recording.metadata.get("dialect") in source.dialect)
    ]
    attempts = [(export, *_read_channels(export, source)) for export in of_kind]
    valid = [(export, recording) for export, recording, fault in attempts if not fault]
    chosen = [export for export, _ in valid] or of_kind
    names = [export.name for export in chosen]
    if len(chosen) > 1:
        with suppress(ReadError):
            recordings = [recording for _, recording in valid if recording is not None]
            return _RoleExports(chosen, join_exports(recordings, names, chosen[0].path.parent))
        fault_text = f"{', '.join(names)} could each be it, and are not parts of one recording"
        return _RoleExports(chosen, None, fault_text, is_unclear=True)
    if not chosen:
        return _RoleExports()
    _, recording, fault = next(export for export in attempts if export[0] is chosen[0])
    if recording is not None and is_empty(recording):
        return _RoleExports(chosen, None, f"{names[0]}: holds no samples")
    return _RoleExports(chosen, recording, fault)


def _read_channels(export: InspectedExport, source: Source) -> tuple[Recording | None, str]:
    """Read the channels of a protocol from an export, or return what is wrong with them."""
    try:
        recording = export.recording
        if source.part is not None:
            recording = read_export(export.path, source.reader, part=source.part)
        if is_empty(recording):
            return recording, ""
        return name_channels(recording, source, export.path), ""
    except ReadError as error:
        return None, str(error).splitlines()[0]


def _signs(
    protocol: Protocol, recordings: Mapping[str, Recording], facts: KnownFacts
) -> Iterator[Sign]:
    """Yield the signs for and against a protocol whose formats match."""
    for name in facts.names:
        if _names_protocol(name, protocol.name):
            yield Sign(f"'{name}' is called like it", _DECISIVE_WEIGHT)
            break
    length = protocol.specimen.length
    if length and facts.length and isclose(length, facts.length, rel_tol=1e-6):
        yield Sign(f"length {_mm(length)} (it states the same)", 1)
    for recording in recordings.values():
        yield from _motion_signs(protocol, recording)
        if recording.markers is not None:
            yield from _marker_signs(protocol, recording.markers)
        yield from _peak_signs(protocol, recording)


def _names_protocol(name: str, protocol: str) -> bool:
    """Check whether the words of a protocol's name follow each other in another name."""
    name_words = "-".join(re.findall(r"[^\W_]+", name.casefold()))
    return f"-{protocol.casefold()}-" in f"-{name_words}-"


def _motion_signs(protocol: Protocol, recording: Recording) -> Iterator[Sign]:
    for channel in recording.channels:
        is_finite = np.isfinite(channel.values)
        if channel.unit != "m" or np.count_nonzero(is_finite) < 2:
            continue
        time, places = recording.clock(channel.clock), channel.values[is_finite]
        yield from _size_signs("travel", float(np.ptp(places)), protocol.rig.stroke, _mm)
        if time.unit == "s":
            speed = _speed(time.time[is_finite], places)
            yield from _size_signs("speed", speed, protocol.rig.crosshead_speed, _mm_s)


def _speed(time: Floats, places: Floats) -> float:
    """Return the mean speed over the middle half of the travel, m/s."""
    travel = np.abs(places - places[0])
    samples = [int(np.argmax(travel >= share * travel.max())) for share in (0.25, 0.75)]
    duration = float(time[samples[1]] - time[samples[0]])
    return float(travel[samples[1]] - travel[samples[0]]) / duration if duration > 0.0 else 0.0


def _marker_signs(protocol: Protocol, tracks: MarkerTracks) -> Iterator[Sign]:
    block = protocol.markers
    body = None if block is None or block.clamp is None else tracks.body(block.clamp)
    if block is None or body is None:
        return
    travel = _largest(np.linalg.norm(body.position - _first_position(body.position), axis=1))
    yield from _size_signs("travel of the clamp", travel, protocol.rig.stroke, _mm)
    reach = marked_length(protocol, tracks)
    if reach is not None and protocol.specimen.length:
        yield from _size_signs("length seen by the markers", reach, protocol.specimen.length, _mm)


def marked_length(protocol: Protocol, tracks: MarkerTracks) -> float | None:
    """Estimate the free length from the markers of a take.

    Parameters
    ----------
    protocol : with the positions of the markers
    tracks : of a take

    Returns
    -------
    m, from the clamped end to the string; None without a clamp or markers.
    """
    block = protocol.markers
    body = None if block is None or block.clamp is None else tracks.body(block.clamp)
    is_specimen = [not name.startswith(f"{body.name}:") for name in tracks.names] if body else []
    places = [
        _first_position(tracks.positions[:, i]) for i, is_used in enumerate(is_specimen) if is_used
    ]
    if block is None or body is None or not places:
        return None
    distances = [float(np.linalg.norm(place - _first_position(body.position))) for place in places]
    finite = [distance for distance in distances if np.isfinite(distance)]
    return max(finite) - block.grip_offset + block.pull_offset if finite else None


def _first_position(positions: Floats) -> Floats:
    """Return the first known position."""
    known_positions = positions[~np.isnan(positions).any(axis=1)]
    return np.asarray(known_positions[0] if len(known_positions) else np.full(3, np.nan))


def _largest(values: Floats) -> float:
    """Return the largest finite number; NaN if there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else float("nan")


def _peak_signs(protocol: Protocol, recording: Recording) -> Iterator[Sign]:
    for channel in recording.channels:
        source = protocol.channels.get(channel.name)
        if source is None or source.peak_range is None:
            continue
        lowest, highest = source.peak_range
        peak = _largest(np.abs(channel.values))
        if peak < lowest or peak > highest:
            text = f"{channel.name} goes to {peak:.3g} {channel.unit}, plausible is {lowest:.3g} to"
            yield Sign(f"{text} {highest:.3g}", -1)


def _size_signs(
    what: str, measured: float, stated: float | None, text_of: _Format
) -> Iterator[Sign]:
    # Ratios: within the first a measured size supports a protocol; beyond the second it contradicts
    # it.
    match_deviation, mismatch_deviation = 0.05, 0.3
    if not stated or not np.isfinite(measured):
        return
    if abs(measured / stated - 1.0) <= match_deviation:
        yield Sign(f"{what} {text_of(measured)} (it states {text_of(stated)})", 1)
    elif abs(measured / stated - 1.0) > mismatch_deviation:
        yield Sign(f"{what} {text_of(measured)} (it states {text_of(stated)})", -1)


def _mm(metres: float) -> str:
    return f"{metres * 1e3:.4g} mm"


def _mm_s(speed: float) -> str:
    return f"{speed * 1e3:.3g} mm/s"
