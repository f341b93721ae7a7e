"""The linearised response of a line to its inputs, and pointwise 95 % bands from it.

The line is solved at the best inputs, and along its whole path once to each side of every cause.
What it answers is taken as straight on either side, with a slope of its own: memory makes lines
answer otherwise upwards than downwards. Causes add up. With these slopes thousands of draws of the
causes cost a product of matrices, so that quantiles of Student's t, of mixtures of it and of a
largest value along the line need no approximation of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.beliefs import Belief

Fields = Mapping[str, Floats]
"""What is looked at of a line, by name; arrays of any shape."""
Look = Callable[[Mapping[str, float]], Fields | None]
"""Solve a line for some inputs; None where it has no equilibrium."""

TAIL = 0.025
"""Outside a band, on each side."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How a line answers.

    Parameters
    ----------
    belief : what its inputs may be
    value : at the best inputs, by name
    up, down : by name, shape (causes, ...): change of the value by a step of each cause, forwards,
        and what a step backwards would undo
    one_sided : causes of which one side has no equilibrium: the other is taken for both
    silent : causes with no equilibrium on either side: left out
    """

    belief: Belief
    value: Fields
    up: Fields
    down: Fields
    one_sided: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()

    def drawn(self, name: str) -> Floats:
        """Draws of a field, shape (draws, ...)."""
        amounts, value = self.belief.amounts, self.value[name]
        flat = (len(self.belief.causes), value.size)
        moved = np.maximum(amounts, 0.0) @ self.up[name].reshape(flat)
        moved += np.minimum(amounts, 0.0) @ self.down[name].reshape(flat)
        return np.asarray(value + moved.reshape(len(amounts), *value.shape))

    def shares(self, name: str) -> dict[str, float]:
        """Share of each cause in the variance of a field, summed over all its numbers.

        Steps of one cause count together. Empty where nothing moves.
        """
        amounts, causes = self.belief.amounts, self.belief.causes
        size = self.value[name].size
        up, down = (each[name].reshape(len(causes), size) for each in (self.up, self.down))
        found: dict[str, float] = {}
        for cause in dict.fromkeys(causes):
            own = np.array([each == cause for each in causes])
            moved = np.maximum(amounts[:, own], 0.0) @ up[own]
            moved += np.minimum(amounts[:, own], 0.0) @ down[own]
            found[cause] = float(np.nansum(_robust_variance(moved)))
        total = sum(found.values())
        return {cause: each / total for cause, each in found.items()} if total > 0.0 else {}


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A number or an array with its pointwise 95 % band.

    Parameters
    ----------
    value : at the best inputs of the best belief
    lower, upper : of its shape
    """

    value: Floats
    lower: Floats
    upper: Floats


def respond(look: Look, belief: Belief) -> Response | None:
    """Solve a line at the best inputs and to both sides of every cause.

    Parameters
    ----------
    look : solves the line; called 1 + 2 x causes times
    belief : what its inputs may be

    Returns
    -------
    The response; None if the line has no equilibrium at the best inputs.
    """
    value = look(belief.inputs())
    if value is None:
        return None
    up, down, one_sided, silent = [], [], [], []
    for cause, step in zip(belief.causes, np.eye(len(belief.causes)), strict=True):
        ahead, behind = look(belief.inputs(step)), look(belief.inputs(-step))
        if ahead is None and behind is None:
            silent.append(cause)
        elif ahead is None or behind is None:
            one_sided.append(cause)
        rises = {name: _change(value[name], ahead, behind, name) for name in value}
        up.append({name: rise for name, (rise, _) in rises.items()})
        down.append({name: fall for name, (_, fall) in rises.items()})
    return Response(
        belief,
        value,
        {name: _stacked(up, name, value[name]) for name in value},
        {name: _stacked(down, name, value[name]) for name in value},
        tuple(dict.fromkeys(one_sided)),
        tuple(dict.fromkeys(silent)),
    )


def _change(
    value: Floats, ahead: Fields | None, behind: Fields | None, name: str
) -> tuple[Floats, Floats]:
    rise = None if ahead is None else ahead[name] - value
    fall = None if behind is None else value - behind[name]
    nothing = np.zeros_like(value)
    first = rise if rise is not None else fall
    last = fall if fall is not None else rise
    return (
        nothing if first is None else np.asarray(first),
        nothing if last is None else np.asarray(last),
    )


def _stacked(changes: Sequence[Fields], name: str, value: Floats) -> Floats:
    return np.stack([each[name] for each in changes]) if changes else np.zeros((0, *value.shape))


def _robust_variance(moved: Floats) -> Floats:
    """Variance of draws as of a normal with their middle 68 %: heavy tails have none."""
    low, high = np.quantile(moved, [0.15866, 0.84134], axis=0)
    return np.asarray((0.5 * (high - low)) ** 2)


def band_of(
    responses: Sequence[Response], measure: Callable[[Response], tuple[Floats, Floats]]
) -> Band:
    """Pointwise 95 % band over all beliefs.

    Parameters
    ----------
    responses : one for each solution of a calibration, the best first
    measure : of a response, the value, shape (...), and its draws, shape (draws, ...)

    Returns
    -------
    From the lowest to the highest of the bands of all, and never without the value.
    """
    values, lows, highs = [], [], []
    for each in responses:
        value, drawn = measure(each)
        low, high = np.quantile(drawn, [TAIL, 1.0 - TAIL], axis=0)
        values.append(value)
        lows.append(np.minimum(low, value))
        highs.append(np.maximum(high, value))
    return Band(values[0], np.min(lows, axis=0), np.max(highs, axis=0))


def field_band(responses: Sequence[Response], name: str) -> Band:
    """Pointwise band of a field.

    Parameters
    ----------
    responses : as for `band_of`
    name : of the field
    """
    return band_of(responses, lambda each: (each.value[name], each.drawn(name)))


def sizes(vectors: Floats) -> Floats:
    """Lengths of vectors along the last axis."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))
