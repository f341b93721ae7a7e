"""What really happened in a virtual three-point test, for whoever checks the processing by it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.bundle_truth import LoadingTruth, line_slope, tell_loading
from labpipe.virtual_lab.conduit_bundle import ConduitScenario
from labpipe.virtual_lab.conduit_record import ConduitSchedule, twist_at
from labpipe.virtual_lab.three_point import ThreePointPath

MIDDLE_WINDOW = (1e-3, 10e-3)
_STEPS = 20_001


@dataclass(frozen=True, slots=True)
class MiddleTruth:
    """Mid-span at full stroke, and its stiffness at first.

    Parameters
    ----------
    curvature : 1/m
    moment : N m, in the bundle
    moment_of_force : N m, P L / 4, what a straight bundle on points would have
    bending_stiffness : N m^2, slope of moment over curvature while the displacement goes through
        `MIDDLE_WINDOW`, least squares over even steps of curvature
    bending_stiffness_of_force : N m^2, the same with P L / 4
    twist : rad, right-handed about x
    """

    curvature: float
    moment: float
    moment_of_force: float
    bending_stiffness: float
    bending_stiffness_of_force: float
    twist: float


@dataclass(frozen=True, slots=True, eq=False)
class ConduitTruth:
    """What really happened; frames and signs of `virtual_lab.conduit_bundle`, SI.

    Parameters
    ----------
    loading : of the way down; displacement is that of the crosshead
    initial_bending_stiffness : N m^2, of the law before anything slips
    bending_stiffness : N m^2, K L^3 / 48 with the slope K over
        `bundle_truth.KINK_WINDOW`, uncorrected
    peak_force, peak_displacement : N, m
    residual_displacement : m, where the roller leaves the bundle on its way up
    energy : J, of the cycle
    middle : mid-span
    start_time, top_time, stop_time : s, true time, of the crosshead
    clocks : offsets of all clocks, s: ``force = force_offset + (1 + drift) x frame`` and
        ``markers = marker_offset + frame``
    time : shape (n,), s, on the cameras' clock, evenly spread
    displacement, force, twist, curvature, moment : shape (n,), m, N, rad, 1/m, N m, at these times;
        the last two at mid-span
    """

    loading: LoadingTruth
    initial_bending_stiffness: float
    bending_stiffness: float
    peak_force: float
    peak_displacement: float
    residual_displacement: float
    energy: float
    middle: MiddleTruth
    start_time: float
    top_time: float
    stop_time: float
    clocks: dict[str, float]
    time: Floats
    displacement: Floats
    force: Floats
    twist: Floats
    curvature: Floats
    moment: Floats


def tell_conduit_truth(
    path: ThreePointPath, scenario: ConduitScenario, schedule: ConduitSchedule, *, rate: float = 5.0
) -> ConduitTruth:
    """Look up what really happened.

    Parameters
    ----------
    path : the solved test of the type
    scenario, schedule : of the sample
    rate : Hz, of the arrays

    Returns
    -------
    The truth.
    """
    stroke, factor = scenario.test.stroke, scenario.factor
    loading = _loading(path).scaled(factor)
    both = 2.0 * stroke * np.linspace(0.0, 1.0, 2 * _STEPS - 1)
    force, way = factor * path.force(both), path.displacement(both)
    top = int(np.argmax(force))
    time: Floats = np.arange(0.0, schedule.end + scenario.clocks.camera_lead, 1.0 / rate)
    progress = schedule.progress_at(time - scenario.clocks.camera_lead)
    _, moment, curvature = path.middle(progress)
    return ConduitTruth(
        loading=loading,
        initial_bending_stiffness=scenario.bundle.law().stiffness,
        bending_stiffness=loading.windowed_stiffness * scenario.test.span**3 / 48.0,
        peak_force=float(force[top]),
        peak_displacement=float(way[top]),
        residual_displacement=path.residual,
        energy=float(np.trapezoid(force, way)),
        middle=_middle(path, scenario),
        start_time=schedule.start,
        top_time=schedule.top,
        stop_time=schedule.stop,
        clocks=_clocks(scenario),
        time=time,
        displacement=path.displacement(progress),
        force=factor * path.force(progress),
        twist=twist_at(path, scenario.markers, progress),
        curvature=curvature,
        moment=factor * moment,
    )


@lru_cache(maxsize=64)
def _loading(path: ThreePointPath) -> LoadingTruth:
    """Of the type; samples differ by a factor."""
    down = path.test.stroke * np.linspace(0.0, 1.0, _STEPS)
    return tell_loading(down, path.force(down))


def _middle(path: ThreePointPath, scenario: ConduitScenario) -> MiddleTruth:
    stroke, span = scenario.test.stroke, scenario.test.span
    first, last = MIDDLE_WINDOW
    _, moment, curvature = path.middle(np.linspace(first, last, _STEPS))
    of_force = 0.25 * span * path.force(np.linspace(first, last, _STEPS))
    slopes = [
        scenario.factor * line_slope(curvature, each, float(curvature[0]), float(curvature[-1]))
        for each in (moment, of_force)
    ]
    full = np.array([stroke])
    _, at_full, bent = path.middle(full)
    return MiddleTruth(
        curvature=float(bent[0]),
        moment=scenario.factor * float(at_full[0]),
        moment_of_force=0.25 * span * scenario.factor * float(path.force(full)[0]),
        bending_stiffness=slopes[0],
        bending_stiffness_of_force=slopes[1],
        twist=scenario.markers.twist,
    )


def _clocks(scenario: ConduitScenario) -> dict[str, float]:
    clocks = scenario.clocks
    return {
        "force_offset": -clocks.trigger_lag * (1.0 + clocks.recorder_drift),
        "drift": clocks.recorder_drift,
        "marker_offset": clocks.camera_lead,
    }
