"""Outliers: marked by a named test, rarely by chance in a whole report, and never removed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from labpipe.records.arrays import Floats
from labpipe.records.group import Group, GroupNumber, Outlier
from labpipe.statistics.families import holm
from labpipe.statistics.group_notes import sample_keys

GRUBBS = "Grubbs' test"
GRUBBS_WITHIN = "Grubbs' test within spools"
ESD = "generalised ESD test"
ESD_WITHIN = "generalised ESD test within spools"
_METHODS = {
    (False, False): GRUBBS,
    (False, True): GRUBBS_WITHIN,
    (True, False): ESD,
    (True, True): ESD_WITHIN,
}


@dataclass(frozen=True, slots=True)
class _Step:
    """The furthest value of those left, its p-value, and the values that lie as far out."""

    where: int
    p: float
    twins: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Suspects:
    """Values of one number that may be outliers, before the other numbers of a report are known.

    Parameters
    ----------
    names, values : of the samples
    steps : the furthest value, then that of the rest, and so on; empty where there is no test
    method : name of the test
    """

    names: Sequence[str] = ()
    values: Sequence[float] = ()
    steps: Sequence[_Step] = ()
    method: str = ""

    @property
    def p(self) -> float:
        """p-value of the surest of them; NaN where there is no test."""
        return min((step.p for step in self.steps), default=float("nan"))

    def below(self, level: float) -> tuple[Outlier, ...]:
        """Mark those whose p-value is below a level, furthest first.

        Parameters
        ----------
        level : chance of marking anything in this number where there is no outlier
        """
        # A value is as sure as the surest step that it had to be set aside for.
        chances = [min(step.p for step in self.steps[at:]) for at in range(len(self.steps))]
        pairs = zip(self.steps, chances, strict=True)
        marked = [(step, chance) for step, chance in pairs if chance < level]
        alone = {step.where for step, _ in marked}
        return tuple(
            Outlier(
                self.names[where],
                self.values[where],
                self.method + _unless_told(others, self.names),
                chance,
            )
            for step, chance in marked
            for where, others in _shared(step, alone)
        )


def find_suspects(
    values: Mapping[str, float], spools: Mapping[str, str], *, most: int | None = None
) -> Suspects:
    """Test whether values lie further from the mean of their spool than chance explains.

    Parameters
    ----------
    values : by sample; NaN are passed over
    spools : spool of each sample
    most : how many may be marked; a tenth of the samples, and at least one, if None

    Returns
    -------
    None where `too_few_for_outliers` says why there is no test. Values that lie equally far
    out are all named and the method says so: the two samples of a spool always are, since each lies
    as far from their mean as the other.

    Notes
    -----
    The residual of each sample from the mean of its spool is compared with the scatter of the
    others within their spools: |t| with N - spools - 1 degrees of freedom, p = N P(|t| > found). In
    one spool this is Grubbs' test (Technometrics 11 (1969) 1). Where several may be marked, the
    furthest is set aside and the test done again, and all up to the last significant one are
    marked, so that two outliers cannot hide each other: the generalised ESD test (Rosner,
    Technometrics 25 (1983) 165), meant for 15 samples or more.
    """
    names = [name for name, value in values.items() if not np.isnan(value)]
    number = np.array([values[name] for name in names])
    spool = np.unique([spools[name] for name in names], return_inverse=True)[1]
    allowed = max(1, len(names) // 10) if most is None else most
    method = _METHODS[allowed > 1, len(set(spool.tolist())) > 1]
    return Suspects(names, number.tolist(), _steps(number, spool, allowed), method)


def with_outliers(groups: Sequence[Group], level: float = 0.05) -> list[Group]:
    """Mark outliers among all numbers of a report.

    Parameters
    ----------
    groups : of the report; outliers that they have are replaced. Numbers that the rig sets are not
        tested
    level : chance of marking anything in the whole report where there is no outlier

    Returns
    -------
    The groups with outliers in their numbers. The smallest p-values of all numbers are one family,
    corrected by `holm`: numbers of one test hang together, which Holm's procedure allows. The steps
    of the ESD test count as one test each, since it marks more often than its level says (1.14
    times at 5 % and 20 samples, two steps).
    """
    suspects = [[_suspects(group, number) for number in group.numbers] for group in groups]
    chances = [
        len(suspect.steps) * suspect.p for group_suspects in suspects for suspect in group_suspects
    ]
    corrected = iter(holm(chances, level))
    return [
        replace(
            group,
            numbers=tuple(
                replace(
                    number,
                    outliers=suspect.below(
                        level / next(corrected).divisor / max(1, len(suspect.steps))
                    ),
                )
                for number, suspect in zip(group.numbers, group_suspects, strict=True)
            ),
        )
        for group, group_suspects in zip(groups, suspects, strict=True)
    ]


def _suspects(group: Group, number: GroupNumber) -> Suspects:
    if number.is_set_by_rig:
        return Suspects()
    keys = sample_keys(group.samples)
    spools = dict(zip(keys, (sample.specimen.spool for sample in group.samples), strict=True))
    values = {key: value.value for key, value in number.values.items() if value.value is not None}
    return find_suspects(values, spools)


def _shared(step: _Step, alone: set[int]) -> list[tuple[int, list[int]]]:
    """The value of a step and those that the test cannot tell it from, each with the others."""
    every = [step.where, *(twin for twin in step.twins if twin not in alone)]
    return [(where, [other for other in every if other != where]) for where in every]


def _unless_told(others: Sequence[int], names: Sequence[str]) -> str:
    other_tests = " and ".join(names[other] for other in others)
    return f", which cannot tell it from {other_tests}" if other_tests else ""


def _steps(values: Floats, spool: NDArray[np.intp], most: int) -> list[_Step]:
    """The furthest value, its p-value, then the same without it, and so on."""
    # p-values whose ratio is lower are equal but for rounding.
    equal_p_ratio = 1.001
    left = np.arange(len(values))
    steps: list[_Step] = []
    for _ in range(most):
        chance = _chances(values[left], spool[left])
        if chance is None:
            break
        furthest = int(np.argmin(chance))
        alike = np.flatnonzero(chance <= equal_p_ratio * chance[furthest])
        twins = tuple(int(left[twin]) for twin in alike if twin != furthest)
        steps.append(_Step(int(left[furthest]), float(chance[furthest]), twins))
        left = np.delete(left, furthest)
    return steps


def _chances(values: Floats, spool: NDArray[np.intp]) -> Floats | None:
    """p-value of each value, Bonferroni over all; None without scatter to compare with."""
    numbers, spool = np.unique(spool, return_inverse=True)
    free = len(values) - len(numbers) - 1
    if free < 1:
        return None
    counts = np.bincount(spool)
    means = np.bincount(spool, weights=values) / counts
    residual = values - means[spool]
    total = float(residual @ residual)
    room = 1.0 - 1.0 / counts[spool]
    if total <= (1e-12 * float(np.abs(values).max())) ** 2:
        return None
    taken = np.divide(residual**2, room, out=np.zeros(len(values)), where=room > 0)
    others = np.maximum(total - taken, 1e-15 * total)
    chance: Floats = np.minimum(
        1.0, 2.0 * len(values) * special.stdtr(free, -np.sqrt(taken * free / others))
    )
    return chance
