"""Solution of a harness file: path of its line, numbers with their bands, and its sweep."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.mechanics.rod.bands import LineBands, StateBands, predict_line_bands
from labpipe.mechanics.rod.input_distributions import InputDistribution
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.response import (
    Band,
    Fields,
    Response,
    compute_band,
    compute_norms,
    respond,
)
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_convergence import check_convergence
from labpipe.mechanics.studies.harness_line import Inputs, PreparedLine, prepare_line
from labpipe.mechanics.studies.harness_numbers import (
    LOWEST_POINT,
    POSITIONS,
    RADIUS,
    RADIUS_ON_PATH,
    Bend,
    BendLimit,
    Doubt,
    build_results,
    check_elements,
    check_jumps,
    check_share,
    check_unloading,
    collect_fields,
    compute_numbers,
    estimate_size,
    evaluate_number,
    find_bend_limit,
    find_reasons,
    find_sharpest_bend,
    list_numbers,
    list_unloading_numbers,
)
from labpipe.mechanics.studies.harness_section import Material, fix_inputs
from labpipe.messages import format_sentence
from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status

FAILED = "failed"


@dataclass(frozen=True, slots=True, eq=False)
class FollowedHarness:
    """A harness file with its solution.

    Parameters
    ----------
    file : its YAML
    harness : as read
    material : of its line
    prepared : line and boundaries
    path : of the line
    status : ``failed`` if the line cannot be solved to the last step; then only the reason is
        written
    reasons : why all numbers are doubtful, or why the solution failed
    results : numbers; empty if failed
    limit : allowed bend radius
    folder : of the results
    files : that were written
    sweep : solutions for the lengths of the sweep; their reasons are those of their bend radii
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
    sweep: tuple[FollowedHarness, ...] = ()
    bands: HarnessBands | None = None

    @property
    def steps(self) -> tuple[int, ...]:
        """Return the steps that are shown: those of the file, and the last."""
        return list_shown_steps(self.harness)

    @property
    def bands_by_step(self) -> Mapping[int, StateBands]:
        """Return the bands of the steps that are shown."""
        states = () if self.bands is None else self.bands.line.states
        return {state.step: state for state in states}

    @property
    def sharpest(self) -> Bend:
        """Return the find_sharpest_bend bend of all steps; NaN for a failed line."""
        return self._sharpest(range(len(self.path.states)))

    @property
    def bend(self) -> Bend:
        """Return the find_sharpest_bend bend at the last step; NaN for a failed line."""
        return self._sharpest([len(self.path.states) - 1])

    def _sharpest(self, steps: Sequence[int]) -> Bend:
        if self.status is Status.FAILED:
            return Bend(math.nan, -1, math.nan)
        return find_sharpest_bend(self.path, self.prepared.line, steps)

    @property
    def is_bend_doubtful(self) -> bool:
        """Return whether the find_sharpest_bend bend of all steps is doubtful."""
        numbers = [result for result in self.results if result.name == RADIUS_ON_PATH]
        return any(result.status is Status.DOUBTFUL for result in numbers)


def list_shown_steps(harness: HarnessFile) -> tuple[int, ...]:
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
) -> FollowedHarness:
    """Solve a harness, without its sweep.

    Parameters
    ----------
    harness : as read
    file : its YAML
    material : of its line
    folder : of the results; nothing is written
    on_step : called after each step of the line

    Raises
    ------
    ProcessingError
        If the line does not fit its boundaries.
    """
    path, prepared, bands = _follow_with_bands(harness, file, material, on_step)
    reasons = _collect_reasons(path, prepared, material, bands)
    is_whole = path.status != FAILED
    status = (Status.DOUBTFUL if reasons else Status.OK) if is_whole else Status.FAILED
    results: tuple[Result, ...] = ()
    if is_whole:
        intervals = {} if bands is None else bands.intervals
        line = harness.line.model_copy(update={"elements": harness.line.elements // 2})
        coarse, section = harness.model_copy(update={"line": line}), material.sections[0]
        half = prepare_line(coarse, section(material.best), material.best)
        names = list_unloading_numbers(path, prepared)
        doubts = _collect_doubts(path, prepared, half, intervals)
        if material.has_unknown_share:
            doubts += check_share(intervals, names)
        if material.knows_only_share:
            intervals = {
                name: interval for name, interval in intervals.items() if name.startswith(names)
            }
        results = build_results(compute_numbers(path, prepared), reasons, intervals, doubts)
    limit = find_bend_limit(harness, material)
    return FollowedHarness(
        *(file, harness, material, prepared, path, status, reasons, results, limit, folder),
        bands=bands,
    )


def _collect_doubts(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> list[Doubt]:
    """Return the doubts about some numbers of a complete path."""
    doubts = [
        check_elements(path, prepared.line),
        check_jumps(path, prepared),
        check_unloading(path, prepared),
        *check_convergence(path, prepared, half, intervals),
    ]
    return [doubt for doubt in doubts if doubt is not None]


def _collect_reasons(
    path: RodPath, prepared: PreparedLine, material: Material, bands: HarnessBands | None
) -> tuple[Reason, ...]:
    """Return the reasons why all numbers are doubtful or missing, those of the bands included."""
    reasons = find_reasons(path, prepared.line, material)
    if bands is None:
        return reasons
    codes = {reason.code for reason in reasons} | {"beyond_tested"}
    notes = [Reason(note.code, note.message) for note in bands.line.notes]
    notes += [] if bands.doubt is None else [bands.doubt]
    return reasons + tuple(note for note in notes if note.code not in codes)


def solve_sweep_length(
    stated: FollowedHarness, length: float, on_step: Callable[[], object] = lambda: None
) -> FollowedHarness:
    """Solve a harness with another length of its line; only its last step is shown.

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
        line = stated.harness.line.model_copy(update={"length": length})
        harness = stated.harness.model_copy(update={"line": line, "show": ()})
        material = stated.material
        if material.knows_only_share:  # shapes of a sweep hardly depend on it
            material = fix_inputs(material)
        other = solve_harness(harness, stated.file, material, stated.folder, on_step)
    if other.status is Status.FAILED:
        return other
    listed = [
        result.reasons
        for result in other.results
        if result.name in (RADIUS, RADIUS_ON_PATH, LOWEST_POINT) and result.value is not None
    ]
    reasons = tuple(dict.fromkeys(reason for result in listed for reason in result))
    return replace(other, reasons=reasons, status=Status.DOUBTFUL if reasons else Status.OK)


def _follow_with_bands(
    harness: HarnessFile, file: Path, material: Material, on_step: Callable[[], object]
) -> tuple[RodPath, PreparedLine, HarnessBands | None]:
    """Solve a line at its best inputs, and at further inputs if these have distributions."""
    solutions: list[Followed] = []

    def follow_line(number: int, inputs: Inputs) -> Followed:
        prepared = prepare_line(harness, material.sections[number](inputs), inputs)
        with np.errstate(over="ignore", invalid="ignore"):  # such a path has the status failed
            path = follow(prepared.line, prepared.boundaries, steps=harness.steps, on_step=on_step)
        solutions.append((path, prepared))
        return solutions[-1]

    try:
        bands = predict_bands(follow_line, material, list_shown_steps(harness))
        path, prepared = solutions[0] if solutions else follow_line(0, material.best)
    except ValueError as error:
        raise ProcessingError.about(
            "mechanics.studies.line_does_not_fit", file, "line", error=error
        ) from error
    return path, prepared, bands


Followed = tuple[RodPath, PreparedLine]
FollowLine = Callable[[int, Inputs], Followed]
"""Prepare and solve a line: number of the distribution, and inputs."""
_ROUNDING = 1e-6
"""Rounding error of the solver, over a number or its `estimate_size`."""
_SHAPE = "shape"


@dataclass(frozen=True, slots=True, eq=False)
class HarnessBands:
    """Bands of the shapes and of the numbers of a harness.

    Parameters
    ----------
    line : pointwise bands of the steps that are shown
    intervals : of the numbers of the last step, by name
    doubt : reason why they are doubtful; None if the effects of the causes add up
    """

    line: LineBands
    intervals: Mapping[str, Interval]
    doubt: Reason | None = None


def predict_bands(
    follow_line: FollowLine, material: Material, steps: Sequence[int]
) -> HarnessBands | None:
    """Compute pointwise 95 % bands of the shape, and intervals of the numbers.

    Parameters
    ----------
    follow_line : solves the line for given inputs
    material : of the line, with the distributions of its inputs
    steps : for which the shape has bands

    Returns
    -------
    None without distributions, or if the line cannot be solved at the best inputs.
    """
    solves = [_Solver(follow_line, number) for number in range(len(material.distributions))]
    if not solves:
        return None
    limit = material.limit
    line = predict_line_bands(
        [solve.path for solve in solves],
        material.distributions,
        steps=steps,
        tested_curvature=limit,
    )
    if line is None:
        return None
    pairs = zip(solves, material.distributions, strict=True)
    draws = [
        _DrawnNumbers(solve, respond(solve.fields, distribution)) for solve, distribution in pairs
    ]
    bands = {name: _compute_band(draws, name) for name in draws[0].value}
    intervals = {
        name: _compute_interval(name, band) for name, band in bands.items() if name != _SHAPE
    }
    return HarnessBands(line, intervals, _check_draws(draws, bands))


def _compute_band(draws: Sequence[_DrawnNumbers], name: str) -> Band:
    by_response = {draw.response: draw for draw in draws}
    return compute_band(
        list(by_response),
        lambda response: (by_response[response].value[name], by_response[response].drawn[name]),
    )


def _compute_interval(name: str, band: Band) -> Interval:
    """Return the interval of a number; that of a radius follows from the band of its curvature."""
    level = 0.95
    lower, upper = float(band.lower), float(band.upper)
    if name in (RADIUS, RADIUS_ON_PATH):
        ends = [1.0 / end if end > 0.0 else math.inf for end in (upper, lower)]
        return Interval(ends[0], ends[1], level)
    return Interval(lower, upper, level)


class _Solver:
    """Solver of a line for the inputs of one distribution; equal inputs are solved once."""

    def __init__(self, follow_line: FollowLine, number: int) -> None:
        self.follow_line, self.number = follow_line, number
        self.solutions: dict[tuple[tuple[str, float], ...], Followed] = {}

    def solve(self, inputs: Inputs) -> Followed:
        """Return path and line for inputs."""
        key = tuple(sorted(inputs.items()))
        if key not in self.solutions:
            self.solutions[key] = self.follow_line(self.number, inputs)
        return self.solutions[key]

    @property
    def first(self) -> Followed:
        """Return path and line at the best inputs, which are solved first."""
        return next(iter(self.solutions.values()))

    def path(self, inputs: Inputs) -> RodPath:
        """Return the path for inputs."""
        return self.solve(inputs)[0]

    def fields(self, inputs: Inputs) -> Fields | None:
        """Return the fields of all numbers; None if the line cannot be solved."""
        path, prepared = self.solve(inputs)
        return None if path.status == "failed" else collect_fields(path, prepared)


class _DrawnNumbers:
    """Numbers at the best inputs of a distribution, and in its draws; of radii, the curvatures.

    The positions of the nodes, shape (n + 1, 3), are one of the numbers.
    """

    def __init__(self, solve: _Solver, response: Response | None) -> None:
        assert response is not None, "the line was solved at the best inputs before"
        self.solve, self.response = solve, response
        self.names = list_numbers(response.value)
        self.value = self.numbers(response.value.__getitem__)
        self.drawn = self.numbers(response.drawn)

    def numbers(self, field: Callable[[str], Floats]) -> dict[str, Floats]:
        """Compute all numbers, and the positions of the nodes, from fields."""
        path, prepared = self.solve.first
        steps = len(path.states) - 1
        numbers = {name: evaluate_number(name, field, prepared, steps) for name in self.names}
        return numbers | {_SHAPE: field(POSITIONS)}

    def solved_draws(self) -> Iterator[tuple[int, dict[str, Floats] | None]]:
        """Solve the line for some draws; yield None for a draw without equilibrium."""
        distribution = self.response.distribution
        for row in choose_draws(distribution):
            fields = self.solve.fields(distribution.inputs(distribution.amounts[row]))
            yield row, None if fields is None else self.numbers(fields.__getitem__)


def choose_draws(distribution: InputDistribution) -> tuple[int, ...]:
    """Choose rows of draws of different sizes; none for a single cause, which has nothing to add.

    Parameters
    ----------
    distribution : of the inputs
    """
    # ranks by size: large draws show best whether the effects of the causes add up
    rank_shares = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9)
    amounts = distribution.amounts
    if amounts.shape[1] < 2:
        return ()
    order = np.argsort(compute_norms(amounts / np.std(amounts, axis=0)), kind="stable")
    return tuple(int(order[int(rank * len(order))]) for rank in rank_shares)


def _check_draws(draws: Sequence[_DrawnNumbers], bands: Mapping[str, Band]) -> Reason | None:
    """Solve some draws; return the reason why bands are doubtful, or None."""
    max_cause_error = 0.5  # of half the width of a band
    path, prepared = draws[0].solve.first
    scales = _compute_rounding(path, prepared)
    squares: dict[str, list[float]] = {}
    count = unsolved = 0
    for draw in draws:
        for row, numbers in draw.solved_draws():
            count += 1
            unsolved += numbers is None
            for name, number in (numbers or {}).items():
                times = _compute_draw_error(
                    number, draw.drawn[name], row, bands[name], scales[name]
                )
                squares.setdefault(name, []).append(times**2)
    errors = {name: math.sqrt(sum(square) / len(square)) for name, square in squares.items()}
    worst = max(errors, key=lambda name: errors[name], default=_SHAPE)
    if not unsolved and errors.get(worst, 0.0) <= max_cause_error:
        return None
    faults = [f"{unsolved} have no equilibrium"] if unsolved else []
    if errors.get(worst, 0.0) > max_cause_error:
        error, limit = errors[worst], max_cause_error
        faults.append(
            format_sentence("mechanics.studies.cause_error", number=worst, error=error, most=limit)
        )
    return Reason.of(
        "mechanics.studies.causes_do_not_add", count=count, faults=" and ".join(faults)
    )


def _compute_rounding(path: RodPath, prepared: PreparedLine) -> dict[str, float]:
    """Return the rounding error of each number, and of the positions."""
    units = {number.name: number.unit for number in compute_numbers(path, prepared)} | {_SHAPE: "m"}
    units |= dict.fromkeys((RADIUS, RADIUS_ON_PATH), "1/m")
    return {name: _ROUNDING * estimate_size(unit, prepared.line) for name, unit in units.items()}


def _compute_draw_error(number: Floats, drawn: Floats, row: int, band: Band, scale: float) -> float:
    """Return the error of a draw over the distance from the median to the end of its band.

    For positions, both the error and the distance are the largest along the line.
    """
    middle = np.median(drawn, axis=0)
    distances = np.where(number > middle, band.upper - middle, middle - band.lower)
    least = scale + _ROUNDING * float(np.max(np.abs(number)))
    return float(np.max(np.abs(number - drawn[row])) / max(float(np.max(distances)), least))
