"""Groups of samples: what enters, what is left out, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.group import Group, Sample, SampleCurve
from labpipe.records.result import Result, Specimen, Status
from labpipe.statistics.groups import build_group, compare_groups

SPOOLS = {"s1": (58.33, 57.71, 56.28), "s2": (47.09, 48.19, 46.08)}


def stiffness(value: float | None, unit: str = "N/m", **said: object) -> Result:
    return Result("stiffness", value, unit, **said)  # type: ignore[arg-type]


def make(spool: str, number: int, slope: float, *, stop: float = 0.02) -> Sample:
    path = np.linspace(0.0, stop, 80)
    curve = SampleCurve(path, slope * path, slope * path)
    peak = Result("peak_force.1", slope * stop, "N")
    return Sample(
        test=f"{spool}-{number}",
        specimen=Specimen("tube", spool, str(number), {"length": 0.3}),
        protocol="tensile",
        loading=(curve,),
        unloading=(),
        results=(stiffness(slope), peak),
    )


def samples() -> list[Sample]:
    return [
        make(spool, number, slope)
        for spool, slopes in SPOOLS.items()
        for number, slope in enumerate(slopes, start=1)
    ]


def built(members: list[Sample], *, scaled: bool = False) -> Group:
    return build_group("tube", "tensile", members, scaled=scaled)


def said(group: Group) -> dict[str, str]:
    return {note.code: note.message for note in group.notes}


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
    failed = stiffness(None, status=Status.FAILED, reason="too_few_samples: 3 samples")
    members = [
        make("s0", 1, 50.0),
        replace(broken, results=(failed,)),
        replace(other, results=(stiffness(1.0, "N/mm"),)),
        replace(without, results=()),
        replace(odd, results=(stiffness(float("inf")),)),
    ]
    number = built(members).numbers[0]
    assert list(number.values) == ["s0-1"]
    assert number.left_out == {
        "s1-0": "too_few_samples: 3 samples",
        "s1-1": "other_unit: in N/mm, where the first sample is in N/m",
        "s1-2": "no_result: the test has no stiffness",
        "s1-3": "not_finite: the value is inf",
    }


def test_no_sample_has_the_number() -> None:
    failed = stiffness(None, status=Status.FAILED, reason="not_reached: it ends at 1 mm")
    number = built([replace(make("s1", 1, 50.0), results=(failed,))]).numbers[0]
    assert number.mean is None
    assert number.left_out == {"s1-1": "not_reached: it ends at 1 mm"}


def test_doubtful_values_enter_and_are_listed() -> None:
    doubted = stiffness(60.0, status=Status.DOUBTFUL, reason="slip: 0.5 N at 3 mm")
    members = samples()
    members[0] = replace(members[0], results=(doubted,))
    group = built(members)
    assert group.numbers[0].values["s1-1"].status is Status.DOUBTFUL
    assert said(group)["doubtful_in_mean"] == (
        "doubtful values are in the means of: stiffness (s1-1)"
    )


def test_outliers_stay_in_the_mean() -> None:
    slopes = (50.0, 50.5, 49.5, 50.2, 49.9, 80.0)
    group = built([make("s1", at, slope) for at, slope in enumerate(slopes)])
    (found,) = group.numbers[0].outliers
    assert (found.sample, found.value) == ("s1-5", 80.0)
    assert group.numbers[0].mean is not None
    assert group.numbers[0].mean.chosen.n == 6


def test_too_few_samples_for_outliers() -> None:
    group = built(samples()[2:4])
    assert said(group)["outliers_not_tested"] == (
        "too few samples for a test of outliers: stiffness; peak_force.1"
    )


def test_empty_group() -> None:
    group = built([], scaled=True)
    assert said(group) == {"empty_group": "there is no sample in this group"}
    assert group.band.reason.startswith("empty_group")
    assert group.band_scaled is not None
    assert group.band_scaled.reason.startswith("empty_group")
    assert group.numbers == ()


def test_one_sample() -> None:
    group = built(samples()[:1])
    assert said(group)["one_sample"] == "one sample (s1-1): no interval and no band"
    assert group.band.reason.startswith("one_curve")
    assert group.numbers[0].mean is not None
    assert group.numbers[0].mean.chosen.interval is None


def test_no_overlap() -> None:
    far = make("s1", 2, 50.0)
    path = far.loading[0].displacement + 0.05
    curve = SampleCurve(path, far.loading[0].force, far.loading[0].force)
    group = built([samples()[0], replace(far, loading=(curve,))])
    assert group.band.reason == (
        "no_overlap: no displacement that every curve has: s1-2 begins at 50 mm, s1-1 ends at 20 mm"
    )


def test_samples_without_a_curve_are_named() -> None:
    members = samples()[:3]
    group = built([*members[:2], replace(members[2], loading=())])
    assert group.band.n == 2
    assert said(group)["no_curve"] == "not in the mean curve, without a loading branch: s1-3"


def test_a_gap_in_one_sample_is_said() -> None:
    members = samples()[:3]
    path, force = members[0].loading[0].displacement, members[0].loading[0].force.copy()
    force[40:44] = np.nan
    group = built([replace(members[0], loading=(SampleCurve(path, force, force),)), *members[1:]])
    assert said(group)["gap_in_curves"].startswith(
        "the mean curve leaves out where a sample has a gap: 9.8"
    )


def test_scaled_band_ends_at_one() -> None:
    group = built(samples()[:3], scaled=True)
    assert group.band_scaled is not None
    assert group.band_scaled.mean[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(group.band_scaled.upper, group.band_scaled.lower, atol=1e-12)


def test_scaled_band_without_a_peak_force() -> None:
    members = samples()[:3]
    failed = Result("peak_force.1", None, "N", status=Status.FAILED, reason="no_curve: none")
    members[1] = replace(members[1], results=(stiffness(50.0), failed))
    members[2] = replace(members[2], results=(stiffness(50.0),))
    group = built(members, scaled=True)
    assert group.band_scaled is not None
    # The third has no such result, so the largest force of its curve stands in.
    assert group.band_scaled.n == 2
    assert said(group)["no_peak_force"] == (
        "not in the mean of force / peak force, without a peak force: s1-2"
    )


def test_tests_of_one_name_are_both_kept() -> None:
    one, two = samples()[:2]
    group = built([replace(one, source="a/result.h5"), replace(two, test=one.test, source="b")])
    assert list(group.numbers[0].values) == ["s1-1 (a/result.h5)", "s1-1 (b)"]


def test_a_sample_tested_twice_is_said() -> None:
    one = samples()[0]
    group = built([one, replace(one, test="again")])
    assert said(group)["sample_repeated"] == (
        "sample 1 of spool s1 was tested 2 times; the means count it as 2 samples"
    )


def test_samples_of_other_size_are_said() -> None:
    one, two = samples()[:2]
    longer = replace(two, specimen=replace(two.specimen, dimensions={"length": 0.4}))
    assert said(built([one, longer]))["dimensions_differ"].startswith(
        "the samples differ in length: 300 mm to 400 mm"
    )


def test_groups_are_compared_in_what_both_have() -> None:
    first, second = built(samples()[:3]), built(samples()[3:])
    found = compare_groups(first, second, names=["stiffness", "energy"], margin=0.1)
    assert [each.name for each in found] == ["stiffness"]
    assert found[0].difference.mean == pytest.approx(47.12 - 57.44)
    assert found[0].margin == pytest.approx(5.744)
    assert found[0].verdict.startswith("different: ")
    every = compare_groups(first, second)
    assert [each.name for each in every] == ["stiffness", "peak_force.1"]
    assert every[0].margin is None
    assert np.isnan(every[0].p_equivalent)


def test_groups_in_other_units_are_not_compared() -> None:
    other = replace(samples()[0], results=(stiffness(1.0, "N/mm"),))
    assert compare_groups(built(samples()[:3]), built([other]), names=["stiffness"]) == ()
