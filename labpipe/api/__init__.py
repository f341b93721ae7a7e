"""Provide the API for Python and notebooks: open, process, table, groups, inspect.

Values are in SI units, except those of `Test.display`. Invalid input raises a `LabpipeError`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from labpipe.api.data_frames import PathLike, groups, parse_path, table
from labpipe.api.one_test import Export, Test, inspect
from labpipe.errors import UsageError
from labpipe.process.output_paths import RESULT_FILE, find_results, find_tests
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.result_files import read_outcome, read_result

__all__ = ["Export", "Test", "groups", "inspect", "open", "process", "table"]


def open(path: PathLike) -> Test:
    """Open a processed test.

    Parameters
    ----------
    path : ``result.h5`` of the test, or a folder that contains only this test

    Returns
    -------
    The test. Results and curve are read immediately, shapes and recordings on first use.

    Raises
    ------
    UsageError
        If the path has no processed test, several tests, or an unfinished one.
    StoreError
        If the file is damaged, is not from labpipe, or has another schema.

    Examples
    --------
    >>> labpipe.open("processed/A2/A2-085-1").results  # doctest: +SKIP
    """
    file = _find_test(parse_path(path), find_results, "labpipe.table(path) reads many tests.")
    return Test(read_outcome(file), read_full=lambda: read_result(file), folder=file.parent)


def process(source: PathLike, *, follow_links: bool = False) -> Test:
    """Process a test in memory, without writing files.

    Parameters
    ----------
    source : folder of a test, its ``test.yaml``, or a ``result.h5`` whose recordings are processed
        again
    follow_links : whether exports may be links to files outside of the test folder

    Returns
    -------
    The test, as `open` returns it after ``labpipe process``.

    Raises
    ------
    LabpipeError
        If the source is not exactly one test, or an input is not valid.

    Examples
    --------
    >>> labpipe.process("raw/A2/A2-085-1").results  # doctest: +SKIP
    """
    from labpipe.process.run import read_source, reduce_test  # imports all of processing

    file = _find_test(parse_path(source), _find_sources, "Name the folder of one test.")
    return Test(reduce_test(*read_source(file, follow_links=follow_links)))


def _find_sources(targets: Sequence[Path]) -> list[Path]:
    """Find the tests to process. A folder with a result but no test sheet gives the result."""
    (target,) = targets
    has_result = target.is_dir() and (target / RESULT_FILE).is_file()
    if has_result and not (target / SHEET_NAME).is_file():
        return [target / RESULT_FILE]
    return find_tests([target])


def _find_test(path: Path, find_files: Callable[[Sequence[Path]], list[Path]], remedy: str) -> Path:
    """Find the file of the only test at a path; refuse several tests, with a remedy as text."""
    files = find_files([path])
    if len(files) > 1:
        raise UsageError.about("api.many_tests", path, count=len(files), remedy=remedy)
    return files[0]
