"""Machine compliance: from a test of a stiff bar, and taken off a displacement."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.lines import fit_line
from labpipe.records.arrays import Floats


def fit_compliance(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Estimate | Failure:
    """Compliance of frame, load cell and grips: displacement per force with a stiff bar gripped.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of the stiff-bar test; NaN in either
        are left out
    start, stop : N, force window; below it grips and joints settle

    Returns
    -------
    m/N, or a failure: ``too_few_samples``, ``no_travel``, ``not_reached`` when the force does not
    reach `stop`, ``not_positive`` when the displacement does not grow with the force.

    Notes
    -----
    The slope of displacement against force of ASTM D3379 (sec. on system compliance) with one bar
    whose own compliance does not matter. The window is cut where the force first rises through its
    ends. Interval as in `labpipe.fitting.lines.fit_line`.
    """
    known = ~np.isnan(displacement) & ~np.isnan(force)
    d, f = displacement[known], force[known]
    if len(f) == 0 or float(f.max()) < stop:
        most = float(f.max()) if len(f) else 0.0
        return Failure(
            "not_reached", f"the force reaches {most:.4g} N, the window ends at {stop:.4g} N"
        )
    last = int(np.argmax(f >= stop))
    below = np.flatnonzero(f[:last] < start)
    first = int(below[-1]) + 1 if len(below) else 0
    line = fit_line(f[first : last + 1], d[first : last + 1])
    if isinstance(line, Failure):
        return line
    if line.slope.value <= 0.0:
        return Failure("not_positive", f"slope {line.slope.value:.4g} m/N")
    return line.slope


def correct_displacement(displacement: Floats, force: Floats, *, compliance: float) -> Floats:
    """Displacement of the specimen alone: d - C F.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; NaN where either is NaN
    compliance : m/N, of frame and grips

    Returns
    -------
    shape (n,), m
    """
    corrected: Floats = displacement - compliance * force
    return corrected
