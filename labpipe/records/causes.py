"""Causes of doubt about a number, and which of them all tests of a rig share.

What is shared does not average out: the mean of a hundred tests is as unsure of it as one test.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from labpipe.records.result import Contribution

NOISE: Final = "noise"
"""Where that of the force is not told from that of the displacement."""
NOISE_OF_FORCE: Final = "noise of the force"
NOISE_OF_DISPLACEMENT: Final = "noise of the displacement"
SCALE_OF_FORCE: Final = "scale of the force"
"""Gain of the calibration, or scale of a load cell that gives newtons."""
SCALE_OF_DISPLACEMENT: Final = "scale of the displacement"
ZERO_OF_FORCE: Final = "zero of the force"
ZERO_OF_DISPLACEMENT: Final = "zero of the displacement"
FRAME_COMPLIANCE: Final = "compliance of the frame"
CLOCK_OFFSET: Final = "offset of the clocks"
CLOCK_DRIFT: Final = "drift of the clocks"
GRIP_OFFSET: Final = "grip offset"
PULL_OFFSET: Final = "pull offset"
CENTRE_OFFSET: Final = "centre offset"
MARKER_SIDE: Final = "side of the markers"
SHAPE: Final = "shape of the specimen"
"""What the displacement of another shape, fitted with one term more or fewer, changes."""
LENGTH: Final = "length"
SPAN: Final = "span"
SECTION: Final = "section"
SLACK: Final = "slack"
REPAIRED_SLIPS: Final = "slips added back"

IS_COMMON: Final[Mapping[str, bool]] = {
    NOISE: False,
    NOISE_OF_FORCE: False,
    NOISE_OF_DISPLACEMENT: False,
    SCALE_OF_FORCE: True,
    SCALE_OF_DISPLACEMENT: True,
    ZERO_OF_FORCE: False,  # taken anew in every test
    ZERO_OF_DISPLACEMENT: False,
    FRAME_COMPLIANCE: True,
    CLOCK_OFFSET: False,  # the clocks are started anew for every test
    CLOCK_DRIFT: False,
    GRIP_OFFSET: False,  # markers are put on every specimen anew
    PULL_OFFSET: False,
    CENTRE_OFFSET: False,
    MARKER_SIDE: False,
    SHAPE: False,
    LENGTH: False,  # every specimen is measured by itself
    SPAN: False,
    SECTION: False,
    SLACK: False,
    REPAIRED_SLIPS: False,
}
"""Whether all tests of a rig share a cause; every cause of a budget stands here."""


def contribution(cause: str, change: float) -> Contribution:
    """Make a row of a budget.

    Parameters
    ----------
    cause : one of those that stand here
    change : as `Contribution` has it

    Raises
    ------
    KeyError
        If it is not said of the cause whether tests of a rig share it.
    """
    return Contribution(cause, change, IS_COMMON[cause])
