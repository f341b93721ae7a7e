"""What was done to a curve since it was recorded, as far as the samples tell."""

from __future__ import annotations

from enum import Enum

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.result import TestResult

_EXACT = 1e-9
"""Share of a signal's range that is rounding."""


class Treatment(Enum):
    """How the curve differs from the samples; the value is what a figure calls it."""

    NONE = "not filtered"
    CORRECTED = "corrected, not filtered"
    FILTERED = "filtered"


def treatment_of_force(result: TestResult) -> Treatment:
    """Tell what was done to the force of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series ``force``

    Returns
    -------
    Filtered too where there is nothing to compare with: then nothing says that it was not.

    Notes
    -----
    A correction (a slip added back, a stray sample bridged) moves whole stretches or a few samples:
    from sample to sample the median change of what was added is zero. A filter changes every
    sample by an amount of its own.
    """
    return _of(result, "force", result.curve.force if result.curve is not None else None)


def treatment(result: TestResult) -> Treatment:
    """Tell what was done to force and displacement of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series

    Returns
    -------
    The greater of both. What frame and grips give is taken off the displacement sample by sample;
    where that was done (note ``compliance_removed``), the displacement counts as corrected.
    """
    force = treatment_of_force(result)
    curve = result.curve
    travel = _of(result, "displacement", curve.displacement if curve is not None else None)
    if any(note.code == "compliance_removed" for note in result.quality):
        travel = Treatment.CORRECTED
    return max(force, travel, key=list(Treatment).index)


def _of(result: TestResult, name: str, after: Floats | None) -> Treatment:
    series = result.aligned.series if result.aligned is not None else {}
    if after is None or name not in series or len(series[name].values) != len(after):
        return Treatment.FILTERED
    change = after - series[name].values
    change = change[~np.isnan(change)]
    if not len(change):
        return Treatment.FILTERED
    least = _EXACT * float(np.nanmax(after) - np.nanmin(after))
    if np.abs(change).max() <= least:
        return Treatment.NONE
    steps = np.abs(np.diff(change))
    return Treatment.CORRECTED if np.median(steps) <= least else Treatment.FILTERED
