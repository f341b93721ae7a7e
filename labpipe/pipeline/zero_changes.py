"""Zeros that do not stay: a level that jumps, a force that is another one at rest afterwards."""

from __future__ import annotations

from math import sqrt

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.fits.loops import sense_of_loading
from labpipe.pipeline.bench import Bench
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.signal.rests_and_jumps import level_jumps
from labpipe.signal.turning_points import noise_level

_MOST = 2
"""Jumps of a force; what jumps again and again is the specimen."""
_MOSTLY = 0.5
"""Share of the range that a displacement jumps by when it is zeroed."""
_TURN = 3
"""Samples beside a turn at which a steep fall belongs to the specimen."""
_RETURNED = 0.02
"""Share of the stroke within which the motion has come back to where it began."""
_DRIFT = 0.03
"""Share of the largest force by which the force at rest may differ before and after."""
_SURE = 6.0
"""Standard errors below which nobody can tell."""
_FEWEST = 3
"""Samples of a rest."""
_TAIL = 10
"""Samples behind a break that are more than a rebound."""


def check_zeros(bench: Bench) -> None:
    """Doubt what follows a jump of force or displacement, and forces whose zero drifted.

    Parameters
    ----------
    bench : with a curve of unfiltered force; gets the doubts
    """
    curve = bench.curve
    if curve is None or not curve.branches:
        return
    _doubt_displacement(bench, curve)
    if not _doubt_force(bench, curve):
        _doubt_drift(bench, curve)


def _doubt_displacement(bench: Bench, curve: Curve) -> None:
    """A crosshead that is zeroed in mid-record: what looks like the largest stroke is none."""
    jumps = _jumps(bench, curve, curve.displacement, "displacement")
    if len(jumps) != 1:
        return
    ((sample, size),) = jumps
    if abs(size) < _MOSTLY * float(np.ptp(_known(curve.displacement))):
        return
    message = (
        f"the displacement jumps by {1e3 * size:.4g} mm from one sample to the next at "
        f"{_at(curve, sample)}: zeroed in mid-record? Branches are not where they seem to be; "
        "export the test without what came before"
    )
    for quantity in ("displacement", "force"):
        bench.doubt(quantity, "zero_jump", message, where=bench.displacement)


def _doubt_force(bench: Bench, curve: Curve) -> bool:
    """Whether the force jumps as no specimen lets it; what falls in loading may be a slip."""
    first = curve.branches[0]
    sense = sense_of_loading(curve.force[first.start : first.stop])
    jumps = _jumps(bench, curve, curve.force, "force")
    found = [each for each in jumps if not _is_of_the_specimen(curve, each[0], sense * each[1])]
    if len(jumps) > _MOST or not found:
        return False
    sample, size = found[0]
    message = (
        f"the force jumps by {size:.4g} N from one sample to the next at {_at(curve, sample)}, as "
        "a zero does and no specimen: look at the cable and at the tare of the load cell"
    )
    during = (float(curve.time[sample]), float(curve.time[-1]))
    bench.doubt("force", "zero_jump", message, where=bench.force, during=during)
    return True


def _jumps(
    bench: Bench, curve: Curve, values: Floats, quantity: str
) -> tuple[tuple[int, float], ...]:
    """Jumps of a level that do not end a stretch in which the channel stood still."""
    stuck = [
        bench.on_curve_clock(each.during[1], each.clock)
        for each in bench.doubts
        if each.reason.code == "frozen_channel" and each.quantity == quantity and each.during
    ]
    return tuple(
        (sample, size)
        for sample, size in level_jumps(curve.time, values)
        if not any(curve.time[sample - 1] <= end <= curve.time[sample] for end in stuck)
    )


def _is_of_the_specimen(curve: Curve, sample: int, grows: float) -> bool:
    """Whether a step may be a break, a slip, or what follows a turn at once."""
    near = [at for each in curve.branches for at in (each.start, each.stop)]
    if any(abs(sample - at) <= _TURN for at in near):
        return True
    inside = [each for each in curve.branches if each.start <= sample < each.stop]
    is_loading = bool(inside) and inside[0].direction is Direction.LOADING
    held = _held_after_loading(curve, sample)
    return grows < 0.0 and (is_loading or held)


def _held_after_loading(curve: Curve, sample: int) -> bool:
    """Whether the specimen is held at the end of a loading: it may break there as well."""
    before = [each for each in curve.branches if each.stop <= sample]
    resting = all(not each.start <= sample < each.stop for each in curve.branches)
    return bool(before) and resting and before[-1].direction is Direction.LOADING


def _doubt_drift(bench: Bench, curve: Curve) -> None:
    """Compare the force at rest before and after.

    A specimen with friction, or one that stays longer, pushes back when it is home again: a force
    against the sense of loading is a drift if it grows from cycle to cycle, too.
    """
    first, last = curve.branches[0], curve.branches[-1]
    before, after = _known(curve.force[: first.start]), _known(curve.force[last.stop :])
    if not _came_back(curve, first, last) or min(len(before), len(after)) < _FEWEST:
        return
    level = median(before)
    change = median(after[-len(before) :]) - level  # the end of a long rest: a specimen relaxes
    part = curve.force[first.start : last.stop]
    most = float(np.nanmax(np.abs(part - level)))
    error = noise_level(curve.force) * sqrt(1.0 / len(before) + 1.0 / len(after))
    limit, sense = max(_DRIFT * most, _SURE * error), sense_of_loading(part)
    if abs(change) < limit or (sense * change < 0.0 and not _grows(curve, limit)):
        return
    message = (
        f"at rest the force is {level:.4g} N before the test and {level + change:.4g} N after it, "
        f"{abs(change) / most:.0%} of the largest force apart: the zero drifted, or the specimen "
        "is held under load"
    )
    bench.doubt("force", "zero_drift", message, where=bench.force)


def check_break(bench: Bench) -> None:
    """Doubt a force that stands below zero once the specimen is broken.

    Parameters
    ----------
    bench : with its failure; gets the doubt. What is left of a specimen may still pull a little,
        so that a force above zero is left alone, and so is a rebound of a few samples
    """
    curve, failure = bench.curve, bench.failure
    if curve is None or not isinstance(failure, FailurePoint):
        return
    after = _known(curve.force[failure.sample + 1 :])
    sense = sense_of_loading(curve.force[: failure.sample + 1])
    if len(after) < _TAIL:
        return
    level, most = sense * median(after[len(after) // 2 :]), float(np.nanmax(np.abs(curve.force)))
    error = noise_level(curve.force) * sqrt(2.0 / len(after))
    if level > -max(_DRIFT * most, _SURE * error):
        return
    message = (
        f"the force stands at {sense * level:.4g} N once the specimen is broken, "
        f"{-level / most:.0%} of its peak below zero: its zero was taken under load, or drifted"
    )
    bench.doubt("force", "zero_drift", message, where=bench.force)


def _grows(curve: Curve, limit: float) -> bool:
    """Whether the force at the end of unloading changes from the first cycle to the last."""
    ends = [each.stop for each in curve.branches if each.direction is Direction.UNLOADING]
    levels = [
        _known(curve.force[max(end - _FEWEST, 0) : end + _FEWEST]) for end in (ends[0], ends[-1])
    ]
    if not all(len(level) for level in levels):
        return False
    # The median of few samples scatters 1.25 times as much as their mean.
    error = 1.25 * noise_level(curve.force) * sqrt(sum(1.0 / len(level) for level in levels))
    return abs(median(levels[1]) - median(levels[0])) > max(limit, _SURE * error)


def _came_back(curve: Curve, first: Branch, last: Branch) -> bool:
    """Whether the test ends with an unloading, and where it began."""
    if last.direction is not Direction.UNLOADING:
        return False
    began, ended = curve.displacement[first.start], curve.displacement[last.stop - 1]
    return bool(abs(ended - began) <= _RETURNED * float(np.ptp(_known(curve.displacement))))


def _known(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _at(curve: Curve, sample: int) -> str:
    return f"{curve.time[sample]:.3f} s" if curve.time_unit == "s" else f"sample {sample + 1}"
