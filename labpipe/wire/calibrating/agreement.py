"""How well a model agrees with measured forces: errors, and whether residuals are just noise."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from labpipe.records.agreement import CurveAgreement, CurveErrors
from labpipe.records.arrays import Floats
from labpipe.wire.calibrating.data import MeasuredCurve


def curve_errors(
    force: Floats, model: Floats, lower: Floats | None = None, upper: Floats | None = None
) -> CurveErrors:
    """SSE, RMSE and RMSE over the largest force; points without a number are left out.

    Parameters
    ----------
    force, model : shape (n,), N
    lower, upper : shape (n,), N, of a band

    Raises
    ------
    ValueError
        If no point is left.

    Notes
    -----
    Eqs. (3.28) and (3.29) of the source. SSE grows with the number of points.
    """
    known = np.isfinite(force) & np.isfinite(model)
    if not known.any():
        message = "no point has both a measured and a modelled force"
        raise ValueError(message)
    left = force[known] - model[known]
    sse = float(left @ left)
    rmse = float(np.sqrt(sse / len(left)))
    inside = np.nan
    if lower is not None and upper is not None:
        inside = float(np.mean((lower[known] <= force[known]) & (force[known] <= upper[known])))
    return CurveErrors(len(left), sse, rmse, rmse / float(np.max(np.abs(force[known]))), inside)


def agreement(curve: MeasuredCurve, model: Floats, factor: float) -> CurveAgreement:
    """One curve against the model.

    Parameters
    ----------
    curve : measured
    model : shape (n,), N, without the sample's factor
    factor : of the sample, load cell included
    """
    errors = curve_errors(curve.force, model)
    left = (curve.force - factor * model) / np.asarray(curve.noise)
    return CurveAgreement(
        test=curve.test,
        sample=curve.sample,
        length=curve.length,
        deflection=curve.deflection,
        force=curve.force,
        model=model,
        sample_factor=factor,
        sse=errors.sse,
        rmse=errors.rmse,
        rmse_share=errors.rmse_share,
        lag_one=lag_one(left),
        runs_p=runs_p(left),
    )


def lag_one(residuals: Floats) -> float:
    """Correlation of neighbours about zero; 0 for residuals that are all zero."""
    power = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / power if power > 0.0 else 0.0


def runs_p(residuals: Floats) -> float:
    """Two-sided p-value of Wald and Wolfowitz's runs test of the residuals' signs.

    Notes
    -----
    Normal approximation (Ann. Math. Stat. 11 (1940) 147). 0 where all have one sign.
    """
    above = residuals > 0.0
    n_above, n_below = int(above.sum()), int((~above).sum())
    n = n_above + n_below
    if n_above == 0 or n_below == 0:
        return 0.0
    runs = 1 + int(np.sum(above[1:] != above[:-1]))
    mean = 1.0 + 2.0 * n_above * n_below / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1.0)
    if variance <= 0.0:
        return 1.0
    return float(2.0 * ndtr(-abs(runs - mean) / np.sqrt(variance)))
