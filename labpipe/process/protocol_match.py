"""Match protocols to the exports of a folder by formats, channels, bodies and motion."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from labpipe.errors import LabpipeError, ReadError
from labpipe.messages import format_sentence
from labpipe.process.reading import is_empty, join_exports, name_channels
from labpipe.protocol.load import list_protocols, load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.readers import read_export
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, MarkerTracks, Recording

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
    for path in list_protocols().values():
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
    each = (_fit_protocol(exports, protocol, names, length, roles or {}) for protocol in protocols)
    fits = [fit for fit in each if fit is not None]
    ranks = [(not fit.faults, fit.uses) for fit in fits]
    alike = [fit for fit, rank in zip(fits, ranks, strict=True) if rank == max(ranks)]
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
                count, total = counts[name], sum(counts.values())
                share = format_sentence("process.sign_siblings", count=count, total=total)
                return [replace(fit, signs=(*fit.signs, (share, _DECISIVE_WEIGHT)))]
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
    unused, files = dict(exports), dict[str, tuple[str, ...]]()
    recordings, faults, unclear = list[Recording](), list[str](), set[str]()
    for role, source in protocol.sources.items():
        candidates = {
            path: _read_channels(path, recording, source)
            for path, recording in unused.items()
            if recording.reader in source.reader
            and path.name in stated.get(role, (path.name,))
            and (source.dialect is None or recording.metadata.get("dialect") in source.dialect)
        }
        parts = {path: part for path, part in candidates.items() if isinstance(part, Recording)}
        paths = list(parts or candidates)
        if not paths and not source.optional:
            return None
        for path in paths:
            del unused[path]
        if paths:
            files[role] = tuple(path.name for path in paths)
            whole = _joined(parts) if parts else candidates[paths[0]]
            if isinstance(whole, Recording):
                recordings.append(whole)
            else:
                faults.append(str(whole))
                unclear |= {role} if len(paths) > 1 else set()
    clamp = None if protocol.markers is None else protocol.markers.clamp
    takes = [recording.markers for recording in recordings if recording.markers is not None]
    has_clamp = any(body.name == clamp for take in takes for body in take.bodies)
    if clamp is not None and takes and not has_clamp:
        faults.append(format_sentence("process.sign_no_clamp", clamp=clamp))
    signs = tuple(_signs(protocol, recordings, names, length))
    uses = sum(map(len, files.values())) + has_clamp
    return Fit(protocol, files, tuple(faults), signs, uses, frozenset(unclear))


def _read_channels(path: Path, recording: Recording, source: Source) -> Recording | str:
    """Read the channels of a protocol from an export, or return what is wrong with them."""
    try:
        if source.part is not None:
            recording = read_export(path, source.reader, part=source.part)
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except ReadError as error:
        return str(error).splitlines()[0]


def _joined(parts: Exports) -> Recording | str:
    """Join the parts of one recording, or return why they are none."""
    names = [path.name for path in parts]
    with suppress(ReadError):
        return join_exports([*parts.values()], names, Path())
    if len(names) > 1:
        return format_sentence("process.sign_unclear_role", names=", ".join(names))
    return format_sentence("process.sign_no_samples", name=names[0])


def _signs(
    protocol: Protocol, recordings: Sequence[Recording], names: Sequence[str], length: float | None
) -> Iterator[Sign]:
    """Yield the signs for and against a protocol whose formats match.

    Within 5 % a size supports a protocol that states it; beyond 30 % it contradicts the protocol.
    """
    match_deviation, mismatch_deviation = 0.05, 0.3
    if name := _first_naming(protocol.name, names):
        yield format_sentence("process.sign_namesake", name=name), _DECISIVE_WEIGHT
    texts = (str(text) for recording in recordings for text in recording.metadata.values())
    if _is_standard(protocol.name) and (text := _first_naming(protocol.name, texts)):
        yield format_sentence("process.sign_standard", name=text), _DECISIVE_WEIGHT
    sizes = [("length", "mm", length or np.nan, protocol.specimen.length)]
    for recording in recordings:
        sizes += _sizes(protocol, recording)
        yield from (("", -1) for channel in recording.channels if _is_odd_peak(protocol, channel))
    for what, unit, size, stated in sizes:
        deviation = abs(size / stated - 1.0) if stated else np.nan  # NaN if nothing was measured
        if stated and deviation <= match_deviation:
            facts = format_sentence(
                "process.sign_size", what=what, unit=unit, size=1e3 * size, stated=1e3 * stated
            )
            yield facts, 1
        elif deviation > mismatch_deviation and what != "length":
            yield "", -1


def _first_naming(protocol: str, texts: Iterable[str]) -> str:
    """Return the first text in which the words of a protocol's name follow each other, or none."""
    for text in texts:
        words = "-".join(re.findall(r"[^\W_]+", text.casefold()))
        if f"-{protocol.casefold()}-" in f"-{words}-":
            return text
    return ""


def _is_standard(protocol: str) -> bool:
    """Check whether a protocol is named after a standard, such as iso-6892."""
    return re.search(r"\d{3,}", protocol) is not None


def _sizes(
    protocol: Protocol, recording: Recording
) -> Iterator[tuple[str, str, float, float | None]]:
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
    block = protocol.markers
    body = None if tracks is None or block is None else tracks.body(block.clamp or "")
    if tracks is not None and block is not None and body is not None:
        origin = _first_position(body.position)
        travel = _largest(np.linalg.norm(body.position - origin, axis=1))
        yield "travel of the clamp", "mm", travel, rig.stroke
        reach = _reach(tracks, f"{block.clamp}:", origin) - block.grip_offset + block.pull_offset
        yield "length seen by the markers", "mm", reach, protocol.specimen.length


def _speed(time: Floats, places: Floats) -> float:
    """Return the mean speed over the middle half of the travel, m/s."""
    travel = np.abs(places - places[0])
    samples = [int(np.argmax(travel >= share * travel.max())) for share in (0.25, 0.75)]
    duration = float(time[samples[1]] - time[samples[0]])
    return float(travel[samples[1]] - travel[samples[0]]) / duration if duration > 0.0 else 0.0


def _reach(tracks: MarkerTracks, prefix: str, origin: Floats) -> float:
    """Return the distance of the farthest marker that is none of the clamp, m."""
    along = [i for i, name in enumerate(tracks.names) if not name.startswith(prefix)]
    first = [_first_position(tracks.positions[:, i]) - origin for i in along]
    return _largest(np.linalg.norm(np.reshape(first, (-1, 3)), axis=1))


def _first_position(positions: Floats) -> Floats:
    """Return the first known position; NaN if there is none."""
    known_positions = positions[~np.isnan(positions).any(axis=1)]
    return np.asarray(known_positions[0] if len(known_positions) else np.full(3, np.nan))


def _largest(values: Floats) -> float:
    """Return the largest finite number; NaN if there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else float("nan")


def _is_odd_peak(protocol: Protocol, channel: Channel) -> bool:
    source = protocol.channels.get(channel.name)
    if source is None or source.peak_range is None:
        return False
    peak, (least, most) = _largest(np.abs(channel.values)), source.peak_range
    return peak < least or peak > most
