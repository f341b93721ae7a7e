"""Mark outliers among the numbers of a report by statistical tests.

The false-alarm rate applies to the whole report. No value is removed.
"""

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
_METHOD_NAMES = {  # (several outliers, several spools)
    (False, False): GRUBBS,
    (False, True): GRUBBS_WITHIN,
    (True, False): ESD,
    (True, True): ESD_WITHIN,
}


@dataclass(frozen=True, slots=True)
class _TestStep:
    """One step of a test: the most extreme of the remaining values.

    Parameters
    ----------
    index : index of the value
    p_value : p-value of the value
    tied_indices : indices of other values with the same p-value
    """

    index: int
    p_value: float
    tied_indices: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OutlierTest:
    """Result of an outlier test of one number, before the correction for all numbers of a report.

    Parameters
    ----------
    names : name of each sample that has a value
    values : value of each of these samples
    steps : the most extreme value, then the most extreme of the remaining values, and so on; empty
        if no test is possible
    method : name of the test
    """

    names: Sequence[str] = ()
    values: Sequence[float] = ()
    steps: Sequence[_TestStep] = ()
    method: str = ""

    @property
    def smallest_p_value(self) -> float:
        """Return the smallest p-value of the steps, or NaN if no test is possible."""
        return min((step.p_value for step in self.steps), default=float("nan"))

    def select_outliers(self, max_p_value: float) -> tuple[Outlier, ...]:
        """Return the outliers of the steps up to the last significant one, the most extreme first.

        Parameters
        ----------
        max_p_value : limit of the p-values of single steps
        """
        # Each step gets the smallest p-value from it on: a significant step marks all earlier ones.
        p_values = [
            min(step.p_value for step in self.steps[position:])
            for position in range(len(self.steps))
        ]
        steps = zip(self.steps, p_values, strict=True)
        significant = [(step, p_value) for step, p_value in steps if p_value < max_p_value]
        step_indices = {step.index for step, _ in significant}
        return tuple(
            Outlier(
                self.names[index],
                self.values[index],
                self.method + _describe_ties([self.names[tied] for tied in tied_indices]),
                p_value,
            )
            for step, p_value in significant
            for index, tied_indices in _list_tied_values(step, step_indices)
        )


def run_outlier_test(
    values: Mapping[str, float], spools: Mapping[str, str], *, max_outliers: int | None = None
) -> OutlierTest:
    """Test whether values lie further from the mean of their spool than chance explains.

    Parameters
    ----------
    values : value by sample; NaN is ignored
    spools : spool by sample
    max_outliers : largest number of outliers; if None, a tenth of the samples, but at least one

    Returns
    -------
    The test. It has no steps if `describe_missing_samples` gives a reason, or if all samples of
    each spool are equal within rounding. Values with equal p-values are all marked, and the name of
    the method lists them; this always applies to the two values of a spool with two samples.

    Notes
    -----
    The residual of each sample from the mean of its spool is compared with the scatter of the
    other samples within their spools: Student's t with N - spools - 1 degrees of freedom. The
    p-value is N times the two-sided tail probability, but at most 1. In one spool this is Grubbs'
    test (Technometrics 11 (1969) 1). For several outliers, the test is repeated without the most
    extreme value, and all values up to the last significant one are marked, so that two outliers
    cannot mask each other. This is the generalised ESD test (Rosner, Technometrics 25 (1983) 165),
    which is meant for 15 samples or more.
    """
    names = [name for name, value in values.items() if not np.isnan(value)]
    tested = np.array([values[name] for name in names])
    spool_index = np.unique([spools[name] for name in names], return_inverse=True)[1]
    limit = max(1, len(names) // 10) if max_outliers is None else max_outliers
    method = _METHOD_NAMES[limit > 1, len(set(spool_index.tolist())) > 1]
    return OutlierTest(names, tested.tolist(), _find_steps(tested, spool_index, limit), method)


def mark_outliers(groups: Sequence[Group], level: float = 0.05) -> list[Group]:
    """Mark outliers among all numbers of a report.

    Parameters
    ----------
    groups : groups of the report. Outliers that they already have are replaced. Numbers that the
        rig sets are not tested
    level : false-alarm rate for the whole report

    Returns
    -------
    The groups with outliers in their numbers.

    Notes
    -----
    The smallest p-values of all numbers form one family. `correct_p_values` corrects them; it holds
    for dependent numbers of one test, too. Each step of the ESD test counts as one test, since its
    false-alarm rate exceeds its level (1.14 times for two steps at 5 % and 20 samples).
    """
    outlier_tests = [[_test_number(group, number) for number in group.numbers] for group in groups]
    p_values = [
        len(outlier_test.steps) * outlier_test.smallest_p_value
        for group_tests in outlier_tests
        for outlier_test in group_tests
    ]
    corrected = iter(correct_p_values(p_values, level))
    return [
        replace(
            group,
            numbers=tuple(
                replace(
                    number,
                    outliers=outlier_test.select_outliers(
                        level / next(corrected).divisor / max(1, len(outlier_test.steps))
                    ),
                )
                for number, outlier_test in zip(group.numbers, group_tests, strict=True)
            ),
        )
        for group, group_tests in zip(groups, outlier_tests, strict=True)
    ]


def _test_number(group: Group, number: GroupNumber) -> OutlierTest:
    if number.is_set_by_rig:
        return OutlierTest()
    names = name_samples(group.samples)
    spools = dict(zip(names, (sample.specimen.spool for sample in group.samples), strict=True))
    values = {
        name: result.value for name, result in number.values.items() if result.value is not None
    }
    return run_outlier_test(values, spools)


def _list_tied_values(step: _TestStep, step_indices: set[int]) -> list[tuple[int, list[int]]]:
    """Return the values that a step marks, each with the other values that it marks.

    Tied values that have a step of their own are left out.
    """
    indices = [step.index, *(tied for tied in step.tied_indices if tied not in step_indices)]
    return [
        (index, [other_index for other_index in indices if other_index != index])
        for index in indices
    ]


def _describe_ties(names: Sequence[str]) -> str:
    """Name the samples from which the test cannot distinguish an outlier; empty if none."""
    if not names:
        return ""
    return format_sentence("statistics.equally_suspect", tests=" and ".join(names))


def _find_steps(
    values: Floats, spool_index: NDArray[np.intp], max_outliers: int
) -> list[_TestStep]:
    """Find the most extreme value, then that of the remaining values, and so on."""
    max_tied_ratio = 1.001  # p-values of values that are equally far differ by rounding
    remaining = np.arange(len(values))
    steps: list[_TestStep] = []
    for _ in range(max_outliers):
        p_values = _compute_p_values(values[remaining], spool_index[remaining])
        if p_values is None:
            break
        extreme = int(np.argmin(p_values))
        tied = np.flatnonzero(p_values <= max_tied_ratio * p_values[extreme])
        tied_indices = tuple(int(remaining[position]) for position in tied if position != extreme)
        steps.append(_TestStep(int(remaining[extreme]), float(p_values[extreme]), tied_indices))
        remaining = np.delete(remaining, extreme)
    return steps


def _compute_p_values(values: Floats, spool_index: NDArray[np.intp]) -> Floats | None:
    """Compute the p-value of each value with Bonferroni's correction.

    Return None if there are too few values, or if the values of each spool are equal.
    """
    spools, spool_index = np.unique(spool_index, return_inverse=True)
    degrees_of_freedom = len(values) - len(spools) - 1
    if degrees_of_freedom < 1:
        return None
    counts = np.bincount(spool_index)
    means = np.bincount(spool_index, weights=values) / counts
    residual = values - means[spool_index]
    sum_of_squares = float(residual @ residual)
    if sum_of_squares <= (1e-12 * float(np.abs(values).max())) ** 2:
        return None
    # Removing a value from a spool of n reduces the sum of squares by residual^2 / (1 - 1 / n).
    variance_factor = 1.0 - 1.0 / counts[spool_index]
    reduction = np.divide(
        residual**2, variance_factor, out=np.zeros(len(values)), where=variance_factor > 0
    )
    remaining_squares = np.maximum(sum_of_squares - reduction, 1e-15 * sum_of_squares)
    t = np.sqrt(reduction * degrees_of_freedom / remaining_squares)
    p_values: Floats = np.minimum(1.0, 2.0 * len(values) * special.stdtr(degrees_of_freedom, -t))
    return p_values
