"""How stiff a line is, and how curved when it is free, from how it hangs between two clamps.

A line between two clamps, under its own weight, has a shape that only weight x length^3 over its
bending stiffness decides, and its free curvature. Photographs of several hangs give both, with an
interval. What its torsional stiffness is does not show there: `rod_snaps`.

Free curvature is fitted as Legendre polynomials along the line, of degree 1 and up, in the plane in
which the line hangs. Degree 0 does nothing between clamps: its moment times the turn of the line,
which the clamps hold, is the same for every shape.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import ArrayRecord, Flags, Floats
from labpipe.records.curve import Interval
from labpipe.rod.boundaries import Boundary, Gravity, Held
from labpipe.rod.line import Line, Section, line_along
from labpipe.rod.path import RodPath, RodState
from labpipe.rod.rotations import from_rotation_vectors, matrices, multiply, shortest_turns
from labpipe.rod.statics import follow

ELEMENTS = 200


BLOCKS = 5
"""Parts of the line that are left out in turn."""


_TRIED = np.geomspace(1e-5, 1e-1, 9)
"""Stiffness over weight x length^3, to start from."""


_AWAY = 1.0
"""Of the length: how far a shape counts to be where there is none."""


_USUAL = 5.0
"""Free curvature times length."""


_STEP = 1e-4


_MORE_THAN = 1.2


_EXACT = 1e-6


_TWO_SHAPES = (
    "a line with this stiffness and free curvature has more than one shape between these clamps: "
    "fit fewer terms of free curvature"
)


_ANY_CURVATURE = 1e6
"""1/m: the law is straight as far as it is asked."""


@dataclass(frozen=True, slots=True, eq=False)
class Hang(ArrayRecord):
    """A line that hangs between two clamps, as it was seen.

    Parameters
    ----------
    points : shape (points, 3), m, z up; the first and the last where the line leaves its clamps
    shares : shape (points,), of the length between the clamps, from 0 to 1, where the points are
    directions : shape (2, 3), of the line, from the first point to the last, in both clamps
    length : between the clamps, m
    mass_per_length : kg/m

    Raises
    ------
    ValueError
        If a number is out of its range, or the points are on one line.
    """

    points: Annotated[Floats, "points", 3]
    shares: Annotated[Floats, "points"]
    directions: Annotated[Floats, 2, 3]
    length: float
    mass_per_length: float

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        apart = float(np.linalg.norm(self.points[-1] - self.points[0]))
        if apart >= self.length:
            message = f"length={self.length!r}: allowed is more than the clamps are apart, {apart}"
            raise ValueError(message)

    @property
    def _area(self) -> Floats:
        """Area within the points and the chord, as a vector, m^2."""
        from_first = self.points - self.points[0]
        return np.asarray(np.sum(np.cross(from_first[:-1], from_first[1:]), axis=0) / 2)

    @property
    def normal(self) -> Floats:
        """Of the plane that it hangs in, so that the line turns about it, shape (3,)."""
        return np.asarray(self._area / np.linalg.norm(self._area))


Hanging: TypeAlias = Callable[[Hang, float, tuple[float, ...]], Floats]
"""Places of a model at the shares of a hang, shape (points, 3), by stiffness, free curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class HangFit:
    """A model fitted to a hang.

    Parameters
    ----------
    stiffness : of bending, N m^2
    natural : free curvature, 1/m: of Legendre polynomials of degree 1, 2, ... along the line,
        positive as the line turns
    model : shape (points, 3), m, where the model is at the shares of the points
    off : shape (points, 3), m, model less points
    blocks : stiffness with a part of the line left out, one after the other, N m^2
    """

    stiffness: float
    natural: tuple[float, ...]
    model: Floats
    off: Floats
    blocks: tuple[float, ...]

    @property
    def distances(self) -> Floats:
        """From each point to the place of the model with the same share of the length, m."""
        return np.asarray(np.linalg.norm(self.off, axis=1))

    @property
    def alike(self) -> float:
        """Correlation of what is left over at neighbouring points."""
        return float(np.sum(self.off[1:] * self.off[:-1]) / np.sum(self.off**2))


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with what makes it uncertain.

    Parameters
    ----------
    value : the number
    parts : name, standard uncertainty in the unit of the value, degrees of freedom
    """

    value: float
    parts: tuple[tuple[str, float, float], ...]

    @property
    def interval(self) -> Interval:
        """95 %, by effective degrees of freedom (GUM G.4.1)."""
        size = float(np.sqrt(sum(part**2 for _, part, _ in self.parts)))
        spread = sum(part**4 / freedom for _, part, freedom in self.parts)
        freedom = size**4 / spread if spread > 0.0 else np.inf
        half = float(t.ppf(0.975, freedom)) * size
        return Interval(self.value - half, self.value + half)

    @property
    def half_width(self) -> float:
        """Of the interval."""
        return (self.interval.upper - self.interval.lower) / 2


def hung(
    hang: Hang, stiffness: float, natural: tuple[float, ...] = (), *, elements: int = ELEMENTS
) -> Floats:
    """Find where a line hangs.

    Parameters
    ----------
    hang : clamps, length and weight; its points are what the line starts from
    stiffness : of bending, N m^2
    natural : free curvature, as in `HangFit`
    elements : of the rod; the error falls with their square

    Returns
    -------
    Places at the shares of the hang, shape (points, 3), m

    Raises
    ------
    ArithmeticError
        If no shape is found; the message says why.
    """
    return _Near(elements)(hang, stiffness, natural)


class _Near:
    """A rod that starts from where it hung before, which takes a fifth of the time."""

    def __init__(self, elements: int) -> None:
        self._elements = elements
        self._before: RodState | None = None

    def __call__(self, hang: Hang, stiffness: float, natural: tuple[float, ...]) -> Floats:
        line, held = laid(hang, stiffness, stiffness, natural, self._elements)
        path = follow(line, [*held, Gravity()], steps=0, start=self._before)
        self._before = reached(path).last
        stations = line.stations / line.length
        places = self._before.positions.T
        return np.column_stack([np.interp(hang.shares, stations, each) for each in places])


def fit_hang(
    hang: Hang, *, terms: int = 1, blocks: int = BLOCKS, hanging: Hanging | None = None
) -> HangFit:
    """Fit bending stiffness and free curvature to a hang, by least squares of the distances.

    Parameters
    ----------
    hang : what was seen
    terms : of the free curvature; 0: the line is straight when it is free
    blocks : parts of the line that are left out, one after the other; 0: none is
    hanging : the model; a rod of 200 elements, if there is none

    Raises
    ------
    ArithmeticError
        If the model has no shape like that, or more than one.
    """
    hanging = _Near(ELEMENTS) if hanging is None else hanging
    every = np.ones(len(hang.points), dtype=bool)
    first = _first_stiffness(hang, hanging)
    stiffness, natural, left = _fitted(hang, first, terms, hanging, every)
    model = hanging(hang, stiffness, natural)
    if np.sum((model - hang.points) ** 2) > _MORE_THAN * left + (_EXACT * hang.length) ** 2:
        raise ArithmeticError(_TWO_SHAPES)
    part = np.minimum((hang.shares * blocks).astype(int), blocks - 1)
    without = [_fitted(hang, stiffness, terms, hanging, part != each) for each in range(blocks)]
    return HangFit(
        stiffness, natural, model, model - hang.points, tuple(each[0] for each in without)
    )


def _first_stiffness(hang: Hang, hanging: Hanging) -> float:
    """The one of a few that is nearest."""
    tried = _TRIED * hang.mass_per_length * 9.81 * hang.length**3
    sizes = [float(np.sum((_tried(hang, each, (), hanging) - hang.points) ** 2)) for each in tried]
    return float(tried[int(np.argmin(sizes))])


def _tried(hang: Hang, stiffness: float, natural: tuple[float, ...], hanging: Hanging) -> Floats:
    """Places of the model; far away where it has none, so that a search turns back."""
    try:
        return hanging(hang, stiffness, natural)
    except ArithmeticError:
        return hang.points + _AWAY * hang.length


def _fitted(
    hang: Hang, first: float, terms: int, hanging: Hanging, kept: Flags
) -> tuple[float, tuple[float, ...], float]:
    """Stiffness, free curvature, and what is left over, m^2."""

    def wanted(x: Floats) -> tuple[float, tuple[float, ...]]:
        bends = _USUAL * (x[1:] - 1) / hang.length
        return first * float(np.exp(x[0] - 1)), tuple(map(float, bends))

    def off(x: Floats) -> Floats:
        places = _tried(hang, *wanted(x), hanging)
        return np.asarray(((places - hang.points)[kept] / hang.length).ravel())

    # around one, where a relative step is a step: one that rounding does not reach
    start, scales = np.ones(1 + terms), np.array([0.1] + [1.0] * terms)
    steps = np.full(len(start), _STEP)
    found = least_squares(off, start, x_scale=scales, xtol=1e-5, ftol=1e-5, diff_step=steps)
    return *wanted(found.x), 2 * float(found.cost) * hang.length**2


def mean_stiffness(
    fits: Sequence[HangFit], *, length_error: float = 0.0, mass_error: float = 0.0
) -> Estimate:
    """Mean bending stiffness of hangs of one line, with its uncertainty.

    Parameters
    ----------
    fits : of at least two hangs, all with blocks
    length_error, mass_error : standard uncertainties of the scale of the photographs (or of the
        length) and of the mass per length, as shares

    Returns
    -------
    The mean, in N m^2, with four parts: `scatter` from hang to hang; `model`: what is left over is
    alike along the line and from hang to hang, so that neither points nor hangs count as
    independent: how the mean moves as blocks of the line are left out (jackknife); `scale`: three
    times the length's; `mass`.

    Raises
    ------
    ValueError
        If there are less than two hangs, or the fits have not the same blocks, two at least.
    """
    blocks = {len(each.blocks) for each in fits}
    if len(fits) < 2 or len(blocks) != 1 or min(blocks) < 2:
        message = f"{len(fits)} hangs, blocks {sorted(blocks)}: allowed are two or more of both"
        raise ValueError(message)
    values = np.array([each.stiffness for each in fits])
    mean = float(values.mean())
    without = np.mean([each.blocks for each in fits], axis=0)
    left_out = len(without)
    moved = np.sqrt((left_out - 1) / left_out * np.sum((without - without.mean()) ** 2))
    parts = (
        *mean_of(values.tolist()).parts,
        ("model", float(moved), left_out - 1.0),
        ("scale", 3.0 * mean * length_error, np.inf),
        ("mass", mean * mass_error, np.inf),
    )
    return Estimate(mean, parts)


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean of two values or more, with their scatter."""
    seen = np.asarray(values, dtype=np.float64)
    size = float(seen.std(ddof=1)) / np.sqrt(len(seen))
    return Estimate(float(seen.mean()), (("scatter", size, len(seen) - 1.0),))


def reached(path: RodPath) -> RodPath:
    """The path, if it got to its end.

    Raises
    ------
    ArithmeticError
        If it did not; the message says why.
    """
    if path.status == "failed":
        raise ArithmeticError(path.reasons[0].sentence)
    return path


def laid(
    hang: Hang,
    stiffness: float,
    torsion: float,
    natural: tuple[float, ...],
    elements: int,
) -> tuple[Line, tuple[Held, Held]]:
    """A line along the points of a hang, without twist, and its clamps.

    Parameters
    ----------
    hang : points, clamps, length and mass
    stiffness, torsion : of bending and torsion, N m^2
    natural : free curvature, as in `HangFit`
    elements : all alike
    """
    law = SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, _ANY_CURVATURE)
    section = Section(law, torsion, mass_per_length=hang.mass_per_length)
    shares = np.linspace(0, 1, elements + 1)
    nodes = np.column_stack([np.interp(shares, hang.shares, each) for each in hang.points.T])
    x, y, z = map(float, hang.normal)
    along = line_along(nodes, section, up=(x, y, z))
    across = matrices(along.frames[:1])[0, :, 0]
    free = np.zeros((elements - 1, 3))
    place = 2 * shares[1:-1] - 1
    free[:, 0] = np.polynomial.legendre.legval(place, (0.0, *natural)) * (across @ hang.normal)
    lengths = np.full(elements, hang.length / elements)
    line = Line(lengths, section, along.positions, along.frames, free)
    ends = along.frames[[0, -1]]
    wanted = hang.directions / np.linalg.norm(hang.directions, axis=1)[:, None]
    frames = multiply(shortest_turns(matrices(ends)[:, :, 2], wanted), ends)
    return line, (Held(0, nodes[0], frames[0]), Held(-1, nodes[-1], frames[1]))


_APART = 1.1
"""Ratio of what is tried to find a slope."""


_USUAL_POWER = 0.8
"""Of the ratio of stiffnesses, by which the turn falls."""


_AT_A_TIME = 5


_BROAD, _FINE = float(np.radians(20.0)), float(np.radians(1.0))
"""Of the turn."""


_TURNING_ELEMENTS = 100


def snap_turn(
    hang: Hang,
    stiffness: float,
    torsion: float,
    natural: tuple[float, ...] = (),
    *,
    most: float = 50.0,
    elements: int = _TURNING_ELEMENTS,
) -> tuple[float, Floats]:
    """Find the turn of the first clamp, about its own direction, at which the line snaps over.

    Parameters
    ----------
    hang : clamps, length and weight
    stiffness, torsion : of bending and torsion, N m^2
    natural : free curvature, as in `HangFit`
    most : rad, to which it is turned
    elements : of the rod

    Returns
    -------
    rad, to one degree; and nodes of the last stable shape, m

    Raises
    ------
    ArithmeticError
        If it does not snap, or cannot be followed for another reason; the message says why.
    """
    line, (first, second) = laid(hang, stiffness, torsion, natural, elements)
    broad = _FirstSnap(line, first, second, _BROAD)
    at, state = broad.after(0.0, None, most)
    fine, state = _FirstSnap(line, first, second, _FINE).after(at, state, at + 2 * _BROAD)
    return float(fine + _FINE / 2), state.positions


@dataclass(frozen=True, slots=True, eq=False)
class _FirstSnap:
    """A line whose first clamp is turned by equal steps, a few at a time."""

    line: Line
    first: Held
    second: Held
    step: float

    def after(self, turn: float, state: RodState | None, most: float) -> tuple[float, RodState]:
        """The last turn before it snaps, and the state there."""
        while turn < most:
            turns = turn + self.step * np.arange(_AT_A_TIME + 1, dtype=np.float64)
            held: list[Boundary] = [self._turned(turns), self.second, Gravity()]
            path = follow(self.line, held, steps=_AT_A_TIME, start=state)
            last = _last_stable(path)
            turn, state = float(turns[last]), path.states[last]
            if last < _AT_A_TIME:
                return turn, state
        message = f"the line does not snap over up to {np.degrees(most):.0f} degrees"
        raise ArithmeticError(message)

    def _turned(self, turns: Floats) -> Held:
        assert self.first.frame is not None
        axis = matrices(self.first.frame[:1])[0, :, 2]
        frames = multiply(from_rotation_vectors(turns[:, None] * axis), self.first.frame)
        return Held(0, self.first.position, frames)


def _last_stable(path: RodPath) -> int:
    """The step before the line jumps, or before no equilibrium follows."""
    # laid into its clamps, in step 0, it may jump
    jumps = [step - 1 for step in path.snapped if step > 0]
    ended = path.status == "failed" and path.reasons[0].code == "no_equilibrium"
    if not jumps and not (ended and path.states):
        reached(path)
    return min([*jumps, len(path.states) - 1])


def fit_torsion(
    hang: Hang,
    turns: Sequence[float] | Floats,
    stiffness: Estimate,
    natural: Sequence[Estimate] = (),
    *,
    elements: int = _TURNING_ELEMENTS,
) -> Estimate:
    """Find torsional over bending stiffness from turns at which a hung line snapped over.

    Parameters
    ----------
    hang : clamps, length and weight
    turns : of a clamp, rad, of at least two trials
    stiffness : of bending, from `mean_stiffness`
    natural : free curvature, as in `HangFit`, 1/m, as known
    elements : of the rod

    Returns
    -------
    The ratio, with these parts: `turns`, the scatter of the trials; `scatter` and `model` of the
    stiffness; `free curvature`. Scale and mass change nothing: the shape fixes weight x length^3 /
    stiffness, and this the turn.

    Raises
    ------
    ArithmeticError
        If the model does not snap.
    ValueError
        If there are less than two turns, or one is not positive.
    """
    seen = np.asarray(turns, dtype=np.float64)
    if len(seen) < 2 or not np.all(np.isfinite(seen) & (seen > 0.0)):
        message = f"turns={seen.tolist()}: allowed are two finite numbers > 0, or more"
        raise ValueError(message)
    trials = mean_of(seen.tolist())
    set_there = tuple(each.value for each in natural)

    def log_turn(ratio: float, share: float = 1.0, bends: tuple[float, ...] = set_there) -> float:
        bending = share * stiffness.value
        turn, _ = snap_turn(hang, bending, ratio * bending, bends, elements=elements)
        return float(np.log(turn))

    wanted = float(np.log(seen.mean()))
    near = float(np.exp((log_turn(1.0) - wanted) / _USUAL_POWER))
    low, high = near / _APART, near * _APART
    at_low, at_high = log_turn(low), log_turn(high)
    power = (at_low - at_high) / np.log(high / low)
    ratio = low * float(np.exp((at_low - wanted) / power))
    at_ratio = at_low - power * np.log(ratio / low)
    _, size, freedom = trials.parts[0]
    parts = [("turns", ratio / power * size / trials.value, freedom)]
    by_stiffness = abs(log_turn(ratio, _APART) - at_ratio) / np.log(_APART)
    for name, part, freedom in stiffness.parts:
        if name in ("scatter", "model"):
            moved = by_stiffness * part / stiffness.value
            parts.append((name, ratio / power * moved, freedom))
    for number, each in enumerate(natural):
        width = each.half_width / 2
        bends = tuple(b + width * (number == at) for at, b in enumerate(set_there))
        moved = abs(log_turn(ratio, bends=bends) - at_ratio)
        parts.append(("free curvature", ratio / power * moved, np.inf))
    return Estimate(ratio, tuple(parts))
