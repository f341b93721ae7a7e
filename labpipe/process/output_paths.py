"""Find the tests and results in the paths of a command line, and tests that occur twice."""

from __future__ import annotations

import os
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path

from labpipe.errors import UsageError
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.records.result import TestResult
from labpipe.store.replace import TEMPORARY_FOLDERS, exists_or_is_staged


def identify_recording(result: TestResult, protocol: Protocol) -> Hashable:
    """Make a key of the recording from which a test was made.

    Parameters
    ----------
    result : result of the test, with its inputs
    protocol : resolved protocol of the test

    Returns
    -------
    A key that is equal for two tests with identical exports and the same protocol, channels,
    markers and parts, since one export may hold several specimens.
    """
    exports = tuple(sorted((file.role, file.sha256) for file in result.inputs))
    channels = tuple(
        (role, source.part, *(channel.channel for channel in source.all_channels.values()))
        for role, source in protocol.sources.items()
    )
    markers = protocol.markers
    marker_names = None if markers is None else (markers.clamp, markers.along)
    return result.protocol, exports, channels, marker_names


def find_copies(recordings: Sequence[tuple[Path, Hashable]]) -> dict[str, str]:
    """Find tests with the recording of an earlier test.

    Parameters
    ----------
    recordings : result file and key (`identify_recording`) of each test

    Returns
    -------
    Reasons to leave out a test, keyed by the text of its result file.
    """
    first_files: dict[Hashable, Path] = {}
    copies: dict[str, str] = {}
    for file, recording in recordings:
        original = first_files.setdefault(recording, file)
        if original != file:
            copies[str(file)] = str(UsageError.about("process.copy", file, original=original))
    return copies


RESULT_FILE, FIGURES_FOLDER = "result.h5", "figures"


def find_tests(targets: Sequence[Path]) -> list[Path]:
    """Find the tests in files and folders.

    Parameters
    ----------
    targets : test folders, campaign folders, test.yaml or result.h5 files

    Returns
    -------
    The test.yaml and result.h5 files, each once, in the order of `targets`. Files in hidden folders
    are left out.

    Raises
    ------
    UsageError
        If a path does not exist, holds no test, or is in a folder that labpipe was writing.
    """
    for target in targets:
        if target.is_file() and target.suffix not in {".yaml", ".yml", ".h5"}:
            kind = target.suffix or "nameless"
            raise UsageError.about("process.export_for_a_test", target, kind=kind)
    return _find_files(targets, SHEET_NAME)


def find_results(targets: Sequence[Path]) -> list[Path]:
    """Find the processed tests in files and folders.

    Parameters
    ----------
    targets : result.h5 files, or folders that contain some

    Returns
    -------
    The result.h5 files, each once, in the order of `targets`. Files in hidden folders are left out.

    Raises
    ------
    UsageError
        If a path does not exist, holds no processed test, or is in a folder that labpipe was
        writing.
    """
    return _find_files(targets, RESULT_FILE)


def find_shared_folder(files: Sequence[Path]) -> Path:
    """Find the deepest folder that contains the folders of all tests.

    Parameters
    ----------
    files : result.h5 files, each in the folder of its test
    """
    campaigns = [os.path.abspath(file.parent.parent) for file in files]  # noqa: PTH100
    return Path(os.path.commonpath(campaigns))


def list_files_below(folder: Path, name: str = "") -> list[Path]:
    """List files below a folder, except hidden ones and those in hidden folders.

    Parameters
    ----------
    folder : folder that is searched recursively; links to folders are not followed
    name : name of the files; empty for all files

    Returns
    -------
    The files in sorted order. Unfinished results of a killed process are in hidden folders.
    """
    paths: list[Path] = []
    for parent, folders, files in os.walk(folder):
        folders[:] = [folder for folder in folders if not folder.startswith(".")]
        file_names = [name] if name else [file for file in files if not file.startswith(".")]
        candidates = [Path(parent, file_name) for file_name in file_names]
        paths += [path for path in candidates if path.name in files or exists_or_is_staged(path)]
    return sorted(paths)


def refuse_duplicates(names: Iterable[tuple[str, Path]], kind: str) -> None:
    """Refuse two tests with the same name or results folder, except for case.

    Parameters
    ----------
    names : name or results folder of each test, and file of the test
    kind : ``name`` or ``folder of results``, for messages

    Raises
    ------
    UsageError
        If a name occurs twice; each repetition is reported with both files.
    """
    first_files: dict[str, Path] = {}
    faults = []
    for name, file in names:
        original = first_files.setdefault(name.casefold(), file)
        if original != file:
            error = UsageError.about("process.repeated", file, kind=kind, name=name, first=original)
            faults.append(str(error))
    if faults:
        raise UsageError("\n".join(faults))


def _find_files(targets: Sequence[Path], name: str) -> list[Path]:
    """List the targets that are files, and the files of a name in the targets that are folders."""
    files: dict[Path, Path] = {}
    for target in targets:
        if set(target.resolve().parts) & set(TEMPORARY_FOLDERS):
            raise UsageError.about("process.unfinished", target)
        matching_files = [target] if exists_or_is_staged(target) else list_files_below(target, name)
        if not matching_files:
            content = "none" if target.is_dir() else "a pipe or a device"
            content = content if target.exists() else "nothing of that name"
            raise UsageError.about(
                "process.no_test" if name == SHEET_NAME else "process.no_result",
                target,
                found=content,
            )
        for file in matching_files:
            files.setdefault(file.resolve(), file)
    return list(files.values())
