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
    describe_system_error,
    find_error_code,
)
from labpipe.process.output_paths import FIGURES_FOLDER, RESULT_FILE
from labpipe.process.reading import (
    fingerprint,
    fingerprint_dialect_cards,
    list_named_exports,
    read_inputs,
)
from labpipe.process.sanity_checks import list_certified_instruments
from labpipe.process.story import reduce_recordings
from labpipe.protocol.grammar import is_test_name
from labpipe.protocol.load import (
    dump_protocol,
    find_missing_exports,
    load_test_sheet,
    parse_protocol,
    resolve_protocol,
)
from labpipe.protocol.schema import FIGURES, Protocol
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.curve import Bending
from labpipe.records.recording import Recording
from labpipe.records.result import Status, TestResult
from labpipe.store.replace import finish_moves, is_unfinished, locked, replacing_together, storing
from labpipe.store.result_files import (
    RawTest,
    read_name,
    read_raw,
    read_result,
    read_run,
    write_result,
)
from labpipe.store.summaries import (
    FAILURE_FILE,
    SUMMARY_FILE,
    FailedTest,
    write_failure,
    write_summary,
)

_DAY_KEYS = ("date", "start_time", "Capture Start Time")
"""Metadata keys of the recording date or time, always in ISO 8601."""
PROCESSING_VERSION = 2
"""Incremented whenever the same exports, sheet and protocol give different numbers."""
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Processed:
    """A processed test and its files.

    Parameters
    ----------
    folder : holds result.h5, summary.json and figures
    result : result of the test
    figures : files of figures
    finished : whether files that a killed process left behind were completed first
    """

    folder: Path
    result: TestResult
    figures: tuple[Path, ...]
    finished: bool = False

    @property
    def n_failed(self) -> int:
        """Return the number of results that are not available."""
        return sum(result.status is Status.FAILED for result in self.result.results)


@dataclass(frozen=True, slots=True)
class Task:
    """One test to be processed.

    Parameters
    ----------
    sheet : its test.yaml, or a result.h5 whose raw group is processed again
    results_folder : results folder of the test; None for that of `labpipe process`
    figures : whether to draw figures as SVG
    png : whether to draw them as PNG as well
    follow_links : whether exports may be links out of the folder of the test
    run : key of its inputs (`make_input_key`), if it is known before they are read; else empty
    """

    sheet: Path
    results_folder: Path | None = None
    figures: bool = True
    png: bool = False
    follow_links: bool = False
    run: str = ""


def process(task: Task, say: Say = lambda _: None) -> Processed:
    """Process one test.

    Parameters
    ----------
    task : the test
    say : called with the name of each stage as it begins

    Returns
    -------
    The result and its folder.

    Raises
    ------
    LabpipeError
        If an input is bad; earlier results are then unchanged.
    """
    say("read")
    source, finished = task.sheet, False
    is_in_place = source.suffix == ".h5" and task.results_folder in (None, source.parent)
    if is_in_place and is_unfinished(source.parent):  # by a process that was killed
        with locked(source.parent), storing(source.parent):
            finished = finish_moves(source.parent)
    raw, protocol = read_source(source, follow_links=task.follow_links)
    say("process")
    result = reduce_test(raw, protocol)
    folder = task.results_folder or find_results_folder(source, None, lambda: result.test)
    figures_shown = _list_figure_files()
    with suppress(StoreError):
        if not task.figures and read_run(folder / RESULT_FILE) == result.run:
            figures_shown = []  # they show this run
    owned = [FAILURE_FILE, *figures_shown]
    with locked(folder), replacing_together(folder, owned=owned) as stage:
        say("write")
        with ThreadPoolExecutor(max_workers=1) as compressor:  # compression releases the GIL
            writing = compressor.submit(write_result, result, stage / RESULT_FILE)
            write_summary(result, stage / SUMMARY_FILE)
            figure_paths: tuple[Path, ...] = ()
            if task.figures:
                say("draw")
                from labpipe.report.figures import save_figures

                figure_paths = tuple(save_figures(result, stage / FIGURES_FOLDER, png=task.png))
            writing.result()
    files = tuple(folder / path.relative_to(stage) for path in figure_paths)
    return Processed(folder, result, files, finished)


def draw_figures(folder: Path) -> tuple[Path, ...]:
    """Draw the figures of a processed test from its result, as `process` does.

    Parameters
    ----------
    folder : holds its result.h5

    Returns
    -------
    The files.

    Raises
    ------
    StoreError
        If the result cannot be read, or another labpipe process uses the folder.
    """
    from labpipe.report.figures import save_figures

    with locked(folder):
        result = read_result(folder / RESULT_FILE)
        with replacing_together(folder, owned=_list_figure_files()) as stage:
            figure_paths = save_figures(result, stage / FIGURES_FOLDER)
    return tuple(folder / path.relative_to(stage) for path in figure_paths)


def read_source(source: Path, *, follow_links: bool = False) -> tuple[RawTest, Protocol]:
    """Read the inputs of a test.

    Parameters
    ----------
    source : its test.yaml, or a result.h5
    follow_links : see `Task`

    Returns
    -------
    Its recordings and metadata, and its resolved protocol.

    Raises
    ------
    LabpipeError
        If an input is bad.
    """
    return _read_stored(source) if source.suffix == ".h5" else _read_exports(source, follow_links)


def reduce_test(raw: RawTest, protocol: Protocol) -> TestResult:
    """Reduce one test in memory.

    Parameters
    ----------
    raw : its recordings and metadata
    protocol : resolved protocol

    Returns
    -------
    Everything that `labpipe process` would store.

    Raises
    ------
    ProcessingError
        If a recording lacks data that a step needs.
    """
    tested, operator = find_day_and_operator(raw.test_yaml, raw.recordings)
    exports = [(file.role, file.sha256) for file in raw.inputs]
    try:
        reduced = reduce_recordings(raw.recordings, protocol, tested=tested, specimen=raw.specimen)
    except ProcessingError as error:
        message = f"{raw.test}, {error}"
        raise ProcessingError(message) from error
    test = reduced.reduced_test
    return TestResult(
        test=raw.test,
        specimen=raw.specimen,
        protocol=protocol.name,
        protocol_yaml=raw.protocol_yaml,
        test_yaml=raw.test_yaml,
        labpipe_version=__version__,
        inputs=raw.inputs,
        recordings=raw.recordings,
        aligned=test.aligned,
        curve=test.curve,
        shape=test.shape,
        bending=test.bending if isinstance(test.bending, Bending) else None,
        results=reduced.results,
        quality=test.findings.notes,
        display=dict(protocol.report.display),
        figures=protocol.report.figures,
        slips=test.slips,
        lines=reduced.lines,
        run=make_input_key(exports, raw.test_yaml, raw.protocol_yaml),
        date=tested,
        operator=operator,
        instruments=list_certified_instruments(protocol),
    )


def find_day_and_operator(
    sheet: str, recordings: Mapping[str, Recording]
) -> tuple[date | None, str]:
    """Find the day and the operator of a test.

    Parameters
    ----------
    sheet : text of its test sheet, whose date has priority
    recordings : recordings by role; the first one with a date is used

    Returns
    -------
    The day, None if it is not stated anywhere; the operator, empty if the sheet does not name one.
    """
    sheet_data = parse_yaml(sheet, "test.yaml").data
    entries = sheet_data if isinstance(sheet_data, Mapping) else {}
    dates = [entries.get("date")]
    dates += [recording.metadata.get(key) for recording in recordings.values() for key in _DAY_KEYS]
    operator = entries.get("operator")
    day = next(filter(None, map(_parse_day, dates)), None)
    return day, operator if isinstance(operator, str) else ""


def _parse_day(written: object) -> date | None:
    try:
        return date.fromisoformat(str(written)[:10])
    except ValueError:
        return None


def read_test_name(source: Path) -> str:
    """Read the name of a test.

    Parameters
    ----------
    source : its test.yaml or result.h5

    Raises
    ------
    LabpipeError
        If it cannot be read.
    """
    return read_name(source) if source.suffix == ".h5" else load_test_sheet(source).test


def make_input_key(inputs: Iterable[tuple[str, str]], test_yaml: str, protocol_yaml: str) -> str:
    """Make the key of the inputs of a test: equal keys mean equal numbers.

    Parameters
    ----------
    inputs : role and SHA-256 of each, in the order of the protocol
    test_yaml : the test sheet as written
    protocol_yaml : the resolved protocol

    Returns
    -------
    SHA-256, hexadecimal, of these and `PROCESSING_VERSION`, independent of time and machine.
    """
    parts = [PROCESSING_VERSION, [list(file) for file in inputs], test_yaml, protocol_yaml]
    return sha256(json.dumps(parts).encode()).hexdigest()


def _list_figure_files() -> list[str]:
    return [f"{FIGURES_FOLDER}/{name}{ending}" for name in FIGURES for ending in (".svg", ".png")]


def _read_exports(sheet_path: Path, follow_links: bool) -> tuple[RawTest, Protocol]:
    """Read a test from its sheet and exports."""
    sheet = load_test_sheet(sheet_path)
    protocol = resolve_protocol(sheet, sheet_path, follow_links=follow_links)
    if missing := find_missing_exports(sheet, sheet_path):
        raise missing
    recordings, inputs = read_inputs(sheet_path.parent, sheet, protocol)
    raw = RawTest(
        test=sheet.test,
        specimen=sheet.specimen.record,
        protocol=protocol.name,
        protocol_yaml=dump_protocol(protocol),
        test_yaml=sheet_path.read_text(encoding="utf-8"),
        labpipe_version=__version__,
        inputs=inputs,
        recordings=recordings,
    )
    return raw, protocol


def _read_stored(result_path: Path) -> tuple[RawTest, Protocol]:
    """Read a test from the raw group of an earlier result."""
    raw = read_raw(result_path)
    if not is_test_name(raw.test):
        expected, found = "the name of a test, such as A2-085-1", repr(raw.test)
        raise StoreError.about(
            "process.bad_result", result_path, "test", expected=expected, found=found
        )
    protocol = parse_protocol(raw.protocol_yaml, f"{result_path}, protocol_yaml")
    for role, source in protocol.sources.items():
        recording, group = raw.recordings.get(role, Recording("")), f"raw/{role}"
        names = [channel.name for channel in recording.channels]
        missing = sorted(set(source.all_channels) - set(names))
        if missing or role not in raw.recordings:
            expected = " ".join(["the channels of its protocol,", *missing]).strip(", ")
            found = ", ".join(map(repr, names)) or "none"
            raise StoreError.about(
                "process.bad_result", result_path, group, expected=expected, found=found
            )
    return raw, protocol


def find_results_folder(source: Path, out: Path | None, name: Callable[[], str]) -> Path:
    """Find the results folder of a test.

    Parameters
    ----------
    source : its test.yaml or result.h5
    out : folder that gets a folder per test; None for `processed` beside `raw`
    name : returns the name of the test; called only if it is needed

    Returns
    -------
    ``out/<test>``; else the folder of the result.h5 itself, or beside ``raw`` in ``processed`` at
    the same depth, or ``processed/<test>`` in the working folder.
    """
    if out is not None:
        return out / name()
    if source.suffix == ".h5":
        return source.parent
    folder = source.resolve().parent
    raw_folders = [parent for parent in folder.parents if parent.name == "raw"]
    if not raw_folders:
        return Path("processed") / name()
    return raw_folders[0].parent / "processed" / folder.relative_to(raw_folders[0])


@dataclass(frozen=True, slots=True)
class Refused:
    """A test that could not be processed.

    Parameters
    ----------
    test : its test.yaml or result.h5
    code : why, see `labpipe.errors.CODES`
    reason : the message for the user
    folder : folder of its results, with failure.json; None if it is not known
    run : key of the inputs; empty if it is not known
    """

    test: Path
    code: str
    reason: str
    folder: Path | None = None
    run: str = ""


def attempt(
    task: Task, say: Say = lambda _: None, *, is_alone: bool = False
) -> Processed | Refused:
    """Process a test, or write failure.json beside its earlier results.

    Parameters
    ----------
    task : the test
    say : called with the name of each stage as it begins
    is_alone : whether faults of labpipe itself are raised

    Returns
    -------
    The test without recordings and stages, which are in its result.h5, to save memory.

    Raises
    ------
    Exception
        A fault of labpipe itself, if the test is alone; failure.json has it as well.
    """
    try:
        processed = process(task, say)
    except LabpipeError as error:
        return refuse(task, error.code, str(error))
    except Exception as error:
        code = find_error_code(error)
        refused = refuse(task, code, _describe_fault(code, task.sheet, error))
        if is_alone and code == "fault_of_labpipe":
            raise
        return refused
    result = replace(
        processed.result, recordings={}, aligned=None, curve=None, shape=None, bending=None
    )
    return replace(processed, result=result)


def refuse(task: Task, code: str, reason: str, *, is_read: bool = True) -> Refused:
    """Record why a test has no new results.

    Parameters
    ----------
    task : the test
    code, reason : see `Refused`
    is_read : whether to read sheet and exports for the key of the inputs; not if reading them may
        have killed a process

    Returns
    -------
    The refusal. If the results folder is not known, not writable, or in use by another process,
    there is no failure.json, or an earlier one remains.
    """
    folder = task.results_folder
    with suppress(LabpipeError, OSError, MemoryError):
        folder = folder or find_results_folder(
            task.sheet, None, partial(read_test_name, task.sheet)
        )
    failure = FailedTest("", code, reason, task.run)
    if is_read:
        failure = _add_inputs(failure, task)
    if folder is not None and code != "in_use":
        with suppress(LabpipeError):
            write_failure(failure, folder)
    return Refused(task.sheet, code, reason, folder, failure.run)


def _add_inputs(failure: FailedTest, task: Task) -> FailedTest:
    """Add name and inputs of the test to a failure, as far as they can be read."""
    try:
        failure = replace(failure, test=read_test_name(task.sheet))
        if task.sheet.suffix == ".h5":
            return failure
        sheet, text = load_test_sheet(task.sheet), task.sheet.read_text(encoding="utf-8")
        protocol = resolve_protocol(sheet, task.sheet, follow_links=task.follow_links)
        resolved = dump_protocol(protocol)
        texts = {"sheet": text, "protocol": resolved}
        hashes = {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
        failure = replace(failure, made_of=hashes)  # known even if an export cannot be read
        exports_by_role, folder = list_named_exports(sheet, protocol), task.sheet.parent
        exports = [fingerprint(folder / name, role, name) for role, name in exports_by_role]
        inputs = (*exports, *fingerprint_dialect_cards(protocol))
        run = make_input_key([(file.role, file.sha256) for file in inputs], text, resolved)
        return replace(failure, inputs=inputs, run=failure.run or run)
    except Exception:  # noqa: BLE001  the same fault may occur here, and is reported already
        return failure


def _describe_fault(code: str, test: Path, error: Exception) -> str:
    """Describe an error that is not a `LabpipeError`; a fault of labpipe with its line of code."""
    if code == "system_refused":
        return f"{test}: {describe_system_error(error)}"
    if code == "out_of_memory":
        return str(LabpipeError.about("process.out_of_memory", test))
    frames = traceback.extract_tb(error.__traceback__)
    frame = ([x for x in frames if "labpipe" in Path(x.filename).parts] or frames)[-1]
    place = f"{Path(frame.filename).name}, line {frame.lineno}"
    kind, message = type(error).__name__, " ".join(str(error).split())
    fault = LabpipeError.about(
        "process.fault_of_labpipe", test, kind=kind, message=message, place=place
    )
    return str(fault)
