"""The mean curve of a group: what is left out of it, and its share of the peak force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.group import SampleCurve
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
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
