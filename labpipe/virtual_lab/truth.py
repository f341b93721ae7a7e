"""True values of a virtual test, with which the results of the processing are compared.

They are computed from curves without noise, and not by the formulas of the processing: the kink is
searched over a fine grid, and the start of the plateau backwards from the end of the curve.

Everything is SI; frames and signs are those of `virtual_lab.cantilever_scenarios`,
`virtual_lab.three_point` and `virtual_lab.tensile`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import MechanicalPath
from labpipe.virtual_lab.instruments import Schedule, compute_twist
from labpipe.virtual_lab.tensile import GripSlip, TensilePath
from labpipe.virtual_lab.three_point import ConduitScenario, ThreePointPath

KINK_WINDOW = (0.2e-3, 5e-3)
STIFFNESS_RANGE = 5e-3
_KINK_GRID_POINTS = 800


@dataclass(frozen=True, slots=True)
class KinkTruth:
    """The two connected straight lines that fit a curve best.

    Parameters
    ----------
    displacement, force : m, N, of their intersection
    stiffness_before, stiffness_after : N/m
    """

    displacement: float
    force: float
    stiffness_before: float
    stiffness_after: float


@dataclass(frozen=True, slots=True)
class LoadingTruth:
    """True numbers of a first loading; lengths in m.

    Parameters
    ----------
    tangent_at_zero : N/m
    stiffness : N/m, slope of the least-squares line over the first 5 mm
    windowed_stiffness : N/m, slope of the least-squares line over `KINK_WINDOW`
    kink : within `KINK_WINDOW`
    end_slope : slope of the least-squares line over the last 5 mm, over `windowed_stiffness`
    plateau_displacement, plateau_force : m, N, from which the tangent over a millimetre stays below
        a tenth of `windowed_stiffness`; None if `end_slope` is 0.1 or more
    """

    tangent_at_zero: float
    stiffness: float
    windowed_stiffness: float
    kink: KinkTruth
    end_slope: float
    plateau_displacement: float | None
    plateau_force: float | None


@dataclass(frozen=True, slots=True)
class TapedTruth:
    """True numbers of a bundle in the cantilever rig.

    Parameters
    ----------
    loading : of the first cycle
    bending_stiffness : N m^2, K L^3 / 3 with the slope K over `KINK_WINDOW`, uncorrected
    loading_stiffness : N/m, of each cycle, slope over 5 mm from where the force exceeds its rest
        value
    hardening : loading stiffnesses relative to the first cycle
    """

    loading: LoadingTruth
    bending_stiffness: float
    loading_stiffness: tuple[float, ...]
    hardening: tuple[float, ...]


def evaluate_taped(path: MechanicalPath) -> TapedTruth:
    """Compute the true numbers of a bundle in the cantilever rig.

    Parameters
    ----------
    path : the solved test

    Returns
    -------
    The numbers. Displacement is the deflection of the pull point; force is the tension of the
    string minus that at rest.
    """
    loading = evaluate_loading(*_sample_loading(path, 1))
    slopes = tuple(
        _fit_slope_after_slack(*_sample_loading(path, n)) for n in range(1, path.test.cycles + 1)
    )
    return TapedTruth(
        loading=loading,
        bending_stiffness=loading.windowed_stiffness * path.test.length**3 / 3.0,
        loading_stiffness=slopes,
        hardening=tuple(slope / slopes[0] for slope in slopes),
    )


def _sample_loading(path: MechanicalPath, cycle: int) -> tuple[Floats, Floats]:
    """Return deflection and force of one loading, m and N."""
    n_steps = 20_001
    progress = path.test.stroke * (2.0 * (cycle - 1) + np.linspace(0.0, 1.0, n_steps))
    return path.deflection(progress), path.tension(progress) - path.rest.tension


def _fit_slope_after_slack(displacement: Floats, force: Floats) -> float:
    """Return the slope over the first 5 mm from where the force exceeds zero, N/m."""
    slack = np.flatnonzero(force <= 0.0)
    begin = 0 if len(slack) == 0 else int(slack[-1])
    pair = slice(begin, begin + 2)
    start = float(np.interp(0.0, force[pair], displacement[pair]))
    moving = slice(begin, None)
    return fit_slope(displacement[moving], force[moving], start, start + STIFFNESS_RANGE)


def evaluate_loading(displacement: Floats, force: Floats) -> LoadingTruth:
    """Compute the true numbers of a first loading.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, free of noise; the displacement increases from zero and
        is dense enough for linear interpolation

    Returns
    -------
    The numbers.
    """
    plateau_share = 0.1  # slope of the plateau over that of the window
    zero_distance = 0.02e-3
    windowed = fit_slope(displacement, force, *KINK_WINDOW)
    last = float(displacement[-1])
    end = fit_slope(displacement, force, last - STIFFNESS_RANGE, last)
    is_level = end < plateau_share * windowed
    tangents = _compute_tangents(displacement, force)
    onset = _find_last_above(*tangents, plateau_share * windowed) if is_level else None
    return LoadingTruth(
        tangent_at_zero=float(np.interp(zero_distance, displacement, force)) / zero_distance,
        stiffness=fit_slope(displacement, force, 0.0, STIFFNESS_RANGE),
        windowed_stiffness=windowed,
        kink=find_kink(displacement, force, *KINK_WINDOW),
        end_slope=end / windowed,
        plateau_displacement=onset,
        plateau_force=None if onset is None else float(np.interp(onset, displacement, force)),
    )


def fit_slope(displacement: Floats, force: Floats, start: float, stop: float) -> float:
    """Fit a line between two displacements by least squares; return its slope, N/m."""
    grid = np.linspace(start, stop, _KINK_GRID_POINTS)
    return float(np.polyfit(grid, np.interp(grid, displacement, force), 1, w=_build_weights())[0])


def _build_weights() -> Floats:
    """Return the square roots of the trapezoidal weights of a grid."""
    roots = np.ones(_KINK_GRID_POINTS)
    roots[[0, -1]] = np.sqrt(0.5)
    return roots


def find_kink(displacement: Floats, force: Floats, start: float, stop: float) -> KinkTruth:
    """Find the kink: the break point of the best two connected lines between two displacements.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, free of noise
    start, stop : m

    Returns
    -------
    The best pair of lines by least squares. The break point is refined by a parabola through the
    best point of the grid and its neighbours.
    """
    grid = np.linspace(start, stop, _KINK_GRID_POINTS)
    forces = np.interp(grid, displacement, force)
    breaks = grid[10:-10]
    misfits = np.array([_fit_two_lines(grid, forces, place)[1] for place in breaks.tolist()])
    best = int(np.clip(np.argmin(misfits), 1, len(misfits) - 2))
    below, middle, above = misfits[best - 1 : best + 2]
    shift = 0.5 * (below - above) / (below - 2.0 * middle + above)
    place = float(breaks[best] + np.clip(shift, -1.0, 1.0) * (breaks[1] - breaks[0]))
    (level, first, change), _ = _fit_two_lines(grid, forces, place)
    return KinkTruth(place, float(level + first * place), float(first), float(first + change))


def _fit_two_lines(grid: Floats, forces: Floats, place: float) -> tuple[Floats, float]:
    """Return level, slope and change of slope of the best lines, and the sum of squares."""
    basis = np.column_stack([np.ones_like(grid), grid, np.maximum(grid - place, 0.0)])
    roots = _build_weights()
    coefficients = np.linalg.lstsq(roots[:, None] * basis, roots * forces, rcond=None)[0]
    return coefficients, float(np.sum((roots * (basis @ coefficients - forces)) ** 2))


def _compute_tangents(displacement: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Return centres of intervals of 1 mm, m, and the slopes of the curve over them, N/m."""
    tangent_step = 1e-3
    half = 0.5 * tangent_step
    grid = np.linspace(half, displacement[-1] - half, 2001)
    ahead, behind = (np.interp(grid + step, displacement, force) for step in (half, -half))
    return grid, (ahead - behind) / tangent_step


def _find_last_above(grid: Floats, tangent: Floats, limit: float) -> float | None:
    """Return where the tangent falls below a limit for the last time, m, or None."""
    above = np.flatnonzero(tangent >= limit)
    if len(above) == 0 or above[-1] == len(grid) - 1:
        return None
    pair = slice(above[-1], above[-1] + 2)
    return float(np.interp(-limit, -tangent[pair], grid[pair]))


_TRUTH_POINTS = 20_001


@dataclass(frozen=True, slots=True)
class CycleTruth:
    """True values of a cycle; lengths in m, times in s on the marker clock.

    Parameters
    ----------
    cycle : counted from 1
    start_time, top_time, stop_time : of the clamp: start, reversal, return
    peak_force, peak_deflection : N, m, the largest of the cycle
    residual_deflection : m, at which the force returns to zero on unloading; None if it does not
    energy : J, integral of force over deflection from the start of the cycle to its end
    """

    cycle: int
    start_time: float
    top_time: float
    stop_time: float
    peak_force: float
    peak_deflection: float
    residual_deflection: float | None
    energy: float


@dataclass(frozen=True, slots=True, eq=False)
class ShapeTruth:
    """Axis of the wire in the specimen frame at a camera frame; arrays of shape (points,).

    Parameters
    ----------
    frame : number of the camera frame
    arc_length, x, y : m
    """

    frame: int
    arc_length: Floats
    x: Floats
    y: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CantileverTruth:
    """True values of a cantilever test; arrays at the camera frames, shape (frames,).

    Parameters
    ----------
    cycles : one by one
    time : s, marker clock
    travel, deflection : m
    force : N
    shapes : at six frames of each branch
    """

    cycles: tuple[CycleTruth, ...]
    time: Floats
    travel: Floats
    deflection: Floats
    force: Floats
    shapes: tuple[ShapeTruth, ...]


def evaluate_cantilever(path: MechanicalPath, schedule: Schedule) -> CantileverTruth:
    """Compute the true values at every camera frame and of every cycle.

    Parameters
    ----------
    path : the solved test
    schedule : of the motion and the recordings

    Returns
    -------
    The truth.
    """
    progress = schedule.progress_at(schedule.frame_times)
    cycles = range(1, path.test.cycles + 1)
    return CantileverTruth(
        cycles=tuple(_evaluate_cycle(path, schedule, number) for number in cycles),
        time=schedule.frame_times,
        travel=path.travel(progress),
        deflection=path.deflection(progress),
        force=path.tension(progress) - path.rest.tension,
        shapes=tuple(_sample_shapes(path, schedule)),
    )


def _evaluate_cycle(path: MechanicalPath, schedule: Schedule, number: int) -> CycleTruth:
    start, top, stop = schedule.turning_times[2 * number - 2 : 2 * number + 1]
    stroke = path.test.stroke
    progress = 2.0 * stroke * (number - 1) + np.linspace(0.0, 2.0 * stroke, _TRUTH_POINTS)
    force = path.tension(progress) - path.rest.tension
    deflection = path.deflection(progress)
    return CycleTruth(
        cycle=number,
        start_time=float(start),
        top_time=float(top),
        stop_time=float(stop),
        peak_force=float(np.max(force)),
        peak_deflection=float(np.max(deflection)),
        residual_deflection=_find_residual(path, number),
        energy=float(np.trapezoid(force, deflection)),
    )


def _find_residual(path: MechanicalPath, number: int) -> float | None:
    """Return the deflection at which the force first returns to zero on unloading."""
    zero_force = 1e-9
    for segment in path.segments:
        if segment.cycle != number or segment.loading or segment.is_still:
            continue
        if segment.tension[-1] > path.rest.tension + zero_force:
            return None
        where = float(segment.progress[-1])
        if segment.tension[-1] < path.rest.tension - zero_force:
            crossing = CubicSpline(segment.progress, segment.tension - path.rest.tension)
            where = float(crossing.roots(extrapolate=False)[0])
        return float(path.deflection(np.array([where]))[0])
    return None


def _sample_shapes(path: MechanicalPath, schedule: Schedule) -> list[ShapeTruth]:
    shape_points = 41
    arc_length = np.linspace(0.0, path.test.length, shape_points)
    turns = schedule.turning_times
    times = [np.linspace(a, b, 6) for a, b in pairwise(turns)]
    frames = np.unique(np.searchsorted(schedule.frame_times, np.concatenate(times)))
    progress = schedule.progress_at(schedule.frame_times[frames])
    x, y, _ = path.points(progress, arc_length)
    return [ShapeTruth(int(frame), arc_length, x[row], y[row]) for row, frame in enumerate(frames)]


@dataclass(frozen=True, slots=True)
class MiddleTruth:
    """True values of mid-span at full stroke, and its stiffness.

    Parameters
    ----------
    curvature : 1/m
    moment : N m, in the bundle
    bending_stiffness : N m^2, slope of moment over curvature for displacements of 1 to 10 mm, by
        least squares over even steps of curvature
    twist : rad, right-handed about x
    """

    curvature: float
    moment: float
    bending_stiffness: float
    twist: float


@dataclass(frozen=True, slots=True, eq=False)
class ConduitTruth:
    """True values of a three-point test.

    Parameters
    ----------
    loading : displacement is that of the crosshead
    initial_bending_stiffness : N m^2, of the law before anything slips
    bending_stiffness : N m^2, K L^3 / 48 with the slope K over `KINK_WINDOW`, uncorrected
    peak_force, peak_displacement : N, m
    residual_displacement : m, at which the roller leaves the bundle on unloading
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


def evaluate_conduit(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, *, rate: float = 5.0
) -> ConduitTruth:
    """Compute the true values of a three-point test.

    Parameters
    ----------
    path : the solved test of the type
    scenario, schedule : of the sample
    rate : Hz, of the arrays

    Returns
    -------
    The truth.
    """
    stroke, factor, clocks = scenario.test.stroke, scenario.factor, scenario.clocks
    down = stroke * np.linspace(0.0, 1.0, _TRUTH_POINTS)
    loading = evaluate_loading(down, factor * path.force(down))
    progress_of_cycle = 2.0 * stroke * np.linspace(0.0, 1.0, 2 * _TRUTH_POINTS - 1)
    force, displacement = (
        factor * path.force(progress_of_cycle),
        path.displacement(progress_of_cycle),
    )
    top = int(np.argmax(force))
    time: Floats = np.arange(0.0, schedule.end + clocks.camera_lead, 1.0 / rate)
    progress = schedule.progress_at(time - clocks.camera_lead)
    _, moment, curvature = path.middle(progress)
    start_time, top_time, stop_time = schedule.turning_times.tolist()
    return ConduitTruth(
        loading=loading,
        initial_bending_stiffness=scenario.bundle.law().stiffness,
        bending_stiffness=loading.windowed_stiffness * scenario.test.span**3 / 48.0,
        peak_force=float(force[top]),
        peak_displacement=float(displacement[top]),
        residual_displacement=path.residual,
        energy=float(np.trapezoid(force, displacement)),
        middle=_evaluate_middle(path, scenario),
        start_time=start_time,
        top_time=top_time,
        stop_time=stop_time,
        clocks={
            "force_offset": -clocks.trigger_lag * (1.0 + clocks.recorder_drift),
            "drift": clocks.recorder_drift,
            "marker_offset": clocks.camera_lead,
        },
        time=time,
        displacement=path.displacement(progress),
        force=factor * path.force(progress),
        twist=compute_twist(path, scenario.markers, progress),
        curvature=curvature,
        moment=factor * moment,
    )


def _evaluate_middle(path: ThreePointPath, scenario: ConduitScenario) -> MiddleTruth:
    first, last = 1e-3, 10e-3  # m, range of the slope
    _, moment, curvature = path.middle(np.linspace(first, last, _TRUTH_POINTS))
    slope = fit_slope(curvature, moment, float(curvature[0]), float(curvature[-1]))
    _, full_moment, full_curvature = path.middle(np.array([scenario.test.stroke]))
    return MiddleTruth(
        curvature=float(full_curvature[0]),
        moment=scenario.factor * float(full_moment[0]),
        bending_stiffness=scenario.factor * slope,
        twist=scenario.markers.twist,
    )


@dataclass(frozen=True, slots=True, eq=False)
class TensileTruth:
    """True values of a tensile test, free of tare, gain error and noise.

    *At the crosshead* means that the compliance of the machine is included, as in a measurement
    without compliance correction. Displacements count from the position of the crosshead before the
    test; from the first sample they are smaller by `displacement[0]`.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, at the samples of the record
    foot : m, displacement at which the first straight line meets zero force
    stiffness_first, stiffness_second : N/m, at the crosshead
    specimen_stiffness_first, specimen_stiffness_second : N/m, of the specimen alone
    break_point : m, displacement at which the two straight lines cross, at the crosshead; None if
        the test ends before
    break_point_from_foot : m, the same, from the foot
    break_force : N, at which they cross
    peak_force : N, largest
    peak_displacement : m, at which it is reached
    failure_displacement : m, at which the force begins to drop; None without a failure
    failure_force : N, there; None without a failure
    energy_to_break : J, integral of force over displacement up to failure; None without one
    slips : in order
    """

    time: Floats
    displacement: Floats
    force: Floats
    foot: float
    stiffness_first: float
    stiffness_second: float
    specimen_stiffness_first: float
    specimen_stiffness_second: float
    break_point: float | None
    break_point_from_foot: float | None
    break_force: float | None
    peak_force: float
    peak_displacement: float
    failure_displacement: float | None
    failure_force: float | None
    energy_to_break: float | None
    slips: tuple[GripSlip, ...]


def evaluate_tensile(path: TensilePath, time: Floats) -> TensileTruth:
    """Compute the true values of a tensile test.

    Parameters
    ----------
    path : the test
    time : shape (n,), s, of the samples

    Returns
    -------
    The truth.
    """
    scenario = path.scenario
    law, compliance = scenario.law, scenario.frame.compliance
    fine = np.linspace(0.0, path.last_time, 100_001)
    travelled, pulled = path.displacement(fine), path.force(fine)
    top = int(np.argmax(pulled))
    break_force = law.stiffness_first * law.break_point
    from_foot = law.break_point + compliance * break_force
    bends = law.foot + from_foot < scenario.last_displacement
    failed = scenario.failure is not None
    return TensileTruth(
        time=time,
        displacement=path.displacement(time),
        force=path.force(time),
        foot=law.foot,
        stiffness_first=add_compliance(law.stiffness_first, compliance),
        stiffness_second=add_compliance(law.stiffness_second, compliance),
        specimen_stiffness_first=law.stiffness_first,
        specimen_stiffness_second=law.stiffness_second,
        break_point=law.foot + from_foot if bends else None,
        break_point_from_foot=from_foot if bends else None,
        break_force=break_force if bends else None,
        peak_force=float(pulled[top]),
        peak_displacement=float(travelled[top]),
        failure_displacement=scenario.last_displacement if failed else None,
        failure_force=float(pulled[-1]) if failed else None,
        energy_to_break=float(np.trapezoid(pulled, travelled)) if failed else None,
        slips=scenario.slips,
    )


def add_compliance(stiffness: float, compliance: float) -> float:
    """Return the stiffness, N/m, of a specimen in series with a compliance, m/N."""
    return stiffness / (1.0 + stiffness * compliance)
