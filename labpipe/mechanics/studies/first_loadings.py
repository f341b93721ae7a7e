"""Extract the first loadings of cantilever tests for a calibration, with their errors.

Systematic errors do not average out over the points as noise does. An error of the force zero
shifts the curve in force; errors of the deflection zero and of the clock shift it in deflection; an
error of the fitted shape is proportional to the deflection and the same in all tests of a rig.
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


def estimate_force_zero_error(protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Estimate the standard error of the force zero, N, from the force at rest.

    Parameters
    ----------
    protocol : protocol of the test
    curve, first : curve of the test, and its first loading branch

    Returns
    -------
    0 if the test has fewer than four samples at rest before its loading.
    """
    at_rest, force = slice(0, first.start), protocol.curve and protocol.curve.force
    zeros = (step for step in protocol.steps if isinstance(step, Zero))
    durations = [step.over for step in zeros if step.channel == force]
    return estimate_zero_error(curve.time[at_rest], curve.force[at_rest], *durations[:1])


def estimate_place_error(
    result: TestResult, protocol: Protocol, curve: Curve, first: Branch
) -> float:
    """Estimate the standard error of the shift of all deflections, m.

    Parameters
    ----------
    result, protocol : result and protocol of the test
    curve, first : curve of the test, and its first loading branch

    Returns
    -------
    Root sum of squares of two errors: that of the deflection zero, and that of the clock of the
    force times the speed of the deflection. The latter is 0 for a test with a single clock, or if
    it is unknown.
    """
    at_rest = slice(0, first.start)
    durations = [step.over for step in protocol.steps if isinstance(step, SpecimenFrame)]
    zero = estimate_zero_error(curve.time[at_rest], curve.displacement[at_rest], *durations[:1])
    fit = None if result.aligned is None else result.aligned.clock_fit
    clock = 0.0 if fit is None else fit.offset_interval.standard_error
    loading_rows = slice(first.start, first.stop)
    valid = np.flatnonzero(np.isfinite(curve.displacement[loading_rows]))
    if len(valid) < 2 or not np.isfinite(clock):
        return zero
    ends = first.start + valid[[0, -1]]
    speed = np.diff(curve.displacement[ends])[0] / np.diff(curve.time[ends])[0]
    return float(np.hypot(zero, clock * speed))


def estimate_scale_errors(result: TestResult) -> tuple[float, float]:
    """Return the relative standard errors of the scale of the deflection.

    Parameters
    ----------
    result : result of the test

    Returns
    -------
    common_error : error common to all tests: scale of the cameras, and choice of the fitted shape
    test_error : error of this test alone, from the offsets of its markers

    Notes
    -----
    From the budget of the first peak. Without a budget, as in files of earlier versions, the whole
    interval counts as common; without an interval both are 0.
    """
    peak = find_result(result.results, "peak_displacement.1")
    if peak is None or peak.interval is None or not peak.value:
        return 0.0, 0.0
    size = abs(peak.value)
    if not peak.budget:
        return peak.interval.standard_error / size, 0.0
    changes = {contribution.cause: contribution.change / size for contribution in peak.budget}
    common, own = (SHAPE, SCALE_OF_DISPLACEMENT), (GRIP, PULL, CENTRE)
    errors = [hypot(*(changes.get(cause, 0.0) for cause in causes)) for causes in (common, own)]
    return errors[0], errors[1]


def estimate_zero_error(time: Floats, values: Floats, duration: float | None = None) -> float:
    """Estimate the standard error of a zero, the mean of values over part of the time at rest.

    Parameters
    ----------
    time : shape (n,), s, evenly sampled
    values : shape (n,), at rest; NaN are ignored
    duration : s, of the part; None for the whole time at rest

    Returns
    -------
    The error in the unit of the values; 0 for fewer than four values.

    Notes
    -----
    The long-run variance over the whole time at rest (`estimate_long_run_variance`) is divided by
    the number of values in the part.
    """
    valid = values[~np.isnan(values)]
    variance = estimate_long_run_variance(valid, parameters=1)
    if np.isnan(variance):
        return 0.0
    total_duration = float(time[-1] - time[0])
    share = 1.0 if duration is None else min(duration / total_duration, 1.0)
    return float(np.sqrt(variance / (share * len(valid))))


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """The first loading of a processed test.

    Parameters
    ----------
    curve : first loading with its errors
    gain : relative standard uncertainty of the load cell's gain
    notes : on doubtful results, and on points that were left out
    file : result.h5 of the test
    cycles : residual deflection, energy and peak ratio; None without a first peak
    """

    curve: MeasuredCurve
    gain: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()
    cycles: CycledTest | None = None


class NotUsableError(LabpipeError):
    """A test that a calibration cannot use; the message states the reason."""

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
    points : approximate number per curve; each point is a mean of consecutive samples
    up_to : m, largest deflection to use, at most `MAX_DEFLECTION` times the length; None for this
        limit
    say : called with the name of each test as it is read

    Returns
    -------
    The first loadings, and the reason for each test that was left out, by file.
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
    points, up_to : as for `read_first_loadings`

    Returns
    -------
    The curve up to its largest deflection. The force excludes the counterweight, because the load
    cell is zeroed while the string holds the wire straight. If the test does not show whether the
    wire was straight, a note says so.

    Raises
    ------
    NotUsableError
        If it is no cantilever test; if it has no zero at rest, no curve, no first loading or no
        free length; if it has fewer than 20 points; or if its wire sagged at rest.

    Notes
    -----
    The noise of a point is estimated from second differences of the block means: those of the
    force, and those of the deflection times the slope of the curve.
    """
    min_points = 20
    if protocol.rig.string is None and not any(isinstance(s, FitShape) for s in protocol.steps):
        raise NotUsableError.of("mechanics.studies.no_cantilever", protocol=protocol.name)
    _require_zeros(result)
    curve, branch = _find_first_branch(result)
    rest_notes = _check_rest(result, curve, branch, protocol)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        raise NotUsableError.of("mechanics.studies.no_length")
    limit = min(up_to or np.inf, MAX_DEFLECTION * length)
    loading_rows = slice(branch.start, branch.stop)
    deflection = average_blocks(curve.displacement[loading_rows], points)
    force = average_blocks(curve.force[loading_rows], points)
    usable = np.isfinite(deflection) & np.isfinite(force)
    inside = usable & (deflection > 0.0) & (deflection <= limit)
    if inside.sum() < min_points:
        raise NotUsableError.of(
            "mechanics.studies.few_points",
            count=int(inside.sum()),
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
        deflection=deflection[inside],
        force=force[inside],
        noise=_estimate_point_noise(deflection[usable], force[usable])[inside[usable]],
        rig=rig,
        zero_error=estimate_force_zero_error(protocol, curve, branch),
        place_error=estimate_place_error(result, protocol, curve, branch),
        scale_error=common_scale_error,
        own_scale_error=test_scale_error,
        self_weight=_read_self_weight(protocol),
    )
    channel = None if protocol.curve is None else protocol.channels.get(protocol.curve.force)
    gain = 0.0 if channel is None else channel.gain_uncertainty
    cycles, cycle_notes = read_cycles(result, measured)
    notes = (
        *_note_doubts(result),
        *rest_notes,
        *_note_cut(result.test, deflection[usable], limit),
        *cycle_notes,
    )
    return FirstLoading(measured, gain, notes, cycles=cycles)


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
    Residual deflection and energy of the first cycle, and the ratio of second to first peak force
    if both cycles reach the same deflection within 1 %, or a note if they do not. None without a
    first peak.
    """
    max_growth = 0.01  # of the deflection between cycles; larger growth changes the second peak
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
            compute_unshared_error(force) / value
            for force, value in zip(forces, values, strict=True)
        ]
        measures[RATIO] = ratio, abs(ratio) * hypot(*errors)
    cycles = CycledTest(
        result.test, curve.length, peak.value, measures, curve.rig, curve.self_weight
    )
    return cycles, notes


def compute_unshared_error(number: Result | None) -> float:
    """Compute the standard error of a number without the causes common to all tests of a rig.

    It is 0 without an interval, and the whole error without a budget.
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
    values : shape (n,), without NaN
    """
    # the second difference of white noise has sqrt(6) times its standard deviation
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0))


def _estimate_point_noise(deflection: Floats, force: Floats) -> Floats:
    """Estimate the noise of the force at each point, including that of the deflection, N.

    The slope is that of a polynomial in the square root of the deflection, because the curve is
    several times steeper at its start, where strands still stick.
    """
    polynomial_degree = 7
    mean_spacing = float(np.ptp(deflection)) / len(deflection)
    root = np.sqrt(np.maximum(deflection, 0.5 * mean_spacing))
    slope = Polynomial.fit(root, force, polynomial_degree).deriv()(root) / (2.0 * root)
    return np.hypot(estimate_noise(force), slope * estimate_noise(deflection))


def _check_rest(
    result: TestResult, curve: Curve, branch: Branch, protocol: Protocol
) -> tuple[QualityNote, ...]:
    """Raise an error for a wire that sagged at rest; return notes if that is unclear."""
    string = protocol.rig.string
    if string is None or string.at_rest == "taut":
        return ()
    weight, length = GRAVITY * string.counterweight, protocol.specimen.length
    sag_weight = compute_prop_force(_read_self_weight(protocol), length or 0.0)
    if weight + sag_weight == 0.0:
        return ()
    evidence = collect_rest_evidence(
        result.aligned, result.shape, curve, branch, weight, own_weight=sag_weight
    )
    if evidence.bend_at_rest:
        raise NotUsableError.of("mechanics.studies.sagged", reason=evidence.bend_at_rest)
    return tuple(list_rest_notes(result.test, evidence))


def _read_self_weight(protocol: Protocol) -> float:
    """Return the weight per length in protocol or test sheet, N/m; 0 if none is stated."""
    return GRAVITY * (protocol.specimen.mass_per_length or 0.0)


def set_self_weight(loading: FirstLoading, self_weight: float) -> FirstLoading:
    """Set the weight of a wire if its test sheet does not state one.

    Parameters
    ----------
    loading : first loading of a test
    self_weight : N/m, weight per length of the wire in the wire sheet

    Returns
    -------
    The loading with a weight. If test sheet and wire sheet both state one and they differ by more
    than a third, it has a note ``mass_contradicts``.
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
    self_weight : N/m, weight per length in the wire sheet
    """
    curves = [loading.curve for loading in loadings]
    count = sum(curve.self_weight == 0.0 for curve in curves)
    if count:
        yield QualityNote.of(
            "mechanics.studies.weight_of_sheet",
            curves[0].wire,
            count=count,
            of=len(curves),
            mass=1e3 * self_weight / GRAVITY,
        )


_NO_ZERO = ("zero_not_at_rest", "begins_under_load")
"""Codes of notes on a test whose force or deflection does not start at rest."""


def _require_zeros(result: TestResult) -> None:
    """Raise an error for a test whose force or deflection has no zero at rest.

    Notes
    -----
    A calibration cannot detect a lost zero. A shifted curve fits nearly as well, with more than
    twice the friction, because friction acts within the first fraction of a millimetre.
    """
    notes = [note for note in result.quality if note.code in _NO_ZERO]
    if notes:
        reasons = "; ".join(f"{note.where}: {note.message} ({note.code})" for note in notes)
        raise NotUsableError.of("mechanics.studies.no_zero", reasons=reasons)


def _find_first_branch(result: TestResult) -> tuple[Curve, Branch]:
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
    """Return notes on doubtful results of the first cycle that depend on the whole curve."""
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


def _note_cut(test: str, deflection: Floats, limit: float) -> list[QualityNote]:
    beyond = deflection > limit
    if not beyond.any():
        return []
    end, limit = 1e3 * float(deflection.max()), 1e3 * limit
    return [QualityNote.of("mechanics.studies.loading_cut", test, end=end, limit=limit)]
