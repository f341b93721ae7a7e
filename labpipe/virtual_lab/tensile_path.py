"""Force of a virtual tensile test as a function of time: law of the specimen, slips, failure.

The path is continuous and free of noise. The crosshead starts at time zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.tensile_scenarios import BilinearLaw, Failure, GripSlip, TensileScenario

_TABLE_POINTS = 200_001
"""Points of the table for specimen and machine in series, whose error is below 1e-7 N."""


def rounded_ramp(distance: Floats, width: float) -> Floats:
    """Return a ramp: zero, then slope 1, with the corner rounded over `width`.

    Parameters
    ----------
    distance : shape (n,), m, from the corner
    width : m, over which the slope grows linearly, half of it on either side

    Returns
    -------
    shape (n,), m: the integral of the slope.
    """
    ramp = np.maximum(distance, 0.0)
    if width == 0.0:
        return ramp
    within = (distance + 0.5 * width) ** 2 / (2.0 * width)
    return np.where(np.abs(distance) < 0.5 * width, within, ramp)


def specimen_force(law: BilinearLaw, distance: Floats) -> Floats:
    """Return the force of the specimen alone, first loading.

    Parameters
    ----------
    law : of the specimen
    distance : shape (n,), m, relative displacement of its ends

    Returns
    -------
    shape (n,), N.

    Notes
    -----
    F = k1 r(d - foot, toe) + (k2 - k1) r(d - foot - break point, knee), r the rounded ramp; outside
    toe and knee these are exactly the two straight lines.
    """
    taut = distance - law.foot
    bend = law.stiffness_second - law.stiffness_first
    first: Floats = law.stiffness_first * rounded_ramp(taut, law.toe)
    return first + bend * rounded_ramp(taut - law.break_point, law.knee)


def loading_force(law: BilinearLaw, compliance: float, displacement: Floats) -> Floats:
    """Return the force of specimen and machine in series, first loading, no slips, no failure.

    Parameters
    ----------
    law : of the specimen
    compliance : m/N, of the machine
    displacement : shape (n,), m, of the crosshead, not negative

    Returns
    -------
    shape (n,), N.

    Notes
    -----
    The crosshead is at d = distance + compliance F(distance), which is tabulated and interpolated.
    """
    if compliance == 0.0:
        return specimen_force(law, displacement)
    distance = np.linspace(0.0, float(np.max(displacement, initial=0.0)), _TABLE_POINTS)
    force = specimen_force(law, distance)
    return np.interp(displacement, distance + compliance * force, force)


@dataclass(frozen=True, slots=True, eq=False)
class TensilePath:
    """Motion and force of a virtual tensile test.

    Parameters
    ----------
    scenario : the test
    """

    scenario: TensileScenario

    @property
    def last_time(self) -> float:
        """Return the time at which the failure begins or full stroke is reached, s."""
        return self.scenario.last_displacement / self.scenario.frame.speed

    @property
    def end(self) -> float:
        """Return the time at which the machine stops recording, s."""
        frame = self.scenario.frame
        back = frame.stroke / frame.speed if frame.unloads else 0.0
        return self.last_time + frame.overrun + back

    def displacement(self, time: Floats) -> Floats:
        """Return the displacement of the crosshead, m, at times, s."""
        frame = self.scenario.frame
        if self.scenario.failure is not None:
            return frame.speed * np.clip(time, 0.0, self.end)
        turn = self.last_time + frame.overrun
        driven_back = frame.speed * np.maximum(time - turn, 0.0) * frame.unloads
        driven = frame.speed * np.clip(time, 0.0, self.last_time)
        return np.maximum(driven - driven_back, 0.0)

    def force(self, time: Floats) -> Floats:
        """Return the tension in the specimen, N, at times, s."""
        scenario = self.scenario
        before = np.minimum(time, self.last_time)
        force = self._loading(before)
        if scenario.failure is not None:
            return force * _share_left(scenario.failure, time - self.last_time)
        if not scenario.frame.unloads:
            return force
        turned = time > self.last_time + scenario.frame.overrun
        return np.where(turned, self._unloading(self.displacement(time)), force)

    def _loading(self, time: Floats) -> Floats:
        scenario = self.scenario
        displacement = self.displacement(time)
        force = loading_force(scenario.law, scenario.frame.compliance, displacement)
        for slip in scenario.slips:
            force = force - _lost(slip, time - slip.position / scenario.frame.speed)
        return np.maximum(force, 0.0)

    def _unloading(self, displacement: Floats) -> Floats:
        """Return the force on unloading by Masing's rule, until the specimen is slack again.

        The unloading curve is the taut part of the loading curve, inverted and twice as large:
        F = F_peak - 2 S((d_peak - d) / 2).
        """
        scenario = self.scenario
        law, compliance = scenario.law, scenario.frame.compliance
        peak = float(self._loading(np.array([self.last_time]))[0])
        relief = np.linspace(0.0, scenario.frame.stroke, _TABLE_POINTS)
        taut = BilinearLaw(law.stiffness_first, law.stiffness_second, law.break_point, law.knee)
        released = 2.0 * specimen_force(taut, 0.5 * relief)
        driven_back = relief + compliance * released
        lost = np.interp(scenario.frame.stroke - displacement, driven_back, released)
        return np.maximum(peak - lost, 0.0)


def _lost(slip: GripSlip, time: Floats) -> Floats:
    """Return the force lost by a slip, N, at times after its beginning."""
    return slip.drop * np.clip(time / slip.duration, 0.0, 1.0)


def _share_left(failure: Failure, time: Floats) -> Floats:
    """Return the remaining share of the force at times after the beginning of the failure."""
    after = np.maximum(time, 0.0)
    intact = 1.0 - np.clip(after / failure.duration, 0.0, 1.0)
    fibres = np.exp(-after / failure.tail)
    share: Floats = (1.0 - failure.residue) * intact + failure.residue * fibres
    return share
