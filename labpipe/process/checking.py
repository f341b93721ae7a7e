"""Check protocols, tests with their exports, plans and harness files for `labpipe check`."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

from labpipe.errors import LabpipeError, ProcessingError, ProtocolError, ReadError, sort_by_likeness
from labpipe.process.output_paths import list_files_below
from labpipe.process.reading import join_exports, read_role_export
from labpipe.process.steps import PreparedTest, calibrate, run_step
from labpipe.protocol.load import (
    find_export_error,
    load_calibration_plan,
    load_campaign_plan,
    load_harness,
    load_protocol,
    load_test_sheet,
    path_exists,
    resolve_protocol,
)
from labpipe.protocol.schema import Markers, Protocol
from labpipe.protocol.sheet_grammar import PLAN_NAME, SHEET_NAME, TestSheet
from labpipe.protocol.yaml_text import parse_yaml, read_text
from labpipe.readers import recognise_export
from labpipe.records.declarations import Decimate, LowPass, Smooth, Zero
from labpipe.records.recording import MarkerTracks, Recording
from labpipe.results.bending import BendingStiffness, MidSpan, Twist
from labpipe.results.tension import TensionResult

_YAML_SUFFIXES = (".yaml", ".yml")
_SIZE_EXAMPLES = {
    "span": ("the distance between the supports", "span: 152.4 mm"),
    "gauge_length": ("the gauge length", "gauge_length: 50 mm"),
    "section.area": ("the area of the cross-section", "section: {area: 20 mm^2}"),
}
"""Meaning of each size that results need, and an example of its entry in the sheet."""
_AREA_SIZES = (["section.width", "section.thickness"], ["section.outer_diameter"])
"""Sets of sizes. Each set can replace ``section.area``, because it determines the area."""
_T = TypeVar("_T")


@dataclass(slots=True)
class CheckReport:
    """Checked files and their faults.

    Parameters
    ----------
    protocols, tests : paths of the checked protocols and test sheets
    plans : paths of the checked calibration plans, campaign plans and harness files
    faults : messages with file, place, expected and found content, and remedy
    """

    protocols: list[Path] = field(default_factory=list)
    tests: list[Path] = field(default_factory=list)
    plans: list[Path] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def attempt(self, function: Callable[[], _T], *, place: str = "") -> _T | None:
        """Call a function, and record a `LabpipeError` that it raises.

        Parameters
        ----------
        function : function without arguments, such as one that loads a file
        place : prefix for the message of a `ProcessingError`, which does not name the file

        Returns
        -------
        The value of the function; None if it raised an error.
        """
        try:
            return function()
        except ProcessingError as error:
            self.faults.append(f"{place}{error}")
        except LabpipeError as error:
            self.add(error)
        return None

    def add(self, *errors: LabpipeError) -> None:
        """Record the faults of errors; each line of a message is one fault."""
        self.faults += [fault for error in errors for fault in str(error).splitlines()]


def check_paths(paths: Sequence[Path] = (), *, follow_links: bool = False) -> CheckReport:
    """Check protocols, tests, plans and harness files.

    Parameters
    ----------
    paths : YAML files, or folders that are searched for them; if empty, the folders ``protocols``
        and ``raw`` in the working folder
    follow_links : whether exports may be links to files outside of the folder of their test

    Returns
    -------
    The report with each fault once. Faults of files are not raised.
    """
    report, files = CheckReport(), dict[Path, None]()
    default_paths = [path for path in (Path("protocols"), Path("raw")) if path.is_dir()]
    for path in paths or default_paths or [Path("protocols")]:
        candidates = list_files_below(path) if path.is_dir() else [path]
        yaml_files = [x for x in candidates if x.suffix in _YAML_SUFFIXES and x.is_file()]
        files |= dict.fromkeys(yaml_files)
        if not yaml_files:
            content = "a folder without YAML files" if path.is_dir() else "a file of another kind"
            content = content if path.exists() else "nothing of that name"
            report.add(ProtocolError.about("process.nothing_to_check", path, found=content))
    for file in files:
        load = _select_loader(file)
        if file.name == SHEET_NAME:
            report.tests.append(file)
        elif load is not None:
            report.plans.append(file)
            report.attempt(partial(load, file))
        else:
            report.protocols.append(file)
            protocol = report.attempt(partial(load_protocol, file))
            if protocol is not None and protocol.name != file.stem:
                facts = {"file": file.stem, "name": protocol.name}
                report.add(ProtocolError.about("process.other_name", file, "(name)", **facts))
    sheets = {file: _check_test(file, report, follow_links=follow_links) for file in report.tests}
    report.add(*_find_duplicate_names({file: sheet for file, sheet in sheets.items() if sheet}))
    report.faults = list(dict.fromkeys(report.faults))
    return report


def _select_loader(path: Path) -> Callable[[Path], object] | None:
    """Select the loader of a plan or harness file; None for any other file."""
    from labpipe.protocol.model_files import CalibrationPlan, HarnessFile

    if path.name == PLAN_NAME:
        return load_campaign_plan
    try:
        data = parse_yaml(read_text(path), str(path)).data
    except ProtocolError:
        return None
    if not isinstance(data, Mapping) or "sources" in data:  # only protocols have sources
        return None
    non_protocol_keys, plan_keys = {*data} - {*Protocol.list_keys()}, {*CalibrationPlan.list_keys()}
    if non_protocol_keys & {*HarnessFile.list_keys()} - plan_keys:
        return load_harness
    return load_calibration_plan if non_protocol_keys & plan_keys else None


def _check_test(path: Path, report: CheckReport, *, follow_links: bool) -> TestSheet | None:
    """Check the sheet of a test, its exports, and the steps on single channels.

    Returns
    -------
    The sheet; None if the sheet is not valid.
    """
    sheet = report.attempt(partial(load_test_sheet, path))
    if sheet is None:
        return None
    protocol = report.attempt(partial(resolve_protocol, sheet, path, follow_links=follow_links))
    missing_sizes = find_missing_sizes(protocol) if protocol is not None else {}
    for size, results in missing_sizes.items():
        meaning, example = _SIZE_EXAMPLES[size]
        facts = {"meaning": meaning, "results": ", ".join(results), "example": example}
        report.add(ProtocolError.about("process.size_missing", path, f"specimen.{size}", **facts))
    n_faults_before = len(report.faults)
    report.add(*filter(None, [find_export_error(sheet, path)]))
    recordings_by_role: dict[str, list[Recording]] = {role: [] for role in sheet.files}
    for role, file_names in sheet.files.items():
        for file in filter(path_exists, (path.parent / name for name in file_names)):
            if protocol is None:
                report.attempt(partial(recognise_export, file))
                continue
            recording = report.attempt(partial(read_role_export, file, protocol.sources[role]))
            if recording is not None:
                recordings_by_role[role].append(recording)
                report.add(*_find_missing_markers(recording.markers, protocol.markers, file))
    has_sizes = "gauge_length" not in missing_sizes  # steps need no other size
    if protocol is not None and has_sizes and len(report.faults) == n_faults_before:
        _check_steps(path, sheet, protocol, recordings_by_role, report)
    return sheet


def _check_steps(
    path: Path,
    sheet: TestSheet,
    protocol: Protocol,
    recordings_by_role: Mapping[str, list[Recording]],
    report: CheckReport,
) -> None:
    """Join and calibrate the exports, run the steps on single channels, and report their faults."""

    def join_and_calibrate() -> PreparedTest:
        recordings = dict[str, Recording]()
        for role in protocol.sources:
            parts = recordings_by_role[role]
            recordings[role] = join_exports(parts, sheet.files[role], path.parent)
        return calibrate(recordings, protocol)[0]

    place = f"{path}, "
    prepared = report.attempt(join_and_calibrate, place=place)
    for step in protocol.steps:
        if prepared is None or not isinstance(step, Zero | Smooth | LowPass | Decimate):
            continue
        if step.channel in prepared.signals.filtered:
            run = partial(run_step, prepared, step, protocol)
            prepared, _ = report.attempt(run, place=place) or (prepared, [])


def find_missing_sizes(protocol: Protocol, sizes: Collection[str] = ()) -> dict[str, list[str]]:
    """Find the sizes of the specimen that results need but neither protocol nor sheet states.

    Parameters
    ----------
    protocol : protocol, resolved or not
    sizes : names of the sizes that a test sheet states, such as ``section.area``

    Returns
    -------
    Names of the results that need a size, keyed by ``span``, ``gauge_length`` or ``section.area``.
    """
    specimen, section = protocol.specimen, protocol.specimen.section
    known_sizes = {key for key, size in specimen if size is not None} | {*sizes}
    known_sizes |= {f"section.{key}" for key, size in section or () if size is not None}
    results_by_size: dict[str, list[str]] = {}
    for entry in protocol.results:
        is_three_point = isinstance(entry, BendingStiffness) and entry.support == "three-point"
        if isinstance(entry, MidSpan | Twist) or is_three_point:
            results_by_size.setdefault("span", []).append(entry.result)
        if isinstance(entry, TensionResult):
            results_by_size.setdefault("gauge_length", []).append(entry.result)
            results_by_size.setdefault("section.area", []).append(entry.result)
    channel = protocol.curve and protocol.channels.get(protocol.curve.displacement)
    is_extension = bool(channel and channel.is_extension)  # measured by an extensometer
    length_sizes: list[list[str]] = [] if is_extension else [["length"]]
    alternatives = {"gauge_length": length_sizes, "section.area": _AREA_SIZES}
    return {
        size: results
        for size, results in results_by_size.items()
        if not any(known_sizes >= {*keys} for keys in [[size], *alternatives.get(size, ())])
    }


def _find_missing_markers(
    tracks: MarkerTracks | None, markers: Markers | None, path: Path
) -> Iterator[ReadError]:
    """Yield an error for a clamp or markers that the protocol names and the take lacks."""
    if tracks is None or markers is None:
        return
    bodies, names = [body.name for body in tracks.bodies], list(tracks.names)
    patterns = () if markers.along == "all" else markers.along
    unmatched = [pattern for pattern in patterns if not fnmatch.filter(names, pattern)]
    missing_names = [("markers", "markers.along", pattern) for pattern in unmatched]
    if markers.clamp is not None and markers.clamp not in bodies:
        missing_names.insert(0, ("rigid body", "markers.clamp", markers.clamp))
    for kind, key, name in missing_names:
        similar_names = sort_by_likeness(name, bodies if kind == "rigid body" else names)
        similar, place = ", ".join(map(repr, similar_names)) or "none", f"{kind} {name!r}"
        yield ReadError.about(
            "process.marker_missing_in_take", path, place, kind=kind, key=key, similar=similar
        )


def _find_duplicate_names(sheets: Mapping[Path, TestSheet]) -> Iterator[ProtocolError]:
    """Yield an error for each test with the name of an earlier test of its campaign."""
    first_paths: dict[tuple[Path, str], Path] = {}
    for path, sheet in sheets.items():
        campaign, name = path.resolve().parent.parent, sheet.test
        first = first_paths.setdefault((campaign, name.casefold()), path)
        if first != path:
            yield ProtocolError.about("process.name_taken", path, "(test)", name=name, first=first)
