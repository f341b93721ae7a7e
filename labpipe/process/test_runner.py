"""Process one test of many: return its results, or the reason why there are none."""

from __future__ import annotations

import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

from labpipe.errors import LabpipeError, code_of, error_text, refusal
from labpipe.process.reading import dialect_cards, fingerprint, named_exports
from labpipe.process.run import Processed, Say, key_of, name_of, process_test, results_folder_of
from labpipe.protocol.load import dump_protocol, load_test_sheet, resolve
from labpipe.store.summaries import FailedTest, write_failure


@dataclass(frozen=True, slots=True)
class Task:
    """One test to be processed.

    Parameters
    ----------
    sheet : its test.yaml, or a result.h5 whose raw group is processed again
    goal : folder of its results; None for that of `labpipe process`
    figures : whether to draw figures as SVG
    png : whether to draw them as PNG as well
    follow_links : whether exports may be links out of the folder of the test
    run : key of its results, if it is known before
    """

    sheet: Path
    goal: Path | None = None
    figures: bool = True
    png: bool = False
    follow_links: bool = False
    run: str = ""


@dataclass(frozen=True, slots=True)
class Refused:
    """A test that could not be processed.

    Parameters
    ----------
    test : its test.yaml or result.h5
    code : why, see `labpipe.errors.CODES`
    reason : the message for the user
    folder : of its results, with failure.json; None if it is not known
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
        done = process_test(
            task.sheet,
            goal=task.goal,
            figures=task.figures,
            png=task.png,
            follow_links=task.follow_links,
            say=say,
        )
    except LabpipeError as error:
        return refuse(task, error.code, str(error))
    except Exception as error:
        code = code_of(error)
        refused = refuse(task, code, _FAULT_TEXTS[code](task.sheet, error))
        if is_alone and code == "fault_of_labpipe":
            raise
        return refused
    result = replace(done.result, recordings={}, aligned=None, curve=None, shape=None, bending=None)
    return replace(done, result=result)


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
    folder = _folder_of(task)
    failure = FailedTest("", code, reason, task.run)
    if is_read:
        failure = _with_inputs(failure, task)
    if folder is not None and code != "in_use":
        with suppress(LabpipeError):
            write_failure(failure, folder)
    return Refused(task.sheet, code, reason, folder, failure.run)


def _folder_of(task: Task) -> Path | None:
    if task.goal is not None:
        return task.goal
    with suppress(LabpipeError, OSError, MemoryError):
        return results_folder_of(task.sheet, None, partial(name_of, task.sheet))
    return None


def _with_inputs(failure: FailedTest, task: Task) -> FailedTest:
    """Add name and inputs of the test to a failure, as far as they can be read."""
    try:
        failure = replace(failure, test=name_of(task.sheet))
        if task.sheet.suffix == ".h5":
            return failure
        sheet, text = load_test_sheet(task.sheet), task.sheet.read_text(encoding="utf-8")
        protocol = resolve(sheet, task.sheet, follow_links=task.follow_links)
        resolved = dump_protocol(protocol)
        texts = {"sheet": text, "protocol": resolved}
        hashes = {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
        failure = replace(failure, made_of=hashes)
        exports_by_role, folder = named_exports(sheet, protocol), task.sheet.parent
        exports = [fingerprint(folder / name, role, name) for role, name in exports_by_role]
        inputs = (*exports, *dialect_cards(protocol))
        run = key_of([(file.role, file.sha256) for file in inputs], text, resolved)
        return replace(failure, inputs=inputs, run=failure.run or run)
    except Exception:  # noqa: BLE001  the same fault may occur here, and is reported already
        return failure


def _out_of_memory(test: Path, _error: Exception) -> str:
    return error_text(
        test,
        "",
        expected="a test that fits into memory",
        found="out of memory",
        remedy="Close other programs, choose fewer --jobs, or leave the test out.",
    )


def _internal_error(test: Path, error: Exception) -> str:
    """Describe an internal error, with the line of labpipe that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    own_frames = [frame for frame in frames if "labpipe" in Path(frame.filename).parts]
    frame = own_frames[-1] if own_frames else frames[-1]
    error_message = " ".join(str(error).split())
    actual = f"a fault of labpipe itself ({type(error).__name__}: {error_message})"
    place = f"{Path(frame.filename).name}, line {frame.lineno}"
    remedy = f"Report it ({place}) with the exports of the test; processed alone, it says more."
    return error_text(test, "", expected="no error", found=actual, remedy=remedy)


_FAULT_TEXTS = {
    "out_of_memory": _out_of_memory,
    "system_refused": lambda test, error: f"{test}: {refusal(error)}",
    "fault_of_labpipe": _internal_error,
}
