"""Failure of a specimen: the permanent loss of force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from labpipe.fits.common_path import finite_samples
from labpipe.records.arrays import Flags, Floats
from labpipe.records.estimates import Failure


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The last sample before the final loss of force.

    Parameters
    ----------
    sample : its number; the specimen broke between it and the next one
    lost_before : largest share of the peak that was suddenly and permanently lost earlier, by a
        specimen that failed in steps; else 0
    slow_below : for a slow loss, share of the peak that the force finally falls below; None for a
        sudden loss
    """

    sample: int
    lost_before: float = 0.0
    slow_below: float | None = None


@dataclass(frozen=True, slots=True)
class LossOfForce:
    """Criteria of a break.

    Parameters
    ----------
    force_below : share of the largest force below which the specimen has failed
    loss : share of the largest force that is lost suddenly
    within : s, longest duration of that loss, or one sampling step if that is longer
    """

    force_below: float
    loss: float
    within: float


def final_loss(
    time: Floats, force: Floats, rule: LossOfForce, goes_back: Flags | None = None
) -> int | Failure:
    """Find the sample at which the final loss of force begins.

    Parameters
    ----------
    time, force : shape (n,), s (or numbers of rows), N; unfiltered; NaN are ignored
    rule : criteria of a loss
    goes_back : shape (n,), where the displacement goes back, so that a falling force is not a loss

    Returns
    -------
    Number of the sample, or a failure: ``no_break`` if the force is not lost, is lost slowly, or
    while the displacement goes back; ``no_tension`` if it is never above zero.

    Notes
    -----
    From the last sample with at least `force_below` of the largest force, go back as long as the
    force falls by at least `loss` of its largest value within `within`. A smooth decrease before
    the loss, such as the necking of a wire, belongs to the test. A loss within one step of a slow
    recording is found as well as one with many samples.
    """
    finite = np.flatnonzero(~np.isnan(force))
    t, f = time[finite], force[finite]
    if not len(f) or not f.max() > 0.0:
        most = float(f.max()) + 0.0 if len(f) else 0.0
        return Failure("no_tension", f"the force is nowhere above zero, at most {most:.4g} N")
    peak = float(f.max())
    last = int(np.flatnonzero(f >= rule.force_below * peak)[-1])
    if last == len(f) - 1:
        text = f"the force ends at {f[-1]:.4g} N, {f[-1] / peak:.0%} of its peak {peak:.4g} N"
        return Failure("no_break", f"{text}; below {rule.force_below:.0%} counts as lost")
    if goes_back is not None and goes_back[finite[last]]:
        return Failure("no_break", "the force goes down while the displacement goes back")
    fallen = f[last] - float(f[last + 1 : max(_reach(t, last, rule.within), last + 2)].min())
    first = _back_to_first(t, f, last, rule, peak)
    if first == last and fallen < rule.loss * peak:
        message = (
            f"the force goes below {rule.force_below:.0%} of its peak {peak:.4g} N slowly: it is "
            f"nowhere lost there by {rule.loss:.0%} within {1e3 * rule.within:.4g} ms; if such "
            "specimens break so, state a longer curve.failure.within"
        )
        return Failure("no_break", message)
    return int(finite[first])


def slow_loss(displacement: Floats, force: Floats, rule: LossOfForce) -> int | None:
    """Find the last sample with the share of the peak, if the motion continues during the loss.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, in the sense of loading; NaN are ignored
    rule : criteria of a loss

    Returns
    -------
    Number of the sample. None if the force is not below the share at the end, or if the motion
    stops or goes back during the loss, as for a specimen that relaxes.
    """
    finite = finite_samples(displacement, force)
    d, f = displacement[finite], force[finite]
    last = last_above(f, rule.force_below)
    if last >= len(f) - 1:
        return None
    # At least 1 % more travel, and at most every second step back.
    goes_on = d[-1] - d[last] >= 0.01 * (d[last] - d[0])
    return int(finite[last]) if goes_on and (np.diff(d[last:]) >= 0.0).mean() > 0.5 else None


def last_above(force: Floats, share: float) -> Any:
    """Return the last sample with at least a share of the largest one, of rows (..., n)."""
    holds = force >= share * np.max(force, axis=-1, keepdims=True)
    return force.shape[-1] - 1 - np.argmax(holds[..., ::-1], axis=-1)


def _reach(time: Floats, sample: int, within: float) -> int:
    """Return the first sample later than `within` after another."""
    return int(np.searchsorted(time, time[sample] + within, side="right"))


def _back_to_first(t: Floats, f: Floats, last: int, rule: LossOfForce, peak: float) -> int:
    """Go back while the force falls by the share within the time, or at that rate."""
    lost = rule.loss * peak
    while last > 0:
        begin = int(np.searchsorted(t, t[last] - rule.within))
        higher = np.flatnonzero(f[begin:last] - f[last] >= lost)
        step = float(t[last] - t[last - 1])
        if len(higher):
            last = begin + int(higher[-1])
        elif f[last - 1] - f[last] >= lost * min(1.0, step / rule.within):
            last -= 1
        else:
            break
    return last


def lost_earlier(time: Floats, force: Floats, rule: LossOfForce) -> float:
    """Return the largest share of the peak that was suddenly and permanently lost before the end.

    Parameters
    ----------
    time, force : shape (n,), s, N; up to the start of the final loss; NaN are ignored
    rule : criteria of a loss

    Returns
    -------
    Share of the largest force; 0 without a loss by the rule.
    """
    is_finite = ~np.isnan(force) & ~np.isnan(time)
    time, force = time[is_finite], force[is_finite]
    peak = float(force.max(initial=0.0))
    later = np.searchsorted(time, time + rule.within, side="right") - 1
    later = np.minimum(np.maximum(later, np.arange(len(force)) + 1), len(force) - 1)
    ahead = np.maximum.accumulate(force[::-1])[::-1][later]
    is_lost = (force - force[later] >= rule.loss * peak) & (later > np.arange(len(force)))
    shares = np.where(is_lost, (force - ahead) / peak if peak > 0.0 else 0.0, 0.0)
    largest = float(shares.max(initial=0.0))
    return largest if largest >= rule.loss else 0.0
