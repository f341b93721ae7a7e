"""A curve from elsewhere beside another one, at its own deflections, never beyond either."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.comparison import CurveMatch, ThirdCurve
from labpipe.wire.calibrating.agreement import curve_errors

FEWEST = 3
"""Points with which two curves are compared."""


def match(
    curve: ThirdCurve,
    deflection: Floats,
    force: Floats,
    band: tuple[Floats, Floats] | None,
    of: str,
) -> CurveMatch:
    """Hold a third curve against another one.

    Parameters
    ----------
    curve : from elsewhere
    deflection, force : shape (m,), m and N, of the other curve, deflections rising
    band : lower and upper end of its 95 % band, shape (m,), N; None or NaN for no band
    of : what the other curve is, for the words: ``the tests``, ``the model``

    Returns
    -------
    Errors at those points of the third curve that lie within the deflections of the other, which is
    interpolated linearly there; each point weighs the same. None for fewer than 3 points.

    Notes
    -----
    RMSE is Eq. (3.29) of the source; it is divided by the largest force of the other curve at the
    points compared.
    """
    shared = _shared(curve, deflection)
    words = _words(curve, shared, deflection, of)
    left_out = int(np.sum(~shared))
    nothing = np.full(len(shared), np.nan)
    if shared.sum() < FEWEST:
        return CurveMatch(nothing, None, len(shared), words)
    lower, upper = (nothing, nothing) if band is None else (_at(curve, deflection, b) for b in band)
    reference = np.where(shared, _at(curve, deflection, force), np.nan)
    errors = curve_errors(curve.force, reference, lower, upper)
    if not np.isfinite(lower[shared]).all():
        errors = replace(errors, inside=np.nan)
    share = errors.rmse / float(np.nanmax(np.abs(reference)))
    return CurveMatch(reference, replace(errors, rmse_share=share), left_out, words)


def _shared(curve: ThirdCurve, deflection: Floats) -> Flags:
    if not len(deflection):
        return np.zeros(len(curve.deflection), dtype=np.bool_)
    shared: Flags = (deflection[0] <= curve.deflection) & (curve.deflection <= deflection[-1])
    return shared


def _at(curve: ThirdCurve, deflection: Floats, values: Floats) -> Floats:
    found: Floats = np.interp(curve.deflection, deflection, values)
    return found


def _words(curve: ThirdCurve, shared: Flags, deflection: Floats, of: str) -> str:
    """Which points were left out."""
    total, kept = len(shared), int(shared.sum())
    if not len(deflection):
        return f"no point was compared: there is no curve of {of}"
    low, high = 1e3 * deflection[0], 1e3 * deflection[-1]
    span = f"{low:.3g} to {high:.4g} mm, the range of {of}"
    if kept == total:
        return ""
    if kept < FEWEST:
        first, last = 1e3 * curve.deflection[0], 1e3 * curve.deflection[-1]
        return (
            f"{kept} of {total} points, from {first:.4g} to {last:.4g} mm, lie within {span}; "
            f"{FEWEST} at least are needed"
        )
    return f"{total - kept} of {total} points left out, outside of {span}"
