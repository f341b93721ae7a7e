"""How a line answers to its inputs, and pointwise 95 % bands from it.

The line is solved at the best inputs, and along its whole path once to each side of every cause, as
far away as 95 % of the draws of that cause lie. Its answer to a cause is the parabola through these
three, straight beyond; causes add up. So the answer to a cause that makes most of a band is exact
where the band ends. Thousands of draws of the causes then cost two products of matrices, so that
quantiles of Student's t, of mixtures of it and of a largest value along the line need no
approximation of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.rod.input_distributions import InputDistribution

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
    reach : shape (causes,), steps of each cause within which the parabolas are
    slopes, bends : by name, shape (causes, ...): of an amount x of a cause the value changes by
        slope x + bend x^2 within reach
    one_sided : causes of which one side has no equilibrium: the other is taken for both
    silent : causes with no equilibrium on either side: left out
    """

    belief: InputDistribution
    value: Fields
    reach: Floats
    slopes: Fields
    bends: Fields
    one_sided: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()

    def drawn(self, name: str) -> Floats:
        """Draws of a field, shape (draws, ...)."""
        value = self.value[name]
        moved = self._moved(name, np.ones(len(self.belief.causes), dtype=np.bool_))
        return np.asarray(value + moved.reshape(len(moved), *value.shape))

    def _moved(self, name: str, which: Flags) -> Floats:
        """Change by some of the causes, shape (draws, numbers)."""
        amounts, reach = self.belief.amounts[:, which], self.reach[which]
        within = np.clip(amounts, -reach, reach)
        squares = within * (2.0 * amounts - within)  # beyond its reach a parabola goes on straight
        flat = (len(self.belief.causes), self.value[name].size)
        slopes, bends = (slope[name].reshape(flat)[which] for slope in (self.slopes, self.bends))
        return np.asarray(amounts @ slopes + squares @ bends)

    def shares(self, name: str) -> dict[str, float]:
        """Share of each cause in the variance of a field, summed over all its numbers.

        Steps of one cause count together. Empty where nothing moves.
        """
        causes = np.array(self.belief.causes)
        found = {
            cause: float(np.nansum(_robust_variance(self._moved(name, causes == cause))))
            for cause in dict.fromkeys(self.belief.causes)
        }
        total = sum(found.values())
        return {cause: finding / total for cause, finding in found.items()} if total > 0.0 else {}


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


def respond(look: Look, belief: InputDistribution) -> Response | None:
    """Solve a line at the best inputs and to both sides of every cause.

    Parameters
    ----------
    look : solves the line; called 1 + 2 x causes times
    belief : what its inputs may be

    Returns
    -------
    The response; None if the line has no equilibrium at the best inputs.
    """
    min_steps = 0.1  # of a cause: nearer, the difference is the solver's error
    max_steps = 2.0  # ends of long tails are not evaluated
    value = look(belief.inputs())
    if value is None:
        return None
    slopes, bends, one_sided, silent = [], [], [], []
    reach = np.quantile(np.abs(belief.amounts), 1.0 - 2.0 * TAIL, axis=0)
    reach = np.clip(reach, min_steps, max_steps)
    for cause, far, step in zip(belief.causes, reach, np.diag(reach), strict=True):
        ahead, behind = look(belief.inputs(step)), look(belief.inputs(-step))
        if ahead is None and behind is None:
            silent.append(cause)
        elif ahead is None or behind is None:
            one_sided.append(cause)
        both = {name: _through(value[name], ahead, behind, name) for name in value}
        slopes.append({name: slope / far for name, (slope, _) in both.items()})
        bends.append({name: bend / far**2 for name, (_, bend) in both.items()})
    return Response(
        belief,
        value,
        reach,
        {name: _stacked(slopes, name, value[name]) for name in value},
        {name: _stacked(bends, name, value[name]) for name in value},
        tuple(dict.fromkeys(one_sided)),
        tuple(dict.fromkeys(silent)),
    )


def _through(
    value: Floats, ahead: Fields | None, behind: Fields | None, name: str
) -> tuple[Floats, Floats]:
    """Slope and bend of the parabola through a value and those a length 1 to both sides of it.

    With one side alone it is straight.
    """
    rise = None if ahead is None else ahead[name] - value
    fall = None if behind is None else value - behind[name]
    if rise is None or fall is None:
        one = rise if rise is not None else fall
        return (np.zeros_like(value) if one is None else np.asarray(one)), np.zeros_like(value)
    return np.asarray(0.5 * (rise + fall)), np.asarray(0.5 * (rise - fall))


def _stacked(each_cause: Sequence[Fields], name: str, value: Floats) -> Floats:
    rows = [fields[name] for fields in each_cause]
    return np.stack(rows) if rows else np.zeros((0, *value.shape))


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
    for response in responses:
        value, drawn = measure(response)
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
    return band_of(responses, lambda response: (response.value[name], response.drawn(name)))


def sizes(vectors: Floats) -> Floats:
    """Lengths of vectors along the last axis."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))
