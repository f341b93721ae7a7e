"""What the paths of a command line stand for: tests to process, results to report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from labpipe.errors import UsageError, complaint
from labpipe.protocol.sheet import SHEET_NAME

RESULT_FILE = "result.h5"
_A_TEST = "a test.yaml, a folder that holds one, or a result.h5"


def find_tests(targets: Sequence[Path]) -> list[Path]:
    """Find the tests below some paths.

    Parameters
    ----------
    targets : test folders, campaign folders, test.yaml or result.h5 files

    Returns
    -------
    test.yaml and result.h5 files, sorted, each once.

    Raises
    ------
    UsageError
        If a path does not exist or holds no test.
    """
    for target in targets:
        if target.is_file() and target.suffix not in {".yaml", ".yml", ".h5"}:
            found = f"a {target.suffix or 'nameless'} file"
            remedy = "An export belongs to a test: `labpipe new` writes its test.yaml."
            raise _unfit(target, _A_TEST, found, remedy)
    remedy = "`labpipe new` writes a test.yaml."
    return _files(targets, SHEET_NAME, expected=_A_TEST, none="neither", remedy=remedy)


def find_results(targets: Sequence[Path]) -> list[Path]:
    """Find the processed tests below some paths.

    Parameters
    ----------
    targets : result.h5 files, or folders that hold some

    Returns
    -------
    result.h5 files, sorted, each once.

    Raises
    ------
    UsageError
        If a path does not exist or holds no processed test.
    """
    expected = f"a {RESULT_FILE}, or a folder with processed tests"
    remedy = "`labpipe process` makes them from the exports of a test."
    return _files(targets, RESULT_FILE, expected=expected, none="none", remedy=remedy)


def shared_folder(files: Sequence[Path]) -> Path:
    """Find the deepest folder that holds all tests; of one test, the folder around it.

    Parameters
    ----------
    files : result.h5 files, each in the folder of its test
    """
    tests = [file.parent.parent for file in files]
    return Path(os.path.commonpath([os.path.abspath(folder) for folder in tests]))  # noqa: PTH100


def _files(
    targets: Sequence[Path], name: str, *, expected: str, none: str, remedy: str
) -> list[Path]:
    """Files among some paths, and those of a name below them; `none` where a folder holds none."""
    found: list[Path] = []
    for target in targets:
        below = [target] if target.is_file() else sorted(target.rglob(name))
        if not below:
            missing = none if target.exists() else "nothing of that name"
            raise _unfit(target, expected, missing, remedy)
        found.extend(below)
    return list(dict.fromkeys(found))


def _unfit(target: Path, expected: str, found: str, remedy: str) -> UsageError:
    return UsageError(complaint(target, "", expected=expected, found=found, remedy=remedy))
