"""Build probability distributions of the inputs of a predicted line.

A distribution is a set of named inputs and of causes that change them linearly. A calibration has
a distribution for each of its solutions. The logarithms of the parameters are distributed about the
solution as the mixture of Student's t of that solution. A specimen of the spool differs from the
mean of the tested samples by a factor on all moments. Parameters and factor are drawn together,
because the uncertain scatter of samples widens both. All other inputs, such as free curvature and
mass, are independent. They are stated as a standard deviation, with degrees of freedom if these are
few, or as a range.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.records.wire import PARAMETERS, Solution

DRAWS = 4096
"""Number of draws of a distribution, a power of two. If the scatter of specimens, estimated from
three samples, dominates, the error of the width of a band is 1.5 %. It is 3 % for random draws."""
CALIBRATION = "calibration"
"""Name of the cause for uncertain parameters of a calibration."""
SPECIMEN = "specimen"
"""Name of the cause for the difference of a specimen from the mean sample."""

_MAX_LOG_STEP = 0.3
"""Largest step of a logarithm. Lines are solved up to two steps away, at a factor of 1.8."""


@dataclass(frozen=True, slots=True, eq=False)
class InputDistribution(ArrayRecord):
    """Inputs of a line, and the causes that change them: inputs = centre + steps x amounts.

    Parameters
    ----------
    names : names of the inputs, each once
    causes : name of the cause of each column of `steps`; a cause may have several columns
    centre : shape (names,), best values in the units of the inputs
    steps : shape (names, causes), change of each input per unit of each cause
    amounts : shape (draws, causes), joint draws of all causes, in units of `steps`
    """

    names: tuple[str, ...]
    causes: tuple[str, ...]
    centre: Annotated[Floats, "names"]
    steps: Annotated[Floats, "names", "causes"]
    amounts: Annotated[Floats, "draws", "causes"]

    def to_inputs(self, amounts: Floats | None = None) -> dict[str, float]:
        """Return the inputs for amounts of the causes, shape (causes,), or the best inputs."""
        values = self.centre if amounts is None else self.centre + self.steps @ amounts
        return dict(zip(self.names, values.tolist(), strict=True))


def build_stated_distribution(
    name: str,
    deviation: float,
    *,
    centre: float = 0.0,
    freedom: float = np.inf,
    cause: str = "",
    draws: int = DRAWS,
    seed: int = 0,
) -> InputDistribution:
    """Build the distribution of an input from its standard deviation.

    Parameters
    ----------
    name : name of the input
    deviation : standard deviation in the unit of the input, positive
    centre : best value
    freedom : degrees of freedom of the deviation; if finite, Student's t replaces the normal
        distribution
    cause : name of the cause; by default that of the input
    draws : number of draws, which are the quantiles at evenly spaced probabilities
    seed : seed of the order of the draws, together with name and cause. The order must differ
        between the distributions of a line, for which different names suffice

    Raises
    ------
    ValueError
        If deviation or degrees of freedom are not positive.
    """
    if not (np.isfinite(deviation) and deviation > 0.0 and freedom > 0.0):
        facts = {"name": name, "deviation": deviation, "freedom": freedom}
        raise ValueError(format_sentence("mechanics.rod.bad_deviation", **facts))
    random = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    uniform = (random.permutation(draws) + 0.5) / draws
    amounts = np.asarray(
        ndtri(uniform) if np.isinf(freedom) else stdtrit(freedom, uniform), np.float64
    )
    steps = np.array([[deviation]])
    return InputDistribution((name,), (cause or name,), np.array([centre]), steps, amounts[:, None])


def build_uniform_distribution(
    name: str, low: float, high: float, *, cause: str, draws: int = DRAWS, seed: int = 0
) -> InputDistribution:
    """Build the distribution of an input that is equally likely anywhere in a range.

    Parameters
    ----------
    name : name of the input
    low, high : ends of the range, in the unit of the input
    cause : name of the cause
    draws, seed : as for `build_stated_distribution`
    """
    random = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    amounts = 2.0 * (random.permutation(draws) + 0.5) / draws - 1.0
    centre, steps = np.array([0.5 * (low + high)]), np.array([[0.5 * (high - low)]])
    return InputDistribution((name,), (cause,), centre, steps, amounts[:, None])


def build_calibrated_distributions(
    solutions: Sequence[Solution],
    widening: float = 1.0,
    *,
    specimen: str | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[InputDistribution, ...]:
    """Build a distribution for each solution in the 95 % set of a calibration.

    Parameters
    ----------
    solutions : solutions of the calibration, the best first
    widening : factor on the deviations of the parameters
    specimen : name of the input that is the logarithm of a factor on all moments, drawn from the
        scatter of samples; None for a line with the law of the mean sample
    draws : number of draws, a power of two
    seed : seed of the draws

    Returns
    -------
    Distributions of the logarithms of those `PARAMETERS` that are active in the wire. As in the
    bands of the calibration, the deviations for a less likely solution are multiplied by
    sqrt(1 - rise / limit).
    """
    return tuple(
        _build_solution_distribution(
            solution,
            widening * np.sqrt(1.0 - solution.rise / solution.limit),
            specimen=specimen,
            draws=draws,
            random=np.random.default_rng([seed, index]),
        )
        for index, solution in enumerate(solution for solution in solutions if solution.is_allowed)
    )


def _build_solution_distribution(
    solution: Solution,
    widening: float,
    *,
    specimen: str | None,
    draws: int,
    random: np.random.Generator,
) -> InputDistribution:
    """Build the distribution of one solution, including the factor of the specimen if any."""
    from scipy.stats.qmc import Sobol  # imports scipy.stats, which takes half a second

    active = np.flatnonzero(np.isfinite(solution.values))
    mixture = solution.mixture
    probability_range = 1.0 - 1e-10  # keeps probabilities away from 0 and 1
    # Columns: component of the mixture, divisor of Student's t, specimen, and each parameter.
    uniform = 0.5 + probability_range * (Sobol(3 + len(active), seed=random).random(draws) - 0.5)
    component = np.searchsorted(np.cumsum(mixture.chance), uniform[:, 0])
    component = np.minimum(component, len(mixture.chance) - 1)
    divisors = np.ones(draws)  # convert normal draws to draws of Student's t
    if np.isfinite(mixture.freedom):
        divisors = np.sqrt(chdtri(mixture.freedom, uniform[:, 1]) / mixture.freedom)
    normal = ndtri(uniform[:, 2:])
    active_covariance = mixture.covariance[:, active[:, None], active]
    variances, axes = np.linalg.eigh(active_covariance)
    roots = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    deviations = np.einsum("nij,nj->ni", roots[component], normal[:, 1:]) / divisors[:, None]
    changes = widening * (mixture.shift[component][:, active] + deviations)
    covariance = np.einsum("s,sij->ij", mixture.chance, active_covariance)
    shift = mixture.shift[:, active]
    covariance += np.einsum("s,si,sj->ij", mixture.chance, shift, shift)
    steps = _find_steps(covariance)
    amounts = changes @ np.linalg.pinv(steps).T
    distribution = InputDistribution(
        tuple(PARAMETERS[index] for index in active),
        (CALIBRATION,) * steps.shape[1],
        np.log(solution.values[active]),
        steps,
        amounts,
    )
    log_factors = mixture.scatter[component] * normal[:, 0] / divisors
    scatter = float(np.sqrt(mixture.chance @ mixture.scatter**2))
    if specimen is None or scatter == 0.0:
        return distribution
    step = min(scatter, _MAX_LOG_STEP)
    specimen_distribution = InputDistribution(
        (specimen,), (SPECIMEN,), np.zeros(1), np.array([[step]]), log_factors[:, None] / step
    )
    return join_distributions([distribution, specimen_distribution])


def join_distributions(distributions: Iterable[InputDistribution]) -> InputDistribution:
    """Join independent distributions.

    Parameters
    ----------
    distributions : distributions with equal numbers of draws. For an input that is in several of
        them, changes and best values are added
    """
    items = tuple(distributions)
    names = tuple(dict.fromkeys(name for item in items for name in item.names))
    counts = [len(item.causes) for item in items]
    centre, steps = np.zeros(len(names)), np.zeros((len(names), sum(counts)))
    for item, end in zip(items, np.cumsum(counts), strict=True):
        rows = np.array([names.index(name) for name in item.names], dtype=np.int64)
        centre[rows] += item.centre
        steps[rows, end - len(item.causes) : end] = item.steps
    causes = tuple(cause for item in items for cause in item.causes)
    amounts = np.hstack([item.amounts for item in items])
    return InputDistribution(names, causes, centre, steps, amounts)


def _find_steps(covariance: Floats) -> Floats:
    """Return steps of one standard deviation along the principal axes, as columns.

    Axes without variance are left out. A step with a component above `_MAX_LOG_STEP` is shortened.
    """
    zero_variance = 1e-12  # relative to the largest variance
    variances, axes = np.linalg.eigh(covariance)
    has_variance = variances > zero_variance * max(float(variances[-1]), 1e-300)
    steps = axes[:, has_variance] * np.sqrt(variances[has_variance])
    largest_component = np.abs(steps).max(axis=0, initial=zero_variance)
    return np.asarray(steps * np.minimum(1.0, _MAX_LOG_STEP / largest_component))
