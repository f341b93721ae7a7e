"""Extract the first loadings of cantilever tests for a calibration, with their errors.

Systematic errors do not average out over the points as noise does. An error of the force zero
shifts the curve in force. Errors of the deflection zero and of the clock shift it in deflection. An
error of the fitted shape is proportional to the deflection and is the same in all tests of a rig.
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
from labpipe.mechanics.wire.calibration.measured_curves import MAX_DEFLECTION, MeasuredCurve
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
    rest_rows, force = slice(0, loading.start), protocol.curve and protocol.curve.force
    zeros = (step for step in protocol.steps if isinstance(step, Zero))
    durations = [step.over for step in zeros if step.channel == force]
    return estimate_zero_error(curve.time[rest_rows], curve.force[rest_rows], *durations[:1])


def estimate_shift_error(
    result: TestResult, protocol: Protocol, curve: Curve, loading: Branch
) -> float:
    """Estimate the standard error of the shift of all deflections.

    Parameters
    ----------
    result, protocol : result and protocol of the test
    curve : curve of the test
    loading : first loading branch of the curve

    Returns
    -------
    Standard error, m: root sum of squares of the error of the deflection zero and of the error of
    the clock of the force times the speed of the deflection. The latter is 0 for a test with a
    single clock, or if it is unknown.
    """
    rest_rows, loading_rows = slice(0, loading.start), slice(loading.start, loading.stop)
    durations = [step.over for step in protocol.steps if isinstance(step, SpecimenFrame)]
    rest_deflection = curve.displacement[rest_rows]
    zero_error = estimate_zero_error(curve.time[rest_rows], rest_deflection, *durations[:1])
    fit = None if result.aligned is None else result.aligned.clock_fit
    clock_error = 0.0 if fit is None else fit.offset_interval.standard_error
    finite_rows = np.flatnonzero(np.isfinite(curve.displacement[loading_rows]))
    if len(finite_rows) < 2 or not np.isfinite(clock_error):
        return zero_error
    ends = loading.start + finite_rows[[0, -1]]
    speed = np.diff(curve.displacement[ends])[0] / np.diff(curve.time[ends])[0]
    return float(np.hypot(zero_error, clock_error * speed))


def estimate_scale_errors(result: TestResult) -> tuple[float, float]:
    """Estimate the relative standard errors of the scale of the deflection.

    Parameters
    ----------
    result : result of the test

    Returns
    -------
    common_error : error common to all tests: scale of the cameras, and choice of the fitted shape
    test_error : error of this test only, from the offsets of its markers

    Notes
    -----
    The errors are those in the budget of the first peak. Without a budget, as in files of earlier
    versions, the whole interval counts as common. Without an interval, both errors are 0.
    """
    peak = find_result(result.results, "peak_displacement.1")
    if peak is None or peak.interval is None or not peak.value:
        return 0.0, 0.0
    size = abs(peak.value)
    if not peak.budget:
        return peak.interval.standard_error / size, 0.0
    changes = {contribution.cause: contribution.change / size for contribution in peak.budget}
    common_causes, test_causes = (SHAPE, SCALE_OF_DISPLACEMENT), (GRIP, PULL, CENTRE)
    common_error = hypot(*(changes.get(cause, 0.0) for cause in common_causes))
    return common_error, hypot(*(changes.get(cause, 0.0) for cause in test_causes))


def estimate_zero_error(time: Floats, values: Floats, duration: float | None = None) -> float:
    """Estimate the standard error of a zero, the mean of values over part of the time at rest.

    Parameters
    ----------
    time : shape (n,), time of evenly spaced samples at rest, s
    values : shape (n,), values at rest; NaN are ignored
    duration : duration of the part of the time at rest, s; None for the whole time

    Returns
    -------
    Standard error in the unit of the values; 0 for fewer than four values.

    Notes
    -----
    The long-run variance over the whole time at rest (`estimate_long_run_variance`) is divided by
    the number of values in the part.
    """
    finite_values = values[~np.isnan(values)]
    variance = estimate_long_run_variance(finite_values, parameters=1)
    if np.isnan(variance):
        return 0.0
    total_duration = float(time[-1] - time[0])
    fraction = 1.0 if duration is None else min(duration / total_duration, 1.0)
    return float(np.sqrt(variance / (fraction * len(finite_values))))


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """The first loading of a processed test.

    Parameters
    ----------
    curve : first loading with its errors
    gain : relative standard uncertainty of the gain of the load cell
    notes : notes on doubtful results, and on points that were left out
    file : path of the result.h5 of the test
    cycles : residual deflection, energy and peak ratio; None without a first peak
    """

    curve: MeasuredCurve
    gain: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()
    cycles: CycledTest | None = None


class NotUsableError(LabpipeError):
    """A test that a calibration cannot use; the message gives the reason."""

    @classmethod
    def of(cls, template: str, /, **facts: object) -> NotUsableError:
        """Make the error from a template and its facts."""
        return cls(format_sentence(template, **facts))


def read_first_loadings(
    files: Sequence[Path],
    *,
    points: int,
    up_to: float | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[list[FirstLoading], dict[str, str]]:
    """Read the first loadings of tests.

    Parameters
    ----------
    files : result.h5 files
    points : approximate number of points of a curve; each point is a mean of consecutive samples
    up_to : largest deflection that is used, m, at most `MAX_DEFLECTION` times the length; None for
        this limit
    say : function that is called with the name of each test as it is read

    Returns
    -------
    loadings : first loadings of the tests
    left_out : reason for each test that was left out, keyed by file
    """
    loadings: list[FirstLoading] = []
    left_out: dict[str, str] = {}
    for file in files:
        say(file.parent.name)
        try:
            result = read_stages(file)
            protocol = parse_protocol(result.protocol_yaml, str(file))
            loading = extract_first_loading(result, protocol, points=points, up_to=up_to)
            loadings.append(replace(loading, file=file))
        except LabpipeError as error:
            message = str(error)
            left_out[str(file)] = message if str(file) in message else f"{file}: {message}"
    return loadings, left_out


def extract_first_loading(
    result: TestResult, protocol: Protocol, *, points: int, up_to: float | None = None
) -> FirstLoading:
    """Extract the first loading of a processed test.

    Parameters
    ----------
    result : result of a cantilever test
    protocol : protocol of its processing
    points, up_to : number of points of the curve, and largest deflection, m, as for
        `read_first_loadings`

    Returns
    -------
    The curve up to its largest deflection. The force excludes the counterweight, because the load
    cell is zeroed while the string holds the wire straight. If the test does not show whether the
    wire was straight, the loading has a note.

    Raises
    ------
    NotUsableError
        If the test is not of a cantilever; if it has no zero at rest, no curve, no first loading or
        no free length; if it has fewer than 20 points; or if the wire sagged at rest.

    Notes
    -----
    The noise of a point is estimated from the second differences of the block means of the force,
    and of the block means of the deflection times the slope of the curve.
    """
    min_points = 20
    if protocol.rig.string is None and not any(isinstance(s, FitShape) for s in protocol.steps):
        raise NotUsableError.of("mechanics.studies.no_cantilever", protocol=protocol.name)
    curve, branch = _find_first_branch(result)
    rest_notes = _note_rest(result, curve, branch, protocol)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        raise NotUsableError.of("mechanics.studies.no_length")
    limit = min(up_to or np.inf, MAX_DEFLECTION * length)
    loading_rows = slice(branch.start, branch.stop)
    deflection = average_blocks(curve.displacement[loading_rows], points)
    force = average_blocks(curve.force[loading_rows], points)
    is_finite = np.isfinite(deflection) & np.isfinite(force)
    is_used = is_finite & (deflection > 0.0) & (deflection <= limit)
    if is_used.sum() < min_points:
        raise NotUsableError.of(
            "mechanics.studies.few_points",
            count=int(is_used.sum()),
            end=1e3 * limit,
            least=min_points,
        )
    string, rig = protocol.rig.string, None
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
        offset_error=estimate_shift_error(result, protocol, curve, branch),
        scale_error=common_scale_error,
        own_scale_error=test_scale_error,
        self_weight=_read_self_weight(protocol),
    )
    channel = None if protocol.curve is None else protocol.channels.get(protocol.curve.force)
    gain = 0.0 if channel is None else channel.gain_uncertainty
    cycles, cycle_notes = read_cycles(result, measured)
    notes = [*_note_doubts(result), *rest_notes]
    largest = float(np.max(deflection[is_finite]))
    if largest > limit:
        ends = {"end": 1e3 * largest, "limit": 1e3 * limit}
        notes.append(QualityNote.of("mechanics.studies.loading_cut", result.test, **ends))
    return FirstLoading(measured, gain, (*notes, *cycle_notes), cycles=cycles)


def read_cycles(
    result: TestResult, curve: MeasuredCurve
) -> tuple[CycledTest | None, tuple[QualityNote, ...]]:
    """Read residual deflection, energy and peak ratio from the results that are `ok`.

    Parameters
    ----------
    result : result of a cantilever test
    curve : first loading of the test

    Returns
    -------
    cycles : residual deflection and energy of the first cycle, and the ratio of the second to the
        first peak force if both cycles reach the same deflection within 1 %; None without a first
        peak
    notes : a note if the deflections differ by more
    """
    max_growth = 0.01  # growth of the deflection; larger growth changes the second peak
    numbers = {number.name: number for number in result.results if number.status is Status.OK}
    peak, second = (numbers.get(f"peak_displacement.{cycle}") for cycle in (1, 2))
    if peak is None or not peak.value:
        return None, ()
    measures: dict[str, tuple[float, float]] = {}
    for name, key in ((RESIDUAL, "residual_displacement.1"), (ENERGY, "energy.1")):
        number = numbers.get(key)
        if number is not None and number.value is not None and number.interval is not None:
            measures[name] = number.value, number.interval.standard_error
    growth = ((second.value or 0.0) / peak.value if second else np.nan) - 1.0
    notes: tuple[QualityNote, ...] = ()
    if abs(growth) > max_growth:
        notes = (QualityNote.of("mechanics.studies.cycles_grow", result.test, growth=growth),)
    forces = [numbers.get(f"peak_force.{cycle}") for cycle in (1, 2)]
    values = [force.value if force and force.value else np.nan for force in forces]
    ratio = values[1] / values[0]
    if abs(growth) <= max_growth and np.isfinite(ratio):
        errors = [
            _compute_unshared_error(force) / value
            for force, value in zip(forces, values, strict=True)
        ]
        measures[RATIO] = ratio, abs(ratio) * hypot(*errors)
    cycles = CycledTest(
        result.test, curve.length, peak.value, measures, curve.rig, curve.self_weight
    )
    return cycles, notes


def _compute_unshared_error(number: Result | None) -> float:
    """Compute the standard error of a number without the causes common to all tests of a rig.

    Without an interval, the error is 0. Without a budget, it is that of the whole interval.
    """
    if number is None or number.interval is None:
        return 0.0
    if not number.budget:
        return number.interval.standard_error
    own_causes = (cause for cause in number.budget if not cause.is_common)
    return hypot(*(cause.change for cause in own_causes))


def estimate_noise(values: Floats) -> float:
    """Estimate the standard deviation of the noise of consecutive values on a smooth curve.

    Parameters
    ----------
    values : shape (n,), consecutive values without NaN
    """
    # the second difference of white noise has sqrt(6) times its standard deviation
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0))


def _estimate_point_noise(deflection: Floats, force: Floats) -> Floats:
    """Estimate the noise of the force at each point, including the noise of the deflection, N.

    The slope of the curve is that of a polynomial in the square root of the deflection, because the
    curve is several times steeper at its start, where strands still stick.
    """
    polynomial_degree = 7
    mean_spacing = float(np.ptp(deflection)) / len(deflection)
    root = np.sqrt(np.maximum(deflection, 0.5 * mean_spacing))
    slope = Polynomial.fit(root, force, polynomial_degree).deriv()(root) / (2.0 * root)
    return np.hypot(estimate_noise(force), slope * estimate_noise(deflection))


def _note_rest(
    result: TestResult, curve: Curve, branch: Branch, protocol: Protocol
) -> tuple[QualityNote, ...]:
    """Return notes if it is unclear whether a wire sagged at rest; refuse a wire that did."""
    string = protocol.rig.string
    if string is None or string.at_rest == "taut":
        return ()
    weight, length = GRAVITY * string.counterweight, protocol.specimen.length
    sag_weight = compute_prop_force(_read_self_weight(protocol), length or 0.0)
    if weight + sag_weight == 0.0:
        return ()
    evidence = collect_rest_evidence(
        result.aligned, result.shape, curve, branch, weight, wire_load=sag_weight
    )
    if evidence.bend_at_rest:
        raise NotUsableError.of("mechanics.studies.sagged", reason=evidence.bend_at_rest)
    return tuple(list_rest_notes(result.test, evidence))


def _read_self_weight(protocol: Protocol) -> float:
    """Read the weight per length in the protocol or test sheet, N/m; 0 if it is not stated."""
    return GRAVITY * (protocol.specimen.mass_per_length or 0.0)


def set_self_weight(loading: FirstLoading, self_weight: float) -> FirstLoading:
    """Set the weight of a wire if its test sheet does not state one.

    Parameters
    ----------
    loading : first loading of a test
    self_weight : weight per length of the wire in the wire sheet, N/m

    Returns
    -------
    The loading with a weight. If test sheet and wire sheet both state a weight and the weights
    differ by more than a third, the loading has a note ``mass_contradicts``.
    """
    max_mass_ratio = 4.0 / 3.0
    stated_weight, curve = loading.curve.self_weight, loading.curve
    if stated_weight == 0.0:
        cycles = loading.cycles and replace(loading.cycles, self_weight=self_weight)
        return replace(loading, curve=replace(curve, self_weight=self_weight), cycles=cycles)
    if 1.0 / max_mass_ratio <= stated_weight / self_weight <= max_mass_ratio:
        return loading
    note = QualityNote.of(
        "mechanics.studies.mass_contradicts",
        curve.test,
        test_mass=1e3 * stated_weight / GRAVITY,
        sheet_mass=1e3 * self_weight / GRAVITY,
        wire=curve.wire,
    )
    return replace(loading, notes=(*loading.notes, note))


def note_sheet_weight(
    loadings: Sequence[FirstLoading], self_weight: float
) -> Iterator[QualityNote]:
    """Yield a note on the weight of tests whose test sheets do not state one.

    Parameters
    ----------
    loadings : first loadings of one wire, as read
    self_weight : weight per length of the wire in the wire sheet, N/m
    """
    curves = [loading.curve for loading in loadings]
    n_without_weight = sum(curve.self_weight == 0.0 for curve in curves)
    if n_without_weight:
        yield QualityNote.of(
            "mechanics.studies.weight_of_sheet",
            curves[0].wire,
            count=n_without_weight,
            of=len(curves),
            mass=1e3 * self_weight / GRAVITY,
        )


def _find_first_branch(result: TestResult) -> tuple[Curve, Branch]:
    """Find the curve and the first loading branch of a test.

    Notes
    -----
    A test without them, or without a zero of force and deflection at rest, is refused. A
    calibration cannot detect a lost zero. A shifted curve fits nearly as well, with more than twice
    the friction, because friction acts within the first fraction of a millimetre.
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


def _note_doubts(result: TestResult) -> list[QualityNote]:
    """Note the doubtful results of the first cycle that depend on the whole curve."""
    reasons = {
        result.reason_text
        for result in result.results
        if result.status is Status.DOUBTFUL
        and result.name in ("peak_force.1", "peak_displacement.1", "energy.1")
    }
    return [
        QualityNote.of("mechanics.studies.test_doubtful", result.test, reason=reason)
        for reason in sorted(reasons)
    ]
