"""Slack, and curves whose displacement counts from where the specimen is taut."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from labpipe.fits.least_squares import zero_of_line
from labpipe.fits.slack import toe_line
from labpipe.records.arrays import Floats
from labpipe.records.causes import SLACK
from labpipe.records.estimates import Failure
from labpipe.records.quality import Reason
from labpipe.results.curve_replicates import displaced, loading_of
from labpipe.uncertainty.extractors import Decide, Reading, Trace
from labpipe.uncertainty.intervals import Measured, SmoothNumbers, measure
from labpipe.uncertainty.replicates import Input, Replicates


def slack_of(trace: Trace, *, start_share: float, stop_share: float) -> Reading | Failure:
    """Decide on the displacement at which the line through the linear region meets zero force.

    Parameters
    ----------
    trace : one curve
    start_share, stop_share : of the largest force, between which the region lies

    Returns
    -------
    One number, m, or a failure as `labpipe.fits.slack.toe_line` has it.
    """
    stretch = loading_of(trace)
    region = toe_line(
        trace.displacement[stretch],
        trace.force[stretch],
        start_share=start_share,
        stop_share=stop_share,
    )
    if isinstance(region, Failure):
        return region

    def numbers(trace: Trace) -> tuple[Floats]:
        d, f = (values[..., stretch][..., region] for values in (trace.displacement, trace.force))
        return (zero_of_line(d, f),)

    return Reading(numbers, len(trace.force[stretch][region]), is_cut=True)


def counted_from_taut(
    replicates: Replicates, slack: Decide, measured_slack: Measured
) -> Replicates:
    """Count the displacement of all curves from where each is taut.

    Parameters
    ----------
    replicates : of a curve whose slack can be measured
    slack : how it is decided on
    measured_slack : the slack of the measured curve, m

    Returns
    -------
    Every curve without its own slack: what noise does to the slack comes in as one more input,
    drawn with the curve that it belongs to, and what another input does to the slack goes with what
    it does to the curve. So a zero of the displacement that is in both is in no number behind.
    What makes the slack doubtful goes with it.
    """
    alone = measure(replace(replicates, inputs=()), slack)
    if isinstance(alone, Failure):
        message = f"expected a slack that was measured, found {alone.message}"
        raise ValueError(message)
    draws = np.where(np.isnan(alone[0].off), np.nanmean(alone[0].off), alone[0].off)
    error = float(np.std(draws))
    inputs = tuple(
        _with_slack(replicate, replicates.smooth, slack) for replicate in replicates.inputs
    )
    corrected = replace(replicates, inputs=inputs)
    if not error:
        return corrected.displaced(-measured_slack.value)
    moved = partial(displaced, by=-error)
    of_slack = Input(SLACK, moved, draws=draws / error, doubts=doubts_of_slack(measured_slack))
    return corrected.displaced(-measured_slack.value, of_slack)


def doubts_of_slack(measured_slack: Measured) -> tuple[Reason, ...]:
    """Why what counts from a slack is as doubtful as the slack."""
    return tuple(
        Reason(reason.code, f"displacement counts from a slack that is doubtful: {reason.message}")
        for _, reason in measured_slack.doubts
    )


def _with_slack(quantity: Input, smooth: Trace, slack: Decide) -> Input:
    """An input with what it does to the slack."""
    base = slack(smooth)
    if isinstance(base, Failure):
        return quantity
    decided = SmoothNumbers.of(slack, smooth, base)
    less, more = (float(decided.changed(quantity, x)[0]) for x in (-1.0, 1.0))
    return replace(quantity, moved=partial(_moved, quantity=quantity, less=-less, more=more))


def _moved(trace: Trace, x: float, *, quantity: Input, less: float, more: float) -> Trace:
    return displaced(quantity.moved(trace, x), x, by=-(more if x > 0.0 else less))
