"""Solve a harness: the path of its line, results with intervals, and the sweep of lengths."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.mechanics.rod.bands import (
    Band,
    InputDistribution,
    LineBands,
    StateBands,
    join_bands,
    predict_line_bands,
)
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import Inputs, Material, prepare_line
from labpipe.mechanics.studies.harness_numbers import (
    LOWEST_POINT,
    PATH_RADIUS,
    RADIUS,
    Bend,
    BendLimit,
    Doubt,
    build_results,
    choose_bend_limit,
    collect_fields,
    estimate_magnitudes,
    evaluate_numbers,
    find_jump_doubt,
    find_reasons,
    find_sharpest_bend,
    find_unloading_doubt,
    get_unit,
    list_unloading_numbers,
    make_convergence_doubts,
    make_share_doubts,
)
from labpipe.messages import format_sentence
from labpipe.protocol.model_files import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status


@dataclass(frozen=True, slots=True, eq=False)
class HarnessSolution:
    """Solution of a harness.

    Parameters
    ----------
    file : path of the harness file
    harness : content of the harness file
    material : material of the line
    path : equilibrium of the line at each step
    status : ``failed`` if the line cannot be solved to the last step; ``doubtful`` if there are
        reasons why all numbers are doubtful
    reasons : reasons why all numbers are doubtful, or why the solution failed
    results : results of the last step and of the path; empty if the solution failed
    limit : allowed bend radius
    folder : folder of the result files
    files : paths of the files that were written
    sweep : solutions of `solve_sweep` for the lengths of the sweep
    bands : bands of the shown steps; None if the uncertainty of the line is unknown
    """

    file: Path
    harness: HarnessFile
    material: Material
    path: RodPath
    status: Status
    reasons: tuple[Reason, ...]
    results: tuple[Result, ...]
    limit: BendLimit
    folder: Path
    files: tuple[Path, ...] = ()
    sweep: tuple[HarnessSolution, ...] = ()
    bands: HarnessBands | None = None

    @property
    def steps(self) -> tuple[int, ...]:
        """Return the numbers of the shown steps: those that the file names, and the last step."""
        return tuple(sorted({*self.harness.show, self.harness.steps}))

    @property
    def intervals(self) -> Mapping[str, Interval]:
        """Return intervals of the numbers, keyed by name; empty if the uncertainty is unknown."""
        return {} if self.bands is None else self.bands.intervals

    @property
    def bands_by_step(self) -> Mapping[int, StateBands]:
        """Return the bands of the shown steps, keyed by step."""
        states = () if self.bands is None else self.bands.line.states
        return {state.step: state for state in states}

    @property
    def sharpest_bend(self) -> Bend:
        """Return the sharpest bend of all steps; its radius is NaN for a failed line."""
        return find_sharpest_bend(self.path, range(len(self.path.states)))

    @property
    def final_sharpest_bend(self) -> Bend:
        """Return the sharpest bend at the last step; its radius is NaN for a failed line."""
        return find_sharpest_bend(self.path, [len(self.path.states) - 1])

    @property
    def is_bend_doubtful(self) -> bool:
        """Return whether the sharpest bend of all steps is doubtful."""
        results = [result for result in self.results if result.name == PATH_RADIUS]
        return any(result.status is Status.DOUBTFUL for result in results)


@dataclass(frozen=True, slots=True)
class Progress:
    """Functions that report progress.

    Parameters
    ----------
    begin : function that is called first, with the number of lines and the number of steps of each
        line
    begin_line : function that is called with the name of each line before it is solved
    end_step : function that is called after each step
    """

    begin: Callable[[int, int], object] = lambda _lines, _steps: None
    begin_line: Callable[[str], object] = lambda _: None
    end_step: Callable[[], object] = lambda: None


def solve_harness(
    harness: HarnessFile,
    file: Path,
    material: Material,
    folder: Path,
    on_step: Callable[[], object] = lambda: None,
    *,
    is_variant: bool = False,
) -> HarnessSolution:
    """Solve a harness without its sweep.

    Parameters
    ----------
    harness : content of the harness file
    file : path of the harness file
    material : material of the line
    folder : folder of the result files, which are not written here
    on_step : function that is called after each step of the line
    is_variant : whether the harness is a variant of a sweep. A variant has no check of convergence.
        If only the isotropic share is uncertain, it has no bands, because shapes hardly depend on
        this share

    Returns
    -------
    The solution. Its status is ``failed`` if the line cannot be solved to the last step.

    Raises
    ------
    ProcessingError
        If the line does not fit its boundaries.
    """
    has_bands = not (is_variant and material.varies_only_share)
    paths: list[RodPath] = []

    def solve(index: int, inputs: Inputs) -> RodPath:
        prepared = prepare_line(harness, material.sections[index](inputs), inputs)
        with np.errstate(over="ignore", invalid="ignore"):  # the status of such a path is failed
            paths.append(follow(*prepared, steps=harness.steps, on_step=on_step))
        return paths[-1]

    try:
        steps = (*harness.show, harness.steps)
        bands = predict_bands(solve, material, steps) if has_bands else None
        path = paths[0] if paths else solve(0, material.best_inputs)
    except ValueError as error:
        raise ProcessingError.about(
            "mechanics.studies.line_does_not_fit", file, "line", error=error
        ) from error
    reasons = _collect_reasons(path, material, bands)
    is_failed = path.status is Status.FAILED
    solved_status = Status.DOUBTFUL if reasons else Status.OK
    solution = HarnessSolution(
        file=file,
        harness=harness,
        material=material,
        path=path,
        status=Status.FAILED if is_failed else solved_status,
        reasons=reasons,
        results=(),
        limit=choose_bend_limit(harness, material),
        folder=folder,
        bands=bands,
    )
    if is_failed:
        return solution
    doubts = [] if is_variant else _find_discretisation_doubts(solution)
    return replace(solution, results=_build_results(solution, doubts))


def _find_discretisation_doubts(solution: HarnessSolution) -> list[Doubt]:
    """Return the doubts about numbers that depend on the number of steps or elements."""
    harness, material = solution.harness, solution.material
    line = harness.line.model_copy(update={"elements": harness.line.elements // 2})
    coarse_harness, section = harness.model_copy(update={"line": line}), material.sections[0]
    coarse_line = prepare_line(coarse_harness, section(material.best_inputs), material.best_inputs)
    return list(make_convergence_doubts(solution.path, coarse_line, solution.intervals))


def _build_results(
    solution: HarnessSolution, convergence_doubts: Sequence[Doubt]
) -> tuple[Result, ...]:
    """Build the results of a solved harness with their doubts and intervals."""
    material, path, intervals = solution.material, solution.path, solution.intervals
    doubts = [find_jump_doubt(path), find_unloading_doubt(path), *convergence_doubts]
    names = list_unloading_numbers(path)
    if material.share_range:
        doubts += make_share_doubts(intervals, names, material.share_range)
    if material.varies_only_share:
        intervals = {name: item for name, item in intervals.items() if name.startswith(names)}
    return build_results(path, solution.reasons, intervals, [*filter(None, doubts)])


def _collect_reasons(
    path: RodPath, material: Material, bands: HarnessBands | None
) -> tuple[Reason, ...]:
    """Collect the reasons of the path and of the bands why all numbers are doubtful or missing."""
    reasons = find_reasons(path, material)
    if bands is None:
        return reasons
    # A path beyond the tested curvature has a reason of its own.
    omitted_codes = {reason.code for reason in reasons} | {"beyond_tested"}
    doubts = [*(Reason(note.code, note.message) for note in bands.line.notes), bands.doubt]
    return reasons + tuple(doubt for doubt in doubts if doubt and doubt.code not in omitted_codes)


def solve_sweep(
    solution: HarnessSolution,
    lengths: Sequence[float],
    progress: Progress = Progress(),
) -> tuple[HarnessSolution, ...]:
    """Solve a harness with other lengths of its line, of which only the last step is shown.

    Parameters
    ----------
    solution : solution for the length in the file, which is not solved again
    lengths : lengths of the line, m
    progress : functions that report progress

    Returns
    -------
    The solution for each length. The reasons of a solution are those of the shown results.

    Raises
    ------
    ProcessingError
        If the line does not fit its boundaries.

    Notes
    -----
    Convergence is checked in the order of increasing radius of the sharpest bend, relative to the
    length of an element, up to the first length that has converged. All lengths with less sharp
    bends count as converged.
    """
    file, material, folder = solution.file, solution.material, solution.folder
    solutions = []
    for length in lengths:
        variant = solution
        if length != solution.harness.line.length:
            progress.begin_line(f"length {1e3 * length:.6g} mm")
            line = solution.harness.line.model_copy(update={"length": length})
            harness = solution.harness.model_copy(update={"line": line, "show": ()})
            variant = solve_harness(
                harness, file, material, folder, progress.end_step, is_variant=True
            )
        solutions.append(variant)
    variants = [item for item in solutions if item is not solution and item.results]
    variants.sort(key=lambda variant: variant.sharpest_bend.radius / variant.path.line.length)
    for variant in variants:
        doubts = _find_discretisation_doubts(variant)
        if not doubts:
            break
        results = _build_results(variant, doubts)
        solutions[solutions.index(variant)] = replace(variant, results=results)
    return tuple(map(_limit_to_shown_reasons, solutions))


def _limit_to_shown_reasons(solution: HarnessSolution) -> HarnessSolution:
    """Keep only the reasons of the results that a sweep shows, and set the status accordingly."""
    if solution.status is Status.FAILED:
        return solution
    shown_reasons = [
        reason
        for result in solution.results
        if result.name in (RADIUS, PATH_RADIUS, LOWEST_POINT) and result.value is not None
        for reason in result.reasons
    ]
    status = Status.DOUBTFUL if shown_reasons else Status.OK
    return replace(solution, reasons=tuple(dict.fromkeys(shown_reasons)), status=status)


IndexedSolver = Callable[[int, Inputs], RodPath]
"""Function that solves the line for the index of a distribution and values of the inputs."""
_ROUNDING_ERROR = 1e-6
"""Rounding error of the solver, relative to a number plus its estimated magnitude."""
_SHAPE = "shape"
"""Key of the positions of the nodes in the result of `_evaluate`."""


@dataclass(frozen=True, slots=True, eq=False)
class HarnessBands:
    """Bands of the shapes and of the numbers of a harness.

    Parameters
    ----------
    line : pointwise bands of the shape at the shown steps
    intervals : intervals of the numbers, keyed by name
    doubt : reason why bands and intervals are doubtful; None if all draws that were solved have an
        equilibrium in which the effects of the causes add up
    """

    line: LineBands
    intervals: Mapping[str, Interval]
    doubt: Reason | None = None


def predict_bands(
    solve: IndexedSolver, material: Material, steps: Sequence[int]
) -> HarnessBands | None:
    """Compute pointwise 95 % bands of the shape, and intervals of the numbers.

    Parameters
    ----------
    solve : function that solves the line for the index of a distribution and values of the inputs
    material : material of the line, with the distributions of its inputs
    steps : steps for which the shape has bands

    Returns
    -------
    Bands of the shape and intervals; None without distributions, or if the line cannot be solved
    at the best inputs of a distribution.
    """
    if not material.distributions:
        return None
    line = predict_line_bands(
        [partial(solve, index) for index in range(len(material.distributions))],
        material.distributions,
        steps=sorted(set(steps)),
        tested_curvature=material.curvature_limit,
        collect=collect_fields,
    )
    if line is None:
        return None
    # For each distribution, the numbers at its best inputs and in all its draws.
    best_numbers = [_evaluate(item.best_fields.__getitem__, line.path) for item in line.responses]
    draws = [_evaluate(response.compute_draws, line.path) for response in line.responses]
    pairs = list(zip(best_numbers, draws, strict=True))
    bands = {
        name: join_bands((numbers[name], drawn_numbers[name]) for numbers, drawn_numbers in pairs)
        for name in best_numbers[0]
    }
    intervals = {name: _make_interval(name, band) for name, band in bands.items() if name != _SHAPE}
    return HarnessBands(line, intervals, _find_draw_doubt(solve, line, draws, bands))


def _evaluate(get_field: Callable[[str], Floats], path: RodPath) -> dict[str, Floats]:
    """Compute all numbers and the shape from fields; a curvature replaces each bend radius.

    Parameters
    ----------
    get_field : function that returns the field of a name
    path : path of the line at the best inputs
    """
    last_positions = get_field(f"positions {len(path.states) - 1}")
    return {**evaluate_numbers(get_field, path), _SHAPE: last_positions}


def _make_interval(name: str, band: Band) -> Interval:
    """Make the interval of a number; that of a radius is made from the band of the curvature."""
    lower, upper = float(band.lower), float(band.upper)
    if name in (RADIUS, PATH_RADIUS):
        lower, upper = (1.0 / end if end > 0.0 else math.inf for end in (upper, lower))
    return Interval(lower, upper)


def choose_draws(distribution: InputDistribution) -> tuple[int, ...]:
    """Choose draws of different magnitudes, to test whether the effects of causes add up.

    Parameters
    ----------
    distribution : distribution of the inputs

    Returns
    -------
    Rows of the draws in `distribution.amounts`; empty if the distribution has a single cause.
    """
    # Large draws show best whether the effects add up. Therefore no rank is in the lower half.
    relative_ranks = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9)
    amounts = distribution.amounts
    if amounts.shape[1] < 2:
        return ()
    magnitudes = np.linalg.norm(amounts / np.std(amounts, axis=0), axis=1)
    sorted_rows = np.argsort(magnitudes, kind="stable")
    return tuple(int(sorted_rows[int(rank * len(sorted_rows))]) for rank in relative_ranks)


def _find_draw_doubt(
    solve: IndexedSolver,
    line: LineBands,
    draws: Sequence[Mapping[str, Floats]],
    bands: Mapping[str, Band],
) -> Reason | None:
    """Solve the line for some draws, and return the reason why the bands are doubtful, if any.

    Parameters
    ----------
    solve : function that solves the line for the index of a distribution and values of the inputs
    line : bands of the shape
    draws : numbers of all draws of each distribution, keyed by name
    bands : bands of the numbers, keyed by name

    Returns
    -------
    The reason; None if the bands are not doubtful.
    """
    max_draw_error = 0.5  # relative to the distance from the median to the end of the band
    # `_evaluate` returns a curvature instead of a radius.
    units = {_SHAPE: "m", RADIUS: "1/m", PATH_RADIUS: "1/m"}
    units = {name: units.get(name) or get_unit(name) for name in bands}
    magnitudes = estimate_magnitudes(line.path.line)
    squares: dict[str, list[float]] = {name: [] for name in bands}
    n_draws = n_unsolved = 0
    for index, (response, values_by_draw) in enumerate(zip(line.responses, draws, strict=True)):
        distribution = response.distribution
        for row in choose_draws(distribution):
            n_draws += 1
            path = solve(index, distribution.to_inputs(distribution.amounts[row]))
            if path.status is Status.FAILED:
                n_unsolved += 1
                continue
            for name, value in _evaluate(collect_fields(path).__getitem__, path).items():
                size = magnitudes[units[name]]
                error = _compute_draw_error(value, values_by_draw[name], row, bands[name], size)
                squares[name].append(error**2)
    rms_errors = {name: math.sqrt(np.mean(items)) for name, items in squares.items() if items}
    worst_name = max(rms_errors, key=lambda name: rms_errors[name], default=_SHAPE)
    findings = [f"{n_unsolved} have no equilibrium"] if n_unsolved else []
    if rms_errors.get(worst_name, 0.0) > max_draw_error:
        values = {"number": worst_name, "error": rms_errors[worst_name], "maximum": max_draw_error}
        findings.append(format_sentence("mechanics.studies.cause_error", **values))
    if not findings:
        return None
    text = " and ".join(findings)
    return Reason.of("mechanics.studies.causes_do_not_add", count=n_draws, findings=text)


def _compute_draw_error(value: Floats, draws: Floats, row: int, band: Band, size: float) -> float:
    """Compute the error of a draw, relative to the distance from the median to the end of the band.

    For positions, the largest error and the largest distance along the line are used.

    Parameters
    ----------
    value : number of the solved line
    draws : numbers of all draws from the linear extrapolation
    row : row of the draw in `draws`
    band : band of the number
    size : estimated magnitude of the number
    """
    median = np.median(draws, axis=0)
    distances = np.where(value > median, band.upper - median, median - band.lower)
    rounding_error = _ROUNDING_ERROR * (size + float(np.max(np.abs(value))))
    return float(np.max(np.abs(value - draws[row])) / max(float(np.max(distances)), rounding_error))
