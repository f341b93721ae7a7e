"""One test among many, whatever becomes of it: its results, or why there are none."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

from labpipe.errors import LabpipeError, code_of, error_text, refusal
from labpipe.process.reading import cards_in_play, fingerprint, named_exports
from labpipe.process.run import Processed, key_of, name_of, process_test, results_folder_of
from labpipe.protocol.load import dump_protocol, load_test_sheet, resolve
from labpipe.store.failure_file import FailedTest, write_failure

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Task:
    """One test to be processed.

    Parameters
    ----------
    sheet : its test.yaml, or a result.h5 whose raw group is processed again
    goal : folder of its results; None where `labpipe process` puts them
    figures : whether to draw, as SVG
    png : whether figures are drawn as PNG, too
    follow_links : whether exports may be links out of the folder of the test
    run : key that its results will have, where that is known before
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
    folder : of its results, where failure.json says the same; None where that is not known
    run : key that its results would have had; empty where that is not known
    """

    test: Path
    code: str
    reason: str
    folder: Path | None = None
    run: str = ""


def attempt(
    task: Task, say: Say = lambda _: None, *, is_alone: bool = False
) -> Processed | Refused:
    """Process a test; what is wrong with it is said beside its earlier results.

    Parameters
    ----------
    task : the test
    say : is given the name of each stage as it begins
    is_alone : whether a fault of labpipe itself may show all that is known of it

    Returns
    -------
    The test without its recordings and stages, which are in its result.h5: hundreds of tests would
    not go into memory.

    Raises
    ------
    Exception
        A fault of labpipe itself, if the test is alone; failure.json has it, too.
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
        refused = refuse(task, code, _WORDED[code](task.sheet, error))
        if is_alone and code == "fault_of_labpipe":
            raise
        return refused
    result = replace(done.result, recordings={}, aligned=None, curve=None, shape=None, bending=None)
    return replace(done, result=result)


def refuse(task: Task, code: str, reason: str, *, is_read: bool = True) -> Refused:
    """Write down why a test has no new results.

    Parameters
    ----------
    task : the test
    code, reason : see `Refused`
    is_read : whether to read sheet and exports, to say what the results would have been made of;
        not where reading may have been what killed a process

    Returns
    -------
    The refusal. Where the folder of the results is not known, cannot be written, or is written by
    another process at the moment, it alone tells; an earlier failure.json stays.
    """
    folder = _folder_of(task)
    failure = FailedTest("", code, reason, task.run)
    if is_read:
        failure = _with_what_is_known(failure, task)
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


def _with_what_is_known(failure: FailedTest, task: Task) -> FailedTest:
    """Say of a failure which test it was and what went in, as far as that can be read."""
    try:
        failure = replace(failure, test=name_of(task.sheet))
        if task.sheet.suffix == ".h5":
            return failure
        sheet, text = load_test_sheet(task.sheet), task.sheet.read_text(encoding="utf-8")
        protocol = resolve(sheet, task.sheet, follow_links=task.follow_links)
        resolved = dump_protocol(protocol)
        texts = {"sheet": text, "protocol": resolved}
        made_of = {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
        failure = replace(failure, made_of=made_of)
        named, folder = named_exports(sheet, protocol), task.sheet.parent
        exports = [fingerprint(folder / name, role, name) for role, name in named]
        inputs = (*exports, *cards_in_play(protocol))
        run = key_of([(each.role, each.sha256) for each in inputs], text, resolved)
        return replace(failure, inputs=inputs, run=failure.run or run)
    except Exception:  # noqa: BLE001  what is wrong may be wrong here again, and is said already
        return failure


def _too_large(test: Path, _error: Exception) -> str:
    return error_text(
        test,
        "",
        expected="a test that goes into the memory",
        found="that the memory was used up",
        remedy="Close other programs, choose fewer --jobs, or leave the test out.",
    )


def _own_fault(test: Path, error: Exception) -> str:
    """Word an error that is none of the user's, with the line of labpipe that it came from."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "labpipe" in Path(frame.filename).parts]
    at = own[-1] if own else frames[-1]
    said = " ".join(str(error).split())
    found = f"a fault of labpipe itself ({type(error).__name__}: {said})"
    place = f"{Path(at.filename).name}, line {at.lineno}"
    remedy = f"Report it ({place}) with the exports of the test; processed alone, it says more."
    return error_text(test, "", expected="to get through", found=found, remedy=remedy)


_WORDED = {
    "out_of_memory": _too_large,
    "system_refused": lambda test, error: f"{test}: {refusal(error)}",
    "fault_of_labpipe": _own_fault,
}
