"""A measured moment-curvature law as a table: stiffnesses with intervals, and where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.processing.law_basis import LawBasis
from labpipe.processing.measured_law import LawFit
from labpipe.records.arrays import Flags, Floats
from labpipe.records.bending import MeasuredLaw
from labpipe.records.quality import Reason

_NORMAL_95 = 1.959963984540054
_ROWS = 41
_FINE = 4000


@dataclass(frozen=True, slots=True, eq=False)
class LawPoints:
    """A law at some curvatures; arrays of shape (n,).

    Parameters
    ----------
    moment, secant, tangent : N m, N m^2, N m^2; NaN beyond the largest curvature measured
    moment_error, secant_error, tangent_error : standard errors
    """

    moment: Floats
    secant: Floats
    tangent: Floats
    moment_error: Floats
    secant_error: Floats
    tangent_error: Floats


def law_points(
    knots: Floats,
    compliance: Floats,
    covariance: Floats,
    curvature: Floats,
    *,
    scale_error: float,
) -> LawPoints:
    """Look up a law at curvatures.

    Parameters
    ----------
    knots, compliance, covariance : of a `MeasuredLaw`
    curvature : shape (n,), 1/m, none negative
    scale_error : standard uncertainty of the scale of the force, as a share

    Returns
    -------
    Moments and stiffnesses, never extrapolated. Where the law is flat (no compliance) errors are
    infinite.

    Notes
    -----
    At a given curvature kappa = k(M) an error dk of the law moves the moment by -dk / k'(M); the
    scale of the force stretches all moments alike.
    """
    basis = LawBasis(knots)
    fine = np.linspace(0.0, knots[-1], _FINE)
    reached = basis.values(fine) @ compliance
    inside = (curvature >= 0.0) & (curvature <= reached[-1] * (1.0 + 1e-12))
    moment = np.where(inside, np.interp(curvature, reached, fine), np.nan)
    at = np.nan_to_num(moment)
    slopes = basis.slopes(at)
    with np.errstate(divide="ignore", invalid="ignore"):
        softness = slopes @ compliance
        by_law = -basis.values(at) / softness[:, None]
        bend = _slope_of_slope(knots, compliance, at)
        by_slope = -(slopes + bend[:, None] * by_law) / softness[:, None] ** 2
        secant, tangent = moment / curvature, 1.0 / softness
        moment_error = _error(by_law, covariance, scale_error * moment)
        return LawPoints(
            moment=moment,
            secant=secant,
            tangent=np.where(inside, tangent, np.nan),
            moment_error=moment_error,
            secant_error=moment_error / curvature,
            tangent_error=_error(by_slope, covariance, scale_error * tangent),
        )


def _slope_of_slope(knots: Floats, compliance: Floats, moment: Floats) -> Floats:
    """Second derivative of curvature by moment, piecewise constant."""
    place = np.clip(np.searchsorted(knots, moment, side="right") - 1, 0, len(knots) - 2)
    return np.asarray((np.diff(compliance) / np.diff(knots))[place], dtype=np.float64)


def _error(gradient: Floats, covariance: Floats, scale: Floats) -> Floats:
    squares = np.einsum("nk,kj,nj->n", gradient, covariance, gradient)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) + scale**2), dtype=np.float64)


def tabulate(
    fit: LawFit,
    common: Sequence[Floats],
    *,
    scale_error: float,
    noise: float,
    curvature_noise: float,
    n_frames: int,
) -> MeasuredLaw:
    """Make the table of a law.

    Parameters
    ----------
    fit : the law with its scatter
    common : one standard error each of what all frames have in common, as changes of the
        compliances, shape (knots,)
    scale_error : standard uncertainty of the scale of the force, as a share
    noise : m, of a marker coordinate, as a mean over as many frames as the law was found from
    curvature_noise : 1/m, standard error of the cloud's curvatures
    n_frames : that went in

    Returns
    -------
    The law.

    Notes
    -----
    A curvature is known where it is above 1.96 times the noise of the cloud's curvatures, and where
    the law's own interval does not hold a moment of zero.
    """
    covariance = fit.covariance + sum(np.outer(change, change) for change in common)
    largest = float(fit.basis.values(fit.basis.knots[-1:])[0] @ fit.compliance)
    curvature = largest * (np.arange(_ROWS) / (_ROWS - 1)) ** 2
    at = law_points(fit.basis.knots, fit.compliance, covariance, curvature, scale_error=scale_error)
    floor = _NORMAL_95 * curvature_noise
    is_known = np.asarray(
        (curvature > floor) & (_NORMAL_95 * at.moment_error < at.moment), dtype=np.bool_
    )
    return MeasuredLaw(
        curvature=curvature,
        **_with_ends("moment", at.moment, at.moment_error, np.isfinite(at.moment_error)),
        **_with_ends("secant", at.secant, at.secant_error, is_known),
        **_with_ends("tangent", at.tangent, at.tangent_error, is_known),
        is_known=is_known,
        reason=_why_not(curvature, is_known, floor),
        floor=floor,
        scale_error=scale_error,
        residual=fit.residual,
        noise=noise,
        n_frames=n_frames,
        knots=fit.basis.knots,
        compliance=fit.compliance,
        compliance_covariance=covariance,
    )


def _with_ends(name: str, value: Floats, error: Floats, shown: Flags) -> dict[str, Floats]:
    """A column with the ends of its interval; the moment itself stays where its ends do not."""
    half = _NORMAL_95 * np.where(shown, error, np.nan)
    middle = value if name == "moment" else np.where(shown, value, np.nan)
    return {name: middle, f"{name}_lower": middle - half, f"{name}_upper": middle + half}


def _why_not(curvature: Floats, is_known: Flags, floor: float) -> Reason | None:
    unknown = int((~is_known[1:]).sum())
    if not unknown:
        return None
    last = float(curvature[1:][~is_known[1:]].max())
    return Reason(
        "below_noise",
        f"{unknown} of {len(curvature) - 1} curvatures, up to {last:.3g} 1/m, are not "
        f"above their noise (1.96 standard errors of the cloud are {floor:.3g} 1/m)",
    )
