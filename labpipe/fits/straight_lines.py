"""The window of a compliance, and areas of sections."""

from __future__ import annotations

import numpy as np

from labpipe.fits.common_path import finite_samples
from labpipe.records.arrays import Floats, Samples, samples_of
from labpipe.records.estimates import Failure

MIN_LINE_SAMPLES = 5


def compliance_window(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Samples | Failure:
    """Find the samples over which the force first rises from one value to another.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of a stiff-bar test; NaN
        are ignored
    start, stop : N, force window; below it grips and joints settle

    Returns
    -------
    The samples, or a failure: ``too_few_samples``, ``no_travel`` if the force is constant,
    ``not_reached`` if it does not reach `stop`.
    """
    finite = finite_samples(displacement, force)
    f = force[finite]
    if len(f) == 0 or float(f.max()) < stop:
        most = float(f.max()) if len(f) else 0.0
        return Failure(
            "not_reached", f"the force reaches {most:.4g} N, the window ends at {stop:.4g} N"
        )
    last = int(np.argmax(f >= stop))
    below = np.flatnonzero(f[:last] < start)
    inside = finite[int(below[-1]) + 1 if len(below) else 0 : last + 1]
    if len(inside) < MIN_LINE_SAMPLES:
        message = f"{len(inside)} samples in the stretch, {MIN_LINE_SAMPLES} are needed"
        return Failure("too_few_samples", message)
    if np.ptp(force[inside]) == 0.0:
        return Failure("no_travel", "the force does not change over the stretch")
    return samples_of(inside)


def correct_displacement(displacement: Floats, force: Floats, *, compliance: float) -> Floats:
    """Return the displacement of the specimen alone: d - C F.

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


def rectangle_area(width: float, thickness: float) -> float:
    """Return the area of a rectangle, m^2: width x thickness, both in m."""
    return width * thickness


def annulus_area(outer_diameter: float, inner_diameter: float) -> float:
    """Return the area of a ring, m^2: pi (OD^2 - ID^2) / 4, diameters in m."""
    return 0.25 * float(np.pi) * (outer_diameter**2 - inner_diameter**2)


def thin_wall_area(outer_diameter: float, wall: float) -> float:
    """Return the area of a tube of stated wall, m^2: pi (OD - t) t, both in m.

    For a corrugated tube, whose diameters include the height of the folds, this differs from
    `annulus_area`: a modulus has to state which one it refers to.
    """
    return float(np.pi) * (outer_diameter - wall) * wall
