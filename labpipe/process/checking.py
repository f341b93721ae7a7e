"""Check protocols and tests against each other and against the exports, without processing."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import ProcessingError, ProtocolError, ReadError, error_text, nearest
from labpipe.process.calibrated_signals import calibrate
from labpipe.process.output_paths import files_below
from labpipe.process.reading import is_empty, join_exports, name_channels
from labpipe.process.steps import run_step
from labpipe.protocol.load import (
    is_there,
    load_calibration_plan,
    load_campaign_plan,
    load_harness,
    load_protocol,
    load_test_sheet,
    missing_exports,
    resolve,
)
from labpipe.protocol.schema import Markers, Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet
from labpipe.protocol.source import Source
from labpipe.protocol.yaml_text import parse_yaml, read_text
from labpipe.readers import read_export, recognise_export
from labpipe.records.declarations import Decimate, LowPass, Smooth, Zero
from labpipe.records.recording import MarkerTracks, Recording
from labpipe.results.beam import BendingStiffness
from labpipe.results.shapes import MidSpan, Twist

_YAML = (".yaml", ".yml")
_INSPECT = "`labpipe inspect` shows what the file holds."


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault.

    Parameters
    ----------
    file : protocol or test sheet
    message : file, place, expected, found, what to do
    """

    file: Path
    message: str


@dataclass(frozen=True, slots=True)
class CheckReport:
    """The checked files and their faults.

    Parameters
    ----------
    protocols, tests : checked files
    findings : all faults, each once
    plans : other checked files: calibration plans, campaign plans, harnesses
    """

    protocols: tuple[Path, ...]
    tests: tuple[Path, ...]
    findings: tuple[Finding, ...]
    plans: tuple[Path, ...] = ()


def check_paths(paths: Sequence[Path] = (), *, follow_links: bool = False) -> CheckReport:
    """Check protocols and tests.

    Parameters
    ----------
    paths : protocols, test sheets, or folders that are searched for them; ``protocols`` and
        ``raw`` in the working folder if empty
    follow_links : whether exports may be links out of the folder of their test

    Returns
    -------
    The report; faults of files are never raised.
    """
    wanted = list(paths) or [path for path in (Path("protocols"), Path("raw")) if path.is_dir()]
    files = list(dict.fromkeys(file for path in wanted for file in _yaml_files(path)))
    tests = tuple(file for file in files if file.name == SHEET_NAME)
    loaders = {file: _loader_of(file) for file in files if file.name != SHEET_NAME}
    plans = tuple(file for file, load in loaders.items() if load is not None)
    others = tuple(file for file, load in loaders.items() if load is None)
    sheets = dict[Path, TestSheet]()
    checks: list[tuple[Path, Iterable[str]]] = [
        *((path, _unusable(path)) for path in wanted or [Path("protocols")]),
        *((other, _protocol_faults(other)) for other in others),
        *((plan, _load_faults(load, plan)) for plan, load in loaders.items() if load is not None),
        *((test, _test_faults(test, sheets, follow_links=follow_links)) for test in tests),
    ]
    findings = [Finding(file, message) for file, messages in checks for message in messages]
    findings += _shared_names(sheets)
    findings_by_message = {finding.message: finding for finding in reversed(findings)}
    return CheckReport(others, tests, tuple(reversed(findings_by_message.values())), plans)


def _yaml_files(path: Path) -> list[Path]:
    if path.is_dir():
        return [file for file in files_below(path) if file.suffix in _YAML and file.is_file()]
    return [path] if path.suffix in _YAML and path.is_file() else []


def _unusable(path: Path) -> Iterator[str]:
    """Find a path with nothing to check."""
    if _yaml_files(path):
        return
    actual = "nothing of that name"
    if path.exists():
        actual = "a folder without any" if path.is_dir() else "another file"
    expected = f"a protocol, a {SHEET_NAME}, or a folder with some"
    remedy = f"`labpipe new` writes a {SHEET_NAME}."
    yield error_text(path, "", expected=expected, found=actual, remedy=remedy)


def _loader_of(path: Path) -> Callable[[Path], object] | None:
    """Return the loader of a YAML file; None for a protocol, even a misspelt one."""
    from labpipe.protocol.campaign_plan import PLAN_NAME
    from labpipe.protocol.harness_file import HarnessFile
    from labpipe.protocol.plans import CalibrationPlan

    if path.name == PLAN_NAME:
        return load_campaign_plan
    try:
        data = parse_yaml(read_text(path), str(path)).data
    except ProtocolError:
        return None
    keys = set(data) if isinstance(data, Mapping) else set()
    if "sources" in keys:
        return None
    other_keys = keys - {*Protocol.keys()}
    if other_keys & {*HarnessFile.keys()} - {*CalibrationPlan.keys()}:
        return load_harness
    return load_calibration_plan if other_keys & {*CalibrationPlan.keys()} else None


def _load_faults(load: Callable[[Path], object], path: Path) -> list[str]:
    """Load a file and list its faults."""
    try:
        load(path)
    except ProtocolError as error:
        return str(error).splitlines()
    return []


def _protocol_faults(path: Path) -> Iterator[str]:
    try:
        protocol = load_protocol(path)
    except ProtocolError as error:
        yield from str(error).splitlines()
        return
    if protocol.name != path.stem:
        expected, remedy = f"the name of the file, {path.stem!r}", "Change one of them."
        yield error_text(
            path, "(name)", expected=expected, found=repr(protocol.name), remedy=remedy
        )


def _test_faults(path: Path, sheets: dict[Path, TestSheet], *, follow_links: bool) -> Iterator[str]:
    """Find what is wrong with a test; its sheet is added to `sheets` if it is valid."""
    try:
        sheet = sheets[path] = load_test_sheet(path)
    except ProtocolError as error:
        yield from str(error).splitlines()
        return
    try:
        protocol = resolve(sheet, path, follow_links=follow_links)
    except ProtocolError as error:
        yield from str(error).splitlines()
        protocol = None
    if protocol is not None:
        yield from _span_faults(path, protocol)
    missing = missing_exports(sheet, path)
    faults = str(missing).splitlines() if missing else []
    recordings: dict[str, list[Recording]] = {role: [] for role in sheet.files}
    for role, names in sheet.files.items():
        source = protocol.sources[role] if protocol else None
        for export in filter(is_there, (path.parent / name for name in names)):
            faults += _export_faults(export, source, protocol, recordings[role])
    yield from faults
    if protocol is not None and not faults:
        yield from _refusals(path, sheet, protocol, recordings)


def _refusals(
    path: Path, sheet: TestSheet, protocol: Protocol, exports: Mapping[str, list[Recording]]
) -> Iterator[str]:
    """Find what `labpipe process` would refuse although each export alone is valid."""
    try:
        recordings: dict[str, Recording] = {
            role: join_exports(exports[role], sheet.files[role], path.parent)
            for role in protocol.sources
        }
        prepared, _ = calibrate(recordings, protocol)
    except ReadError as error:
        yield str(error)
        return
    except ProcessingError as error:
        yield f"{path}, {error}"
        return
    for step in protocol.steps:
        if not isinstance(step, Zero | Smooth | LowPass | Decimate):
            continue
        if step.channel in prepared.signals.filtered:
            try:
                prepared, _ = run_step(prepared, step, protocol)
            except ProcessingError as error:
                yield f"{path}, {error}"


def needs_span(protocol: Protocol) -> list[str]:
    """List the results that need the span, if the protocol does not state it.

    Parameters
    ----------
    protocol : resolved or not
    """
    if protocol.specimen.span is not None:
        return []
    return [
        entry.result
        for entry in protocol.results
        if isinstance(entry, MidSpan | Twist)
        or (isinstance(entry, BendingStiffness) and entry.support == "three-point")
    ]


def _span_faults(path: Path, protocol: Protocol) -> Iterator[str]:
    """Find a test on two supports without a span."""
    results = needs_span(protocol)
    if results:
        yield error_text(
            path,
            "specimen.span",
            expected=f"the distance of the supports (for {', '.join(results)})",
            found="nothing",
            remedy="Write it into the specimen, such as 'span: 152.4 mm'.",
        )


def _export_faults(
    path: Path, source: Source | None, protocol: Protocol | None, recordings: list[Recording]
) -> Iterator[str]:
    """Find what is wrong with one export; only that it can be read, where the protocol failed.

    What is right goes into `recordings`, with the channels of the protocol.
    """
    try:
        if source is None or protocol is None:
            recognise_export(path)
            return
        recording = read_export(path, source.reader, dialect=source.dialect, part=source.part)
    except ReadError as error:
        yield str(error)
        return
    faults = list(_marker_faults(recording.markers, protocol.markers, path))
    try:
        if not is_empty(recording):  # one of several parts, or the only one
            recording = name_channels(recording, source, path)
    except ReadError as error:
        faults = [*str(error).splitlines(), *faults]
    yield from faults
    if not faults:
        recordings.append(recording)


def _marker_faults(
    tracks: MarkerTracks | None, markers: Markers | None, path: Path
) -> Iterator[str]:
    """Find a clamp or markers that are missing in the take."""
    if tracks is None or markers is None:
        return
    bodies = [body.name for body in tracks.bodies]
    if markers.clamp is not None and markers.clamp not in bodies:
        near_names = nearest(markers.clamp, bodies)
        remedy = f"The take has {', '.join(map(repr, near_names))}." if near_names else _INSPECT
        yield error_text(
            path,
            f"rigid body {markers.clamp!r}",
            expected="the rigid body that 'markers.clamp' names",
            found="no such body" if bodies else "no rigid bodies at all",
            remedy=remedy,
        )
    for pattern in () if markers.along == "all" else markers.along:
        if not fnmatch.filter(tracks.names, pattern):
            near_names = nearest(pattern, list(tracks.names))
            remedy = f"Nearest: {', '.join(map(repr, near_names))}." if near_names else _INSPECT
            expected = "markers that 'markers.along' names"
            place = f"markers {pattern!r}"
            yield error_text(path, place, expected=expected, found="none", remedy=remedy)


def _shared_names(sheets: Mapping[Path, TestSheet]) -> Iterator[Finding]:
    """Find tests of one campaign with the same name: they would overwrite each other."""
    seen: dict[tuple[Path, str], Path] = {}
    for path, sheet in sheets.items():
        key = (path.resolve().parent.parent, sheet.test.casefold())
        if key in seen:
            expected, actual = "a name that no other test of the campaign has", repr(sheet.test)
            remedy = f"{seen[key]} has it too: rename one of them."
            text = error_text(path, "(test)", expected=expected, found=actual, remedy=remedy)
            yield Finding(path, text)
        seen.setdefault(key, path)
