"""First loadings of processed cantilever tests, as a calibration takes them, with their errors.

They do not average out over the points as noise does. The zero of the force moves a whole curve
up; the zero of the deflection, and a clock that is off, move it sideways; the shape that is put
through the markers is off in proportion to the deflection, and in all tests of a rig alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial

from labpipe.bending.bent_frames import held_at_rest
from labpipe.errors import LabpipeError
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.causes import CENTRE, GRIP, PULL, SCALE_OF_DISPLACEMENT, SHAPE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import FitShape, SpecimenFrame, Zero
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Status, TestResult
from labpipe.records.wire import WireSpec
from labpipe.results.moment_curvature import at_rest, notes_of
from labpipe.statistics.mean_curves import block_means
from labpipe.store.read import read_stages
from labpipe.uncertainty.autocorrelation import long_run_variance
from labpipe.units import GRAVITY
from labpipe.wire.calibration.measured_curves import DEEPEST, MeasuredCurve
from labpipe.wire.cantilever import StringRig
from labpipe.wire.wire_table import straight_range

_ALIKE, _OWN = (SHAPE, SCALE_OF_DISPLACEMENT), (GRIP, PULL, CENTRE)
"""Causes that stretch deflections in proportion: of all tests of a rig, and of each its own."""


def force_zero_error(protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Standard error of the zero of the force, N.

    Parameters
    ----------
    protocol : of the test
    curve, first : of the test, and its first loading branch

    Returns
    -------
    By how the force scatters at rest; 0 where the test has no rest before its loading.
    """
    rest, force = slice(0, first.start), protocol.curve and protocol.curve.force
    zeroed = (step for step in protocol.steps if isinstance(step, Zero) and step.channel == force)
    over = next((step.over for step in zeroed), None)  # the stretch that it is the mean of
    return zero_error(curve.time[rest], curve.force[rest], over)


def place_error(result: TestResult, protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Standard error of what all deflections are off by, m.

    Parameters
    ----------
    result, protocol : of the test
    curve, first : of the result, and its first loading branch

    Returns
    -------
    Of the zero of the deflection, as `force_zero_error`, and of the force's clock times the speed
    of the deflection; the clock's is 0 where there is but one.
    """
    rest = slice(0, first.start)
    frames = (step for step in protocol.steps if isinstance(step, SpecimenFrame))
    over = next((step.over for step in frames), None)  # that deflections are counted from
    zero = zero_error(curve.time[rest], curve.displacement[rest], over)
    fit = None if result.aligned is None else result.aligned.clock_fit
    clock = 0.0 if fit is None else fit.offset_interval.standard_error
    return float(np.hypot(zero, (clock if np.isfinite(clock) else 0.0) * _speed(curve, first)))


def scale_errors(result: TestResult) -> tuple[float, float]:
    """Standard errors of the deflection's scale, as ratios.

    Parameters
    ----------
    result : of the test

    Returns
    -------
    common : alike in all tests: scale of the cameras, and what another shape through the markers
        would make of the first peak
    own : of this test, whose markers sit where they do

    Notes
    -----
    From the budget of the first peak. Of a peak without one, as earlier versions stored it, all of
    its interval counts as common; without an interval nothing is known, and both are 0.
    """
    peak = next((result for result in result.results if result.name == "peak_displacement.1"), None)
    if peak is None or peak.interval is None or not peak.value:
        return 0.0, 0.0
    size = abs(peak.value)
    if not peak.budget:
        return peak.interval.standard_error / size, 0.0
    changes = {contribution.cause: contribution.change / size for contribution in peak.budget}
    common, test_error = (
        hypot(*(changes.get(cause, 0.0) for cause in causes)) for causes in (_ALIKE, _OWN)
    )
    return common, test_error


def zero_error(time: Floats, values: Floats, over: float | None) -> float:
    """Standard error of a zero that is the mean over part of a rest, in the unit of the values.

    Parameters
    ----------
    time : shape (n,), s, evenly sampled
    values : shape (n,), at rest; NaN count as absent
    over : s, of the part; None for all of it

    Returns
    -------
    0 for fewer than four values.

    Notes
    -----
    Long-run variance of the whole rest (`long_run_variance`) over the number of values in the part.
    """
    valid = values[~np.isnan(values)]
    variance = long_run_variance(valid, parameters=1)
    if np.isnan(variance):
        return 0.0
    lasts = float(time[-1] - time[0])
    share = 1.0 if over is None else min(over / lasts, 1.0)
    return float(np.sqrt(variance / (share * len(valid))))


def _speed(curve: Curve, first: Branch) -> float:
    """Mean speed of the deflection over the branch, m/s."""
    part = slice(first.start, first.stop)
    valid = np.flatnonzero(np.isfinite(curve.displacement[part]))
    if len(valid) < 2:
        return 0.0
    begin, end = valid[0] + first.start, valid[-1] + first.start
    moved = curve.displacement[end] - curve.displacement[begin]
    return float(moved / (curve.time[end] - curve.time[begin]))


_SECOND_DIFFERENCE = np.sqrt(6.0)
"""Standard deviation of a second difference of white noise, over that of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """The first loading of a processed test.

    Parameters
    ----------
    curve : as calibrations take it
    gain : standard uncertainty of the load cell's gain, as a ratio
    notes : what is doubtful about it, or was cut off
    file : that it was read from
    """

    curve: MeasuredCurve
    gain: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()


class NotUsableError(LabpipeError):
    """A test has no first loading that a calibration could take; the message says why."""


def read_first_loadings(
    files: Sequence[Path],
    *,
    points: int,
    up_to: float | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[list[FirstLoading], dict[str, str]]:
    """Read first loadings, test after test.

    Parameters
    ----------
    files : result.h5 files
    points : of each curve, about; each is the mean of consecutive samples
    up_to : m, largest deflection that is taken; None for as far as a first loading is followed
    say : is given the name of each test as it is read

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
    """Take the first loading out of a processed test.

    Parameters
    ----------
    result : of a cantilever test
    protocol : that it was processed by
    points, up_to : as for `read_first_loadings`

    Returns
    -------
    The curve up to its largest deflection. The string held the wire straight at rest, so that the
    load cell, zeroed then, reads what comes on top of the counterweight; a test that knows nothing
    of this is taken to be such, with a note.

    Raises
    ------
    NotUsableError
        If it is no cantilever, or has no zero of force and deflection, no curve, no first loading,
        no free length, too few points, or a wire that hung at rest.

    Notes
    -----
    The noise of a point is that of the second differences of the block means: of the force, and of
    the deflection times the slope of the curve. What all points are off by together is apart from
    it: `force_zero_error`, `place_error`, `scale_errors`.
    """
    min_points = 20
    _require_cantilever(protocol)
    _require_zeros(result)
    curve, branch = _first_branch(result)
    rest_notes = _rest_notes(result, curve, branch, protocol)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        message = "the free length is not known: give it in the test sheet (specimen.length)"
        raise NotUsableError(message)
    limit = min(up_to or np.inf, DEEPEST * length)
    part = slice(branch.start, branch.stop)
    deflection = block_means(curve.displacement[part], points)
    force = block_means(curve.force[part], points)
    usable = np.isfinite(deflection) & np.isfinite(force)
    taken = usable & (deflection > 0.0) & (deflection <= limit)
    if taken.sum() < min_points:
        message = (
            f"{int(taken.sum())} points of the first loading lie between 0 and "
            f"{1e3 * limit:.3g} mm: {min_points} at least are needed; ask for more points, or for "
            "deeper ones"
        )
        raise NotUsableError(message)
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
        rig=_rig(protocol, length),
        zero_error=force_zero_error(protocol, curve, branch),
        place_error=place_error(result, protocol, curve, branch),
        scale_error=common_scale_error,
        own_scale_error=test_scale_error,
        self_weight=_self_weight(protocol),
    )
    notes = (*_doubts(result), *rest_notes, *_cut(result.test, deflection[usable], limit))
    return FirstLoading(measured, _gain(protocol), notes)


def noise_of(values: Floats) -> float:
    """Standard deviation of the noise of consecutive values on a smooth curve, in their unit.

    Parameters
    ----------
    values : shape (n,), without NaN
    """
    return float(np.std(np.diff(values, 2)) / _SECOND_DIFFERENCE)


def _noise(deflection: Floats, force: Floats) -> Floats:
    """Noise of the force at each point, that of the deflection in it, N.

    The slope is that of a polynomial in the root of the deflection: strands that still stick make
    the first points several times as steep as the next, and what they say of friction as doubtful.
    """
    polynomial_degree = 7
    first = float(np.ptp(deflection)) / len(deflection)
    root = np.sqrt(np.maximum(deflection, 0.5 * first))
    slope = Polynomial.fit(root, force, polynomial_degree).deriv()(root) / (2.0 * root)
    return np.hypot(noise_of(force), slope * noise_of(deflection))


_HELD = (
    "For the next test shorten the string until it holds the wire straight; if it did hold this "
    "one, say so in the test sheet (rig.string.at_rest: taut) and process it again"
)


def _rest_notes(
    result: TestResult, curve: Curve, branch: Branch, protocol: Protocol
) -> tuple[QualityNote, ...]:
    """Refuse a wire that hung at rest; say what is not known of it."""
    string = protocol.rig.string
    if string is None or string.at_rest == "taut":
        return ()
    weight, length = GRAVITY * string.counterweight, protocol.specimen.length
    sag_weight = held_at_rest(_self_weight(protocol), length or 0.0)
    if weight + sag_weight == 0.0:
        return ()
    rest = at_rest(result.aligned, result.shape, curve, branch, weight, own_weight=sag_weight)
    if rest.why_not_straight:
        message = f"{rest.why_not_straight}. {_HELD}"
        raise NotUsableError(message)
    return tuple(notes_of(result.test, rest))


def _self_weight(protocol: Protocol) -> float:
    """Weight per length as protocol or test sheet says, N/m; 0 where they do not."""
    return GRAVITY * (protocol.specimen.mass_per_length or 0.0)


def with_self_weight(loading: FirstLoading, self_weight: float) -> FirstLoading:
    """Give a test the weight of its wire where its own sheet does not say one.

    Parameters
    ----------
    loading : of a test
    self_weight : N/m, of the wire by its row in the sheet of wires

    Returns
    -------
    The same with a note ``mass_contradicts`` where both are said and differ by more than a third.
    """
    # between two statements of one mass; beyond it one of them is a slip.
    max_mass_ratio = 4.0 / 3.0
    stated_weight, curve = loading.curve.self_weight, loading.curve
    if stated_weight == 0.0:
        return replace(loading, curve=replace(curve, self_weight=self_weight))
    if 1.0 / max_mass_ratio <= stated_weight / self_weight <= max_mass_ratio:
        return loading
    message = (
        f"its sheet says {1e3 * stated_weight / GRAVITY:.4g} g/m (specimen.mass_per_length), the sheet of "
        f"wires {1e3 * self_weight / GRAVITY:.4g} g/m for {curve.wire}: that of the test is taken"
    )
    note = QualityNote("mass_contradicts", Severity.WARNING, curve.test, message)
    return replace(loading, notes=(*loading.notes, note))


def weight_note(loadings: Sequence[FirstLoading], self_weight: float) -> QualityNote | None:
    """Say which weight tests have whose own sheets say none.

    Parameters
    ----------
    loadings : of one wire, as they were read
    self_weight : N/m, of the wire by its row in the sheet of wires
    """
    without = [loading.curve.test for loading in loadings if loading.curve.self_weight == 0.0]
    if not without:
        return None
    count = f"{len(without)} of {len(loadings)} test sheets do not say"
    which = "no test sheet says" if len(without) == len(loadings) else count
    message = (
        f"{which} a mass per length (specimen.mass_per_length): the weight is that of the sheet of "
        f"wires, {1e3 * self_weight / GRAVITY:.4g} g/m, stated there or from copper and insulation"
    )
    return QualityNote("weight_of_sheet", Severity.INFO, loadings[0].curve.wire, message)


def insulation_note(spec: WireSpec, tested: float, *, of: str = "") -> QualityNote | None:
    """Say when tests bent a wire beyond what the straight line of its insulation is taken for.

    Parameters
    ----------
    spec : of the wire
    tested : 1/m, largest curvature of its tests
    of : the wire whose calibration predicts them; empty for that wire itself
    """
    limit = straight_range(spec)
    if tested <= limit:
        return None
    by = "parameters make up for an insulation that gives way"
    remedy = "Give the sheet an insulation_table, or the plan a smaller up_to"
    if of:
        by = f"what the calibration of {of} predicts is doubtful beyond"
        remedy = "Give the sheet an insulation_table"
    message = (
        f"the tests bend {spec.name} to {tested:.3g} 1/m; from {limit:.3g} 1/m on its insulation "
        f"is strained by more than {100.0 * spec.insulation_strain:.3g} %, where its straight line "
        f"is not taken to hold: {by}. {remedy}"
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
"""Codes of notes on a test whose force or deflection is not counted from rest."""


def _require_zeros(result: TestResult) -> None:
    """Refuse a test that is not counted from rest: friction is in its first part of a millimetre.

    Notes
    -----
    A calibration cannot see it by itself: a curve that is shifted fits nearly as well, with more
    than twice the friction.
    """
    lost = [note for note in result.quality if note.code in _NO_ZERO]
    if lost:
        reasons = "; ".join(f"{note.where}: {note.message} ({note.code})" for note in lost)
        message = f"its zero is lost, and with it the begin of the first loading: {reasons}"
        raise NotUsableError(message)


def _first_branch(result: TestResult) -> tuple[Curve, Branch]:
    curve = result.curve
    if curve is None:
        message = "it has no curve: look at its summary"
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
        message = f"its first loading failed: {peak.why}"
        raise NotUsableError(message)
    return curve, first[0]


def _rig(protocol: Protocol, length: float) -> StringRig | None:
    """String and counterweight as the protocol says; none where it names no string."""
    string = protocol.rig.string
    if string is None:
        return None
    return StringRig(string.length, GRAVITY * string.counterweight, length, string.length)


def _gain(protocol: Protocol) -> float:
    curve = protocol.curve
    channel = None if curve is None else protocol.channels.get(curve.force)
    return 0.0 if channel is None else channel.gain_uncertainty


def _doubts(result: TestResult) -> list[QualityNote]:
    """Say what of the curve is doubtful: results of the first cycle that rest on all of it."""
    reasons = {
        result.why
        for result in result.results
        if result.status is Status.DOUBTFUL
        and result.name in ("peak_force.1", "peak_displacement.1", "energy.1")
    }
    return [
        QualityNote("test_doubtful", Severity.WARNING, result.test, f"taken as it is: {reason}")
        for reason in sorted(reasons)
    ]


def _cut(test: str, deflection: Floats, limit: float) -> list[QualityNote]:
    beyond = deflection > limit
    if not beyond.any():
        return []
    message = (
        f"the first loading goes to {1e3 * deflection.max():.4g} mm; what lies beyond "
        f"{1e3 * limit:.4g} mm was left out"
    )
    return [QualityNote("loading_cut", Severity.INFO, test, message)]
