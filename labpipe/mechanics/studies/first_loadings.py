"""Extract the first-loading curves of cantilever tests, with their errors, for a calibration.

Systematic errors do not average out over the points as noise does. An error of the force zero
shifts the curve in force. Errors of the deflection zero and of the clock shift the curve in
deflection. An error of the fitted shape is proportional to the deflection. This error counts as
the same in all tests of a rig.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial

from labpipe.errors import LabpipeError
from labpipe.mechanics.wire.calibration.hardening import ENERGY, RATIO, RESIDUAL, CycledTest
from labpipe.mechanics.wire.calibration.measured_curves import MAX_DEFLECTION_RATIO, MeasuredCurve
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.messages import format_sentence
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.causes import CENTRE, GRIP, PULL, SCALE_OF_DISPLACEMENT, SHAPE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import FitShape, SpecimenFrame, Zero
from labpipe.records.quality import QualityNote
from labpipe.records.result import Result, Status, TestResult, find_result
from labpipe.results.bending import compute_prop_force
from labpipe.results.moment_curvature import collect_rest_evidence, list_rest_notes
from labpipe.store.result_files import read_stages
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance
from labpipe.units import GRAVITY


def estimate_force_zero_error(protocol: Protocol, curve: Curve, loading: Branch) -> float:
    """Estimate the standard error of the force zero from the force at rest.

    Parameters
    ----------
    protocol : protocol of the test
    curve : curve of the test
    loading : first loading branch of the curve

    Returns
    -------
    Standard error, N; 0 if the test has fewer than four samples at rest before its loading.
    """
    rest_rows = slice(0, loading.start)
    force_channel = protocol.curve and protocol.curve.force
    zero_steps = (step for step in protocol.steps if isinstance(step, Zero))
    duration = next((step.over for step in zero_steps if step.channel == force_channel), None)
    return estimate_zero_error(curve.time[rest_rows], curve.force[rest_rows], duration)


def estimate_offset_error(
    result: TestResult, protocol: Protocol, curve: Curve, loading: Branch
) -> float:
    """Estimate the standard error of the common offset of all deflections.

    Parameters
    ----------
    result : result of the test
    protocol : protocol of the test
    curve : curve of the test
    loading : first loading branch of the curve

    Returns
    -------
    Standard error, m. Two errors are combined in quadrature: the error of the deflection zero, and
    the clock error times the mean speed of the deflection. The clock error is taken as 0 if the
    test has one clock, or if the error is unknown.
    """
    rest_rows, loading_rows = slice(0, loading.start), slice(loading.start, loading.stop)
    # The deflection is zeroed over the duration of the step `SpecimenFrame`.
    frame_steps = (step for step in protocol.steps if isinstance(step, SpecimenFrame))
    duration = next((step.over for step in frame_steps), None)
    rest_deflection = curve.displacement[rest_rows]
    zero_error = estimate_zero_error(curve.time[rest_rows], rest_deflection, duration)
    clock_fit = None if result.aligned is None else result.aligned.clock_fit
    clock_error = 0.0 if clock_fit is None else clock_fit.offset_interval.standard_error
    finite_rows = np.flatnonzero(np.isfinite(curve.displacement[loading_rows]))
    if len(finite_rows) < 2 or not np.isfinite(clock_error):
        return zero_error
    end_rows = loading.start + finite_rows[[0, -1]]
    speed = np.diff(curve.displacement[end_rows])[0] / np.diff(curve.time[end_rows])[0]
    return float(np.hypot(zero_error, clock_error * speed))


def estimate_scale_errors(result: TestResult) -> tuple[float, float]:
    """Estimate the relative standard errors of the scale of the deflection.

    Parameters
    ----------
    result : result of the test

    Returns
    -------
    common_error : error from the scale of the cameras and the choice of the fitted shape, which is
        taken as common to all tests of a calibration
    test_error : error from the offsets of the markers, which is taken as independent between tests

    Notes
    -----
    The errors are those in the budget of the first peak deflection, relative to the peak. Without a
    budget, as in files of earlier versions, the standard error of the peak is taken as common.
    Without an interval, both errors are 0. The division into common and test errors is made here;
    `IS_COMMON` divides causes differently.
    """
    peak = find_result(result.results, "peak_displacement.1")
    if peak is None or peak.interval is None or not peak.value:
        return 0.0, 0.0
    magnitude = abs(peak.value)
    if not peak.budget:
        return peak.interval.standard_error / magnitude, 0.0
    changes = {contribution.cause: contribution.change / magnitude for contribution in peak.budget}
    common_causes, test_causes = (SHAPE, SCALE_OF_DISPLACEMENT), (GRIP, PULL, CENTRE)
    common_error = hypot(*(changes.get(cause, 0.0) for cause in common_causes))
    return common_error, hypot(*(changes.get(cause, 0.0) for cause in test_causes))


def estimate_zero_error(time: Floats, values: Floats, duration: float | None = None) -> float:
    """Estimate the standard error of a zero, which is a mean of values at rest.

    Parameters
    ----------
    time : shape (n,), time of evenly spaced samples at rest, s
    values : shape (n,), values at rest; NaNs are ignored
    duration : duration over which the values are averaged, s; None for the whole time at rest

    Returns
    -------
    Standard error in the unit of the values; 0 for fewer than four values.

    Notes
    -----
    The long-run variance over the whole time at rest (`estimate_long_run_variance`) is divided by
    the number of values in `duration`.
    """
    finite_values = values[~np.isnan(values)]
    variance = estimate_long_run_variance(finite_values, n_parameters=1)
    if np.isnan(variance):
        return 0.0
    total_duration = float(time[-1] - time[0])
    fraction = 1.0 if duration is None else min(duration / total_duration, 1.0)
    return float(np.sqrt(variance / (fraction * len(finite_values))))


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """First loading of a processed test.

    Parameters
    ----------
    curve : first-loading curve with its errors
    gain_uncertainty : relative standard uncertainty of the gain of the load cell
    notes : notes on doubtful results, on the wire at rest, on its weight, on points that are not
        used, and on cycles
    file : path of the result.h5 of the test
    cycles : residual deflection, energy and peak ratio of the test; None without a first peak
    """

    curve: MeasuredCurve
    gain_uncertainty: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()
    cycles: CycledTest | None = None


class NotUsableError(LabpipeError):
    """Raised if a calibration cannot use a test. The message states the reason."""

    @classmethod
    def of(cls, code: str, /, **values: object) -> NotUsableError:
        """Make the error from the code of its message and the values in the message."""
        return cls(format_sentence(code, **values))


def read_first_loadings(
    files: Sequence[Path],
    *,
    min_points: int,
    max_deflection: float | None = None,
    report_name: Callable[[str], None] = lambda _: None,
) -> tuple[list[FirstLoading], dict[str, str]]:
    """Read the first loadings of tests.

    Parameters
    ----------
    files : result.h5 files
    min_points : minimum number of points of a curve, each a mean of consecutive samples;
        a curve of more samples has fewer than twice as many points
    max_deflection : largest deflection that is used, m. The limit is at most `MAX_DEFLECTION_RATIO`
        times the free length; None for this limit
    report_name : function that is called with the name of each test before it is read

    Returns
    -------
    loadings : first loadings of the tests
    reasons_by_file : reason why a test is not used, keyed by the path of its file
    """
    loadings: list[FirstLoading] = []
    reasons_by_file: dict[str, str] = {}
    for file in files:
        report_name(file.parent.name)
        try:
            result = read_stages(file)
            protocol = parse_protocol(result.protocol_yaml, str(file))
            loading = extract_first_loading(result, protocol, min_points, max_deflection)
            loadings.append(replace(loading, file=file))
        except LabpipeError as error:
            message = str(error)
            reasons_by_file[str(file)] = message if str(file) in message else f"{file}: {message}"
    return loadings, reasons_by_file


def extract_first_loading(
    result: TestResult, protocol: Protocol, min_points: int, max_deflection: float | None = None
) -> FirstLoading:
    """Extract the first loading of a processed test.

    Parameters
    ----------
    result : result of a cantilever test
    protocol : protocol with which the test was processed
    min_points, max_deflection : minimum number of points of the curve, and largest deflection, m,
        as for `read_first_loadings`

    Returns
    -------
    The first loading up to the largest deflection. The force excludes the counterweight, because
    the load cell is zeroed while the string holds the wire straight. If the test does not show
    whether the wire was straight, the loading has a note.

    Raises
    ------
    NotUsableError
        If the test is not a cantilever test; if it has no zero at rest, no curve, no first loading
        or no free length; if its first peak failed; if fewer than 20 points are used; or if the
        wire sagged at rest.

    Notes
    -----
    The noise of force and deflection is estimated from second differences of the block means. The
    noise of the deflection is multiplied by the slope of the curve and added in quadrature.
    """
    min_used_points = 20
    if protocol.rig.string is None and not any(isinstance(s, FitShape) for s in protocol.steps):
        raise NotUsableError.of("mechanics.studies.no_cantilever", protocol=protocol.name)
    curve, branch = _find_first_branch(result)
    rest_notes = _make_rest_notes(result, curve, branch, protocol)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        raise NotUsableError.of("mechanics.studies.no_length")
    limit = min(max_deflection or np.inf, MAX_DEFLECTION_RATIO * length)
    loading_rows = slice(branch.start, branch.stop)
    deflection = average_blocks(curve.displacement[loading_rows], min_points)
    force = average_blocks(curve.force[loading_rows], min_points)
    is_finite = np.isfinite(deflection) & np.isfinite(force)
    is_used = is_finite & (deflection > 0.0) & (deflection <= limit)
    if is_used.sum() < min_used_points:
        raise NotUsableError.of(
            "mechanics.studies.few_points",
            count=int(is_used.sum()),
            limit_mm=1e3 * limit,
            minimum=min_used_points,
        )
    rig, string = None, protocol.rig.string
    if string is not None:
        rig = StringRig(string.length, GRAVITY * string.counterweight, length, string.length)
    common_scale_error, test_scale_error = estimate_scale_errors(result)
    measured = MeasuredCurve(
        wire=result.specimen.type,
        test=result.test,
        sample=f"{result.specimen.spool}, sample {result.specimen.sample}",
        length=length,
        deflection=deflection[is_used],
        force=force[is_used],
        noise=_estimate_point_noise(deflection[is_finite], force[is_finite])[is_used[is_finite]],
        rig=rig,
        zero_error=estimate_force_zero_error(protocol, curve, branch),
        offset_error=estimate_offset_error(result, protocol, curve, branch),
        scale_error=common_scale_error,
        curve_scale_error=test_scale_error,
        self_weight=_get_self_weight(protocol),
    )
    channel = None if protocol.curve is None else protocol.channels.get(protocol.curve.force)
    gain_uncertainty = 0.0 if channel is None else channel.gain_uncertainty
    cycles, cycle_notes = extract_cycle_measures(result, measured)
    notes = [*_make_doubt_notes(result), *rest_notes]
    largest_deflection = float(np.max(deflection[is_finite]))
    if largest_deflection > limit:
        deflections = {"largest_mm": 1e3 * largest_deflection, "limit_mm": 1e3 * limit}
        notes.append(QualityNote.of("mechanics.studies.loading_cut", result.test, **deflections))
    return FirstLoading(measured, gain_uncertainty, (*notes, *cycle_notes), cycles=cycles)


def extract_cycle_measures(
    result: TestResult, curve: MeasuredCurve
) -> tuple[CycledTest | None, tuple[QualityNote, ...]]:
    """Extract residual deflection, energy and peak ratio from the results with the status `ok`.

    Parameters
    ----------
    result : result of a cantilever test
    curve : first loading of the test

    Returns
    -------
    cycles : residual deflection and energy of the first cycle, and the ratio of the second to the
        first peak force if both cycles reach the same deflection within 1 %; None without a first
        peak
    notes : a note if the peak deflections differ by more than 1 %
    """
    max_peak_change = 0.01  # relative; a larger change of the deflection affects the second force
    results = {item.name: item for item in result.results if item.status is Status.OK}
    first_peak, second_peak = (results.get(f"peak_displacement.{cycle}") for cycle in (1, 2))
    if first_peak is None or not first_peak.value:
        return None, ()
    # The value and the standard error of each measure, keyed by its name.
    measures: dict[str, tuple[float, float]] = {}
    for name, key in ((RESIDUAL, "residual_displacement.1"), (ENERGY, "energy.1")):
        item = results.get(key)
        if item is not None and item.value is not None and item.interval is not None:
            measures[name] = item.value, item.interval.standard_error
    second_deflection = (second_peak.value or 0.0) if second_peak else np.nan
    peak_change = second_deflection / first_peak.value - 1.0
    notes: tuple[QualityNote, ...] = ()
    if abs(peak_change) > max_peak_change:
        notes = (QualityNote.of("mechanics.studies.cycles_grow", result.test, change=peak_change),)
    peak_results = [results.get(f"peak_force.{cycle}") for cycle in (1, 2)]
    peak_forces = [peak.value if peak and peak.value else np.nan for peak in peak_results]
    ratio = peak_forces[1] / peak_forces[0]
    if abs(peak_change) <= max_peak_change and np.isfinite(ratio):
        relative_errors = [
            _compute_test_error(peak) / force
            for peak, force in zip(peak_results, peak_forces, strict=True)
        ]
        measures[RATIO] = ratio, abs(ratio) * hypot(*relative_errors)
    peak, rig, self_weight = first_peak.value, curve.rig, curve.self_weight
    return CycledTest(result.test, curve.length, peak, measures, rig, self_weight), notes


def _compute_test_error(result: Result | None) -> float:
    """Compute the standard error of a result without the causes common to all tests of a rig.

    Without an interval, the error is 0. Without a budget, it is the standard error of the interval.
    """
    if result is None or result.interval is None:
        return 0.0
    if not result.budget:
        return result.interval.standard_error
    return hypot(*(row.change for row in result.budget if not row.is_common))


def estimate_noise(values: Floats) -> float:
    """Estimate the standard deviation of the noise of consecutive values on a smooth curve.

    Parameters
    ----------
    values : shape (n,), consecutive values without NaN

    Returns
    -------
    Standard deviation in the unit of the values.
    """
    # The standard deviation of the second difference of white noise is sqrt(6) times that of the
    # noise.
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0))


def _estimate_point_noise(deflection: Floats, force: Floats) -> Floats:
    """Estimate the noise of the force, N, at each point, including the noise of the deflection.

    The slope of the curve is that of a polynomial in the square root of the deflection, because the
    curve is several times steeper at its start, where strands still stick.
    """
    polynomial_degree = 7
    mean_spacing = float(np.ptp(deflection)) / len(deflection)
    root = np.sqrt(np.maximum(deflection, 0.5 * mean_spacing))
    slope = Polynomial.fit(root, force, polynomial_degree).deriv()(root) / (2.0 * root)
    return np.hypot(estimate_noise(force), slope * estimate_noise(deflection))


def _make_rest_notes(
    result: TestResult, curve: Curve, branch: Branch, protocol: Protocol
) -> tuple[QualityNote, ...]:
    """Return notes if the test does not show whether the wire sagged at rest.

    Raises
    ------
    NotUsableError
        If the wire sagged.
    """
    string = protocol.rig.string
    if string is None or string.at_rest == "taut":
        return ()
    counterweight, length = GRAVITY * string.counterweight, protocol.specimen.length
    prop_force = compute_prop_force(_get_self_weight(protocol), length or 0.0)
    if counterweight + prop_force == 0.0:
        return ()
    evidence = collect_rest_evidence(
        result.aligned, result.shape, curve, branch, counterweight, wire_load=prop_force
    )
    if sag_message := evidence.bend_at_rest:
        raise NotUsableError.of("mechanics.studies.sagged", reason=sag_message)
    return tuple(list_rest_notes(result.test, evidence))


def _get_self_weight(protocol: Protocol) -> float:
    """Return the weight per length in the protocol or test sheet, N/m; 0 if it is not stated."""
    return GRAVITY * (protocol.specimen.mass_per_length or 0.0)


def set_self_weight(loading: FirstLoading, self_weight: float) -> FirstLoading:
    """Set the weight of a wire if its test sheet does not state one.

    Parameters
    ----------
    loading : first loading of a test
    self_weight : weight per length of the wire in the wire sheet, N/m

    Returns
    -------
    The loading with a weight. If test sheet and wire sheet both state a weight and the ratio of the
    weights is outside 3/4 to 4/3, the loading has a note ``mass_contradicts``.
    """
    max_weight_ratio = 4.0 / 3.0
    test_weight, curve = loading.curve.self_weight, loading.curve
    if test_weight == 0.0:
        cycles = loading.cycles and replace(loading.cycles, self_weight=self_weight)
        return replace(loading, curve=replace(curve, self_weight=self_weight), cycles=cycles)
    if 1.0 / max_weight_ratio <= test_weight / self_weight <= max_weight_ratio:
        return loading
    note = QualityNote.of(
        "mechanics.studies.mass_contradicts",
        curve.test,
        test_mass=1e3 * test_weight / GRAVITY,
        sheet_mass=1e3 * self_weight / GRAVITY,
        wire=curve.wire,
    )
    return replace(loading, notes=(*loading.notes, note))


def make_sheet_weight_notes(
    loadings: Sequence[FirstLoading], wire: str, self_weight: float
) -> Iterator[QualityNote]:
    """Yield a note if test sheets state no weight, so that the weight of the wire sheet is used.

    Parameters
    ----------
    loadings : first loadings of all tests, before `set_self_weight`
    wire : name of the wire whose tests are noted
    self_weight : weight per length of the wire in the wire sheet, N/m
    """
    curves = [loading.curve for loading in loadings if loading.curve.wire == wire]
    n_without_weight = sum(curve.self_weight == 0.0 for curve in curves)
    if n_without_weight:
        yield QualityNote.of(
            "mechanics.studies.weight_of_sheet",
            wire,
            n_without_weight=n_without_weight,
            n_tests=len(curves),
            mass=1e3 * self_weight / GRAVITY,
        )


def _find_first_branch(result: TestResult) -> tuple[Curve, Branch]:
    """Find the curve and the first loading branch of a test.

    Raises
    ------
    NotUsableError
        If the test has no curve or no first loading, if its first peak failed, or if force or
        deflection has no zero at rest.

    Notes
    -----
    A calibration cannot detect a missing zero. A shifted curve fits nearly as well, with more than
    twice the friction, because friction acts within the first fraction of a millimetre.
    """
    zero_codes = ("zero_not_at_rest", "begins_under_load")
    notes = [note for note in result.quality if note.code in zero_codes]
    if notes:
        reasons = "; ".join(f"{note.where}: {note.message} ({note.code})" for note in notes)
        raise NotUsableError.of("mechanics.studies.no_zero", reasons=reasons)
    curve = result.curve
    if curve is None:
        raise NotUsableError.of("mechanics.studies.no_curve")
    first_branches = [b for b in curve.branches if (b.cycle, b.direction) == (1, Direction.LOADING)]
    if not first_branches:
        raise NotUsableError.of("mechanics.studies.no_first_loading")
    peak = find_result(result.results, "peak_force.1")
    if peak is not None and peak.status is Status.FAILED:
        raise NotUsableError.of("mechanics.studies.failed_first_loading", reasons=peak.reason_text)
    return curve, first_branches[0]


def _make_doubt_notes(result: TestResult) -> list[QualityNote]:
    """Make notes on the doubtful results of the first cycle that depend on the whole curve."""
    reasons = {
        item.reason_text
        for item in result.results
        if item.status is Status.DOUBTFUL
        and item.name in ("peak_force.1", "peak_displacement.1", "energy.1")
    }
    return [
        QualityNote.of("mechanics.studies.test_doubtful", result.test, reason=reason)
        for reason in sorted(reasons)
    ]
