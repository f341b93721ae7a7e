"""Solution of a harness: its path, its numbers with their bands, and the lengths of its sweep."""

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
from labpipe.rod.bands import StateBands
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
    path : of the line
    prepared : line and boundaries
    reasons : why its bend is doubtful or missing
    bands : of the last step, if any
    """

    length: float
    path: RodPath
    prepared: PreparedLine
    reasons: tuple[Reason, ...] = ()
    bands: HarnessBands | None = None

    @property
    def status(self) -> str:
        """Return `ok`, `doubtful` or `failed`."""
        return self.path.status if self.path.status == FAILED or not self.reasons else "doubtful"

    @property
    def bend(self) -> Bend:
        """Return the sharpest bend at the last step; NaN for a failed line."""
        return self._sharpest([len(self.path.states) - 1])

    @property
    def bend_on_path(self) -> Bend:
        """Return the sharpest bend of all steps; NaN for a failed line."""
        return self._sharpest(range(len(self.path.states)))

    def _sharpest(self, steps: Sequence[int]) -> Bend:
        if self.path.status == FAILED:
            return Bend(math.nan, -1, math.nan)
        return sharpest(self.path, self.prepared.line, steps)


@dataclass(frozen=True, slots=True, eq=False)
class FollowedHarness:
    """A harness with its solution.

    Parameters
    ----------
    file : its YAML
    harness : as read
    material : of its line
    prepared : line and boundaries
    path : of the line
    status : ``failed`` where the line cannot be solved to the last step; then only the reason is
        written
    reasons : why it is doubtful or failed
    results : numbers; none of a failed one
    limit : allowed bend radius
    folder : of the results
    files : that were written
    sweep : other lengths
    bands : of the steps that are shown; None without information on the uncertainty of the line
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
        """Return the steps that are shown: those of the file, and the last."""
        return shown_steps(self.harness)

    @property
    def bands_by_step(self) -> Mapping[int, StateBands]:
        """Return the bands of the steps that are shown."""
        states = () if self.bands is None else self.bands.line.states
        return {state.step: state for state in states}

    @property
    def sharpest(self) -> Bend:
        """Return the sharpest bend of all steps."""
        return sharpest(self.path, self.prepared.line, range(len(self.path.states)))

    @property
    def is_bend_doubtful(self) -> bool:
        """Return whether the sharpest bend of all steps is doubtful."""
        numbers = [result for result in self.results if result.name == RADIUS_ON_PATH]
        return any(result.status is Status.DOUBTFUL for result in numbers)


def shown_steps(harness: HarnessFile) -> tuple[int, ...]:
    """Return the steps of the file that are shown, and the last.

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
    """Solve a harness, without its sweep.

    Parameters
    ----------
    harness : as read
    file : its YAML
    material : of its line
    folder : of the results; nothing is written
    on_step : called after each step of the line
    length : m, of a sweep, which shows the last step only; None for that of the file

    Raises
    ------
    ProcessingError
        If the line does not fit its boundaries.
    """
    steps = shown_steps(harness) if length is None else (harness.steps,)
    path, prepared, bands = _follow_with_bands(
        harness, file, material, steps, length, on_step=on_step
    )
    reasons = _all_reasons(path, prepared, material, bands)
    is_whole = path.status != FAILED
    status = (Status.DOUBTFUL if reasons else Status.OK) if is_whole else Status.FAILED
    solution = path, prepared, bands
    results = _results_with_doubts(harness, material, solution, length) if is_whole else ()
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
    """Return the numbers of a complete path, each with all its doubts."""
    path, prepared, bands = solution
    intervals = {} if bands is None else bands.intervals
    doubts = _doubts(path, prepared, _with_half_elements(harness, material, length), intervals)
    reasons = _all_reasons(path, prepared, material, bands)
    return results_of(numbers_of(path, prepared), reasons, intervals, doubts)


def _doubts(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> list[Doubt]:
    """Return the doubts about some numbers of a complete path."""
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
    """Return the reasons why all numbers are doubtful or missing, with those of the bands."""
    reasons = reasons_of(path, prepared.line, material)
    if bands is None:
        return reasons
    codes = {reason.code for reason in reasons} | {"beyond_tested"}
    notes = [Reason(note.code, note.message) for note in bands.line.notes]
    notes += [] if bands.doubt is None else [bands.doubt]
    return reasons + tuple(note for note in notes if note.code not in codes)


def solve_sweep_length(
    stated: FollowedHarness, length: float, on_step: Callable[[], object] = lambda: None
) -> SweepRun:
    """Solve a harness with another length of its line.

    Parameters
    ----------
    stated : the harness with its own length, which is not solved again
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
            if result.name in (RADIUS, RADIUS_ON_PATH, LOWEST_POINT) and result.value is not None
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
    """Solve a line at its best inputs, and at others where these have distributions."""
    solutions: list[Followed] = []

    def follow_line(number: int, inputs: Inputs) -> Followed:
        prepared = prepare_line(harness, material.sections[number](inputs), inputs, length=length)
        with np.errstate(over="ignore", invalid="ignore"):  # it then has the status failed
            path = follow(prepared.line, prepared.boundaries, steps=harness.steps, on_step=on_step)
        solutions.append((path, prepared))
        return solutions[-1]

    try:
        bands = harness_bands(follow_line, material, steps)
        path, prepared = solutions[0] if solutions else follow_line(0, material.best)
    except ValueError as error:
        message = error_text(
            *(file, "line"),
            expected="a line that fits its boundaries",
            found=f"this: {error}",
            remedy="Check the line and its boundaries.",
        )
        raise ProcessingError(message) from error
    return path, prepared, bands
