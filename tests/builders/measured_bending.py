"""A small measured bending, made up: a cloud of two branches and a law that softens."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Bending, BendingCloud, MeasuredLaw
from labpipe.records.quality import Reason


def some_bending() -> Bending:
    """Six means at three places, and a law of five points of which the first two are unknown."""
    return Bending(some_cloud(), some_law())


def some_cloud() -> BendingCloud:
    load = np.array([0.2, 0.5, 0.8, 0.8, 0.5, 0.2])
    share = np.array([1.0, 0.5, 0.0])
    moment = 0.05 * load[:, None] * share
    return BendingCloud(
        time=np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        branch=np.array([0, 0, 0, 1, 1, 1]),
        cycle=np.array([1, 1, 1, 1, 1, 1]),
        force=load,
        arc_length=np.array([0.0, 0.04, 0.08]),
        curvature=moment / 4e-3,
        curvature_error=np.full((6, 3), 0.05),
        curvature_systematic=np.full((6, 3), 0.02),
        moment=moment,
        moment_error=np.full((6, 3), 1e-4),
        moment_at_rest=-2e-3 * share,
        frames_per_mean=50,
    )


def some_law() -> MeasuredLaw:
    curvature = np.array([0.0, 0.1, 2.0, 5.0, 10.0])
    moment = np.array([0.0, 5e-4, 9e-3, 0.02, 0.035])
    known = np.array([False, False, True, True, True])
    secant: Floats = np.array([np.nan, np.nan, 4.5e-3, 4e-3, 3.5e-3])
    tangent: Floats = np.array([np.nan, np.nan, 4.2e-3, 3.4e-3, 2.8e-3])
    return MeasuredLaw(
        curvature=curvature,
        moment=moment,
        moment_lower=0.99 * moment,
        moment_upper=1.01 * moment,
        secant=secant,
        secant_lower=0.99 * secant,
        secant_upper=1.01 * secant,
        tangent=tangent,
        tangent_lower=0.98 * tangent,
        tangent_upper=1.02 * tangent,
        is_known=known,
        reason=Reason("below_noise", "1 of 4 curvatures, up to 0.1 1/m, are not above their noise"),
        floor=0.12,
        scale_error=0.002,
        residual=9e-6,
        noise=8e-6,
        n_frames=2600,
        knots=np.array([0.0, 0.01, 0.035]),
        compliance=np.array([200.0, 240.0, 330.0]),
        compliance_covariance=np.diag([1.0, 0.5, 0.5]),
    )
