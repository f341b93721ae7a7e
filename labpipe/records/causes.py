"""Name the causes of uncertainty, and those that are common to all tests of a rig.

A common cause does not average out: it affects the mean of a hundred tests as much as one test.
"""

from __future__ import annotations

from typing import Final

from labpipe.records.result import Contribution

NOISE: Final = "noise"
"""Noise of force and displacement together; for tensile results, noise of the stress alone."""
FIT: Final = "fit"
"""Standard error that the fit of a result states."""
NOISE_OF_FORCE: Final = "noise of the force"
NOISE_OF_DISPLACEMENT: Final = "noise of the displacement"
SCALE_OF_FORCE: Final = "scale of the force"
"""Uncertainty of the calibrated gain, or of the scale of a load cell that reads in newtons."""
SCALE_OF_DISPLACEMENT: Final = "scale of the displacement"
ZERO_OF_FORCE: Final = "zero of the force"
DRIFT_OF_ZERO: Final = "drift of the zero"
"""Drift of the zero of the force since it was zeroed."""
ZERO_OF_DISPLACEMENT: Final = "zero of the displacement"
SHAPE: Final = "shape of the wire"
"""Effect of one term more or fewer in the fitted shape of a wire or bundle, divided by sqrt(3)."""
COMPLIANCE: Final = "compliance of the frame"
TURN: Final = "turn of the drive"
"""Uncertainty of the time of reversal, and of the start that is computed from it."""
SPEED: Final = "speed of the drive"
GRIP: Final = "grip offset"
"""Uncertainty of the distance from the pivot of the clamp to the clamped end."""
PULL: Final = "pull offset"
"""Uncertainty of the distance from the last marker to the point where the string pulls."""
CENTRE: Final = "centre offset"
"""Uncertainty of the distance from the axis of the specimen to the centres of its markers."""
MARKER_SIDE: Final = "side of the markers"
"""Change if the markers were on the other side of the specimen, divided by sqrt(3)."""
CLOCK_OFFSET: Final = "clock offset"
CLOCK_DRIFT: Final = "clock drift"
LENGTH: Final = "length"
SPAN: Final = "span"
SECTION: Final = "section"
SLACK: Final = "slack"
"""Uncertainty of the subtracted slack."""
REPAIRED_SLIPS: Final = "slips added back"
RESOLUTION_OF_FORCE: Final = "resolution of the force"
"""Rounding by a converter whose step is coarser than the noise, uniform within half a step."""
RESOLUTION_OF_DISPLACEMENT: Final = "resolution of the displacement"
"""Rounding of a displacement whose step is coarser than the noise, uniform within half a step. If
values are repeated because they are updated at a lower rate, a step is one between updates."""
STEP: Final = "sampling step"
"""Unknown time of an event within a sampling step, such as a break or a reversal."""
PEAK: Final = "flat peak"
"""Uncertainty of the strain at a flat peak, where noise decides which sample is the largest."""
TANGENT: Final = "length of the tangents"
"""Effect of shorter tangents at a corner of the curve."""

_COMMON_CAUSES = frozenset({
    *(SCALE_OF_FORCE, SCALE_OF_DISPLACEMENT, COMPLIANCE, SPEED),
    GRIP,  # the clamp is set once for a series
    SPAN,  # the supports are set once for a series
    TANGENT,  # the corners of all specimens are rounded alike
})  # fmt: skip
_CAUSES = (
    *(NOISE, FIT, NOISE_OF_FORCE, NOISE_OF_DISPLACEMENT, SCALE_OF_FORCE, SCALE_OF_DISPLACEMENT),
    *(ZERO_OF_FORCE, DRIFT_OF_ZERO, ZERO_OF_DISPLACEMENT, SHAPE, COMPLIANCE, TURN, SPEED, GRIP),
    *(PULL, CENTRE, MARKER_SIDE, CLOCK_OFFSET, CLOCK_DRIFT, LENGTH, SPAN, SECTION, SLACK),
    *(REPAIRED_SLIPS, RESOLUTION_OF_FORCE, RESOLUTION_OF_DISPLACEMENT, STEP, PEAK, TANGENT),
)
IS_COMMON: Final = {cause: cause in _COMMON_CAUSES for cause in _CAUSES}
"""Whether a cause is common to all tests of a rig, keyed by cause, in the order of the budgets of
groups."""


def make_contribution(cause: str, change: float) -> Contribution:
    """Make the contribution of a cause to the uncertainty of a result.

    Parameters
    ----------
    cause : a key of `IS_COMMON`
    change : change of the result by one standard uncertainty of the cause, see `Contribution`

    Raises
    ------
    KeyError
        If the cause is unknown.
    """
    return Contribution(cause, change, IS_COMMON[cause])
