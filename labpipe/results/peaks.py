"""Peaks: the largest force and the largest displacement of every cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from labpipe.fits.loops import largest_sample, noise_power
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.declarations import Output
from labpipe.records.estimates import Failure, widened
from labpipe.results.cycles import CycleNumber, per_cycle, stretch_of_cycle
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import (
    Computed,
    Errors,
    Kind,
    Outcome,
    force_scale,
)
from labpipe.signal.filters import power_passed
from labpipe.signal.turning_points import noise_level

_FEW = 16
"""Samples below which nobody can tell how far the noise remembers."""
_NOISE = 100_000
"""Samples before a turn that say what the noise of the force is like."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakForce(Kind):
    """``peak_force.<cycle>`` (N)."""

    result: ClassVar = "peak-force"
    outputs: ClassVar = (
        Output("peak_force", "N", "Peak force", ("force",), first=1, is_raised_by_slips=True),
    )

    def compute(self, test: Evidence) -> Computed:
        """Largest sample of the force of each cycle."""
        method = "largest force of the cycle after the filter, in the sense of loading"
        reads = (0.0, 1.25)
        how = CycleNumber(_force, _force_errors, method, needs=1, reads=reads, gap="force")
        return per_cycle(self, test, how)


def _force(test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
    del displacement
    return peak_of_cycle(test, branches)


def _force_errors(test: Evidence, branches: list[Branch], value: float) -> Errors:
    del branches
    return {"zero of the force": test.raw_force.zero_error, **force_scale(test, value)}


def peak_of_cycle(test: Evidence, branches: list[Branch]) -> Outcome:
    """Largest force of a cycle, N, without the uncertainty of zero and scale.

    Parameters
    ----------
    test : with its curve
    branches : of the cycle
    """
    sense = test.sense_of(test.known_curve.force)
    values = sense * _force_of_cycle(test, branches)
    peak = largest_sample(values, noise=_force_noise(test, branches[0]))
    if isinstance(peak, Failure):
        return peak
    peak = widened(peak, test.repair_error(before=branches[0].stop))
    return replace(peak, value=sense * peak.value)


def _force_of_cycle(test: Evidence, branches: list[Branch]) -> Floats:
    """All samples of the force over a cycle: on its own clock where that is another one."""
    curve, signal = test.known_curve, test.force
    stretch = stretch_of_cycle(test, branches)
    if signal.clock == test.clocks.curve:
        return curve.force[stretch]
    ends = curve.time[[stretch.start, min(stretch.stop, len(curve.time)) - 1]]
    first, last = (test.clocks.from_curve(float(at), signal.clock) for at in ends)
    return signal.values[slice(*np.searchsorted(signal.time, [first, last]))]


def _force_noise(test: Evidence, loading: Branch) -> float:
    """Standard deviation that the noise of the force has left after its filters, N."""
    raw = test.unfiltered or test.raw_force
    ends = (loading.start_time, loading.stop_time)
    first, last = (test.clocks.from_curve(at, raw.clock) for at in ends)
    start, stop = np.searchsorted(raw.time, [first, last])
    values = raw.values[max(int(start), int(stop) - _NOISE) : int(stop)]
    values = values[~np.isnan(values)]
    filters = test.signals.filters.get(test.signals.force, ())
    if not filters or len(values) < _FEW:
        return noise_level(values)
    passed = min(power_passed(act, len(values)) for act, _ in filters)
    return float(min(np.sqrt(passed * noise_power(values)), noise_level(values)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakDisplacement(Kind):
    """``peak_displacement.<cycle>`` (m)."""

    result: ClassVar = "peak-displacement"
    outputs: ClassVar = (
        Output("peak_displacement", "m", "Displacement at the peak", ("displacement",), first=1),
    )

    def compute(self, test: Evidence) -> Computed:
        """Largest sample of the displacement of each cycle."""
        how = CycleNumber(
            _displacement,
            _displacement_errors,
            "largest displacement of the cycle, in the sense of loading",
            needs=1,
            reads=(0.9, 1.1),
            gap="displacement",
        )
        return per_cycle(self, test, how)


def _displacement(test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
    sense = test.sense_of(displacement)
    values = sense * displacement[stretch_of_cycle(test, branches)]
    found = largest_sample(values, noise=noise_level(values))
    return found if isinstance(found, Failure) else replace(found, value=sense * found.value)


def _displacement_errors(test: Evidence, branches: list[Branch], value: float) -> Errors:
    del branches
    signal = test.displacement
    return {
        "zero of the displacement": signal.zero_error,
        "scale of the displacement": signal.relative_error * value,
    }


KINDS = (PeakForce, PeakDisplacement)
