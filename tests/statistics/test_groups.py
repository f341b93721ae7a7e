"""Groups of samples: what enters, what is left out, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.group import Verdict
from labpipe.records.quality import Reason, worded
from labpipe.records.result import Status
from labpipe.statistics.groups import compare_groups
from labpipe.statistics.outliers import with_outliers
from labpipe.statistics.two_groups import judged
from tests.builders.sloped_samples import built, make, said, samples, stiffness


def test_numbers_and_band_of_two_spools() -> None:
    group = built(samples())
    number = group.numbers[0]
    assert (number.name, number.unit, len(number.values)) == ("stiffness", "N/m", 6)
    assert number.mean is not None
    assert number.mean.chosen.mean == pytest.approx(52.28)
    assert not number.left_out
    assert (group.band.n, group.band.over) == (2, "spool means")
    np.testing.assert_allclose(group.band.mean, 52.28 * group.band.displacement)
    assert "not pooled over 6 samples" in said(group)["curve_pooling"]
    assert group.band_scaled is None


def test_order_of_samples_does_not_matter() -> None:
    one, two = built(samples()), built(samples()[::-1])
    assert [each.test for each in one.samples] == [each.test for each in two.samples]
    assert one.numbers == two.numbers


def test_sample_2_comes_before_sample_10() -> None:
    group = built([make("s1", number, 50.0) for number in (10, 2, 1)])
    assert [each.specimen.sample for each in group.samples] == ["1", "2", "10"]


def test_what_is_left_out_says_why() -> None:
    broken, other, without, odd = (make("s1", number, 50.0 + number) for number in range(4))
    failed = stiffness(
        None, status=Status.FAILED, reasons=(Reason("too_few_samples", "3 samples"),)
    )
    members = [
        make("s0", 1, 50.0),
        replace(broken, results=(failed,)),
        replace(other, results=(stiffness(1.0, "N/mm"),)),
        replace(without, results=()),
        replace(odd, results=(stiffness(float("inf")),)),
    ]
    number = built(members).numbers[0]
    assert list(number.values) == ["s0-1"]
    assert {test: worded(why) for test, why in number.left_out.items()} == {
        "s1-0": "too_few_samples: 3 samples",
        "s1-1": "other_unit: in N/mm, where the first sample is in N/m",
        "s1-2": "no_result: the test has no stiffness",
        "s1-3": "not_finite: the value is inf",
    }


def test_no_sample_has_the_number() -> None:
    failed = stiffness(
        None, status=Status.FAILED, reasons=(Reason("not_reached", "it ends at 1 mm"),)
    )
    number = built([replace(make("s1", 1, 50.0), results=(failed,))]).numbers[0]
    assert number.mean is None
    assert number.left_out == {"s1-1": (Reason("not_reached", "it ends at 1 mm"),)}


def test_outliers_stay_in_the_mean() -> None:
    slopes = (50.0, 50.5, 49.5, 50.2, 49.9, 80.0)
    group = built([make("s1", at, slope) for at, slope in enumerate(slopes)])
    (number, *_) = with_outliers([group])[0].numbers
    (found,) = number.outliers
    assert (found.sample, found.value) == ("s1-5", 80.0)
    assert group.numbers[0].mean is not None
    assert group.numbers[0].mean.chosen.n == 6


def test_groups_are_compared_in_what_both_have() -> None:
    first, second = built(samples()[:3]), built(samples()[3:])
    found = compare_groups(first, second, names=["stiffness", "energy"], margin=0.1)
    assert [each.name for each in found] == ["stiffness"]
    assert found[0].difference.mean == pytest.approx(47.12 - 57.44)
    assert found[0].margin == pytest.approx(5.744)
    assert found[0].verdict is Verdict.NOT_ASKED
    assert judged("one", found)[0].verdict is Verdict.DIFFERENT
    every = compare_groups(first, second)
    assert [each.name for each in every] == ["stiffness", "peak_force.1"]
    assert every[0].margin is None
    assert np.isnan(every[0].p_equivalent)


def test_groups_in_other_units_are_not_compared() -> None:
    other = replace(samples()[0], results=(stiffness(1.0, "N/mm"),))
    assert compare_groups(built(samples()[:3]), built([other]), names=["stiffness"]) == ()
