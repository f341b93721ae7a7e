"""Match protocols to the exports of a folder by formats, channels, bodies and motion."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import TypeAlias

import numpy as np

from labpipe.errors import LabpipeError, ReadError
from labpipe.process.reading import is_empty, join_exports, name_channels
from labpipe.protocol.load import known_protocols, load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.readers import read_export
from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks, Recording

Exports: TypeAlias = Mapping[Path, Recording]
Sign: TypeAlias = tuple[str, int]
"""What speaks for or against a protocol: a text, and a weight of 1, or 2 for a decisive sign;
negative for a sign against the protocol."""
_DECISIVE_WEIGHT = 2


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
    unclear: frozenset[str]

    @property
    def weight(self) -> int:
        """Sum of the weights of all signs."""
        return sum(weight for _, weight in self.signs)


def all_protocols() -> list[Protocol]:
    """Load all valid protocols; `labpipe check` reports the others."""
    loaded = []
    for path in known_protocols().values():
        with suppress(LabpipeError):
            loaded.append(load_protocol(path))
    return loaded


def match_protocols(
    exports: Exports,
    protocols: Sequence[Protocol],
    *,
    names: Sequence[str] = (),
    length: float | None = None,
    siblings: Sequence[Mapping[str, int]] = (),
    roles: Mapping[str, tuple[str, ...]] | None = None,
) -> list[Fit]:
    """Find the protocols that fit the exports best.

    Parameters
    ----------
    exports : of one test
    protocols : candidates
    names : of the folder, of its exports and of the specimen's type
    length : m, free length in the name of the folder; None if there is none
    siblings : numbers of other tests by protocol, first those of the same type, then those of the
        whole campaign; tests without a protocol under an empty name
    roles : files by role that the user named

    Returns
    -------
    One protocol if it fits better than all others; several that fit equally, by name; none if
    every protocol needs an export that is missing.

    Notes
    -----
    Signs in the exports and their names have priority. If several protocols are left, the one of
    the majority of the first siblings that have one is chosen.
    """
    fits = [
        fit
        for protocol in protocols
        if (fit := _fit_protocol(exports, protocol, names, length, roles or {})) is not None
    ]
    best = max((_rank(fit) for fit in fits), default=None)
    alike = [fit for fit in fits if _rank(fit) == best]
    likely = [fit for fit in alike if fit.weight >= 0] or alike
    if len(likely) < 2:
        return likely
    first, second, *_ = sorted(likely, key=lambda fit: -fit.weight)
    if first.weight >= _DECISIVE_WEIGHT and first.weight > second.weight:
        return [first]
    for counts in siblings:
        name = majority(counts)
        for fit in likely:
            if fit.protocol.name == name:
                share = f"{counts[name]} of {sum(counts.values())} other tests here have it"
                return [replace(fit, signs=(*fit.signs, (share, _DECISIVE_WEIGHT)))]
    return sorted(likely, key=lambda fit: fit.protocol.name)


def _rank(fit: Fit) -> tuple[bool, int]:
    return not fit.faults, fit.uses


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


def _fit_protocol(
    exports: Exports,
    protocol: Protocol,
    names: Sequence[str],
    length: float | None,
    stated: Mapping[str, tuple[str, ...]],
) -> Fit | None:
    """Assign the exports to the roles of a protocol; None if a role stays empty."""
    if set(stated) - set(protocol.sources):
        return None
    unused = dict(exports)
    by_role: dict[str, _RoleExports] = {}
    for role, source in protocol.sources.items():
        candidates = {
            path: recording
            for path, recording in unused.items()
            if role not in stated or path.name in stated[role]
        }
        of_role = _exports_of_role(candidates, source)
        if of_role.paths:
            by_role[role] = of_role
            unused = {path: unused[path] for path in unused if path not in of_role.paths}
        elif not source.optional:
            return None
    recordings = [of_role.recording for of_role in by_role.values() if of_role.recording]
    faults = [of_role.fault for of_role in by_role.values() if of_role.fault]
    clamp = None if protocol.markers is None else protocol.markers.clamp
    takes = [recording.markers for recording in recordings if recording.markers is not None]
    has_clamp = any(body.name == clamp for take in takes for body in take.bodies)
    if clamp is not None and takes and not has_clamp:
        faults.append(f"the take has no rigid body {clamp!r}, which 'markers.clamp' names")
    return Fit(
        protocol,
        {role: tuple(path.name for path in of_role.paths) for role, of_role in by_role.items()},
        tuple(faults),
        tuple(_signs(protocol, recordings, names, length)),
        uses=sum(len(of_role.paths) for of_role in by_role.values()) + has_clamp,
        unclear=frozenset(role for role, of_role in by_role.items() if of_role.is_unclear),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _RoleExports:
    """The exports of a role, their recording, and what is wrong with them."""

    paths: Sequence[Path] = ()
    recording: Recording | None = None
    fault: str = ""
    is_unclear: bool = False


def _exports_of_role(candidates: Exports, source: Source) -> _RoleExports:
    """Find the exports of a role: one, or the parts of one recording."""
    outcomes = {
        path: _read_channels(path, recording, source)
        for path, recording in candidates.items()
        if recording.reader in source.reader
        and (source.dialect is None or recording.metadata.get("dialect") in source.dialect)
    }
    valid = {path: read for path, read in outcomes.items() if isinstance(read, Recording)}
    paths = list(valid or outcomes)
    if not paths:
        return _RoleExports()
    names = [path.name for path in paths]
    if len(paths) > 1:
        with suppress(ReadError):
            return _RoleExports(paths, join_exports([*valid.values()], names, paths[0].parent))
        fault = f"{', '.join(names)} could each be it, and are not parts of one recording"
        return _RoleExports(paths, fault=fault, is_unclear=True)
    outcome = outcomes[paths[0]]
    if isinstance(outcome, str):
        return _RoleExports(paths, fault=outcome)
    if is_empty(outcome):
        return _RoleExports(paths, fault=f"{names[0]}: holds no samples")
    return _RoleExports(paths, outcome)


def _read_channels(path: Path, recording: Recording, source: Source) -> Recording | str:
    """Read the channels of a protocol from an export, or return what is wrong with them."""
    try:
        if source.part is not None:
            recording = read_export(path, source.reader, part=source.part)
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except ReadError as error:
        return str(error).splitlines()[0]


def _signs(
    protocol: Protocol, recordings: Sequence[Recording], names: Sequence[str], length: float | None
) -> Iterator[Sign]:
    """Yield the signs for and against a protocol whose formats match."""
    namesake = next((name for name in names if _names_protocol(name, protocol.name)), None)
    if namesake is not None:
        yield f"'{namesake}' is called like it", _DECISIVE_WEIGHT
    stated_length = protocol.specimen.length
    if stated_length and length and isclose(stated_length, length, rel_tol=1e-6):
        yield f"length {1e3 * length:.4g} mm (it states the same)", 1
    # Ratios: within the first a measured size supports a protocol; beyond the second it
    # contradicts it.
    match_deviation, mismatch_deviation = 0.05, 0.3
    for recording in recordings:
        for what, unit, measured, stated in _sizes(protocol, recording):
            if stated and measured is not None and np.isfinite(measured):
                deviation = abs(measured / stated - 1.0)
                text = f"{what} {1e3 * measured:.4g} {unit} (it states {1e3 * stated:.4g} {unit})"
                if deviation <= match_deviation:
                    yield text, 1
                elif deviation > mismatch_deviation:
                    yield text, -1
        yield from _peak_signs(protocol, recording)


def _names_protocol(name: str, protocol: str) -> bool:
    """Check whether the words of a protocol's name follow each other in another name."""
    name_words = "-".join(re.findall(r"[^\W_]+", name.casefold()))
    return f"-{protocol.casefold()}-" in f"-{name_words}-"


def _sizes(
    protocol: Protocol, recording: Recording
) -> Iterator[tuple[str, str, float | None, float | None]]:
    """Yield sizes that a recording shows: name, unit, and measured and stated size in SI."""
    rig, tracks = protocol.rig, recording.markers
    for channel in recording.channels:
        is_finite = np.isfinite(channel.values)
        if channel.unit == "m" and np.count_nonzero(is_finite) >= 2:
            clock, places = recording.clock(channel.clock), channel.values[is_finite]
            yield "travel", "mm", float(np.ptp(places)), rig.stroke
            if clock.unit == "s":
                speed = _speed(clock.time[is_finite], places)
                yield "speed", "mm/s", speed, rig.crosshead_speed
    body = None if tracks is None else _clamp_positions(protocol, tracks)
    if tracks is not None and body is not None:
        travel = _largest(np.linalg.norm(body - _first_position(body), axis=1))
        yield "travel of the clamp", "mm", travel, rig.stroke
        reach = marked_length(protocol, tracks)
        yield "length seen by the markers", "mm", reach, protocol.specimen.length


def _speed(time: Floats, places: Floats) -> float:
    """Return the mean speed over the middle half of the travel, m/s."""
    travel = np.abs(places - places[0])
    samples = [int(np.argmax(travel >= share * travel.max())) for share in (0.25, 0.75)]
    duration = float(time[samples[1]] - time[samples[0]])
    return float(travel[samples[1]] - travel[samples[0]]) / duration if duration > 0.0 else 0.0


def _clamp_positions(protocol: Protocol, tracks: MarkerTracks) -> Floats | None:
    clamp = None if protocol.markers is None else protocol.markers.clamp
    body = None if clamp is None else tracks.body(clamp)
    return None if body is None else body.position


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
    block, body = protocol.markers, _clamp_positions(protocol, tracks)
    if block is None or body is None:
        return None
    origin = _first_position(body)
    distances = [
        float(np.linalg.norm(_first_position(tracks.positions[:, i]) - origin))
        for i, name in enumerate(tracks.names)
        if not name.startswith(f"{block.clamp}:")
    ]
    finite = [distance for distance in distances if np.isfinite(distance)]
    return max(finite) - block.grip_offset + block.pull_offset if finite else None


def _first_position(positions: Floats) -> Floats:
    """Return the first known position; NaN if there is none."""
    known_positions = positions[~np.isnan(positions).any(axis=1)]
    return np.asarray(known_positions[0] if len(known_positions) else np.full(3, np.nan))


def _largest(values: Floats) -> float:
    """Return the largest finite number; NaN if there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else float("nan")


def _peak_signs(protocol: Protocol, recording: Recording) -> Iterator[Sign]:
    for channel in recording.channels:
        source = protocol.channels.get(channel.name)
        peak = _largest(np.abs(channel.values))
        if source is not None and source.peak_range is not None:
            least, most = source.peak_range
            if peak < least or peak > most:
                text = f"{channel.name} goes to {peak:.3g} {channel.unit}, plausible is"
                yield f"{text} {least:.3g} to {most:.3g}", -1
