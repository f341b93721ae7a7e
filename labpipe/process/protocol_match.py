"""Which protocols fit the exports of a folder: by their kinds, channels, bodies and motion."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isclose
from pathlib import Path

import numpy as np

from labpipe.errors import LabpipeError, ReadError
from labpipe.process.raw_folder import InspectedExport
from labpipe.process.reading import is_empty, joined, name_channels, where_to_name
from labpipe.protocol.load import known_protocols, load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.readers import read_export
from labpipe.readers.channels import NoChannelError
from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks, Recording

_NEAR, _FAR = 0.05, 0.3
"""Within this ratio a measured size speaks for a protocol; beyond this one, against it."""
_Shown = Callable[[float], str]
_STRONG = 2
"""Weight of a sign that decides alone; two weak ones weigh as much."""


@dataclass(frozen=True, slots=True)
class Sign:
    """One thing that speaks for a protocol, or against it.

    Parameters
    ----------
    text : in words
    weight : 1, or 2 for what decides alone; below 0 where it speaks against the protocol
    """

    text: str
    weight: int


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How a protocol fits what lies in a folder.

    Parameters
    ----------
    protocol : without a test's own values
    files : names of the exports by role
    faults : what `labpipe check` would find in them
    signs : what speaks for the protocol, and against it
    uses : how much of the exports it uses: files, and rigid bodies that it names
    unclear : roles for which several exports come into question, which are all in `files`
    """

    protocol: Protocol
    files: Mapping[str, tuple[str, ...]]
    faults: tuple[str, ...]
    signs: tuple[Sign, ...]
    uses: int
    unclear: frozenset[str] = frozenset()

    @property
    def weight(self) -> int:
        """Of all signs together."""
        return sum(sign.weight for sign in self.signs)


@dataclass(frozen=True, slots=True)
class KnownFacts:
    """What is known of a test before its exports are looked at.

    Parameters
    ----------
    names : of the folder, of its exports and of the specimen's type
    length : m, free length as the name of the folder says; None if it does not
    of_type, of_campaign : how many of the other tests of this type, and of all others here, have
        which protocol; those without one yet are counted under an empty name
    roles : files by role that a person named
    """

    names: tuple[str, ...] = ()
    length: float | None = None
    of_type: Mapping[str, int] = field(default_factory=dict)
    of_campaign: Mapping[str, int] = field(default_factory=dict)
    roles: Mapping[str, tuple[str, ...]] | None = None


def all_protocols(protocols: Path | None = None) -> list[Protocol]:
    """Read every protocol that can be named; those that are wrong are for `labpipe check`.

    Parameters
    ----------
    protocols : the lab's folder; ``protocols`` in the working folder if None
    """
    found = []
    for path in known_protocols(protocols).values():
        with suppress(LabpipeError):
            found.append(load_protocol(path))
    return found


def fitting(
    exports: Sequence[InspectedExport], protocols: Sequence[Protocol], known: KnownFacts
) -> list[Fit]:
    """Find the protocols that fit exports best.

    Parameters
    ----------
    exports : of one test
    protocols : that come into question
    known : of the test

    Returns
    -------
    One, where it fits better than every other; several that fit alike, by name; none where every
    protocol needs an export that is not there.

    Notes
    -----
    What the exports and their names show counts first. Where that leaves several, the one that
    most of the other tests of the type have is taken, or else most of all others here.
    """
    fits = [fit for protocol in protocols if (fit := _fit(exports, protocol, known)) is not None]
    if not fits:
        return []
    best = max(_rank(fit) for fit in fits)
    alike = [fit for fit in fits if _rank(fit) == best]
    likely = [fit for fit in alike if fit.weight >= 0] or alike
    if len(likely) == 1:
        return likely
    first, second, *_ = sorted(likely, key=lambda fit: -fit.weight)
    if first.weight >= _STRONG and first.weight > second.weight:
        return [first]
    for among in (known.of_type, known.of_campaign):
        name = majority(among)
        for fit in likely:
            if fit.protocol.name == name:
                share = f"{among[name]} of {sum(among.values())} other tests here have it"
                return [replace(fit, signs=(*fit.signs, Sign(share, _STRONG)))]
    return sorted(likely, key=lambda fit: fit.protocol.name)


def majority(among: Mapping[str, int]) -> str:
    """Find the protocol that more than half of some tests have; empty if none has.

    Parameters
    ----------
    among : number of tests by protocol; under an empty name those that have none yet

    Examples
    --------
    >>> majority({"tensile": 3, "pet-tape": 1, "": 1}), majority({"tensile": 6, "": 15})
    ('tensile', '')
    """
    return next((name for name in among if 2 * among[name] > sum(among.values())), "")


def _rank(fit: Fit) -> tuple[bool, int]:
    return not fit.faults, fit.uses


def _fit(exports: Sequence[InspectedExport], protocol: Protocol, known: KnownFacts) -> Fit | None:
    """Hand out the exports to the roles of a protocol; None where a role stays empty."""
    asked = known.roles or {}
    if set(asked) - set(protocol.sources):
        return None
    left = list(exports)
    found: dict[str, _Found] = {}
    for role, source in protocol.sources.items():
        pool = [each for each in left if each.name in asked[role]] if role in asked else left
        for_role = _for_role(pool, source)
        if for_role.exports:
            found[role] = for_role
            left = [each for each in left if each not in for_role.exports]
        elif not source.optional:
            return None
    seen = {
        role: finding.recording for role, finding in found.items() if finding.recording is not None
    }
    takes = [each.markers for each in seen.values() if each.markers is not None]
    clamp = None if protocol.markers is None else protocol.markers.clamp
    bodies = [body.name for take in takes for body in take.bodies]
    faults = [finding.fault for finding in found.values() if finding.fault]
    if clamp is not None and takes and clamp not in bodies:
        faults.append(f"the take has no rigid body {clamp!r}, which 'markers.clamp' names")
    files = {role: tuple(x.name for x in finding.exports) for role, finding in found.items()}
    return Fit(
        protocol,
        files,
        tuple(faults),
        tuple(_signs(protocol, seen, known)),
        uses=sum(map(len, files.values())) + (clamp in bodies),
        unclear=frozenset(role for role, finding in found.items() if finding.is_unclear),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What there is for a role: exports, their recording, and what is wrong with them."""

    exports: Sequence[InspectedExport] = ()
    recording: Recording | None = None
    fault: str = ""
    is_unclear: bool = False


def _for_role(pool: Sequence[InspectedExport], source: Source) -> _Found:
    """Find the exports of a role: one, or the parts of one recording."""
    of_kind = [
        seen_export
        for seen_export in pool
        if seen_export.reader in source.reader and _speaks(seen_export, source)
    ]
    tried = [(each, *_named(each, source)) for each in of_kind]
    good = [(each, recording) for each, recording, fault in tried if not fault]
    taken = [each for each, _ in good] or of_kind
    names = [each.name for each in taken]
    if len(taken) > 1:
        with suppress(ReadError):
            recordings = [recording for _, recording in good if recording is not None]
            return _Found(taken, joined(recordings, names, taken[0].path.parent))
        several = f"{', '.join(names)} could each be it, and are not parts of one recording"
        return _Found(taken, None, several, is_unclear=True)
    if not taken:
        return _Found()
    _, recording, fault = next(each for each in tried if each[0] is taken[0])
    if recording is not None and is_empty(recording):
        return _Found(taken, None, f"{names[0]}: holds no samples")
    return _Found(taken, recording, fault)


def _speaks(export: InspectedExport, source: Source) -> bool:
    dialect = export.recording.metadata.get("dialect")
    return source.dialect is None or dialect in source.dialect


def _named(export: InspectedExport, source: Source) -> tuple[Recording | None, str]:
    """The channels that a protocol asks of an export, or what is wrong with them."""
    try:
        whole = export.recording
        if source.part is not None:
            whole = read_export(export.path, source.reader, part=source.part)
        if is_empty(whole):
            return whole, ""
        return name_channels(whole, source, export.path), ""
    except NoChannelError as error:
        return None, where_to_name(error, source, export.path)
    except ReadError as error:
        return None, str(error)


def _signs(protocol: Protocol, seen: Mapping[str, Recording], known: KnownFacts) -> Iterator[Sign]:
    """What speaks for a protocol, and against it, beyond that the exports are of its kind."""
    for name in known.names:
        if _is_called(name, protocol.name):
            yield Sign(f"'{name}' is called like it", _STRONG)
            break
    length = protocol.specimen.length
    if length and known.length and isclose(length, known.length, rel_tol=1e-6):
        yield Sign(f"length {_mm(length)} (it states the same)", 1)
    for recording in seen.values():
        yield from _motion_signs(protocol, recording)
        if recording.markers is not None:
            yield from _marker_signs(protocol, recording.markers)
        yield from _peak_signs(protocol, recording)


def _is_called(name: str, protocol: str) -> bool:
    """Check whether the words of a protocol's name follow each other in another name."""
    words = "-".join(re.findall(r"[^\W_]+", name.casefold()))
    return f"-{protocol.casefold()}-" in f"-{words}-"


def _motion_signs(protocol: Protocol, recording: Recording) -> Iterator[Sign]:
    for channel in recording.channels:
        seen = np.isfinite(channel.values)
        if channel.unit != "m" or np.count_nonzero(seen) < 2:
            continue
        time, places = recording.clock(channel.clock), channel.values[seen]
        yield from _compared("travel", float(np.ptp(places)), protocol.rig.stroke, _mm)
        if time.unit == "s":
            speed = _speed(time.time[seen], places)
            yield from _compared("speed", speed, protocol.rig.crosshead_speed, _mm_s)


def _speed(time: Floats, places: Floats) -> float:
    """Typical speed while it moves, m/s: the time that the middle half of the travel takes."""
    way = np.abs(places - places[0])
    passed = [int(np.argmax(way >= share * way.max())) for share in (0.25, 0.75)]
    taken = float(time[passed[1]] - time[passed[0]])
    return float(way[passed[1]] - way[passed[0]]) / taken if taken > 0.0 else 0.0


def _marker_signs(protocol: Protocol, tracks: MarkerTracks) -> Iterator[Sign]:
    words = protocol.markers
    body = None if words is None or words.clamp is None else tracks.body(words.clamp)
    if words is None or body is None:
        return
    travel = _largest(np.linalg.norm(body.position - _start(body.position), axis=1))
    yield from _compared("travel of the clamp", travel, protocol.rig.stroke, _mm)
    reach = seen_length(protocol, tracks)
    if reach is not None and protocol.specimen.length:
        yield from _compared("length seen by the markers", reach, protocol.specimen.length, _mm)


def seen_length(protocol: Protocol, tracks: MarkerTracks) -> float | None:
    """Find the free length that the markers of a take show, roughly.

    Parameters
    ----------
    protocol : with what markers stand for
    tracks : of a take

    Returns
    -------
    m, from the clamped end to the string, if the last marker is on its place; None without a
    clamp or markers.
    """
    words = protocol.markers
    body = None if words is None or words.clamp is None else tracks.body(words.clamp)
    own = [not name.startswith(f"{body.name}:") for name in tracks.names] if body else []
    places = [_start(tracks.positions[:, i]) for i, is_own in enumerate(own) if is_own]
    if words is None or body is None or not places:
        return None
    away = [float(np.linalg.norm(place - _start(body.position))) for place in places]
    known = [each for each in away if np.isfinite(each)]
    return max(known) - words.grip_offset + words.pull_offset if known else None


def _start(positions: Floats) -> Floats:
    """The first place at which something was seen."""
    seen = positions[~np.isnan(positions).any(axis=1)]
    return np.asarray(seen[0] if len(seen) else np.full(3, np.nan))


def _largest(values: Floats) -> float:
    """The largest number; NaN where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else float("nan")


def _peak_signs(protocol: Protocol, recording: Recording) -> Iterator[Sign]:
    for channel in recording.channels:
        source = protocol.channels.get(channel.name)
        if source is None or source.peak_range is None:
            continue
        least, most = source.peak_range
        peak = _largest(np.abs(channel.values))
        if peak < least or peak > most:
            text = f"{channel.name} goes to {peak:.3g} {channel.unit}, plausible is {least:.3g} to"
            yield Sign(f"{text} {most:.3g}", -1)


def _compared(what: str, found: float, stated: float | None, shown: _Shown) -> Iterator[Sign]:
    if not stated or not np.isfinite(found):
        return
    if abs(found / stated - 1.0) <= _NEAR:
        yield Sign(f"{what} {shown(found)} (it states {shown(stated)})", 1)
    elif abs(found / stated - 1.0) > _FAR:
        yield Sign(f"{what} {shown(found)} (it states {shown(stated)})", -1)


def _mm(metres: float) -> str:
    return f"{metres * 1e3:.4g} mm"


def _mm_s(speed: float) -> str:
    return f"{speed * 1e3:.3g} mm/s"
