"""Bands of a harness: uncertainty of shape and numbers by that of its inputs.

The response of a line is linear in vectors (`harness_responses`), from which its numbers are
computed in every draw. A few draws are solved with all causes at once to check that these add up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.rod.bands import LineBands, bands_of
from labpipe.rod.input_distributions import InputDistribution
from labpipe.rod.path import RodPath
from labpipe.rod.response import Band, Fields, Response, band_of, respond, sizes
from labpipe.studies.harness_line import Inputs, PreparedLine
from labpipe.studies.harness_numbers import numbers_of, reference_size
from labpipe.studies.harness_responses import (
    POSITIONS,
    RADIUS,
    RADIUS_ON_PATH,
    evaluate_number,
    fields_of,
    number_names,
)
from labpipe.studies.harness_section import Material

Followed = tuple[RodPath, PreparedLine]
FollowLine = Callable[[int, Inputs], Followed]
"""Prepare and solve a line: number of the distribution, and inputs."""
_ROUNDING_SHARE = 1e-6
"""Rounding error of the solver, over a number or its `reference_size`."""
_SHAPE = "shape"


@dataclass(frozen=True, slots=True, eq=False)
class HarnessBands:
    """Bands of the shapes and of the numbers of a harness.

    Parameters
    ----------
    line : pointwise bands of the steps that are shown
    intervals : of the numbers of the last step, by name
    doubt : reason why they are doubtful; None where the causes of a draw add up
    """

    line: LineBands
    intervals: Mapping[str, Interval]
    doubt: Reason | None = None


def harness_bands(
    follow_line: FollowLine, material: Material, steps: Sequence[int]
) -> HarnessBands | None:
    """Predict a harness with pointwise 95 % bands.

    Parameters
    ----------
    follow_line : solves the line for inputs
    material : of the line, with the distributions of its inputs
    steps : with bands of the shape

    Returns
    -------
    None without distributions, or if the line cannot be solved at the best inputs.
    """
    solves = [_Solver(follow_line, number) for number in range(len(material.distributions))]
    if not solves:
        return None
    limit = material.limit
    line = bands_of(
        [solve.path for solve in solves],
        material.distributions,
        steps=steps,
        tested_curvature=limit,
    )
    if line is None:
        return None
    pairs = zip(solves, material.distributions, strict=True)
    draws = [_DrawnNumbers(solve, respond(solve.fields, belief)) for solve, belief in pairs]
    bands = {name: _band(draws, name) for name in draws[0].value}
    intervals = {name: _interval(name, band) for name, band in bands.items() if name != _SHAPE}
    return HarnessBands(line, intervals, _doubt(draws, bands))


def _band(draws: Sequence[_DrawnNumbers], name: str) -> Band:
    by_response = {draw.response: draw for draw in draws}
    return band_of(
        list(by_response),
        lambda response: (by_response[response].value[name], by_response[response].drawn[name]),
    )


def _interval(name: str, band: Band) -> Interval:
    """Return the interval of a number; of a radius, from that of its curvature."""
    level = 0.95
    lower, upper = float(band.lower), float(band.upper)
    if name in (RADIUS, RADIUS_ON_PATH):
        ends = [1.0 / end if end > 0.0 else math.inf for end in (upper, lower)]
        return Interval(ends[0], ends[1], level)
    return Interval(lower, upper, level)


class _Solver:
    """Solves a line for inputs of one distribution, each of them once."""

    def __init__(self, follow_line: FollowLine, number: int) -> None:
        self.follow_line, self.number = follow_line, number
        self.solutions: dict[tuple[tuple[str, float], ...], Followed] = {}

    def solve(self, inputs: Inputs) -> Followed:
        """Return the path and line."""
        key = tuple(sorted(inputs.items()))
        if key not in self.solutions:
            self.solutions[key] = self.follow_line(self.number, inputs)
        return self.solutions[key]

    @property
    def first(self) -> Followed:
        """Return the path and line at the best inputs, which are solved first."""
        return next(iter(self.solutions.values()))

    def path(self, inputs: Inputs) -> RodPath:
        """Return the path alone."""
        return self.solve(inputs)[0]

    def fields(self, inputs: Inputs) -> Fields | None:
        """Return the fields of all numbers; None of a line that cannot be solved."""
        path, prepared = self.solve(inputs)
        return None if path.status == "failed" else fields_of(path, prepared)


class _DrawnNumbers:
    """Numbers at the best inputs of a distribution, and in its draws; radii as curvatures.

    The shape is one of them: positions of the nodes, shape (n + 1, 3).
    """

    def __init__(self, solve: _Solver, response: Response | None) -> None:
        assert response is not None, "the line was solved at the best inputs before"
        self.solve, self.response = solve, response
        self.names = number_names(response.value)
        self.value = self.numbers(response.value.__getitem__)
        self.drawn = self.numbers(response.drawn)

    def numbers(self, field: Callable[[str], Floats]) -> dict[str, Floats]:
        """Return all numbers of fields, and the shape."""
        path, prepared = self.solve.first
        steps = len(path.states) - 1
        numbers = {name: evaluate_number(name, field, prepared, steps) for name in self.names}
        return numbers | {_SHAPE: field(POSITIONS)}

    def solved_draws(self) -> Iterator[tuple[int, dict[str, Floats] | None]]:
        """Solve draws with all their causes at once; None for one without equilibrium."""
        belief = self.response.distribution
        for row in check_draws(belief):
            fields = self.solve.fields(belief.inputs(belief.amounts[row]))
            yield row, None if fields is None else self.numbers(fields.__getitem__)


def check_draws(belief: InputDistribution) -> tuple[int, ...]:
    """Return rows of draws of different sizes; none for a single cause, where nothing is added.

    Parameters
    ----------
    belief : that is drawn from
    """
    # by size of the draw: large draws show best whether causes add up
    rank_shares = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9)
    amounts = belief.amounts
    if amounts.shape[1] < 2:
        return ()
    order = np.argsort(sizes(amounts / np.std(amounts, axis=0)), kind="stable")
    return tuple(int(order[int(rank * len(order))]) for rank in rank_shares)


def _doubt(draws: Sequence[_DrawnNumbers], bands: Mapping[str, Band]) -> Reason | None:
    """Return the reason why bands are doubtful; None where the causes add up."""
    max_cause_error = 0.5  # of half the width of a band
    path, prepared = draws[0].solve.first
    scales = _scales(path, prepared)
    squares: dict[str, list[float]] = {}
    count = lost = 0
    for draw in draws:
        for row, numbers in draw.solved_draws():
            count += 1
            lost += numbers is None
            for name, number in (numbers or {}).items():
                times = _relative_error(number, draw.drawn[name], row, bands[name], scales[name])
                squares.setdefault(name, []).append(times**2)
    off = {name: math.sqrt(sum(square) / len(square)) for name, square in squares.items()}
    largest = max(off, key=lambda name: off[name], default=_SHAPE)
    if not lost and off.get(largest, 0.0) <= max_cause_error:
        return None
    faults = [f"{lost} have no equilibrium"] if lost else []
    if off.get(largest, 0.0) > max_cause_error:
        faults.append(
            f"{largest} differs by {off[largest]:.2g} times half the width of its band, "
            f"root mean square (expected at most {max_cause_error:g})"
        )
    message = (
        f"the causes of the bands do not add up: of {count} draws with all causes "
        f"at once, {' and '.join(faults)}; bands may be too narrow or shifted"
    )
    return Reason("causes_do_not_add", message)


def _scales(path: RodPath, prepared: PreparedLine) -> dict[str, float]:
    """Return the rounding error of each number and of the shape."""
    units = {number.name: number.unit for number in numbers_of(path, prepared)} | {_SHAPE: "m"}
    units |= dict.fromkeys((RADIUS, RADIUS_ON_PATH), "1/m")
    return {
        name: _ROUNDING_SHARE * reference_size(unit, prepared.line) for name, unit in units.items()
    }


def _relative_error(number: Floats, drawn: Floats, row: int, band: Band, scale: float) -> float:
    """Return the error of a draw over the distance from the median to the end of its band.

    Of the shape, both are the largest along the line.
    """
    middle = np.median(drawn, axis=0)
    distances = np.where(number > middle, band.upper - middle, middle - band.lower)
    least = scale + _ROUNDING_SHARE * float(np.max(np.abs(number)))
    return float(np.max(np.abs(number - drawn[row])) / max(float(np.max(distances)), least))
