"""Bands of a harness: what a calibration, or the file, does not know, in shape and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.curve import Interval
from labpipe.rod.bands import LineBands, bands_of
from labpipe.rod.path import RodPath
from labpipe.rod.response import Fields, field_band, respond
from labpipe.studies.harness_line import Inputs, Laid
from labpipe.studies.harness_numbers import Number, numbers_of
from labpipe.studies.harness_section import Material

Followed = tuple[RodPath, Laid]
FollowLine = Callable[[int, Inputs], Followed]
"""Lay a line and follow it: number of the belief, and inputs."""
_LEVEL = 0.95
_RADIUS = "smallest_bend_radius"


@dataclass(frozen=True, slots=True, eq=False)
class HarnessBands:
    """Bands of the shapes and of the numbers of a harness.

    Parameters
    ----------
    line : pointwise bands of the steps that are shown
    intervals : of the numbers of the last step, by name
    """

    line: LineBands
    intervals: Mapping[str, Interval]


def harness_bands(
    follow_line: FollowLine, material: Material, steps: Sequence[int]
) -> HarnessBands | None:
    """Predict a harness with pointwise 95 % bands.

    Parameters
    ----------
    follow_line : follows the line for some inputs; each is followed once
    material : of the line, with what is believed of it
    steps : that are looked at

    Returns
    -------
    None where nothing is believed, or the line cannot be followed at the best inputs.
    """
    solves = [_Solve(follow_line, number) for number in range(len(material.beliefs))]
    if not solves:
        return None
    limit = material.limit
    line = bands_of(
        [each.path for each in solves], material.beliefs, at=steps, tested_curvature=limit
    )
    if line is None:
        return None
    pairs = zip(solves, material.beliefs, strict=True)
    responses = [respond(solve.numbers, belief) for solve, belief in pairs]
    band = field_band([each for each in responses if each is not None], _NUMBERS)
    path, laid = solves[0].first
    intervals = {
        each.name: _interval(each, lower, upper)
        for each, lower, upper in zip(
            numbers_of(path, laid), band.lower.tolist(), band.upper.tolist(), strict=True
        )
    }
    radius = line.states[-1].smallest_bend_radius
    own = {_RADIUS: Interval(float(radius.lower), float(radius.upper), _LEVEL)}
    return HarnessBands(line, intervals | own)


def _interval(number: Number, lower: float, upper: float) -> Interval:
    """Interval of a number; of a radius, from that of its curvature."""
    if _is_radius(number):
        ends = [1.0 / end if end > 0.0 else math.inf for end in (upper, lower)]
        return Interval(ends[0], ends[1], _LEVEL)
    return Interval(lower if number.is_signed else max(lower, 0.0), upper, _LEVEL)


def _is_radius(number: Number) -> bool:
    return number.name.startswith(_RADIUS)


_NUMBERS = "numbers"


class _Solve:
    """Follows a line for inputs of one belief, each once."""

    def __init__(self, follow_line: FollowLine, number: int) -> None:
        self.follow_line, self.number = follow_line, number
        self.known: dict[tuple[tuple[str, float], ...], Followed] = {}

    def both(self, inputs: Inputs) -> Followed:
        """Path and line."""
        key = tuple(sorted(inputs.items()))
        if key not in self.known:
            self.known[key] = self.follow_line(self.number, inputs)
        return self.known[key]

    @property
    def first(self) -> Followed:
        """Path and line at the best inputs, which are followed first."""
        return next(iter(self.known.values()))

    def path(self, inputs: Inputs) -> RodPath:
        """Path alone."""
        return self.both(inputs)[0]

    def numbers(self, inputs: Inputs) -> Fields | None:
        """All numbers as one array, radii as curvatures: those of a straight line are finite."""
        path, laid = self.both(inputs)
        if path.status == "failed":
            return None
        numbers = numbers_of(path, laid)
        values = [1.0 / each.value if _is_radius(each) else each.value for each in numbers]
        return {_NUMBERS: np.array(values)}
