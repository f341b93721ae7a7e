"""How stiff a hung line is against twist, from the turn of a clamp at which it snaps over.

If one clamp of a line that hangs between two is turned about its own direction, the line leaves its
plane, more and more. At a limit point, where the bottom of the loop stands nearly across, it snaps
over, at a turn that the ratio of torsional to bending stiffness decides. What comes after is not
followed: the two sides of a real line touch there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Boundary, Gravity, Held
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState
from labpipe.rod.rotations import from_rotation_vectors, matrices, multiply
from labpipe.rod.statics import follow
from tests.judges.rod_fits import Estimate, Hang, laid, mean_of, reached

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
    curl: tuple[float, float] = (0.0, 0.0),
    most: float = 50.0,
    elements: int = _TURNING_ELEMENTS,
) -> float:
    """Find the turn of the first clamp, about its own direction, at which the line snaps over.

    Parameters
    ----------
    hang : clamps, length and weight
    stiffness, torsion : of bending and torsion, N m^2
    natural : free curvature, as in `HangFit`
    curl : 1/m, free curvature that is the same all along: in the plane of the hang, where hangs do
        not show it, and across it
    most : rad, to which it is turned
    elements : of the rod

    Returns
    -------
    rad, to one degree

    Raises
    ------
    ArithmeticError
        If it does not snap, or cannot be followed for another reason; the message says why.
    """
    line, (first, second) = laid(hang, stiffness, torsion, natural, elements, curl=curl)
    broad = _FirstSnap(line, first, second, _BROAD)
    at, state = broad.after(0.0, None, most)
    fine, _ = _FirstSnap(line, first, second, _FINE).after(at, state, at + 2 * _BROAD)
    return float(fine + _FINE / 2)


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
        turn = snap_turn(hang, bending, ratio * bending, bends, elements=elements)
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
