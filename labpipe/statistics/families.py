"""Multiple testing by Holm's procedure.

A test at 5 % has a false finding in every twentieth number: twenty in a report of four hundred.
Holm's procedure limits the probability of any false finding in the whole family to 5 %, for any
dependence between the numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan


@dataclass(frozen=True, slots=True)
class Corrected:
    """A p-value in its family.

    Parameters
    ----------
    p : adjusted: below the level of the family if the finding is significant; NaN for no test
    divisor : the level of this test is that of the family divided by it
    tests : in the family
    """

    p: float
    divisor: int
    tests: int


def holm(chances: Sequence[float], level: float = 0.05) -> list[Corrected]:
    """Correct the p-values of a family.

    Parameters
    ----------
    chances : p-values; NaN without a test, which then does not count
    level : probability of any false finding in the family

    Returns
    -------
    In the order of `chances`. From the first p-value on that is not below its level, all have the
    divisor of that one: an interval at the level of its test excludes zero exactly if the test is
    significant.

    Notes
    -----
    Holm, Scandinavian Journal of Statistics 6 (1979) 65: the smallest of m p-values is compared
    with level / m, the next with level / (m - 1), and so on up to the first that is larger.

    Examples
    --------
    >>> [each.p for each in holm([0.04, 0.01, 0.03])]
    [0.06, 0.03, 0.06]
    """
    tested = sorted((i for i, p in enumerate(chances) if not isnan(p)), key=chances.__getitem__)
    corrected = [Corrected(nan, max(1, len(tested)), len(tested))] * len(chances)
    largest, divisor, goes_on = 0.0, max(1, len(tested)), True
    for rank, i in enumerate(tested):
        remaining = len(tested) - rank
        largest = max(largest, min(1.0, remaining * chances[i]))
        divisor = remaining if goes_on else divisor
        goes_on = goes_on and largest < level
        corrected[i] = Corrected(largest, divisor, len(tested))
    return corrected
