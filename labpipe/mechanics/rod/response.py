"""Response surface of a line over its uncertain inputs, and pointwise 95 % bands.

The whole path is solved at the best inputs, and once to each side of every cause, at the distance
that covers 95 % of the draws of that cause. The response to a cause is the parabola through these
three solutions, continued linearly; the effects of the causes are added. Therefore the response to
a dominant cause is exact at the ends of its band. Thousands of draws then cost two matrix products.
Quantiles of Student's t, of its mixtures, and of largest values along the line need no further
approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod.input_distributions import InputDistribution
from labpipe.records.arrays import Flags, Floats

Fields = Mapping[str, Floats]
"""Fields of a line, by name; arrays of any shape."""
SolveFields = Callable[[Mapping[str, float]], Fields | None]
"""Function that solves a line for some inputs; it returns None without an equilibrium."""

TAIL = 0.025
"""Probability outside a band, on each side."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Response of a line.

    Parameters
    ----------
    distribution : of its inputs
    value : at the best inputs, by name
    reach : shape (causes,), range of the parabolas, in steps of each cause
    slopes, bends : by name, shape (causes, ...); within reach, an amount x of a cause changes the
        value by slope x + bend x^2
    one_sided : causes without an equilibrium on one side; the other side is used for both
    silent : causes without an equilibrium on either side; they have no effect on the band
    """

    distribution: InputDistribution
    value: Fields
    reach: Floats
    slopes: Fields
    bends: Fields
    one_sided: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()

    def drawn(self, name: str) -> Floats:
        """Return draws of a field, shape (draws, ...)."""
        value = self.value[name]
        changes = self._moved(name, np.ones(len(self.distribution.causes), dtype=np.bool_))
        return np.asarray(value + changes.reshape(len(changes), *value.shape))

    def _moved(self, name: str, which: Flags) -> Floats:
        """Return the change of a field by some of the causes, shape (draws, numbers)."""
        amounts, max_amounts = self.distribution.amounts[:, which], self.reach[which]
        within = np.clip(amounts, -max_amounts, max_amounts)
        squares = within * (2.0 * amounts - within)  # linear beyond the reach
        flat = (len(self.distribution.causes), self.value[name].size)
        slopes, bends = (slope[name].reshape(flat)[which] for slope in (self.slopes, self.bends))
        return np.asarray(amounts @ slopes + squares @ bends)

    def shares(self, name: str) -> dict[str, float]:
        """Return the share of each cause in the variance of a field, summed over its numbers.

        All steps of a cause count together. The mapping is empty if the field is constant.
        """
        causes = np.array(self.distribution.causes)
        variances = {
            cause: float(np.nansum(_estimate_variance(self._moved(name, causes == cause))))
            for cause in dict.fromkeys(self.distribution.causes)
        }
        total = sum(variances.values())
        return (
            {cause: variance / total for cause, variance in variances.items()}
            if total > 0.0
            else {}
        )


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A number or an array with its pointwise 95 % band.

    Parameters
    ----------
    value : at the best inputs of the best distribution
    lower, upper : ends of the band, of the same shape
    """

    value: Floats
    lower: Floats
    upper: Floats


def respond(solve: SolveFields, distribution: InputDistribution) -> Response | None:
    """Solve a line at the best inputs and to both sides of every cause.

    Parameters
    ----------
    solve : solves the line; called 1 + 2 x causes times
    distribution : of its inputs

    Returns
    -------
    The response; None if the line has no equilibrium at the best inputs.
    """
    min_steps = (
        0.1  # of a cause; closer solutions differ by little more than the error of the solver
    )
    max_steps = 2.0  # ends of long tails are not evaluated
    value = solve(distribution.inputs())
    if value is None:
        return None
    slopes, bends, one_sided, silent = [], [], [], []
    max_amounts = np.quantile(np.abs(distribution.amounts), 1.0 - 2.0 * TAIL, axis=0)
    max_amounts = np.clip(max_amounts, min_steps, max_steps)
    for cause, distance, step in zip(
        distribution.causes, max_amounts, np.diag(max_amounts), strict=True
    ):
        ahead, behind = solve(distribution.inputs(step)), solve(distribution.inputs(-step))
        if ahead is None and behind is None:
            silent.append(cause)
        elif ahead is None or behind is None:
            one_sided.append(cause)
        fits = {name: _fit_parabola(value[name], ahead, behind, name) for name in value}
        slopes.append({name: slope / distance for name, (slope, _) in fits.items()})
        bends.append({name: bend / distance**2 for name, (_, bend) in fits.items()})
    return Response(
        distribution,
        value,
        max_amounts,
        {name: _stack_causes(slopes, name, value[name]) for name in value},
        {name: _stack_causes(bends, name, value[name]) for name in value},
        tuple(dict.fromkeys(one_sided)),
        tuple(dict.fromkeys(silent)),
    )


def _fit_parabola(
    value: Floats, ahead: Fields | None, behind: Fields | None, name: str
) -> tuple[Floats, Floats]:
    """Fit a parabola to a value and its neighbours at distance 1; return slope and curvature.

    With a single neighbour the fit is a straight line, with none it is constant.
    """
    rise = None if ahead is None else ahead[name] - value
    fall = None if behind is None else value - behind[name]
    if rise is None or fall is None:
        change = rise if rise is not None else fall
        return (np.zeros_like(value) if change is None else np.asarray(change)), np.zeros_like(
            value
        )
    return np.asarray(0.5 * (rise + fall)), np.asarray(0.5 * (rise - fall))


def _stack_causes(fields_by_cause: Sequence[Fields], name: str, value: Floats) -> Floats:
    rows = [fields[name] for fields in fields_by_cause]
    return np.stack(rows) if rows else np.zeros((0, *value.shape))


def _estimate_variance(changes: Floats) -> Floats:
    """Estimate the variance from the central 68 % of the draws, robustly to heavy tails."""
    low, high = np.quantile(changes, [0.15866, 0.84134], axis=0)
    return np.asarray((0.5 * (high - low)) ** 2)


def compute_band(
    responses: Sequence[Response], measure: Callable[[Response], tuple[Floats, Floats]]
) -> Band:
    """Compute the pointwise 95 % band over all distributions.

    Parameters
    ----------
    responses : one for each solution of a calibration, the best first
    measure : returns the value of a response, shape (...), and its draws, shape (draws, ...)

    Returns
    -------
    The band from the lowest to the highest end of the bands of all responses. Each of these
    includes its value.
    """
    values, lows, highs = [], [], []
    for response in responses:
        value, drawn = measure(response)
        low, high = np.quantile(drawn, [TAIL, 1.0 - TAIL], axis=0)
        values.append(value)
        lows.append(np.minimum(low, value))
        highs.append(np.maximum(high, value))
    return Band(values[0], np.min(lows, axis=0), np.max(highs, axis=0))


def compute_field_band(responses: Sequence[Response], name: str) -> Band:
    """Compute the pointwise band of a field.

    Parameters
    ----------
    responses : as for `compute_band`
    name : of the field
    """
    return compute_band(responses, lambda response: (response.value[name], response.drawn(name)))


def compute_norms(vectors: Floats) -> Floats:
    """Compute the lengths of vectors along the last axis."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))
