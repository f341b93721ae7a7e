"""The mean curve of a group: what is left out of it, and its share of the peak force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.group import SampleCurve
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.statistics.mean_curves import _gaps
from tests.builders.sloped_samples import built, make, said, samples, stiffness


def test_no_overlap() -> None:
    far = make("s1", 2, 50.0)
    path = far.loading[0].displacement + 0.05
    curve = SampleCurve(path, far.loading[0].force, far.loading[0].force)
    group = built([samples()[0], replace(far, loading=(curve,))])
    assert str(group.band.reason) == (
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
    assert len(group.band_scaled.displacement) == 201
    np.testing.assert_allclose(group.band_scaled.upper, group.band_scaled.lower, atol=1e-12)


def test_scaled_band_without_a_peak_force() -> None:
    members = samples()[:3]
    failed = Result(
        "peak_force.1", None, "N", status=Status.FAILED, reasons=(Reason("no_curve", "none"),)
    )
    members[1] = replace(members[1], results=(stiffness(50.0), failed))
    members[2] = replace(members[2], results=(stiffness(50.0),))
    group = built(members, scaled=True)
    assert group.band_scaled is not None
    # The third has no such result, so the largest force of its curve stands in.
    assert group.band_scaled.n == 2
    assert said(group)["no_peak_force"] == (
        "not in the mean of force / peak force, without a peak force: s1-2"
    )


def test_three_curves_have_intervals_at_three_displacements() -> None:
    """A quarter, half, all of 20 mm; over three t is 4.303."""
    group = built(samples()[:3])
    band = group.band
    assert band.n == 3
    assert not band.has_area
    assert (1e3 * band.displacement[band.marks]).tolist() == pytest.approx([5.0, 10.0, 20.0])
    force = np.array([each.loading[0].force for each in group.samples])
    at = [int(np.argmin(abs(group.samples[0].loading[0].displacement - x))) for x in (0.01,)]
    half = 4.302653 * force[:, at].std(axis=0, ddof=1) / np.sqrt(3)
    middle = band.marks[1]
    assert 0.5 * (band.upper - band.lower)[middle] == pytest.approx(float(half[0]), rel=0.05)
    assert np.isnan(band.lower_all).all()
    assert str(band.reason) == (
        "few_curves: 3 samples are too few for a band, which needs 6; the mean has its interval at"
        " three displacements"
    )


def test_two_curves_have_a_mean_and_a_sentence() -> None:
    band = built(samples()[:2]).band
    assert len(band.mean) == len(band.displacement)
    assert np.isnan(band.lower).all()
    assert not len(band.marks)
    assert str(band.reason).startswith("two_curves: two samples are too few for any band;")


def test_six_curves_have_their_bands() -> None:
    band = built([make("s1", at, 50.0 + at) for at in range(6)]).band
    assert band.reason is None
    assert band.has_area
    assert not len(band.marks)
    assert np.isfinite(band.upper_all).all()


def test_one_missing_point_of_a_grid_is_a_gap() -> None:
    grid = 1e-3 * np.array([0.0, 1.0, 2.0, 4.0, 5.0, 8.0])
    assert _gaps(grid) == ["2 mm to 4 mm", "5 mm to 8 mm"]
    assert _gaps(grid[:3]) == _gaps(grid[:1]) == []
