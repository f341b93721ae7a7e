"""Two clocks whose offset somebody has stated by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.protocol.schema import AlignStated
from labpipe.records.arrays import median
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.quality import Severity
from labpipe.signal.clock_alignment import rough_peaks
from labpipe.signal.turning_points import Stroke, goes_down

_RATE = 1e-4
"""How far two recorders may differ in rate that nobody has compared."""
_SMOOTH, _SHARE = 0.5, 0.3
"""As for `rough_peaks`: s, and share of the range."""
_FAR, _SURELY = 1.0, 3.0
"""s by which a peak of the force may be off its turn by a rough look at it; and standard errors."""


def take_stated_clocks(
    bench: Bench, align: AlignStated, motion: Signal, strokes: tuple[Stroke, ...]
) -> ClockFit:
    """Take an offset between the clocks of force and motion as it is stated.

    Parameters
    ----------
    bench : gets a note, and a doubt where the force peaks elsewhere
    align : offset, drift, uncertainty and reason of the protocol
    motion, strokes : on the clock of the motion

    Returns
    -------
    The fit, with the statement in place of an event.

    Notes
    -----
    Without a stated uncertainty the offset is taken as known to one sample of the slower recorder.
    The drift is known to 100 ppm / sqrt(3), a rectangle (GUM, JCGM 100:2008, sec. 4.3.7).
    """
    force = bench.raw[align.channel or bench.force]
    known_to = align.uncertainty
    if known_to is None:
        known_to = max(median(np.diff(motion.time)), median(np.diff(force.time)))
    fit = ClockFit(
        offset=align.offset,
        drift=align.drift,
        offset_interval=Interval.normal_95(align.offset, known_to),
        drift_interval=Interval.normal_95(align.drift, _RATE / sqrt(3.0)),
        residual=0.0,
        event_times_motion=np.zeros(1),
        event_times_force=np.full(1, align.offset),
        event_errors=np.full(1, known_to),
        method=f"stated: {align.because}",
    )
    message = (
        f"the offset of the clocks is stated, not measured: {align.offset:.6g} s, standard "
        f"uncertainty {known_to:.3g} s"
        f"{'' if align.uncertainty is not None else ' (one sample, as none is stated)'}, drift "
        f"{1e6 * align.drift:.4g} ppm, because: {align.because}"
    )
    bench.note("clocks_stated", Severity.INFO, "align", message)
    _check(bench, align, fit, motion, strokes)
    return fit


def _check(
    bench: Bench,
    align: AlignStated,
    fit: ClockFit,
    motion: Signal,
    strokes: tuple[Stroke, ...],
) -> None:
    """Doubt a statement by which the force peaks long before or after the motion turns."""
    force = bench.raw[align.channel or bench.force]
    if not strokes or not np.nanmax(force.values) > np.nanmin(force.values):
        return
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    peaks = rough_peaks(force.time, force.values, smoothing=_SMOOTH, share=_SHARE)
    if not len(peaks):
        return
    ends = [motion.time[[before.stop, after.start]] for before, after in pairwise(strokes)]
    tops = [fit.to_force_time(end) for end in ends[::2]]  # of the strokes that load
    off = [
        max(0.0, float(np.abs(peaks - top.mean()).min()) - 0.5 * float(np.ptp(top)))
        for top in tops
        if force.time[0] <= top[0] and top[1] <= force.time[-1]
    ]
    known_to = float(fit.event_errors[0])
    if not off or median(np.array(off)) <= _FAR + _SURELY * known_to:
        return
    message = (
        f"by the stated offset the force peaks {median(np.array(off)):.2f} s away from where the "
        "motion turns: look at its sign (time of the force less time of the motion) and at the "
        "files"
    )
    for quantity in ("clock", "force"):
        bench.doubt(quantity, "clocks_stated_wrong", message, where="align")
