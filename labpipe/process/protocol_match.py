"""Match protocols to the exports of a folder: by formats, channels, names and other tests."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from labpipe.errors import LabpipeError, ReadError
from labpipe.messages import format_sentence
from labpipe.process.reading import is_empty, join_exports, name_channels
from labpipe.protocol.load import list_protocols, load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.readers import read_export
from labpipe.records.recording import Recording

Exports: TypeAlias = Mapping[Path, Recording]


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolMatch:
    """A protocol whose roles the exports of a folder fill.

    Parameters
    ----------
    protocol : without overrides of a test
    files : names of the exports by role
    faults : those that `labpipe check` would find
    n_used : number of the files that it reads, plus 1 if the take has its clamp
    ambiguous_roles : roles with several possible exports, which are all in `files`
    reason : sentence on why it was chosen among several; empty if it was the only one
    """

    protocol: Protocol
    files: Mapping[str, tuple[str, ...]]
    faults: tuple[str, ...]
    n_used: int
    ambiguous_roles: frozenset[str]
    reason: str = ""


def load_all_protocols() -> list[Protocol]:
    """Load all valid protocols; `labpipe check` reports the others."""
    protocols = []
    for path in list_protocols().values():
        with suppress(LabpipeError):
            protocols.append(load_protocol(path))
    return protocols


def match_protocols(
    exports: Exports,
    protocols: Sequence[Protocol],
    *,
    names: Sequence[str] = (),
    length: float | None = None,
    siblings: Sequence[Mapping[str, int]] = (),
    stated_files: Mapping[str, tuple[str, ...]] | None = None,
) -> list[ProtocolMatch]:
    """Find the protocols that fit the exports best.

    Parameters
    ----------
    exports : of one test
    protocols : candidates
    names : of the folder, of its exports and of the specimen type
    length : m, free length of the specimen; None if it is not known
    siblings : numbers of other tests by protocol, first those of the same type, then those of the
        whole campaign; tests without a protocol under an empty name
    stated_files : files by role that the user named

    Returns
    -------
    One protocol if it fits better than all others; several that fit equally, by name; none if
    every protocol needs an export that is missing.

    Notes
    -----
    The protocols that use most exports without a fault are compared by these rules, in this order:
    one of `names` contains the name of the protocol; the metadata of an export name the standard
    after which the protocol is named; the protocol states this `length` within 5 %; more than half
    of the `siblings` have it. The first rule that only one protocol meets decides.
    """
    candidates = (_match_protocol(exports, protocol, stated_files or {}) for protocol in protocols)
    matches = [match for match in candidates if match is not None]
    ranks = [(not match.faults, match.n_used) for match in matches]
    best = [match for match, rank in zip(matches, ranks, strict=True) if rank == max(ranks)]
    best.sort(key=lambda match: match.protocol.name)
    if len(best) < 2:
        return best
    texts = [str(text) for export in exports.values() for text in export.metadata.values()]
    namesakes = [match for match in best if _is_named_in(names, match.protocol.name)]
    standards = [match for match in best if _is_standard_in(texts, match.protocol.name)]
    same_length = [match for match in best if _has_length(match.protocol, length)]
    reasons = [
        (format_sentence("process.reason_namesake"), namesakes),
        (format_sentence("process.reason_standard"), standards),
        (format_sentence("process.reason_length"), same_length),
    ]
    for counts in siblings:
        name, total = find_majority(counts), sum(counts.values())
        count = counts.get(name, 0)
        reason = format_sentence("process.reason_siblings", count=count, total=total)
        reasons.append((reason, [match for match in best if match.protocol.name == name]))
    decided = [replace(met[0], reason=reason) for reason, met in reasons if len(met) == 1]
    return decided[:1] or best


def _is_standard_in(texts: Sequence[str], protocol: str) -> bool:
    """Check whether a text contains the standard after which a protocol is named."""
    return re.search(r"\d{3,}", protocol) is not None and _is_named_in(texts, protocol)


def _is_named_in(names: Sequence[str], protocol: str) -> bool:
    """Check whether a name contains the name of a protocol as whole words."""
    words = ("-".join(re.findall(r"[^\W_]+", name.casefold())) for name in names)
    return any(f"-{protocol.casefold()}-" in f"-{name}-" for name in words)


def _has_length(protocol: Protocol, length: float | None) -> bool:
    stated = protocol.specimen.length
    if stated is None or length is None:
        return False
    return abs(length - stated) <= 0.05 * stated


def find_majority(counts: Mapping[str, int]) -> str:
    """Find the protocol of more than half of the tests; empty if there is none.

    Parameters
    ----------
    counts : number of tests by protocol; under an empty name those without one

    Examples
    --------
    >>> find_majority({"tensile": 3, "pet-tape": 1, "": 1})
    'tensile'
    >>> find_majority({"tensile": 6, "": 15})
    ''
    """
    return next((name for name in counts if 2 * counts[name] > sum(counts.values())), "")


def _match_protocol(
    exports: Exports,
    protocol: Protocol,
    stated_files: Mapping[str, tuple[str, ...]],
) -> ProtocolMatch | None:
    """Assign the exports to the roles of a protocol; None if a required role stays empty."""
    if set(stated_files) - set(protocol.sources):
        return None
    unused, files = dict(exports), dict[str, tuple[str, ...]]()
    recordings, faults, ambiguous_roles = list[Recording](), list[str](), set[str]()
    for role, source in protocol.sources.items():
        candidates = {
            path: _read_channels(path, recording, source)
            for path, recording in unused.items()
            if recording.reader in source.reader
            and path.name in stated_files.get(role, (path.name,))
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
            joined = _join(parts) if parts else candidates[paths[0]]
            if isinstance(joined, Recording):
                recordings.append(joined)
            else:
                faults.append(joined)
                ambiguous_roles |= {role} if len(paths) > 1 else set()
    clamp = None if protocol.markers is None else protocol.markers.clamp
    takes = [recording.markers for recording in recordings if recording.markers is not None]
    has_clamp = any(body.name == clamp for take in takes for body in take.bodies)
    if clamp is not None and takes and not has_clamp:
        faults.append(format_sentence("process.match_no_clamp", clamp=clamp))
    n_used = sum(map(len, files.values())) + has_clamp
    return ProtocolMatch(protocol, files, tuple(faults), n_used, frozenset(ambiguous_roles))


def _read_channels(path: Path, recording: Recording, source: Source) -> Recording | str:
    """Read the channels of a protocol from an export, or return the message of the error."""
    try:
        if source.part is not None:
            recording = read_export(path, source.reader, part=source.part)
        return recording if is_empty(recording) else name_channels(recording, source, path)
    except ReadError as error:
        return str(error).splitlines()[0]


def _join(parts: Exports) -> Recording | str:
    """Join the parts of one recording, or return why they cannot be joined."""
    names = [path.name for path in parts]
    with suppress(ReadError):
        return join_exports([*parts.values()], names, Path())
    if len(names) > 1:
        return format_sentence("process.match_ambiguous_role", names=", ".join(names))
    return format_sentence("process.match_no_samples", name=names[0])
