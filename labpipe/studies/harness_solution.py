"""A harness, followed: its path, its numbers with their bands, and the lengths of its sweep."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError, error_text
from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from labpipe.studies.harness_bands import Followed, HarnessBands, harness_bands
from labpipe.studies.harness_convergence import (
    coarse_doubt,
    depends_on_history,
    few_elements_doubt,
    walk_with_other_steps,
)
from labpipe.studies.harness_line import Inputs, PreparedLine, prepare_line
from labpipe.studies.harness_numbers import (
    Bend,
    BendLimit,
    Doubt,
    bend_limit,
    element_doubt,
    jump_doubt,
    numbers_of,
    reasons_of,
    results_of,
    sharpest,
    unloading_doubt,
)
from labpipe.studies.harness_responses import LOWEST_POINT, RADIUS, RADIUS_ON_PATH
from labpipe.studies.harness_section import Material

FAILED = "failed"


@dataclass(frozen=True, slots=True, eq=False)
class SweepRun:
    """One length of a sweep.

    Parameters
    ----------
    length : m
    path : as followed
    prepared : that was followed
    reasons : why its bend is doubtful, or was not found
    bands : of the last step; None without
    """

    length: float
    path: RodPath
    prepared: PreparedLine
    reasons: tuple[Reason, ...] = ()
    bands: HarnessBands | None = None

    @property
    def status(self) -> str:
        """`ok`, `doubtful` or `failed`."""
        return self.path.status if self.path.status == FAILED or not self.reasons else "doubtful"

    @property
    def bend(self) -> Bend:
        """The sharpest bend at the last step; NaN for a line that could not be followed there."""
        return self._sharpest([len(self.path.states) - 1])

    @property
    def bend_on_path(self) -> Bend:
        """The sharpest bend on the way; NaN for a line that could not be followed to its end."""
        return self._sharpest(range(len(self.path.states)))

    def _sharpest(self, steps: Sequence[int]) -> Bend:
        if self.path.status == FAILED:
            return Bend(math.nan, -1, math.nan)
        return sharpest(self.path, self.prepared.line, steps)


@dataclass(frozen=True, slots=True, eq=False)
class FollowedHarness:
    """What became of a harness.

    Parameters
    ----------
    file : its YAML
    harness : as read
    material : of its line
    prepared : line and boundaries that were followed
    path : as followed
    status : ``failed`` where the line cannot be followed to the last step; nothing is written then
        but the reason
    reasons : why it is doubtful or failed
    results : numbers; none of a failed one
    limit : allowed bend radius
    folder : of the results
    files : that were written
    sweep : other lengths
    bands : of the steps that are shown; None where nothing says how well the line is known
    """

    file: Path
    harness: HarnessFile
    material: Material
    prepared: PreparedLine
    path: RodPath
    status: Status
    reasons: tuple[Reason, ...]
    results: tuple[Result, ...]
    limit: BendLimit
    folder: Path
    files: tuple[Path, ...] = ()
    sweep: tuple[SweepRun, ...] = ()
    bands: HarnessBands | None = None

    @property
    def steps(self) -> tuple[int, ...]:
        """Steps that are shown: those that were asked for, and the last."""
        return shown_steps(self.harness)

    @property
    def sharpest(self) -> Bend:
        """The sharpest bend on the whole way."""
        return sharpest(self.path, self.prepared.line, range(len(self.path.states)))

    @property
    def is_bend_doubtful(self) -> bool:
        """Whether the sharpest bend on the whole way is."""
        numbers = [result for result in self.results if result.name == RADIUS_ON_PATH]
        return any(result.status is Status.DOUBTFUL for result in numbers)


def shown_steps(harness: HarnessFile) -> tuple[int, ...]:
    """Steps that were asked for, and the last.

    Parameters
    ----------
    harness : as read
    """
    return tuple(sorted({*harness.show, harness.steps}))


def solve_harness(
    harness: HarnessFile,
    file: Path,
    material: Material,
    folder: Path,
    on_step: Callable[[], object] = lambda: None,
    *,
    length: float | None = None,
) -> FollowedHarness:
    """Follow a harness, without its sweep.

    Parameters
    ----------
    harness : as read
    file : its YAML
    material : of its line
    folder : of the results, which is not touched
    on_step : called after each step of the line
    length : m, of a sweep, which shows the last step only; None for that of the file

    Raises
    ------
    ProcessingError
        If the line cannot be laid as its boundaries say.
    """
    steps = shown_steps(harness) if length is None else (harness.steps,)
    path, prepared, bands = _follow_with_bands(
        harness, file, material, steps, length, on_step=on_step
    )
    reasons = _all_reasons(path, prepared, material, bands)
    is_whole = path.status != FAILED
    status = (Status.DOUBTFUL if reasons else Status.OK) if is_whole else Status.FAILED
    results = (
        _results_with_doubts(harness, material, (path, prepared, bands), length) if is_whole else ()
    )
    limit = bend_limit(harness, material)
    return FollowedHarness(
        *(file, harness, material, prepared, path, status, reasons, results, limit, folder),
        bands=bands,
    )


def _with_half_elements(
    harness: HarnessFile, material: Material, length: float | None
) -> PreparedLine:
    line = harness.line.model_copy(update={"elements": harness.line.elements // 2})
    harness = harness.model_copy(update={"line": line})
    return prepare_line(harness, material.sections[0](material.best), material.best, length=length)


def _results_with_doubts(
    harness: HarnessFile,
    material: Material,
    solution: tuple[RodPath, PreparedLine, HarnessBands | None],
    length: float | None = None,
) -> tuple[Result, ...]:
    """Numbers of a line that was followed to its end, each with all its doubts."""
    path, prepared, bands = solution
    intervals = {} if bands is None else bands.intervals
    doubts = _doubts(path, prepared, _with_half_elements(harness, material, length), intervals)
    reasons = _all_reasons(path, prepared, material, bands)
    return results_of(numbers_of(path, prepared), reasons, intervals, doubts)


def _doubts(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> list[Doubt]:
    """Why some numbers of a line that was followed to its end are doubtful."""
    doubts = [
        element_doubt(path, prepared.line),
        few_elements_doubt(path, prepared, half, intervals),
        jump_doubt(path, prepared),
        unloading_doubt(path, prepared),
    ]
    if depends_on_history(prepared):
        other = walk_with_other_steps(prepared, len(path.states) - 1)
        doubts.append(coarse_doubt(path, prepared, other, intervals))
    return [doubt for doubt in doubts if doubt is not None]


def _all_reasons(
    path: RodPath, prepared: PreparedLine, material: Material, bands: HarnessBands | None
) -> tuple[Reason, ...]:
    """Why all numbers are doubtful, or why there are none; what the bands say included."""
    reasons = reasons_of(path, prepared.line, material)
    if bands is None:
        return reasons
    codes = {reason.code for reason in reasons} | _COVERED_CODES
    notes = [Reason(note.code, note.message) for note in bands.line.notes]
    notes += [] if bands.doubt is None else [bands.doubt]
    return reasons + tuple(note for note in notes if note.code not in codes)


_COVERED_CODES = {"beyond_tested"}
"""Codes of notes of bands that `reasons_of` has a word for."""
_SWEEP_NUMBERS = (RADIUS, RADIUS_ON_PATH, LOWEST_POINT)
"""Numbers that a sweep lists for each length."""


def solve_sweep_length(
    stated: FollowedHarness, length: float, on_step: Callable[[], object] = lambda: None
) -> SweepRun:
    """Follow a harness with another length of its line.

    Parameters
    ----------
    stated : the harness with its own length, which is not followed again
    length : m
    on_step : called after each step of the line

    Raises
    ------
    ProcessingError
        As `solve_harness`.
    """
    other = stated
    if length != stated.harness.line.length:
        inputs = stated.harness, stated.file, stated.material, stated.folder
        other = solve_harness(*inputs, on_step, length=length)
    reasons = other.reasons
    if other.status is not Status.FAILED:
        listed = [
            result.reasons
            for result in other.results
            if result.name in _SWEEP_NUMBERS and result.value is not None
        ]
        reasons = tuple(dict.fromkeys(reason for result in listed for reason in result))
    return SweepRun(length, other.path, other.prepared, reasons, other.bands)


def _follow_with_bands(
    harness: HarnessFile,
    file: Path,
    material: Material,
    steps: Sequence[int],
    length: float | None = None,
    *,
    on_step: Callable[[], object],
) -> tuple[RodPath, PreparedLine, HarnessBands | None]:
    """Follow a line at its best inputs, and beside them where something is believed of them."""
    solutions: list[Followed] = []

    def follow_line(number: int, inputs: Inputs) -> Followed:
        prepared = prepare_line(harness, material.sections[number](inputs), inputs, length=length)
        with np.errstate(over="ignore", invalid="ignore"):  # it then fails, and says so
            path = follow(prepared.line, prepared.boundaries, steps=harness.steps, on_step=on_step)
        found = path, prepared
        solutions.append(found)
        return found

    try:
        bands = harness_bands(follow_line, material, steps)
        path, prepared = solutions[0] if solutions else follow_line(0, material.best)
    except ValueError as error:
        message = error_text(
            *(file, "line"),
            expected="a line that can be laid as its boundaries say",
            found=f"this: {error}",
            remedy="Check the line and what holds it.",
        )
        raise ProcessingError(message) from error
    return path, prepared, bands
