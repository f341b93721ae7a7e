"""First loadings of processed cantilever tests for a calibration, with their systematic errors.

These errors do not average out over the points as noise does. An error of the force zero shifts the
curve in force; errors of the deflection zero and of the clock shift it in deflection; an error of
the fitted shape is proportional to the deflection and the same in all tests of a rig.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial

from labpipe.errors import LabpipeError
from labpipe.mechanics.wire.calibration.measured_curves import DEEPEST, MeasuredCurve
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.wire_table import straight_range
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.causes import CENTRE, GRIP, PULL, SCALE_OF_DISPLACEMENT, SHAPE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import FitShape, SpecimenFrame, Zero
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Status, TestResult
from labpipe.records.wire import WireSpec
from labpipe.results.beam import compute_prop_force
from labpipe.results.moment_curvature import collect_rest_evidence, list_rest_notes
from labpipe.store.read import read_stages
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance
from labpipe.units import GRAVITY


def force_zero_error(protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Return the standard error of the force zero, N.

    Parameters
    ----------
    protocol : of the test
    curve, first : of the test, and its first loading branch

    Returns
    -------
    From the scatter of the force at rest; 0 where the test has no rest before its loading.
    """
    rest, force = slice(0, first.start), protocol.curve and protocol.curve.force
    zeroed = (step for step in protocol.steps if isinstance(step, Zero) and step.channel == force)
    duration = next((step.over for step in zeroed), None)  # duration of the mean, s
    return zero_error(curve.time[rest], curve.force[rest], duration)


def place_error(result: TestResult, protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Return the standard error of the shift of all deflections, m.

    Parameters
    ----------
    result, protocol : of the test
    curve, first : of the result, and its first loading branch

    Returns
    -------
    That of the deflection zero, as `force_zero_error`, combined with that of the clock of the force
    times the speed of the deflection; the latter is 0 where there is one clock only.
    """
    rest = slice(0, first.start)
    frames = (step for step in protocol.steps if isinstance(step, SpecimenFrame))
    duration = next((step.over for step in frames), None)  # duration of the reference, s
    zero = zero_error(curve.time[rest], curve.displacement[rest], duration)
    fit = None if result.aligned is None else result.aligned.clock_fit
    clock = 0.0 if fit is None else fit.offset_interval.standard_error
    return float(np.hypot(zero, (clock if np.isfinite(clock) else 0.0) * _speed(curve, first)))


def scale_errors(result: TestResult) -> tuple[float, float]:
    """Return the standard errors of the scale of the deflection, as ratios.

    Parameters
    ----------
    result : of the test

    Returns
    -------
    common : the same in all tests: scale of the cameras, and effect of another fitted shape on the
        first peak
    test_error : of this test alone, by the places of its markers

    Notes
    -----
    From the budget of the first peak. Without a budget, as in files of earlier versions, the whole
    interval counts as common; without an interval both are 0.
    """
    peak = next((result for result in result.results if result.name == "peak_displacement.1"), None)
    if peak is None or peak.interval is None or not peak.value:
        return 0.0, 0.0
    size = abs(peak.value)
    if not peak.budget:
        return peak.interval.standard_error / size, 0.0
    changes = {contribution.cause: contribution.change / size for contribution in peak.budget}
    common, test_error = (
        hypot(*(changes.get(cause, 0.0) for cause in causes))
        for causes in ((SHAPE, SCALE_OF_DISPLACEMENT), (GRIP, PULL, CENTRE))
    )
    return common, test_error


def zero_error(time: Floats, values: Floats, duration: float | None) -> float:
    """Return the standard error of a zero, the mean over part of a rest, in the unit of values.

    Parameters
    ----------
    time : shape (n,), s, evenly sampled
    values : shape (n,), at rest; NaN are ignored
    duration : s, of the part; None for all of it

    Returns
    -------
    0 for fewer than four values.

    Notes
    -----
    Long-run variance of the whole rest (`estimate_long_run_variance`) over the number of values in
    the part.
    """
    valid = values[~np.isnan(values)]
    variance = estimate_long_run_variance(valid, parameters=1)
    if np.isnan(variance):
        return 0.0
    lasts = float(time[-1] - time[0])
    share = 1.0 if duration is None else min(duration / lasts, 1.0)
    return float(np.sqrt(variance / (share * len(valid))))


def _speed(curve: Curve, first: Branch) -> float:
    """Return the mean speed of the deflection over the branch, m/s."""
    part = slice(first.start, first.stop)
    valid = np.flatnonzero(np.isfinite(curve.displacement[part]))
    if len(valid) < 2:
        return 0.0
    begin, end = valid[0] + first.start, valid[-1] + first.start
    moved = curve.displacement[end] - curve.displacement[begin]
    return float(moved / (curve.time[end] - curve.time[begin]))


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """The first loading of a processed test.

    Parameters
    ----------
    curve : for a calibration
    gain : standard uncertainty of the load cell's gain, as a ratio
    notes : doubts, and what was cut off
    file : that it was read from
    """

    curve: MeasuredCurve
    gain: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()


class NotUsableError(LabpipeError):
    """A test without a first loading for a calibration; the message has the reason."""


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
    points : of each curve, approximately; each is the mean of consecutive samples
    up_to : m, largest deflection to use; None for `DEEPEST` of the length
    say : called with the name of each test as it is read

    Returns
    -------
    The curves, and by file why a test was left out.
    """
    loadings: list[FirstLoading] = []
    left_out: dict[str, str] = {}
    for file in files:
        say(file.parent.name)
        try:
            result = read_stages(file)
            protocol = parse_protocol(result.protocol_yaml, str(file))
            loading = first_loading(result, protocol, points=points, up_to=up_to)
            loadings.append(replace(loading, file=file))
        except LabpipeError as error:
            message = str(error)
            left_out[str(file)] = message if str(file) in message else f"{file}: {message}"
    return loadings, left_out


def first_loading(
    result: TestResult, protocol: Protocol, *, points: int, up_to: float | None = None
) -> FirstLoading:
    """Return the first loading of a processed test.

    Parameters
    ----------
    result : of a cantilever test
    protocol : of its processing
    points, up_to : as for `read_first_loadings`

    Returns
    -------
    The curve up to its largest deflection. The string is assumed to hold the wire straight at rest,
    so that the load cell, zeroed then, reads the force beyond the counterweight; a test that does
    not show whether it did has a note.

    Raises
    ------
    NotUsableError
        If it is no cantilever test, or has no zero of force and deflection, no curve, no first
        loading, no free length, too few points, or a wire that sagged at rest.

    Notes
    -----
    The noise of a point is that of the second differences of the block means: of the force, and of
    the deflection times the slope of the curve. Errors common to all points are separate:
    `force_zero_error`, `place_error`, `scale_errors`.
    """
    min_points = 20
    _require_cantilever(protocol)
    _require_zeros(result)
    curve, branch = _first_branch(result)
    rest_notes = _rest_notes(result, curve, branch, protocol)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        message = "the free length is unknown: state it in the test sheet (specimen.length)"
        raise NotUsableError(message)
    limit = min(up_to or np.inf, DEEPEST * length)
    part = slice(branch.start, branch.stop)
    deflection = average_blocks(curve.displacement[part], points)
    force = average_blocks(curve.force[part], points)
    usable = np.isfinite(deflection) & np.isfinite(force)
    taken = usable & (deflection > 0.0) & (deflection <= limit)
    if taken.sum() < min_points:
        message = (
            f"{int(taken.sum())} points of the first loading lie between 0 and "
            f"{1e3 * limit:.3g} mm, at least {min_points} are required: increase the number of "
            "points or up_to"
        )
        raise NotUsableError(message)
    string, rig = protocol.rig.string, None
    if string is not None:
        weight = GRAVITY * string.counterweight
        rig = StringRig(string.length, weight, length, string.length)
    sample = f"{result.specimen.spool}, sample {result.specimen.sample}"
    common_scale_error, test_scale_error = scale_errors(result)
    measured = MeasuredCurve(
        wire=result.specimen.type,
        test=result.test,
        sample=sample,
        length=length,
        deflection=deflection[taken],
        force=force[taken],
        noise=_noise(deflection[usable], force[usable])[taken[usable]],
        rig=rig,
        zero_error=force_zero_error(protocol, curve, branch),
        place_error=place_error(result, protocol, curve, branch),
        scale_error=common_scale_error,
        own_scale_error=test_scale_error,
        self_weight=_self_weight(protocol),
    )
    notes = (
        *_doubt_notes(result),
        *rest_notes,
        *_cut_notes(result.test, deflection[usable], limit),
    )
    channel = None if protocol.curve is None else protocol.channels.get(protocol.curve.force)
    gain = 0.0 if channel is None else channel.gain_uncertainty
    return FirstLoading(measured, gain, notes)


def noise_of(values: Floats) -> float:
    """Return the standard deviation of the noise of consecutive values on a smooth curve.

    Parameters
    ----------
    values : shape (n,), without NaN
    """
    # the second difference of white noise has sqrt(6) times its standard deviation
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0))


def _noise(deflection: Floats, force: Floats) -> Floats:
    """Return the noise of the force at each point, with that of the deflection, N.

    The slope is that of a polynomial in the root of the deflection, as the first points, where
    strands still stick, are several times as steep as the next.
    """
    polynomial_degree = 7
    first = float(np.ptp(deflection)) / len(deflection)
    root = np.sqrt(np.maximum(deflection, 0.5 * first))
    slope = Polynomial.fit(root, force, polynomial_degree).deriv()(root) / (2.0 * root)
    return np.hypot(noise_of(force), slope * noise_of(deflection))


_STRING_REMEDY = (
    "For the next test shorten the string until it holds the wire straight; if it did in this "
    "test, state so in the test sheet (rig.string.at_rest: taut) and process it again"
)


def _rest_notes(
    result: TestResult, curve: Curve, branch: Branch, protocol: Protocol
) -> tuple[QualityNote, ...]:
    """Refuse a wire that sagged at rest; return notes where that is unknown."""
    string = protocol.rig.string
    if string is None or string.at_rest == "taut":
        return ()
    weight, length = GRAVITY * string.counterweight, protocol.specimen.length
    sag_weight = compute_prop_force(_self_weight(protocol), length or 0.0)
    if weight + sag_weight == 0.0:
        return ()
    rest = collect_rest_evidence(
        result.aligned, result.shape, curve, branch, weight, own_weight=sag_weight
    )
    if rest.why_not_straight:
        message = f"{rest.why_not_straight}. {_STRING_REMEDY}"
        raise NotUsableError(message)
    return tuple(list_rest_notes(result.test, rest))


def _self_weight(protocol: Protocol) -> float:
    """Return the weight per length of protocol or test sheet, N/m; 0 where they have none."""
    return GRAVITY * (protocol.specimen.mass_per_length or 0.0)


def with_self_weight(loading: FirstLoading, self_weight: float) -> FirstLoading:
    """Set the weight of a wire where its test sheet does not state one.

    Parameters
    ----------
    loading : of a test
    self_weight : N/m, of the wire in the wire sheet

    Returns
    -------
    The same, with a note ``mass_contradicts`` if both are stated and differ by more than a third.
    """
    max_mass_ratio = 4.0 / 3.0
    stated_weight, curve = loading.curve.self_weight, loading.curve
    if stated_weight == 0.0:
        return replace(loading, curve=replace(curve, self_weight=self_weight))
    if 1.0 / max_mass_ratio <= stated_weight / self_weight <= max_mass_ratio:
        return loading
    message = (
        f"its test sheet states {1e3 * stated_weight / GRAVITY:.4g} g/m "
        f"(specimen.mass_per_length), the wire sheet {1e3 * self_weight / GRAVITY:.4g} g/m for "
        f"{curve.wire}: the former is used"
    )
    note = QualityNote("mass_contradicts", Severity.WARNING, curve.test, message)
    return replace(loading, notes=(*loading.notes, note))


def weight_note(loadings: Sequence[FirstLoading], self_weight: float) -> QualityNote | None:
    """Return a note on the weight of tests whose test sheets do not state one.

    Parameters
    ----------
    loadings : of one wire, as they were read
    self_weight : N/m, of the wire in the wire sheet
    """
    without = [loading.curve.test for loading in loadings if loading.curve.self_weight == 0.0]
    if not without:
        return None
    count = f"{len(without)} of {len(loadings)} test sheets do not state"
    which = "no test sheet states" if len(without) == len(loadings) else count
    message = (
        f"{which} a mass per length (specimen.mass_per_length): the weight is that of the wire "
        f"sheet, {1e3 * self_weight / GRAVITY:.4g} g/m, stated there or from copper and insulation"
    )
    return QualityNote("weight_of_sheet", Severity.INFO, loadings[0].curve.wire, message)


def insulation_note(spec: WireSpec, tested: float, *, of: str = "") -> QualityNote | None:
    """Return a note if tests bent a wire beyond the linear range of its insulation.

    Parameters
    ----------
    spec : of the wire
    tested : 1/m, largest curvature of its tests
    of : the calibrated wire; empty for that wire itself
    """
    limit = straight_range(spec)
    if tested <= limit:
        return None
    effect = "the parameters compensate for the softer insulation"
    remedy = "Add an insulation_table to the sheet, or a smaller up_to to the plan"
    if of:
        effect = f"predictions by the calibration of {of} are doubtful beyond"
        remedy = "Add an insulation_table to the sheet"
    message = (
        f"the tests bend {spec.name} to {tested:.3g} 1/m; from {limit:.3g} 1/m on its insulation "
        f"is strained by more than {100.0 * spec.insulation_strain:.3g} %, beyond its linear "
        f"range: {effect}. {remedy}"
    )
    return QualityNote("insulation_doubtful", Severity.WARNING, spec.name, message)


def _require_cantilever(protocol: Protocol) -> None:
    has_shape = any(isinstance(step, FitShape) for step in protocol.steps)
    if protocol.rig.string is None and not has_shape:
        message = (
            f"it is no cantilever test: its protocol, {protocol.name}, has neither a string "
            "(rig.string) nor a shape (step fit-shape)"
        )
        raise NotUsableError(message)


_NO_ZERO = ("zero_not_at_rest", "begins_under_load")
"""Codes of notes on a test whose force or deflection does not start at rest."""


def _require_zeros(result: TestResult) -> None:
    """Refuse a test without a zero at rest.

    Notes
    -----
    A calibration cannot detect it: a shifted curve fits nearly as well, with more than twice the
    friction, which acts in the first part of a millimetre.
    """
    lost = [note for note in result.quality if note.code in _NO_ZERO]
    if lost:
        reasons = "; ".join(f"{note.where}: {note.message} ({note.code})" for note in lost)
        message = f"its zero is lost, and with it the start of the first loading: {reasons}"
        raise NotUsableError(message)


def _first_branch(result: TestResult) -> tuple[Curve, Branch]:
    curve = result.curve
    if curve is None:
        message = "it has no curve: see its summary"
        raise NotUsableError(message)
    first = [
        branch
        for branch in curve.branches
        if branch.cycle == 1 and branch.direction is Direction.LOADING
    ]
    if not first:
        message = "it has no first loading: no branch was found"
        raise NotUsableError(message)
    peak = next((result for result in result.results if result.name == "peak_force.1"), None)
    if peak is not None and peak.status is Status.FAILED:
        message = f"its first loading failed: {peak.reason_text}"
        raise NotUsableError(message)
    return curve, first[0]


def _doubt_notes(result: TestResult) -> list[QualityNote]:
    """Return notes on doubtful results of the first cycle that depend on the whole curve."""
    reasons = {
        result.reason_text
        for result in result.results
        if result.status is Status.DOUBTFUL
        and result.name in ("peak_force.1", "peak_displacement.1", "energy.1")
    }
    return [
        QualityNote("test_doubtful", Severity.WARNING, result.test, f"used unchanged: {reason}")
        for reason in sorted(reasons)
    ]


def _cut_notes(test: str, deflection: Floats, limit: float) -> list[QualityNote]:
    beyond = deflection > limit
    if not beyond.any():
        return []
    message = (
        f"the first loading goes to {1e3 * deflection.max():.4g} mm; points beyond "
        f"{1e3 * limit:.4g} mm were left out"
    )
    return [QualityNote("loading_cut", Severity.INFO, test, message)]
