"""Process one test: read its exports, reduce it, and write result.h5, summary.json and figures."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from hashlib import sha256
from pathlib import Path

from labpipe import __version__
from labpipe.errors import (
    LabpipeError,
    ProcessingError,
    StoreError,
    choose_error_code,
    describe_system_error,
)
from labpipe.process.output_paths import FIGURES_FOLDER, RESULT_FILE
from labpipe.process.reading import fingerprint_inputs, read_inputs
from labpipe.process.sanity_checks import list_certified_instruments
from labpipe.process.story import reduce_recordings
from labpipe.protocol.grammar import is_test_name
from labpipe.protocol.load import (
    find_export_error,
    format_protocol,
    load_test_sheet,
    parse_protocol,
    resolve_protocol,
)
from labpipe.protocol.schema import FIGURE_NEEDS, Protocol
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.curve import Bending
from labpipe.records.recording import Recording
from labpipe.records.result import Status, TestResult
from labpipe.store.parts import RawTest
from labpipe.store.replace import finish_moves, is_unfinished, lock, map_errors, replace_files
from labpipe.store.result_files import read_name, read_raw, read_result, read_run, write_result
from labpipe.store.summaries import (
    FAILURE_FILE,
    SUMMARY_FILE,
    FailedTest,
    write_failure,
    write_summary,
)

_DATE_KEYS = ("date", "start_time", "Capture Start Time")
"""Metadata keys whose values begin with an ISO 8601 date."""
_FIGURE_FILES = [
    f"{FIGURES_FOLDER}/{name}.{kind}" for name in FIGURE_NEEDS for kind in ("svg", "png")
]
"""Paths of all figures that a test may have, relative to its results folder."""
PROCESSING_VERSION = 3
"""Version of the processing.

The version is incremented whenever the same exports, sheet and protocol give other numbers.
"""
StageCallback = Callable[[str], None]
"""Function that is called with the name of each stage when the stage begins."""


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedTest:
    """Processed test and its files.

    Parameters
    ----------
    folder : folder with result.h5, summary.json and figures
    result : result of the test, without its arrays if `try_to_process` returned it
    figures : paths of the figures
    has_completed_replacement : whether a replacement of files was completed that an earlier, killed
        process had begun
    """

    folder: Path
    result: TestResult
    figures: tuple[Path, ...]
    has_completed_replacement: bool = False

    @property
    def n_failed(self) -> int:
        """Return the number of results that failed."""
        return sum(result.status is Status.FAILED for result in self.result.results)


@dataclass(frozen=True, slots=True)
class Task:
    """Test to be processed, with its options.

    Parameters
    ----------
    source : test.yaml of the test, or a result.h5 whose recordings are processed again
    results_folder : results folder of the test; None for that of `choose_results_folder`
    figures : whether to draw figures as SVG
    png : whether to draw figures as PNG as well
    follow_links : whether exports may be links to files outside of the folder of the test
    run : key of the inputs (`make_input_key`); empty if it is not known before the inputs are read
    """

    source: Path
    results_folder: Path | None = None
    figures: bool = True
    png: bool = False
    follow_links: bool = False
    run: str = ""


def process(task: Task, on_stage: StageCallback = lambda _: None) -> ProcessedTest:
    """Process one test.

    Parameters
    ----------
    task : test to be processed, with its options
    on_stage : function that is called with the name of each stage when the stage begins

    Returns
    -------
    The result and its files.

    Raises
    ------
    LabpipeError
        If an input is not valid. Earlier results are then unchanged.
    """
    on_stage("read")
    source, has_completed_replacement = task.source, False
    is_in_place = source.suffix == ".h5" and task.results_folder in (None, source.parent)
    if is_in_place and is_unfinished(source.parent):  # an earlier process was killed
        with lock(source.parent), map_errors(source.parent):
            has_completed_replacement = finish_moves(source.parent)
    raw_test, protocol = read_source(source, follow_links=task.follow_links)
    on_stage("process")
    result = reduce_test(raw_test, protocol)
    folder = task.results_folder or choose_results_folder(source, None, lambda: result.test)
    outdated_figures = _FIGURE_FILES
    with suppress(StoreError):
        if not task.figures and read_run(folder / RESULT_FILE) == result.run:
            outdated_figures = []
    outdated_files = [FAILURE_FILE, *outdated_figures]
    with lock(folder), replace_files(folder, earlier_files=outdated_files) as new_folder:
        on_stage("write")
        with ThreadPoolExecutor(max_workers=1) as compressor:  # compression releases the GIL
            write_future = compressor.submit(write_result, result, new_folder / RESULT_FILE)
            write_summary(result, new_folder / SUMMARY_FILE)
            paths = list[Path]()
            if task.figures:
                on_stage("draw")
                from labpipe.report.figures import save_figures

                paths = save_figures(result, new_folder / FIGURES_FOLDER, png=task.png)
            write_future.result()
    figures = tuple(folder / path.relative_to(new_folder) for path in paths)
    return ProcessedTest(folder, result, figures, has_completed_replacement)


def draw_figures(folder: Path) -> tuple[Path, ...]:
    """Draw the figures of a processed test again from its stored result.

    Parameters
    ----------
    folder : folder with the result.h5 of the test

    Returns
    -------
    The paths of the figures.

    Raises
    ------
    StoreError
        If the result cannot be read, or another labpipe process uses the folder.
    """
    from labpipe.report.figures import save_figures

    with lock(folder):
        result = read_result(folder / RESULT_FILE)
        with replace_files(folder, earlier_files=_FIGURE_FILES) as new_folder:
            paths = save_figures(result, new_folder / FIGURES_FOLDER)
    return tuple(folder / path.relative_to(new_folder) for path in paths)


def read_source(source: Path, *, follow_links: bool = False) -> tuple[RawTest, Protocol]:
    """Read the inputs of a test.

    Parameters
    ----------
    source : test.yaml or result.h5 of the test
    follow_links : see `Task`

    Returns
    -------
    The recordings and metadata of the test, and its resolved protocol.

    Raises
    ------
    LabpipeError
        If an input is not valid.
    """
    if source.suffix == ".h5":
        return _read_stored_test(source)
    sheet = load_test_sheet(source)
    protocol = resolve_protocol(sheet, source, follow_links=follow_links)
    if error := find_export_error(sheet, source):
        raise error
    recordings, inputs = read_inputs(source.parent, sheet, protocol)
    raw_test = RawTest(
        test=sheet.test,
        specimen=sheet.specimen.record,
        protocol=protocol.name,
        protocol_yaml=format_protocol(protocol),
        test_yaml=source.read_text(encoding="utf-8"),
        labpipe_version=__version__,
        inputs=inputs,
        recordings=recordings,
    )
    return raw_test, protocol


def reduce_test(raw_test: RawTest, protocol: Protocol) -> TestResult:
    """Compute the result of a test without writing files.

    Parameters
    ----------
    raw_test : recordings and metadata of the test
    protocol : resolved protocol

    Returns
    -------
    The result that `labpipe process` stores.

    Raises
    ------
    ProcessingError
        If a recording lacks data that a step needs.
    """
    test_date, operator = find_date_and_operator(raw_test.test_yaml, raw_test.recordings)
    input_hashes = [(file.role, file.sha256) for file in raw_test.inputs]
    try:
        reduction = reduce_recordings(
            raw_test.recordings, protocol, test_date=test_date, specimen=raw_test.specimen
        )
    except ProcessingError as error:
        message = f"{raw_test.test}, {error}"
        raise ProcessingError(message) from error
    test = reduction.reduced_test
    return TestResult(
        test=raw_test.test,
        specimen=raw_test.specimen,
        protocol=protocol.name,
        protocol_yaml=raw_test.protocol_yaml,
        test_yaml=raw_test.test_yaml,
        labpipe_version=__version__,
        inputs=raw_test.inputs,
        recordings=raw_test.recordings,
        aligned=test.aligned,
        curve=test.curve,
        shape=test.shape,
        bending=test.bending if isinstance(test.bending, Bending) else None,
        results=reduction.results,
        quality=test.findings.notes,
        display=dict(protocol.report.display),
        figures=protocol.report.figures,
        slips=test.slips,
        lines=reduction.lines,
        run=make_input_key(input_hashes, raw_test.test_yaml, raw_test.protocol_yaml),
        date=test_date,
        operator=operator,
        instruments=list_certified_instruments(protocol),
    )


def find_date_and_operator(
    test_yaml: str, recordings: Mapping[str, Recording]
) -> tuple[date | None, str]:
    """Find the date and the operator of a test.

    Parameters
    ----------
    test_yaml : text of the test sheet, whose date has priority
    recordings : recordings, keyed by role; the first recording with a date is used

    Returns
    -------
    test_date : day of the test; None if neither the sheet nor a recording states it
    operator : operator of the test; empty if the sheet names no operator
    """
    data = parse_yaml(test_yaml, "test.yaml").data
    entries = data if isinstance(data, Mapping) else {}
    operator = entries.get("operator")
    operator = operator if isinstance(operator, str) else ""
    dates = [entries.get("date")]
    dates += [x.metadata.get(key) for x in recordings.values() for key in _DATE_KEYS]
    for stated_date in dates:
        with suppress(ValueError):
            return date.fromisoformat(str(stated_date)[:10]), operator
    return None, operator


def read_test_name(source: Path) -> str:
    """Read the name of a test.

    Parameters
    ----------
    source : test.yaml or result.h5 of the test

    Raises
    ------
    LabpipeError
        If the name cannot be read.
    """
    return read_name(source) if source.suffix == ".h5" else load_test_sheet(source).test


def make_input_key(inputs: Iterable[tuple[str, str]], test_yaml: str, protocol_yaml: str) -> str:
    """Make the key of the inputs of a test; tests with equal keys have equal results.

    Parameters
    ----------
    inputs : role and SHA-256 of each input file, in the order of the protocol
    test_yaml : text of the test sheet
    protocol_yaml : text of the resolved protocol

    Returns
    -------
    SHA-256 (hexadecimal) of the inputs and of `PROCESSING_VERSION`. It does not depend on the time
    or the machine.
    """
    contents = [PROCESSING_VERSION, [list(file) for file in inputs], test_yaml, protocol_yaml]
    return sha256(json.dumps(contents).encode()).hexdigest()


def _read_stored_test(result_path: Path) -> tuple[RawTest, Protocol]:
    """Read a test and its protocol from an earlier result, and check its channels."""
    raw_test = read_raw(result_path)
    if not is_test_name(raw_test.test):
        facts = {"expected": "the name of a test, such as A2-085-1", "found": repr(raw_test.test)}
        raise StoreError.about("process.bad_result", result_path, "test", **facts)
    protocol = parse_protocol(raw_test.protocol_yaml, f"{result_path}, protocol_yaml")
    for role, source in protocol.sources.items():
        recording = raw_test.recordings.get(role, Recording(""))
        channel_names = [channel.name for channel in recording.channels]
        missing_names = sorted(set(source.all_channels) - set(channel_names))
        if missing_names or role not in raw_test.recordings:
            expected = " ".join(["the channels of its protocol,", *missing_names]).strip(", ")
            facts = {"expected": expected, "found": ", ".join(map(repr, channel_names)) or "none"}
            raise StoreError.about("process.bad_result", result_path, f"raw/{role}", **facts)
    return raw_test, protocol


def choose_results_folder(source: Path, parent: Path | None, get_name: Callable[[], str]) -> Path:
    """Choose the results folder of a test.

    Parameters
    ----------
    source : test.yaml or result.h5 of the test
    parent : folder for the results of all tests; None for the default folder
    get_name : function that returns the name of the test; it is called only if the name is needed

    Returns
    -------
    - ``<parent>/<test>`` if `parent` is given;
    - the folder of a result.h5 itself;
    - for ``raw/<path>/test.yaml`` the folder ``processed/<path>`` beside ``raw``;
    - for a sheet elsewhere ``processed/<test>`` in the working folder.
    """
    if parent is not None:
        return parent / get_name()
    if source.suffix == ".h5":
        return source.parent
    folder = source.resolve().parent
    raw_folders = [path for path in folder.parents if path.name == "raw"]
    if not raw_folders:
        return Path("processed") / get_name()
    return raw_folders[0].parent / "processed" / folder.relative_to(raw_folders[0])


@dataclass(frozen=True, slots=True)
class RefusedTest:
    """Test that could not be processed, with the reason.

    Parameters
    ----------
    source : test.yaml or result.h5 of the test
    code : code of the reason, see `labpipe.errors.CODES`
    reason : message for the user
    folder : results folder of the test, with failure.json; None if it is not known
    run : key of the inputs; empty if it is not known
    """

    source: Path
    code: str
    reason: str
    folder: Path | None = None
    run: str = ""


def try_to_process(
    task: Task, on_stage: StageCallback = lambda _: None, *, is_alone: bool = False
) -> ProcessedTest | RefusedTest:
    """Process a test; if it cannot be processed, write failure.json beside its earlier results.

    Parameters
    ----------
    task : test to be processed, with its options
    on_stage : function that is called with the name of each stage when the stage begins
    is_alone : whether no other test is processed; an internal error of labpipe is then raised

    Returns
    -------
    The processed test, or the reason why it could not be processed. Recordings, aligned signals,
    curve, shape and bending data are removed from the returned result to save memory; they are in
    the result.h5 of the test.

    Raises
    ------
    Exception
        For an internal error of labpipe if `is_alone` is True; failure.json reports it as well.
    """
    try:
        processed = process(task, on_stage)
    except LabpipeError as error:
        return record_refusal(task, error.code, str(error))
    except Exception as error:
        code = choose_error_code(error)
        refused_test = record_refusal(task, code, _describe_fault(code, task.source, error))
        if is_alone and code == "fault_of_labpipe":
            raise
        return refused_test
    result = replace(
        processed.result, recordings={}, aligned=None, curve=None, shape=None, bending=None
    )
    return replace(processed, result=result)


def record_refusal(task: Task, code: str, reason: str, *, reads_inputs: bool = True) -> RefusedTest:
    """Record in failure.json why a test has no new results.

    Parameters
    ----------
    task : test that could not be processed
    code, reason : see `RefusedTest`
    reads_inputs : whether to read sheet and exports for the key of the inputs; False if reading
        them may crash the process

    Returns
    -------
    The refused test. If its results folder is not known, not writable, or in use by another
    process, no failure.json is written, and an earlier one remains.
    """
    folder = task.results_folder
    with suppress(LabpipeError, OSError, MemoryError):
        get_name = partial(read_test_name, task.source)
        folder = folder or choose_results_folder(task.source, None, get_name)
    failure = FailedTest(test="", code=code, reason=reason, run=task.run)
    if reads_inputs:
        failure = _add_inputs(failure, task)
    if folder is not None and code != "in_use":
        with suppress(LabpipeError):
            write_failure(failure, folder)
    return RefusedTest(task.source, code, reason, folder, failure.run)


def _add_inputs(failure: FailedTest, task: Task) -> FailedTest:
    """Add the name and the inputs of a test to its failure, as far as they can be read."""
    try:
        source = task.source
        failure = replace(failure, test=read_test_name(source))
        if source.suffix == ".h5":
            return failure
        sheet, test_yaml = load_test_sheet(source), source.read_text(encoding="utf-8")
        protocol = resolve_protocol(sheet, source, follow_links=task.follow_links)
        texts = {"sheet": test_yaml, "protocol": format_protocol(protocol)}
        hashes = {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
        failure = replace(failure, made_of=hashes)  # the hashes remain if an export cannot be read
        inputs = fingerprint_inputs(source.parent, sheet, protocol)
        input_hashes = [(file.role, file.sha256) for file in inputs]
        run = failure.run or make_input_key(input_hashes, texts["sheet"], texts["protocol"])
        return replace(failure, inputs=inputs, run=run)
    except Exception:  # noqa: BLE001  the error that is being reported may be raised here again
        return failure


def _describe_fault(code: str, source: Path, error: Exception) -> str:
    """Describe an error other than a `LabpipeError`, from the system or from labpipe itself."""
    if code == "system_refused":
        return f"{source}: {describe_system_error(error)}"
    if code == "out_of_memory":
        return str(LabpipeError.about("process.out_of_memory", source))
    frames = traceback.extract_tb(error.__traceback__)
    labpipe_frames = [frame for frame in frames if "labpipe" in Path(frame.filename).parts]
    frame = (labpipe_frames or frames)[-1]
    location = f"{Path(frame.filename).name}, line {frame.lineno}"
    facts = {"kind": type(error).__name__, "message": " ".join(str(error).split())}
    return str(LabpipeError.about("process.fault_of_labpipe", source, place=location, **facts))
