"""Calibration of the wire model by first loadings of cantilevers (PHYSICS 6, source 3.4).

Of one wire, several samples and lengths determine phi = F_rad (mu_s + mu_p), the modulus of the
insulation and the strength of the copper, as far as they do: intervals come from the profile
likelihood with t quantiles, and what the tests do not say is said in words. The objective is that
of `calibrating.search`, the law that of `calibrating.parts`, the loading curve the exact one of
`first_loading`. The source's own procedure is in `calibrating.source_method`.
"""

from __future__ import annotations

from collections.abc import Sequence

from labpipe.records.calibration import Calibration, CalibrationFailure
from labpipe.wire.calibrating.data import MeasuredCurve
from labpipe.wire.calibrating.finding import Settings, Wire, find
from labpipe.wire.calibrating.telling import tell

__all__ = ["MeasuredCurve", "Settings", "Wire", "calibrate"]


def calibrate(
    wire: Wire, curves: Sequence[MeasuredCurve], settings: Settings | None = None
) -> Calibration | CalibrationFailure:
    """Calibrate a wire by tests of several samples and lengths.

    Parameters
    ----------
    wire : as its sheet has it
    curves : first loadings, all of one wire
    settings : which parameters are free, fixed or have a prior, and what is known of the load cell

    Returns
    -------
    The calibration; or a failure ``no_sample_usable``, ``wires_mixed``, ``noise_not_positive``,
    ``deflection_too_large``, ``too_few_points``, ``parameter_without_effect``,
    ``value_out_of_bounds`` or ``model_cannot_follow``.

    Raises
    ------
    ValueError
        If a choice has an unknown name, or a number is out of its range.
    """
    found = find(wire, curves, settings or Settings())
    return found if isinstance(found, CalibrationFailure) else tell(found)
