"""Causes of uncertainty, and which of them all tests of a rig share.

Shared causes do not average out: they affect the mean of a hundred tests as much as one test.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from labpipe.records.result import Contribution

NOISE: Final = "noise"
"""Noise of force and displacement that cannot be separated."""
FIT: Final = "fit"
"""Uncertainty of a fit with its own error: a law, a clock, a slip."""
NOISE_OF_FORCE: Final = "noise of the force"
NOISE_OF_DISPLACEMENT: Final = "noise of the displacement"
SCALE_OF_FORCE: Final = "scale of the force"
"""Gain of the calibration, or scale of a load cell that gives newtons."""
SCALE_OF_DISPLACEMENT: Final = "scale of the displacement"
ZERO_OF_FORCE: Final = "zero of the force"
DRIFT_OF_ZERO: Final = "drift of the zero"
"""How far the zero of the force moved after it was taken."""
ZERO_OF_DISPLACEMENT: Final = "zero of the displacement"
SHAPE: Final = "shape of the wire"
"""Effect of a shape that is fitted with one term more or fewer."""
COMPLIANCE: Final = "compliance of the frame"
TURN: Final = "turn of the drive"
SPEED: Final = "speed of the drive"
GRIP: Final = "grip offset"
PULL: Final = "pull offset"
CENTRE: Final = "centre offset"
MARKER_SIDE: Final = "side of the markers"
CLOCK_OFFSET: Final = "clock offset"
CLOCK_DRIFT: Final = "clock drift"
LENGTH: Final = "length"
SPAN: Final = "span"
SECTION: Final = "section"
SLACK: Final = "slack"
REPAIRED_SLIPS: Final = "slips added back"
RESOLUTION: Final = "resolution of the force"
"""Half a step of a converter with a resolution coarser than the noise."""
STEP: Final = "sampling step"
"""Where between two samples a specimen broke, or a machine turned."""
PEAK: Final = "flat peak"
"""Which of the samples near the largest force is the largest, in noise."""
TANGENT: Final = "length of the tangents"
"""Effect of shorter tangents at a corner of the curve."""

IS_COMMON: Final[Mapping[str, bool]] = {
    NOISE: False,
    FIT: False,
    NOISE_OF_FORCE: False,
    NOISE_OF_DISPLACEMENT: False,
    SCALE_OF_FORCE: True,
    SCALE_OF_DISPLACEMENT: True,
    ZERO_OF_FORCE: False,  # taken in every test
    DRIFT_OF_ZERO: False,
    ZERO_OF_DISPLACEMENT: False,
    SHAPE: False,
    COMPLIANCE: True,
    TURN: False,  # found in the force of each test
    SPEED: True,
    GRIP: True,  # the clamp stays where it was set
    PULL: False,  # markers are attached to every specimen
    CENTRE: False,
    MARKER_SIDE: False,
    CLOCK_OFFSET: False,  # the clocks are started for every test
    CLOCK_DRIFT: False,
    LENGTH: False,  # every specimen is measured by itself
    SPAN: True,  # supports are set once for a series
    SECTION: False,
    SLACK: False,
    REPAIRED_SLIPS: False,
    RESOLUTION: False,
    STEP: False,
    PEAK: False,
    TANGENT: True,  # corners of all specimens are smeared alike
}
"""Whether all tests of a rig share a cause, for every cause of a budget."""


def make_contribution(cause: str, change: float) -> Contribution:
    """Make a row of a budget.

    Parameters
    ----------
    cause : a key of `IS_COMMON`
    change : as for `Contribution`

    Raises
    ------
    KeyError
        If the cause is unknown.
    """
    return Contribution(cause, change, IS_COMMON[cause])
