"""Holm's procedure against its definition and against a package."""

from __future__ import annotations

from math import isnan, nan

import numpy as np
import pytest
from scipy import stats

from labpipe.statistics.families import holm


def test_an_example_by_hand() -> None:
    """0.01 x 4, 0.015 x 3 = 0.045, 0.03 x 2 = 0.06: the third and all that follow do not hold."""
    found = holm([0.03, 0.01, 0.2, 0.015])
    assert [each.p for each in found] == pytest.approx([0.06, 0.04, 0.2, 0.045])
    assert [each.divisor for each in found] == [2, 4, 2, 3]
    assert {each.tests for each in found} == {4}


def test_what_has_no_test_does_not_count() -> None:
    first, none, last = holm([0.02, nan, 0.03])
    assert (first.p, last.p) == (0.04, 0.04)
    assert isnan(none.p)
    assert (none.tests, none.divisor) == (2, 2)
    assert holm([]) == []
    assert holm([nan])[0].divisor == 1


def test_a_family_of_one_is_not_corrected() -> None:
    (only,) = holm([0.04])
    assert (only.p, only.divisor, only.tests) == (0.04, 1, 1)


def test_p_never_exceeds_one_and_keeps_its_order() -> None:
    rng = np.random.default_rng(3)
    chances = rng.uniform(size=40)
    adjusted = np.array([each.p for each in holm(chances.tolist())])
    assert adjusted.max() <= 1.0
    order = np.argsort(chances)
    assert (np.diff(adjusted[order]) >= 0.0).all()
    bonferroni = np.minimum(1.0, 40 * chances)
    assert (adjusted <= bonferroni + 1e-12).all()
    assert (adjusted >= stats.false_discovery_control(chances) - 1e-12).all()


def test_no_finding_of_many_is_right_in_19_of_20_families() -> None:
    rng, wrong = np.random.default_rng(5), 0
    for chances in rng.uniform(size=(2000, 12)):
        wrong += any(each.p < 0.05 for each in holm(chances.tolist()))
    assert stats.binomtest(wrong, 2000, 0.05).pvalue > 0.01
