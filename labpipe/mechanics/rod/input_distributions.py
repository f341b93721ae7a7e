"""Distributions of the inputs of a line's prediction.

A distribution is a set of named inputs and independent causes that move them linearly. A
calibration gives a distribution for each of its solutions: the logarithms of its parameters lie
about the solution as its mixture of Student's t says, a specimen of the spool differs from the mean
of the tested ones by a factor on all moments, and both are drawn together, since the uncertain
scatter of samples widens both. Everything else (free curvature, mass, places of clips, difference
of spools) is stated as a standard deviation, with its degrees of freedom where they are few.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit
from scipy.stats.qmc import Sobol

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.records.wire_calibration import PARAMETERS, Solution

DRAWS = 4096
"""Of a distribution, a power of two. The width of a band has an error of 1.5 % where the scatter of
specimens, estimated from three samples, dominates; random draws have 3 %."""
CALIBRATION = "calibration"
SPECIMEN = "specimen"

_MAX_LOG_STEP = 0.3  # of a logarithm; lines are solved two steps away, a factor of 1.8


@dataclass(frozen=True, slots=True, eq=False)
class InputDistribution(ArrayRecord):
    """Inputs of a line, and the causes that move them: inputs = centre + steps x amounts.

    Parameters
    ----------
    names : of the inputs, each once
    causes : of each step; several steps may have one cause
    centre : best values
    steps : shape (names, causes): change of each input per unit of each cause
    amounts : shape (draws, causes): draws of all causes together, in their steps
    """

    names: tuple[str, ...]
    causes: tuple[str, ...]
    centre: Annotated[Floats, "names"]
    steps: Annotated[Floats, "names", "causes"]
    amounts: Annotated[Floats, "draws", "causes"]

    def inputs(self, amounts: Floats | None = None) -> dict[str, float]:
        """Return the inputs at amounts of the causes, shape (causes,), or the best values."""
        moved = self.centre if amounts is None else self.centre + self.steps @ amounts
        return dict(zip(self.names, moved.tolist(), strict=True))


def stated_distribution(
    name: str,
    deviation: float,
    *,
    centre: float = 0.0,
    freedom: float = np.inf,
    cause: str = "",
    draws: int = DRAWS,
    seed: int = 0,
) -> InputDistribution:
    """Return the distribution of one input from its standard deviation.

    Parameters
    ----------
    name : of the input
    deviation : its standard deviation, in its own unit; positive
    centre : its best value
    freedom : degrees of freedom of the deviation: the input is drawn from Student's t
    cause : its name in a budget; by default the name of the input
    draws, seed : number and order of the draws, whose quantiles are exact. Distributions of one
    line
        need different seeds; the name is part of the seed, so that different names suffice
    """
    if not (np.isfinite(deviation) and deviation > 0.0 and freedom > 0.0):
        raise ValueError(
            format_sentence(
                "mechanics.rod.bad_deviation", name=name, deviation=deviation, freedom=freedom
            )
        )
    chance = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    uniform = (chance.permutation(draws) + 0.5) / draws
    amounts = np.asarray(
        ndtri(uniform) if np.isinf(freedom) else stdtrit(freedom, uniform), np.float64
    )
    steps = np.array([[deviation]])
    return InputDistribution((name,), (cause or name,), np.array([centre]), steps, amounts[:, None])


def uniform_distribution(
    name: str, low: float, high: float, *, cause: str, draws: int = DRAWS, seed: int = 0
) -> InputDistribution:
    """Return the distribution of one input that lies anywhere in a range.

    Parameters
    ----------
    name : of the input
    low, high : ends of the range, in the unit of the input
    cause : its name in a budget
    draws, seed : as for `stated_distribution`
    """
    chance = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    amounts = 2.0 * (chance.permutation(draws) + 0.5) / draws - 1.0
    centre, steps = np.array([0.5 * (low + high)]), np.array([[0.5 * (high - low)]])
    return InputDistribution((name,), (cause,), centre, steps, amounts[:, None])


def calibrated_distributions(
    solutions: Sequence[Solution],
    widening: float = 1.0,
    *,
    specimen: str | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[InputDistribution, ...]:
    """Return a distribution for each solution of a calibration in its 95 % set.

    Parameters
    ----------
    solutions : of the calibration, the best first
    widening : of its quantiles
    specimen : input that is the logarithm of a factor on all moments, for a line that is another
        specimen of the spool: it is drawn from the scatter of samples. None for a line with the
        law of the mean sample
    draws, seed : number of draws, a power of two, and their seed

    Returns
    -------
    Distributions in the logarithms of the acting `PARAMETERS`; fixed ones do not move. As in the
    bands of the calibration, the spread of a less likely solution is narrower: by
    sqrt(1 - rise / limit).
    """
    return tuple(
        _solution_distribution(
            *(solution, widening * np.sqrt(1.0 - solution.rise / solution.limit)),
            specimen=specimen,
            draws=draws,
            chance=np.random.default_rng([seed, number]),
        )
        for number, solution in enumerate(solution for solution in solutions if solution.is_allowed)
    )


def _solution_distribution(
    solution: Solution,
    wide: float,
    *,
    specimen: str | None,
    draws: int,
    chance: np.random.Generator,
) -> InputDistribution:
    acts = np.flatnonzero(np.isfinite(solution.values))
    mixture = solution.mixture
    uniform = _sobol_points(chance, draws, 3 + len(acts))
    last = len(mixture.chance) - 1
    place = np.minimum(np.searchsorted(np.cumsum(mixture.chance), uniform[:, 0]), last)
    student = _student_divisor(uniform[:, 1], mixture.freedom)
    normal = ndtri(uniform[:, 2:])
    inner = mixture.covariance[:, acts[:, None], acts]
    roots = np.stack([_square_root(covariance) for covariance in inner])
    normal_part = np.einsum("nij,nj->ni", roots[place], normal[:, 1:])
    moved = wide * (mixture.shift[place][:, acts] + normal_part / student[:, None])
    spread = np.einsum("s,sij->ij", mixture.chance, inner)
    spread += np.einsum("s,si,sj->ij", mixture.chance, *(2 * [mixture.shift[:, acts]]))
    steps = _steps(spread)
    names, amounts = [PARAMETERS[number] for number in acts], moved @ np.linalg.pinv(steps).T
    distribution = InputDistribution(
        tuple(names), (CALIBRATION,) * steps.shape[1], np.log(solution.values[acts]), steps, amounts
    )
    factor = mixture.scatter[place] * normal[:, 0] / student
    size = float(np.sqrt(mixture.chance @ mixture.scatter**2))
    if specimen is None or size == 0.0:
        return distribution
    size = min(size, _MAX_LOG_STEP)
    one_step = np.array([[size]])
    specimen_part = InputDistribution(
        (specimen,), (SPECIMEN,), np.zeros(1), one_step, factor[:, None] / size
    )
    return join_distributions([distribution, specimen_part])


def join_distributions(distributions: Iterable[InputDistribution]) -> InputDistribution:
    """Join independent distributions.

    Parameters
    ----------
    distributions : with equal numbers of draws; an input in several is moved by all of them, and
    its
        best value is the sum of theirs
    """
    parts = tuple(distributions)
    names = tuple(dict.fromkeys(name for part in parts for name in part.names))
    counts = [len(part.causes) for part in parts]
    centre, steps = np.zeros(len(names)), np.zeros((len(names), sum(counts)))
    for part, last in zip(parts, np.cumsum(counts), strict=True):
        rows = np.array([names.index(name) for name in part.names], dtype=np.int64)
        centre[rows] += part.centre
        steps[rows, last - len(part.causes) : last] = part.steps
    causes = tuple(cause for part in parts for cause in part.causes)
    return InputDistribution(
        names, causes, centre, steps, np.hstack([part.amounts for part in parts])
    )


def _sobol_points(chance: np.random.Generator, draws: int, numbers: int) -> Floats:
    """Return Sobol points in the unit cube, shape (draws, numbers)."""
    inner_share = 1.0 - 1e-10  # keeps probabilities away from 0 and 1
    return np.asarray(0.5 + inner_share * (Sobol(numbers, seed=chance).random(draws) - 0.5))


def _student_divisor(uniform: Floats, freedom: float) -> Floats:
    """Return the divisors that turn normal draws into Student's t."""
    if np.isinf(freedom):
        return np.ones(len(uniform))
    return np.asarray(np.sqrt(chdtri(freedom, uniform) / freedom))


def _square_root(covariance: Floats) -> Floats:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _steps(covariance: Floats) -> Floats:
    """Return the uncertain principal axes, one standard deviation long, within the largest step."""
    zero_variance = 1e-12  # of the largest variance
    values, vectors = np.linalg.eigh(covariance)
    moves = values > zero_variance * max(float(values[-1]), 1e-300)
    steps = vectors[:, moves] * np.sqrt(values[moves])
    longest_step = np.abs(steps).max(axis=0, initial=zero_variance)
    return np.asarray(steps * np.minimum(1.0, _MAX_LOG_STEP / longest_step))
