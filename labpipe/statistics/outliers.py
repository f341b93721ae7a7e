"""Outliers: marked by a statistical test with a false-alarm rate per report, never removed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.group import Group, GroupNumber, Outlier
from labpipe.statistics.group_notes import name_samples
from labpipe.statistics.two_groups import correct_p_values

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
    """Index of the furthest of the remaining values, its p-value, and equally far values."""

    index: int
    p: float
    ties: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Suspects:
    """Possible outliers of one number, before correction for all numbers of a report.

    Parameters
    ----------
    names, values : of the samples
    steps : the furthest value, then the furthest of the others, and so on; empty without a test
    method : name of the test
    """

    names: Sequence[str] = ()
    values: Sequence[float] = ()
    steps: Sequence[_Step] = ()
    method: str = ""

    @property
    def p(self) -> float:
        """Return the smallest p-value, or NaN without a test."""
        return min((step.p for step in self.steps), default=float("nan"))

    def select_outliers(self, level: float) -> tuple[Outlier, ...]:
        """Return the outliers with a p-value below a level, furthest first.

        Parameters
        ----------
        level : false-alarm rate for this number
        """
        # A value has the smallest p-value of its step and all later ones.
        chances = [min(step.p for step in self.steps[number:]) for number in range(len(self.steps))]
        pairs = zip(self.steps, chances, strict=True)
        marked = [(step, chance) for step, chance in pairs if chance < level]
        single_places = {step.index for step, _ in marked}
        return tuple(
            Outlier(
                self.names[where],
                self.values[where],
                self.method + _equally_suspect(others, self.names),
                chance,
            )
            for step, chance in marked
            for where, others in _shared(step, single_places)
        )


def find_suspects(
    values: Mapping[str, float], spools: Mapping[str, str], *, max_suspects: int | None = None
) -> Suspects:
    """Test whether values lie further from the mean of their spool than chance explains.

    Parameters
    ----------
    values : by sample; NaN are ignored
    spools : spool of each sample
    max_suspects : largest number of outliers; a tenth of the samples, and at least one, if None

    Returns
    -------
    Empty if `describe_missing_samples` gives a reason. Equally far values are all named, also in
    the method: the two samples of a spool always are, as they are equally far from their mean.

    Notes
    -----
    The residual of each sample from the mean of its spool is compared with the scatter of the
    others within their spools: |t| with N - spools - 1 degrees of freedom, p = N P(|t| > found). In
    one spool this is Grubbs' test (Technometrics 11 (1969) 1). For several outliers, the furthest
    is removed and the test repeated, and all up to the last significant one are marked, so that two
    outliers cannot mask each other: the generalised ESD test (Rosner, Technometrics 25 (1983) 165),
    meant for 15 samples or more.
    """
    names = [name for name, value in values.items() if not np.isnan(value)]
    number = np.array([values[name] for name in names])
    spool = np.unique([spools[name] for name in names], return_inverse=True)[1]
    allowed = max(1, len(names) // 10) if max_suspects is None else max_suspects
    method = _METHODS[allowed > 1, len(set(spool.tolist())) > 1]
    return Suspects(names, number.tolist(), _steps(number, spool, allowed), method)


def mark_outliers(groups: Sequence[Group], level: float = 0.05) -> list[Group]:
    """Mark outliers among all numbers of a report.

    Parameters
    ----------
    groups : of the report; existing outliers are replaced. Numbers set by the rig are not tested
    level : false-alarm rate for the whole report

    Returns
    -------
    The groups with outliers in their numbers. The smallest p-values of all numbers are one family,
    corrected by `correct_p_values`, which allows for dependent numbers of one test. Each step of
    the ESD test counts as one test, since its false-alarm rate exceeds its level (1.14 times at 5 %
    and 20 samples, two steps).
    """
    suspects = [[_suspects(group, number) for number in group.numbers] for group in groups]
    chances = [
        len(suspect.steps) * suspect.p for group_suspects in suspects for suspect in group_suspects
    ]
    corrected = iter(correct_p_values(chances, level))
    return [
        replace(
            group,
            numbers=tuple(
                replace(
                    number,
                    outliers=suspect.select_outliers(
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
    keys = name_samples(group.samples)
    spools = dict(zip(keys, (sample.specimen.spool for sample in group.samples), strict=True))
    values = {key: value.value for key, value in number.values.items() if value.value is not None}
    return find_suspects(values, spools)


def _shared(step: _Step, single_places: set[int]) -> list[tuple[int, list[int]]]:
    """Return the value of a step and equally suspect ones, each with the others."""
    every = [step.index, *(twin for twin in step.ties if twin not in single_places)]
    return [(where, [other for other in every if other != where]) for where in every]


def _equally_suspect(others: Sequence[int], names: Sequence[str]) -> str:
    other_tests = " and ".join(names[other] for other in others)
    if not other_tests:
        return ""
    return format_sentence("statistics.equally_suspect", tests=other_tests)


def _steps(values: Floats, spool: NDArray[np.intp], max_suspects: int) -> list[_Step]:
    """Return the furthest value with its p-value, then that of the others, and so on."""
    equal_p_ratio = 1.001  # within rounding
    remaining = np.arange(len(values))
    steps: list[_Step] = []
    for _ in range(max_suspects):
        chance = _chances(values[remaining], spool[remaining])
        if chance is None:
            break
        furthest = int(np.argmin(chance))
        equal = np.flatnonzero(chance <= equal_p_ratio * chance[furthest])
        twins = tuple(int(remaining[twin]) for twin in equal if twin != furthest)
        steps.append(_Step(int(remaining[furthest]), float(chance[furthest]), twins))
        remaining = np.delete(remaining, furthest)
    return steps


def _chances(values: Floats, spool: NDArray[np.intp]) -> Floats | None:
    """Return the p-value of each value with Bonferroni correction, or None without scatter."""
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
