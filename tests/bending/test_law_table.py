from __future__ import annotations

import numpy as np
import pytest

from labpipe.bending.fitted_law import LawFit, law_knots
from labpipe.bending.law_table import law_points, tabulate
from labpipe.records.arrays import Floats
from labpipe.records.curve import MeasuredLaw

BASIS = law_knots(0.06, 5)
LAW: Floats = np.array([180.0, 200.0, 240.0, 300.0, 340.0])
COVARIANCE: Floats = np.diag([9.0, 4.0, 4.0, 4.0, 16.0])


def fit(compliance: Floats = LAW) -> LawFit:
    return LawFit(
        basis=BASIS,
        compliance=compliance,
        covariance=COVARIANCE,
        sensitivity=np.zeros((5, 1, 2)),
        residual=9e-6,
        n=2,
        variance=1e-10,
    )


def table(*, scale_error: float = 0.0, noise: float = 0.05) -> MeasuredLaw:
    return tabulate(
        fit(), [], scale_error=scale_error, noise=1e-5, curvature_noise=noise, n_frames=100
    )


def test_points_lie_on_the_law() -> None:
    moment = np.array([0.001, 0.02, 0.05])
    curvature = BASIS.values(moment) @ LAW
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert at.moment == pytest.approx(moment, rel=1e-4)
    assert at.secant == pytest.approx(moment / curvature, rel=1e-4)
    assert at.tangent == pytest.approx(1.0 / (BASIS.slopes(moment) @ LAW), rel=1e-3)


@pytest.mark.slow
def test_errors_are_those_of_other_laws() -> None:
    curvature, rng = np.array([1.0, 4.0, 9.0]), np.random.default_rng(3)
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.01)
    drawn = rng.multivariate_normal(LAW, COVARIANCE, 3000)
    scales = 1.0 + 0.01 * rng.standard_normal(3000)
    others = [law_points(BASIS.knots, law, COVARIANCE, curvature, scale_error=0.0) for law in drawn]
    for name in ("moment", "secant", "tangent"):
        values = scales[:, None] * np.array([getattr(other, name) for other in others])
        assert values.std(axis=0) == pytest.approx(getattr(at, f"{name}_error"), rel=0.08)


def test_nothing_is_extrapolated() -> None:
    last = float(BASIS.values(BASIS.knots[-1:])[0] @ LAW)
    curvature = np.array([1e3, -1.0, 1.01 * last])
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert np.isnan([at.moment, at.secant, at.tangent]).all()
    at = law_points(BASIS.knots, LAW, COVARIANCE, np.array([last]), scale_error=0.0)
    assert at.moment == pytest.approx(BASIS.knots[-1:])


def test_a_flat_law_has_no_stiffness() -> None:
    flat = np.array([0.0, 0.0, 0.0, 0.0, 340.0])
    at = law_points(BASIS.knots, flat, COVARIANCE, np.array([0.0]), scale_error=0.0)
    assert np.isinf(at.tangent).all()
    assert not np.isfinite(at.moment_error).any()


def test_below_the_noise_there_is_no_stiffness() -> None:
    law = table(noise=0.5)
    assert law.floor == pytest.approx(0.98, abs=1e-3)
    unknown = law.curvature <= law.floor
    assert law.is_known.tolist() == (~unknown).tolist()
    assert np.isnan(law.secant[unknown]).all()
    assert np.isfinite(law.secant[~unknown]).all()
    assert np.isfinite(law.moment).all()
    last = law.curvature[unknown].max()
    assert str(law.reason) == (
        f"below_noise: {int(unknown.sum()) - 1} of 40 curvatures, up to {last:.3g} 1/m, are not "
        "above their noise (1.96 standard errors of the cloud are 0.98 1/m)"
    )


def test_all_but_zero_can_be_known() -> None:
    law = table(noise=1e-6)
    assert law.is_known.tolist() == [False, *[True] * 40]
    assert law.reason is None


def test_intervals_hold_the_scale_and_what_frames_share() -> None:
    plain, scaled = table(), table(scale_error=0.05)
    assert (scaled.secant_upper - scaled.secant)[-1] == pytest.approx(
        np.hypot((plain.secant_upper - plain.secant)[-1], 1.96 * 0.05 * plain.secant[-1]), rel=1e-3
    )
    shared = tabulate(
        fit(), [np.full(5, 10.0)], scale_error=0.0, noise=1e-5, curvature_noise=0.05, n_frames=1
    )
    assert shared.compliance_covariance == pytest.approx(COVARIANCE + 100.0)
