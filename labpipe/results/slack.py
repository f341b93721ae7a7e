"""Slack, and curves whose displacement counts from where the specimen is taut."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from labpipe.records.arrays import Floats, Samples, samples_of
from labpipe.records.causes import SLACK
from labpipe.records.declarations import Needs, Output
from labpipe.records.estimates import Failure, fail, or_failure
from labpipe.results.curve_replicates import displaced, loading_of
from labpipe.results.kinds import Computed, Kind
from labpipe.results.least_squares import finite_samples, zero_of_line
from labpipe.results.reduced_test import NO_LOADING, ReducedTest, doubts_of_slack, measured
from labpipe.uncertainty.extractors import Decide, Reading, Trace, on_part
from labpipe.uncertainty.intervals import Measured, SmoothNumbers
from labpipe.uncertainty.replicates import Input, Replicates

_MIN_REGION_SAMPLES = 8


def toe_line(
    displacement: Floats, force: Floats, *, start_share: float, stop_share: float
) -> Samples:
    """Find the samples of the linear region for toe compensation.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch in order of time, force zeroed;
        NaN are ignored
    start_share, stop_share : shares of the largest force between which the region lies

    Returns
    -------
    The samples, or a failure: ``too_few_samples`` (fewer than 8 in the region), ``not_rising`` if
    the force does not rise there, ``not_reached`` if the branch begins above the lower share. The
    slack is the zero of the line through them: `labpipe.results.least_squares.zero_of_line`.

    Notes
    -----
    Toe compensation of ASTM D638, annex A1 (also D882): the tangent to the linear region is
    extrapolated to zero force, the corrected zero of displacement. The force crosses a share
    halfway between the first sample above and the last one below before the peak, so that single
    noisy samples do not determine the region.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.02, 401)
    >>> force = 5000.0 * np.maximum(d - 0.002, 0.0)
    >>> region = toe_line(d, force, start_share=0.1, stop_share=0.3)
    >>> round(1e3 * float(zero_of_line(d[region], force[region])), 9)
    2.0
    """
    finite = finite_samples(displacement, force)
    d, f = displacement[finite], force[finite]
    if len(d) < _MIN_REGION_SAMPLES:
        fail("too_few_samples", f"{len(d)} samples, {_MIN_REGION_SAMPLES} are needed")
    top = int(np.argmax(f))
    first, last = (
        _rise(f[: top + 1], share * float(f[top])) for share in (start_share, stop_share)
    )
    if first == 0:
        message = f"the branch begins at {f[0]:.4g} N, above {start_share:.0%} of {f[top]:.4g} N"
        fail("not_reached", message)
    if last - first < _MIN_REGION_SAMPLES:
        message = (
            f"{max(last - first, 0)} samples in the linear region, {_MIN_REGION_SAMPLES} are needed"
        )
        fail("too_few_samples", message)
    region = slice(first, last)
    if np.isnan(zero_of_line(d[region], f[region])):
        fail("not_rising", "the force does not rise in the linear region")
    return samples_of(finite[region])


def _rise(force: Floats, height: float) -> int:
    """Return the sample at which a rising force crosses a height."""
    above = np.flatnonzero(force >= height)
    below = np.flatnonzero(force < height)
    if len(above) == 0 or len(below) == 0:
        return 0
    return (int(above[0]) + int(below[-1]) + 1) // 2


def slack_of(trace: Trace, *, start_share: float, stop_share: float) -> Reading:
    """Decide on the displacement at which the line through the linear region meets zero force.

    Parameters
    ----------
    trace : one curve
    start_share, stop_share : of the largest force, between which the region lies

    Returns
    -------
    One number, m, or a failure of `toe_line`.
    """
    stretch = loading_of(trace)
    region = toe_line(
        trace.displacement[stretch],
        trace.force[stretch],
        start_share=start_share,
        stop_share=stop_share,
    )
    slack = on_part(zero_of_line, (stretch, region))
    return Reading(slack, len(trace.force[stretch][region]), is_cut=True)


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
    alone = measured(replace(replicates, inputs=()), slack)
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


def _with_slack(quantity: Input, smooth: Trace, slack: Decide) -> Input:
    """An input with what it does to the slack."""
    base = or_failure(slack)(smooth)
    if isinstance(base, Failure):
        return quantity
    decided = SmoothNumbers.of(or_failure(slack), smooth, base)
    less, more = (float(decided.changed(quantity, x)[0]) for x in (-1.0, 1.0))
    return replace(quantity, moved=partial(_moved, quantity=quantity, less=-less, more=more))


def _moved(trace: Trace, x: float, *, quantity: Input, less: float, more: float) -> Trace:
    return displaced(quantity.moved(trace, x), x, by=-(more if x > 0.0 else less))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackResult(Kind):
    """``slack`` (m): displacement before the specimen is taut."""

    result: ClassVar = "slack"
    outputs: ClassVar = (Output("slack", "m", "Slack", ("displacement",), can_be_negative=True),)
    needs: ClassVar = Needs(branches=True, correction="slack")

    method: ClassVar = "toe compensation, ASTM D638 annex A1"

    def measure(self, test: ReducedTest) -> Computed:
        """Return the displacement at which the line of the linear region meets zero force."""
        during = test.while_loading()
        slack = test.slack or test.unavailable(NO_LOADING).failure
        return Computed((self.number(slack, during=during),))


KINDS = (SlackResult,)
