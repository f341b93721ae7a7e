"""What is known of the numbers that a line is predicted from: values, and how they may be off.

A belief is a set of named inputs and independent causes that move them, each by a straight step. A
calibration gives a belief for each of its solutions: the logarithms of its parameters lie about the
solution as its mixture of Student's t says, a specimen of the spool differs from the mean of the
tested ones by a factor on all moments, and both are drawn together, since what is not known of the
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

from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.records.wire_calibration import PARAMETERS, Solution

DRAWS = 4096
"""Of a belief, a power of two: a band's width is off by 1.5 % where most of it is the scatter of
specimens, of which three samples say little; as many draws by chance alone are off by 3 %."""
CALIBRATION, SPECIMEN = "calibration", "specimen"
"""Causes, as a budget names them."""

_MAX_LOG_STEP = 0.3  # step of a logarithm; lines are solved two away, where it is 1.8 times as much


@dataclass(frozen=True, slots=True, eq=False)
class InputDistribution(ArrayRecord):
    """Inputs of a line, and the causes that move them: inputs = centre + steps x amounts.

    Parameters
    ----------
    names : of the inputs, each once
    causes : what moves them, one for each step; several steps may have one cause
    centre : best values
    steps : shape (names, causes): how far one of each cause moves each input
    amounts : shape (draws, causes): draws of all causes together, in their steps
    """

    names: tuple[str, ...]
    causes: tuple[str, ...]
    centre: Annotated[Floats, "names"]
    steps: Annotated[Floats, "names", "causes"]
    amounts: Annotated[Floats, "draws", "causes"]

    def inputs(self, amounts: Floats | None = None) -> dict[str, float]:
        """Inputs at some amounts of the causes, shape (causes,); the best values without any."""
        moved = self.centre if amounts is None else self.centre + self.steps @ amounts
        return dict(zip(self.names, moved.tolist(), strict=True))


def known(
    name: str,
    deviation: float,
    *,
    centre: float = 0.0,
    freedom: float = np.inf,
    cause: str = "",
    draws: int = DRAWS,
    seed: int = 0,
) -> InputDistribution:
    """One input with its standard deviation.

    Parameters
    ----------
    name : of the input
    deviation : its standard deviation, in its own unit; positive
    centre : its best value
    freedom : degrees of freedom of the deviation: the input is drawn from Student's t
    cause : as a budget names it; the name of the input if left out
    draws, seed : how many are drawn, and in which order: their quantiles are those of the
        distribution. Beliefs of one line want seeds of their own; the name takes part in the seed,
        so that inputs of different names have them
    """
    if not (np.isfinite(deviation) and deviation > 0.0 and freedom > 0.0):
        message = (
            f"{name}: deviation={deviation!r}, freedom={freedom!r}: allowed are numbers above zero"
        )
        raise ValueError(message)
    chance = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    even = (chance.permutation(draws) + 0.5) / draws
    amounts = np.asarray(ndtri(even) if np.isinf(freedom) else stdtrit(freedom, even), np.float64)
    steps = np.array([[deviation]])
    return InputDistribution((name,), (cause or name,), np.array([centre]), steps, amounts[:, None])


def calibrated_distributions(
    solutions: Sequence[Solution],
    widening: float = 1.0,
    *,
    specimen: str | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[InputDistribution, ...]:
    """What a calibration knows of a wire, a belief for each solution in its 95 % set.

    Parameters
    ----------
    solutions : of the calibration, the best first
    widening : of its quantiles
    specimen : input that is the logarithm of a factor on all moments, for a line that is one more
        specimen of the spool: it is drawn from what the calibration knows of the scatter of
        samples. None for a line with the law of the mean sample
    draws, seed : how many are drawn, a power of two, and from where

    Returns
    -------
    Beliefs in the logarithms of `PARAMETERS`; what the wire has not is no input. What is fixed does
    not move. As in the calibration's own bands a solution's spread is the narrower the less likely
    it is: by sqrt(1 - rise / limit).
    """
    return tuple(
        _of_solution(
            *(solution, widening * np.sqrt(1.0 - solution.rise / solution.limit)),
            specimen=specimen,
            draws=draws,
            chance=np.random.default_rng([seed, number]),
        )
        for number, solution in enumerate(solution for solution in solutions if solution.is_allowed)
    )


def _of_solution(
    solution: Solution,
    wide: float,
    *,
    specimen: str | None,
    draws: int,
    chance: np.random.Generator,
) -> InputDistribution:
    acts = np.flatnonzero(np.isfinite(solution.values))
    mixture = solution.mixture
    even = _evenly(chance, draws, 3 + len(acts))
    last = len(mixture.chance) - 1
    place = np.minimum(np.searchsorted(np.cumsum(mixture.chance), even[:, 0]), last)
    student = _student(even[:, 1], mixture.freedom)
    normal = ndtri(even[:, 2:])
    inner = mixture.covariance[:, acts[:, None], acts]
    roots = np.stack([_root(each) for each in inner])
    plain = np.einsum("nij,nj->ni", roots[place], normal[:, 1:])
    moved = wide * (mixture.shift[place][:, acts] + plain / student[:, None])
    spread = np.einsum("s,sij->ij", mixture.chance, inner)
    spread += np.einsum("s,si,sj->ij", mixture.chance, *(2 * [mixture.shift[:, acts]]))
    steps = _steps(spread)
    names, amounts = [PARAMETERS[number] for number in acts], moved @ np.linalg.pinv(steps).T
    belief = InputDistribution(
        tuple(names), (CALIBRATION,) * steps.shape[1], np.log(solution.values[acts]), steps, amounts
    )
    factor = mixture.scatter[place] * normal[:, 0] / student
    size = float(np.sqrt(mixture.chance @ mixture.scatter**2))
    if specimen is None or size == 0.0:
        return belief
    size = min(size, _MAX_LOG_STEP)
    one = np.array([[size]])
    own = InputDistribution((specimen,), (SPECIMEN,), np.zeros(1), one, factor[:, None] / size)
    return joined([belief, own])


def joined(beliefs: Iterable[InputDistribution]) -> InputDistribution:
    """Beliefs of which none knows of the others, as one.

    Parameters
    ----------
    beliefs : with as many draws each; an input in several is moved by all of them, and its best
        value is the sum of theirs
    """
    every = tuple(beliefs)
    names = tuple(dict.fromkeys(name for each in every for name in each.names))
    counts = [len(each.causes) for each in every]
    centre, steps = np.zeros(len(names)), np.zeros((len(names), sum(counts)))
    for each, last in zip(every, np.cumsum(counts), strict=True):
        rows = np.array([names.index(name) for name in each.names], dtype=np.int64)
        centre[rows] += each.centre
        steps[rows, last - len(each.causes) : last] = each.steps
    causes = tuple(cause for each in every for cause in each.causes)
    return InputDistribution(
        names, causes, centre, steps, np.hstack([each.amounts for each in every])
    )


def _evenly(chance: np.random.Generator, draws: int, numbers: int) -> Floats:
    """Chances between 0 and 1 that fill their cube evenly (Sobol's), shape (draws, numbers)."""
    inner_share = 1.0 - 1e-10  # keeps probabilities away from 0 and 1
    return np.asarray(0.5 + inner_share * (Sobol(numbers, seed=chance).random(draws) - 0.5))


def _student(even: Floats, freedom: float) -> Floats:
    """What normal draws are divided by to be Student's."""
    if np.isinf(freedom):
        return np.ones(len(even))
    return np.asarray(np.sqrt(chdtri(freedom, even) / freedom))


def _root(covariance: Floats) -> Floats:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _steps(covariance: Floats) -> Floats:
    """Principal axes that are not known, one standard deviation long, or the longest that is."""
    zero_variance = 1e-12  # of the largest variance
    values, vectors = np.linalg.eigh(covariance)
    moves = values > zero_variance * max(float(values[-1]), 1e-300)
    steps = vectors[:, moves] * np.sqrt(values[moves])
    longest = np.abs(steps).max(axis=0, initial=zero_variance)
    return np.asarray(steps * np.minimum(1.0, _MAX_LOG_STEP / longest))
