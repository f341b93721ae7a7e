"""What paths of a command line stand for: tests to process, results to report, copies."""

from __future__ import annotations

import os
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path

from labpipe.errors import UsageError, error_text
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.records.result import TestResult
from labpipe.store.replace import STAGES, is_there


def recording_of(result: TestResult, protocol: Protocol) -> Hashable:
    """Say which recording of which specimen a test was made of.

    Parameters
    ----------
    result : with its inputs
    protocol : resolved

    Returns
    -------
    Equal for two tests whose exports are the same bytes and of which the same channels, markers and
    parts were taken, by one protocol. One export may hold several specimens.
    """
    exports = tuple(sorted((each.role, each.sha256) for each in result.inputs))
    taken = tuple(
        (role, source.part, *(all_channel.channel for all_channel in source.all_channels.values()))
        for role, source in protocol.sources.items()
    )
    markers = protocol.markers
    seen = None if markers is None else (markers.clamp, markers.along)
    return result.protocol, exports, taken, seen


def find_copies(recordings: Sequence[tuple[Path, Hashable]]) -> dict[str, str]:
    """Find tests whose recording is that of an earlier one.

    Parameters
    ----------
    recordings : file and `recording_of` of each test

    Returns
    -------
    By file, as text, why it is not to be counted.
    """
    first: dict[Hashable, Path] = {}
    copies: dict[str, str] = {}
    for file, recording in recordings:
        kept = first.setdefault(recording, file)
        if kept != file:
            copies[str(file)] = error_text(
                file,
                "",
                expected="each recording once",
                found=f"the same exports, byte for byte, as in {kept}",
                remedy="Look at `files` in both test sheets, or leave the copy out.",
            )
    return copies


RESULT_FILE = "result.h5"
_A_TEST = "a test.yaml, a folder that holds one, or a result.h5"


def find_tests(targets: Sequence[Path]) -> list[Path]:
    """Find the tests below some paths.

    Parameters
    ----------
    targets : test folders, campaign folders, test.yaml or result.h5 files

    Returns
    -------
    test.yaml and result.h5 files, sorted, each once; none out of a hidden folder.

    Raises
    ------
    UsageError
        If a path does not exist, holds no test, or lies in a folder that labpipe was writing.
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
    result.h5 files, sorted, each once; none out of a hidden folder.

    Raises
    ------
    UsageError
        If a path does not exist, holds no processed test, or lies in a folder that labpipe was
        writing.
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


def files_below(folder: Path, name: str = "") -> list[Path]:
    """List files below a folder, but none that are hidden or in a hidden folder.

    Parameters
    ----------
    folder : searched through and through; links to folders are not followed
    name : of the files that are wanted; all of them if empty

    Returns
    -------
    The files, sorted. What labpipe was writing when it was killed is in a hidden folder.
    """
    found: list[Path] = []
    for place, folders, files in os.walk(folder):
        folders[:] = [folder for folder in folders if not folder.startswith(".")]
        wanted = [name] if name else [file for file in files if not file.startswith(".")]
        here = [Path(place, each) for each in wanted]
        found += [path for path in here if path.name in files or is_there(path)]
    return sorted(found)


def refuse_repeated(marked: Iterable[tuple[str, Path]], what: str) -> None:
    """Refuse two tests that share what each has for itself, but for the case of letters.

    Parameters
    ----------
    marked : of each test its name, or where its results go, and its file
    what : which of these it is

    Raises
    ------
    UsageError
        If one occurs twice; each repetition is reported with both files.
    """
    first: dict[str, Path] = {}
    faults = []
    for mark, file in marked:
        earlier = first.setdefault(mark.casefold(), file)
        if earlier != file:
            expected, found = f"one test for each {what}", f"a second for {mark!r}"
            remedy = (
                f"{earlier} is the first: rename one of them in its test.yaml, or leave it out."
            )
            faults.append(error_text(file, "", expected=expected, found=found, remedy=remedy))
    if faults:
        raise UsageError("\n".join(faults))


def _files(
    targets: Sequence[Path], name: str, *, expected: str, none: str, remedy: str
) -> list[Path]:
    """Files among some paths, and those of a name below them; `none` where a folder holds none."""
    files: dict[Path, Path] = {}
    for target in targets:
        if set(target.resolve().parts) & set(STAGES):
            unfinished = "one that labpipe was writing when it was stopped"
            raise _unfit(target, expected, unfinished, "Process the test again.")
        below = [target] if is_there(target) else files_below(target, name)
        if not below:
            missing = none if target.is_dir() else "a pipe or a device"
            missing = missing if target.exists() else "nothing of that name"
            raise _unfit(target, expected, missing, remedy)
        for file in below:
            files.setdefault(file.resolve(), file)
    return list(files.values())


def _unfit(target: Path, expected: str, found: str, remedy: str) -> UsageError:
    return UsageError(error_text(target, "", expected=expected, found=found, remedy=remedy))
