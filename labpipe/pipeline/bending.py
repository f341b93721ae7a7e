"""Measured moment-curvature on the bench: from shape, curve and string to the law's stiffness."""

from __future__ import annotations

import numpy as np

from labpipe.bending.bent_frames import BendingErrors, BendingTest, TipPull, bent
from labpipe.bending.law_table import law_points, measure_bending
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import loading_branch
from labpipe.pipeline.held_at_rest import Held, held, stated
from labpipe.pipeline.outcomes import Asked, blocked_or, to_result, while_loading
from labpipe.pipeline.plausibility import GRAVITY
from labpipe.pipeline.string_at_rest import at_rest
from labpipe.protocol.results import MomentCurvature
from labpipe.protocol.schema import LoadString, Protocol
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import AT_REST, Branch, Curve, Shape
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.measured_bending import Bending, MeasuredLaw
from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Result
from labpipe.records.step_settings import FitShape

_MISFIT = (3.0, 2e-5)
"""Times the noise, and m on top, that markers may lie off the shapes of the law."""


def bending_stiffness(bench: Bench, entry: MomentCurvature, protocol: Protocol) -> list[Result]:
    """``<name>`` (N m^2): secant or tangent stiffness of the measured law at a curvature."""
    method = (
        f"{entry.kind} at {entry.at:g} 1/m of the monotone law that the shapes of the first "
        "loading obey together"
    )
    asked = Asked(entry.name, "N*m^2", ("force", "displacement", "clock"), method)
    if bench.bending is None:
        bench.bending = _measured(bench, protocol)
    if isinstance(bench.bending, Failure):
        return [to_result(bench, asked, blocked_or(bench, bench.bending))]
    law = bench.bending.law
    if law is None:
        why = bench.bending.reason or Failure("no_law", "no law was found")
        return [to_result(bench, asked, why)]
    doubt = _misfit(bench) or _bent_before(bench.bending, law, entry)
    during = while_loading(bench)
    return [to_result(bench, asked, _stiffness(law, entry), doubts=[doubt], during=during)]


def _stiffness(law: MeasuredLaw, entry: MomentCurvature) -> Estimate | Failure:
    largest = float(law.curvature[-1])
    if entry.at > largest:
        message = (
            f"the first loading bends the wire to {largest:.3g} 1/m, {entry.at:g} 1/m is asked for"
        )
        return Failure("not_reached", message)
    if entry.at <= law.floor:
        message = (
            f"curvatures up to {law.floor:.3g} 1/m are not told from their noise, {entry.at:g} 1/m "
            "is asked for"
        )
        return Failure("below_noise", message)
    at = law_points(
        law.knots,
        law.compliance,
        law.compliance_covariance,
        np.array([entry.at]),
        scale_error=law.scale_error,
    )
    value, error = (
        (at.secant, at.secant_error) if entry.kind == "secant" else (at.tangent, at.tangent_error)
    )
    return Estimate(float(value[0]), float(error[0]), law.n_frames)


def _measured(bench: Bench, protocol: Protocol) -> Bending | Failure:
    """Measure, and note what was assumed."""
    curve, shape, branch = bench.curve, bench.shape, loading_branch(bench)
    if curve is None or shape is None or branch is None:
        return Failure("no_cycle", "there is no loading with a shape and a force")
    try:
        bending = measure_bending(_test(bench, protocol, curve, shape, branch))
    except ValueError as error:
        return Failure("no_moment_curvature", str(error))
    _tell(bench, bending)
    return bending


def _test(
    bench: Bench, protocol: Protocol, curve: Curve, shape: Shape, first: Branch
) -> BendingTest:
    """What the pure functions need of bench and protocol."""
    words = protocol.markers
    if words is None:
        message = "expected a block markers:"
        raise ValueError(message)
    start, stop = bench.zeroed["deflection"]
    rest = np.asarray((shape.time >= start) & (shape.time <= stop), dtype=np.bool_)
    force = np.interp(shape.time, curve.time, curve.force, left=np.nan, right=np.nan)
    branch, cycle = _numbers(curve, shape.time)
    signal = bench.signals[bench.force]
    pull, other = _pull(bench, protocol.rig.string, shape, rest)
    return BendingTest(
        shape=shape,
        force=force,
        branch=branch,
        cycle=cycle,
        first=curve.branches.index(first),
        rest=rest,
        centre_offset=words.centre_offset,
        free_tip=any(isinstance(step, FitShape) and step.tip == "free" for step in protocol.steps),
        pull=pull,
        errors=BendingErrors(
            force_noise=_scatter(force[rest]),
            force_zero=signal.zero_error,
            force_scale=signal.relative_error,
            offset=words.offset_uncertainty,
            other_tension_at_rest=other,
        ),
    )


def _numbers(curve: Curve, time: Floats) -> tuple[Ints, Ints]:
    """Branch and cycle of every frame."""
    branch: Ints = np.full(len(time), AT_REST, dtype=np.int64)
    cycle: Ints = np.zeros(len(time), dtype=np.int64)
    for number, part in enumerate(curve.branches):
        inside = (time >= part.start_time) & (time < part.stop_time)
        branch[inside], cycle[inside] = number, part.cycle
    return branch, cycle


def _scatter(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.std()) if len(known) else 0.0


def _pull(
    bench: Bench, string: LoadString | None, shape: Shape, rest: Flags
) -> tuple[TipPull, float | None]:
    """What pulls at the tip, and another tension at rest that is as likely."""
    still = np.nanmean(shape.coefficients[rest], axis=0)[None]
    tip = float(bent(still, shape.length, np.array([shape.length])).x[0, 0])
    if string is None:
        message = (
            "rig.string is not stated: the force is taken normal to the clamped axis, with nothing "
            "hanging at the tip"
        )
        bench.note("force_taken_normal", Severity.INFO, "rig.string", message)
        return TipPull(None, 0.0, 0.0, tip), None
    weight = GRAVITY * string.counterweight
    if weight == 0.0:
        return TipPull(string.length, 0.0, 0.0, tip), None
    before = held_before(bench, string)
    note = before.note
    bench.note(note.code, note.severity, note.where, note.message)
    return TipPull(string.length, before.weight, before.tension, tip), before.other


def held_before(bench: Bench, string: LoadString) -> Held:
    """What the string held before the first loading: as stated, or as the test tells."""
    weight = GRAVITY * string.counterweight
    if string.at_rest != "by-data":
        return stated(string.at_rest, weight)
    curve, first = bench.curve, loading_branch(bench)
    if curve is None or first is None:
        message = "expected a curve with a loading branch"
        raise ValueError(message)
    return held(at_rest(bench.aligned, bench.shape, curve, first, weight))


def _tell(bench: Bench, bending: Bending) -> None:
    cloud, law = bending.cloud, bending.law
    said = (
        f"{cloud.curvature.size} points, each a mean over {cloud.frames_per_mean} frames, at "
        f"{len(cloud.arc_length)} places"
    )
    if law is not None:
        said += (
            f"; law from {law.n_frames} frames of the first loading up to {law.curvature[-1]:.3g} "
            f"1/m, markers {1e6 * law.residual:.3g} um rms off its shapes, curvatures up to "
            f"{law.floor:.2g} 1/m are noise"
        )
    bench.note("moment_curvature", Severity.INFO, "shape", said)


def _bent_before(bending: Bending, law: MeasuredLaw, entry: MomentCurvature) -> Reason | None:
    """Why a number is doubtful: the wire had been bent as far the other way before the test."""
    resting = float(np.nanmax(np.abs(bending.cloud.moment_at_rest)))
    moment = float(np.interp(entry.at, law.curvature, law.moment))
    if resting <= moment:
        return None
    return Reason(
        "bent_before",
        f"at rest the wire hung under a moment of {1e3 * resting:.3g} N mm, more than "
        f"the {1e3 * moment:.3g} N mm at {entry.at:g} 1/m: below that it is not loaded for the "
        "first time",
    )


def _misfit(bench: Bench) -> Reason | None:
    """Why the law is doubtful: markers lie farther off its shapes than their noise."""
    bending = bench.bending
    if not isinstance(bending, Bending) or bending.law is None or bench.shape is None:
        return None
    law = bending.law
    limit = _MISFIT[0] * law.noise + _MISFIT[1]
    if not law.residual > limit:
        return None
    return Reason(
        "law_misfit",
        f"markers lie {1e6 * law.residual:.3g} um rms off the shapes of the law, more "
        f"than {1e6 * limit:.3g} um: the wire does not bend alike all along, or string and offsets "
        "are not as stated",
    )
