"""Find the tests and results in the paths of a command line, and tests that occur twice."""

from __future__ import annotations

import os
from bisect import bisect_left, bisect_right, insort
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from operator import itemgetter
from pathlib import Path

import numpy as np

from labpipe.errors import UsageError
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.records.arrays import Floats
from labpipe.records.result import TestResult
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.store.replace import TEMPORARY_FOLDERS, exists_or_is_staged

RESULT_FILE, FIGURES_FOLDER = "result.h5", "figures"
"""Names of the result file of a test and of the folder of its figures."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingIdentity:
    """Properties by which the recording of a test is identified.

    Parameters
    ----------
    export_key : key that is equal for two tests with identical exports and the same protocol,
        channels, markers and parts, because one export may contain several specimens
    group_key : key that is equal for two tests with the same protocol, markers and number of
        samples
    samples : at most 2000 displacements (m) and as many forces (N) of the curve; empty without a
        curve
    tolerances : largest root mean square difference of the displacements (m) and of the forces (N)
        of one recording that was saved twice; empty without a curve
    mean_force : mean of the force samples, N; NaN without a curve
    """

    export_key: Hashable
    group_key: Hashable
    samples: tuple[Floats, ...] = ()
    tolerances: tuple[float, ...] = ()
    mean_force: float = float("nan")

    def has_samples_of(self, other: RecordingIdentity) -> bool:
        """Return whether another recording has the same samples, apart from rounding.

        Parameters
        ----------
        other : recording with the same `group_key`
        """
        columns = zip(self.samples, other.samples, self.tolerances, other.tolerances, strict=True)
        return bool(self.samples) and all(
            sqrt(np.nanmean((values - other_values) ** 2)) <= min(tolerances)
            for values, other_values, *tolerances in columns
        )


def identify_recording(result: TestResult, protocol: Protocol) -> RecordingIdentity:
    """Identify the recording from which a test was made.

    Parameters
    ----------
    result : result of the test, with its inputs and its curve
    protocol : resolved protocol of the test

    Notes
    -----
    Forces of two recordings differ at least by their noise, whose root mean square difference is
    1.4 standard deviations. Forces of one recording that was saved twice differ by less than half
    of a standard deviation, or by less than 2e-5 of their range. Its displacements differ by less
    than 1e-3 of their range.
    """
    noise_factor, force_fraction, displacement_fraction, n_compared = 0.5, 2e-5, 1e-3, 1000
    exports = tuple(sorted((file.role, file.sha256) for file in result.inputs))
    channels = tuple(
        (role, source.part, *(channel.names for channel in source.all_channels.values()))
        for role, source in protocol.sources.items()
    )
    markers, curve = protocol.markers, result.curve
    marker_names = None if markers is None else (markers.clamp, markers.along)
    export_key = (result.protocol, exports, channels, marker_names)
    columns = () if curve is None else (curve.displacement, curve.force)
    if not columns or not all(np.isfinite(values).any() for values in columns):
        return RecordingIdentity(export_key, (result.protocol, marker_names, 0))
    stride = max(1, len(columns[0]) // n_compared)
    travel, force_range = (float(np.nanmax(values) - np.nanmin(values)) for values in columns)
    noise = estimate_noise_level(columns[1])
    force_tolerance = max(noise_factor * noise, force_fraction * force_range)
    tolerances = displacement_fraction * travel, force_tolerance
    samples = tuple(values[::stride].copy() for values in columns)
    group_key = (result.protocol, marker_names, len(columns[0]))
    mean_force = float(np.nanmean(samples[1]))
    return RecordingIdentity(export_key, group_key, samples, tolerances, mean_force)


def find_copies(recordings: Sequence[tuple[Path, RecordingIdentity]]) -> dict[str, str]:
    """Find the tests whose recording is that of an earlier test.

    Parameters
    ----------
    recordings : result file and recording (`identify_recording`) of each test

    Returns
    -------
    Reason to leave out each of these tests, keyed by the path of its result file.
    """
    first_files: dict[Hashable, Path] = {}
    groups: dict[Hashable, list[tuple[float, Path, RecordingIdentity]]] = {}
    copies: dict[str, str] = {}
    for file, recording in recordings:
        # Mean forces differ by at most the root mean square of the differences of the samples.
        group, mean_force = groups.setdefault(recording.group_key, []), recording.mean_force
        tolerance = recording.tolerances[1] if recording.tolerances else 0.0
        start = bisect_left(group, mean_force - tolerance, key=itemgetter(0))
        stop = bisect_right(group, mean_force + tolerance, key=itemgetter(0))
        equal_files = (path for _, path, x in group[start:stop] if recording.has_samples_of(x))
        original = first_files.get(recording.export_key) or next(equal_files, None)
        if original is not None:
            copies[str(file)] = str(UsageError.about("process.copy", file, original=original))
            continue
        first_files[recording.export_key] = file
        insort(group, (mean_force, file, recording), key=itemgetter(0))
    return copies


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
        If a path does not exist, contains no test, or is in a folder that labpipe was writing.
    """
    for target in targets:
        if target.is_file() and target.suffix not in {".yaml", ".yml", ".h5"}:
            kind = f"a {target.suffix} file" if target.suffix else "a file without a suffix"
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
        If a path does not exist, contains no processed test, or is in a folder that labpipe was
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
    The files in sorted order. A file of a replacement that a killed process left unfinished is
    listed under its final path.
    """
    paths: list[Path] = []
    for parent, folders, files in os.walk(folder):
        folders[:] = [folder for folder in folders if not folder.startswith(".")]
        file_names = [name] if name else [file for file in files if not file.startswith(".")]
        candidates = [Path(parent, file_name) for file_name in file_names]
        paths += [path for path in candidates if path.name in files or exists_or_is_staged(path)]
    return sorted(paths)


def refuse_duplicates(names: Iterable[tuple[str, Path]], kind: str) -> None:
    """Raise an error if two tests have the same name or results folder, apart from case.

    Parameters
    ----------
    names : name or results folder of each test, and file of the test
    kind : ``name`` or ``folder of results``, for messages

    Raises
    ------
    UsageError
        If a name occurs twice; each repetition is reported with both files.
    """
    if faults := list_duplicates(names, kind):
        raise UsageError("\n".join(faults))


def list_duplicates(names: Iterable[tuple[str, Path]], kind: str) -> list[str]:
    """List one message for each repetition that `refuse_duplicates` refuses.

    Parameters
    ----------
    names, kind : as for `refuse_duplicates`
    """
    first_files: dict[str, Path] = {}
    faults = []
    for name, file in names:
        original = first_files.setdefault(name.casefold(), file)
        if original != file:
            error = UsageError.about("process.repeated", file, kind=kind, name=name, first=original)
            faults.append(str(error))
    return faults


def _find_files(targets: Sequence[Path], name: str) -> list[Path]:
    """List the targets that are files, and in the targets that are folders the files of a name."""
    files: dict[Path, Path] = {}
    for target in targets:
        if set(target.resolve().parts) & set(TEMPORARY_FOLDERS):
            raise UsageError.about("process.unfinished", target)
        matching_files = [target] if exists_or_is_staged(target) else list_files_below(target, name)
        if not matching_files:
            kind = "none" if target.is_dir() else "a pipe or a device"
            kind = kind if target.exists() else "nothing of that name"
            raise UsageError.about(
                "process.no_test" if name == SHEET_NAME else "process.no_result", target, found=kind
            )
        for file in matching_files:
            files.setdefault(file.resolve(), file)
    return list(files.values())
