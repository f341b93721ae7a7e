"""Measured moment-curvature of a test: from shape, curve and string to the law."""

from __future__ import annotations

import numpy as np

from labpipe.bending.bent_frames import BendingErrors, BendingTest, TipPull, curves_at
from labpipe.bending.law_table import measure_bending
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import AT_REST, Curve, Shape
from labpipe.records.estimates import Failure
from labpipe.records.measured_bending import Bending
from labpipe.records.quality import Finding, worth_knowing
from labpipe.results.evidence import Evidence, LoadString
from labpipe.results.string_at_rest import Held, at_rest, held, stated
from labpipe.units import GRAVITY


def measured(test: Evidence) -> tuple[Bending | Failure, list[Finding]]:
    """Measure the moment-curvature law of a test, and note what was assumed.

    Parameters
    ----------
    test : with curve and shape
    """
    curve, shape, first = test.curve, test.shape, test.first_loading
    if curve is None or shape is None or first is None:
        return Failure("no_cycle", "there is no loading with a shape and a force"), []
    if not test.setup.has_markers:
        return Failure("no_moment_curvature", "expected a block markers:"), []
    start, stop = test.signals.zeroed["deflection"]
    rest = np.asarray((shape.time >= start) & (shape.time <= stop), dtype=np.bool_)
    pull, other, found = _pull(test, shape, rest)
    force = np.interp(shape.time, curve.time, curve.force, left=np.nan, right=np.nan)
    branch, cycle = _numbers(curve, shape.time)
    frames = BendingTest(
        shape=shape,
        force=force,
        branch=branch,
        cycle=cycle,
        first=curve.branches.index(first),
        rest=rest,
        centre_offset=test.setup.centre_offset,
        free_tip=test.setup.free_tip,
        pull=pull,
        errors=BendingErrors(
            force_noise=_scatter(force[rest]),
            force_zero=test.force.zero_error,
            force_scale=test.force.relative_error,
            offset=test.setup.offset_uncertainty,
            other_tension_at_rest=other,
        ),
    )
    try:
        bending = measure_bending(frames)
    except ValueError as error:
        return Failure("no_moment_curvature", str(error)), found
    return bending, [*found, _measured_law(bending)]


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


def _pull(test: Evidence, shape: Shape, rest: Flags) -> tuple[TipPull, float | None, list[Finding]]:
    """What pulls at the tip, and another tension at rest that is as likely."""
    still, string = np.nanmean(shape.coefficients[rest], axis=0)[None], test.setup.string
    tip = float(curves_at(still, shape.length, np.array([shape.length])).x[0, 0])
    if string is None:
        message = (
            "rig.string is not stated: the force is taken normal to the clamped axis, with nothing "
            "hanging at the tip"
        )
        return (
            TipPull(None, 0.0, 0.0, tip),
            None,
            [worth_knowing("force_taken_normal", "rig.string", message)],
        )
    if string.counterweight == 0.0:
        return TipPull(string.length, 0.0, 0.0, tip), None, []
    before = held_before(test, string)
    pull = TipPull(string.length, before.weight, before.tension, tip)
    return pull, before.other, [Finding(before.note)]


def held_before(test: Evidence, string: LoadString) -> Held:
    """What the string held before the first loading: as stated, or as the test shows.

    Parameters
    ----------
    test : with a curve
    string : with a counterweight
    """
    weight = GRAVITY * string.counterweight
    if string.at_rest != "by-data":
        return stated(string.at_rest, weight)
    curve, first = test.curve, test.first_loading
    if curve is None or first is None:
        message = "expected a curve with a loading branch"
        raise ValueError(message)
    return held(at_rest(test.aligned, test.shape, curve, first, weight))


def _measured_law(bending: Bending) -> Finding:
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
    return worth_knowing("moment_curvature", "shape", said)
