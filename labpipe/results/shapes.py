"""Results from the shape of the specimen: tip travel, bending law, three-point bending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.causes import SCALE_OF_FORCE
from labpipe.records.curve import Bending, Branch, Curve, Interval, MeasuredLaw
from labpipe.records.declarations import CURVE, Curvature, Needs, Output, Snake
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.results.cycles import compute_shape_error
from labpipe.results.kinds import Computed, Errors, Kind, compute_scale_error
from labpipe.results.least_squares import require_samples
from labpipe.results.reduced_test import NO_LOADING, ReducedTest, SpanBend
from labpipe.results.stiffness import Window
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance
from labpipe.uncertainty.noise_model import estimate_noise
from labpipe.uncertainty.replicates import N_REPLICATES, fit_smooth_curve, make_generator
from labpipe.units import GRAVITY


def fit_secant_stiffness(
    time: Floats, displacement: Floats, force: Floats, chosen: Flags
) -> Estimate:
    """Return the slope of force against displacement over chosen samples.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N
    chosen : shape (n,); NaN are ignored

    Returns
    -------
    N/m.

    Raises
    ------
    UnavailableError
        ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    k = sum (t - mean t) F / sum (t - mean t) d: time is the instrument, because ordinary least
    squares of F on a noisy displacement is too small (by the ratio of noise variance to variance;
    Fuller, Measurement Error Models, 1987, sec. 1.4). The standard error is from the long-run
    variance of F - k d less a cubic in time, the shape of the curve.
    """
    chosen = chosen & ~np.isnan(displacement) & ~np.isnan(force)
    count = int(chosen.sum())
    require_samples(count, 8)
    t, d, f = time[chosen], displacement[chosen], force[chosen]
    weight = t - t.mean()
    travel = float(weight @ (d - d.mean()))
    if travel == 0.0:
        raise UnavailableError.of("results.no_travel", quantity="displacement")
    slope = float(weight @ (f - f.mean())) / travel
    scaled = weight / np.abs(weight).max()
    residuals = f - slope * d
    noise = residuals - np.polynomial.Polynomial.fit(scaled, residuals, 3)(scaled)
    variance = estimate_long_run_variance(noise, parameters=4)
    return Estimate(slope, float(np.sqrt(variance * (weight @ weight)) / abs(travel)), count)


_SPAN = "mid_span"
"""Signal of mid-span from cameras, and quantity of numbers from them alone."""


_TURN_WINDOW, _MIN_SIDE_FRAMES = 2.0, 5
"""s on each side of a turn for a value there; frames needed on each side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TipTravel(Kind):
    """``tip_travel`` (m): largest distance of the tip from its first position."""

    result: ClassVar = "tip-travel"
    outputs: ClassVar = (Output("tip_travel", "m", "Travel of the tip", ("displacement",)),)
    needs: ClassVar = Needs(shape="fit-shape")

    method: ClassVar = (
        "largest distance of the last point of the shape from its mean over five frames"
    )

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the largest distance of the last point of the shape from its start."""
        if test.shape is None:
            raise UnavailableError.of("results.no_shape")
        tip = test.shape.positions[:, -1]
        tip = tip[np.isfinite(tip).all(axis=1)]
        if len(tip) < 16:
            raise UnavailableError.of("results.few_tips", count=len(tip))
        distances = np.linalg.norm(tip - tip[:5].mean(axis=0), axis=1)
        error = float(np.sqrt(2.0) * estimate_noise_level(distances))
        return Computed(
            (self.make_result(test, Estimate(float(distances.max()), error, len(tip))),)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentCurvature(Kind):
    """``<name>`` (N m^2): bending stiffness by the measured moment-curvature law."""

    result: ClassVar = "moment-curvature"
    outputs: ClassVar = (Output("{name}", "N*m^2"),)
    needs: ClassVar = Needs(branches=True, shape="fit-shape", clamp=True)
    method: ClassVar = (
        "{kind} at {at:g} 1/m of the monotone law that all shapes of the first loading obey"
    )
    at: Annotated[Curvature, "Curvature of the first loading"]
    kind: Annotated[
        Literal["secant", "tangent"], "secant: moment / curvature; tangent: slope of the law"
    ] = "secant"
    name: Annotated[Snake, "Such as bending_stiffness_at_20"] = "bending_stiffness"

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the secant or tangent stiffness of the law at a curvature."""
        bending = test.bending
        if bending is None or isinstance(bending, Failure):
            raise test.make_error(bending or Failure.of("results.no_bent_loading"))
        law = bending.law
        if law is None:
            raise UnavailableError(bending.reason or Failure.of("results.no_law"))
        outcome = return_failure(_read_stiffness)(law, self)
        scale = 0.0 if isinstance(outcome, Failure) else law.scale_error * abs(outcome.value)
        doubts = _find_misfit(test, law) or (
            *_find_earlier_bending(bending, law, self),
            *_find_missing_weight(test, law, self),
        )
        error, during = {SCALE_OF_FORCE: scale}, test.find_loading_interval()
        return Computed((self.make_result(test, outcome, error, during=during, doubts=doubts),))


def _read_stiffness(law: MeasuredLaw, entry: MomentCurvature) -> Estimate:
    largest = float(law.curvature[-1])
    if entry.at > largest:
        raise UnavailableError.of("results.curvature_not_reached", largest=largest, needed=entry.at)
    if entry.at <= law.floor:
        raise UnavailableError.of("results.below_noise", floor=law.floor, needed=entry.at)
    from labpipe.results.measured_law import evaluate_law  # only these tests load it

    points = evaluate_law(
        law.knots, law.compliance, law.compliance_covariance, np.array([entry.at]), scale_error=0.0
    )
    value, error = (
        (points.secant, points.secant_error)
        if entry.kind == "secant"
        else (points.tangent, points.tangent_error)
    )
    return Estimate(float(value[0]), float(error[0]), law.n_frames)


def _find_earlier_bending(
    bending: Bending, law: MeasuredLaw, entry: MomentCurvature
) -> tuple[Reason, ...]:
    """Return a doubt if the wire had been bent as far the other way before the test."""
    resting = float(np.nanmax(np.abs(bending.cloud.moment_at_rest)))
    moment = float(np.interp(entry.at, law.curvature, law.moment))
    if resting <= moment:
        return ()
    resting, moment = 1e3 * resting, 1e3 * moment
    return (Reason.of("results.bent_before", resting=resting, moment=moment, at=entry.at),)


def _find_missing_weight(
    test: ReducedTest, law: MeasuredLaw, entry: MomentCurvature
) -> tuple[Reason, ...]:
    """Return a doubt if the weight of the specimen is unknown and may matter."""
    if test.setup.mass_per_length is not None or test.shape is None:
        return ()
    moment = float(np.interp(entry.at, law.curvature, law.moment))
    limits = test.setup.limits
    own_moment = 0.5 * GRAVITY * limits.unstated_mass * test.shape.length**2
    if own_moment <= limits.weight_share * moment:
        return ()
    reason = Reason.of(
        "results.weight_matters",
        mass=1e3 * limits.unstated_mass,
        moment=1e6 * own_moment,
        share=limits.weight_share,
        at=entry.at,
    )
    return (reason,)


def _find_misfit(test: ReducedTest, law: MeasuredLaw) -> tuple[Reason, ...]:
    """Return a doubt if markers deviate from the shapes of the law by more than their noise."""
    limit = 3.0 * law.noise + 2e-5  # m
    if test.shape is None or not law.residual > limit:
        return ()
    return (Reason.of("results.law_misfit", residual=1e6 * law.residual, limit=1e6 * limit),)


_Parts: TypeAlias = tuple[SpanBend, Curve, Branch, Floats]


def _require_span(test: ReducedTest) -> _Parts:
    """Return axis, curve, first loading, and times of the frames on the clock of the curve."""
    bend, curve, branch = test.span, test.curve, test.first_loading
    if isinstance(bend, Failure):
        raise UnavailableError(bend)
    if bend is None or curve is None or branch is None:
        raise test.make_error(NO_LOADING)
    fit = test.clocks.others.get(test.signals.raw[_SPAN].clock)
    return bend, curve, branch, bend.time if fit is None else fit.to_marker_time(bend.time)


@dataclass(frozen=True, slots=True, kw_only=True)
class MidSpan(Window):
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m): of a bent span."""

    result: ClassVar = "mid-span"
    outputs: ClassVar = (
        Output(
            "mid_span_bending_stiffness", "N*m^2", "Mid-span bending stiffness", (*CURVE, _SPAN)
        ),
        Output("mid_span_curvature", "1/m", "Mid-span curvature", ("displacement", "clock", _SPAN)),
    )
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")
    corrections: Annotated[
        tuple[Literal["large-deflection"], ...],
        "large-deflection: the supports push along the specimen as well",
    ] = ()

    def list_methods(self, test: ReducedTest) -> tuple[str, str]:
        """Return the methods, which include the moment and the correction."""
        del test
        large = "large-deflection" in self.corrections
        moment = "P L / 4 + P tan(slope at the supports) x deflection / 2" if large else "P L / 4"
        return (
            f"slope of the moment {moment} against the curvature at mid-span "
            "from {start_mm:g} mm to {stop_mm:g} mm of the first loading, time as instrument",
            "curvature at mid-span where the motion turns, against rest",
        )

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the slope of moment against curvature at mid-span, and the largest curvature."""
        parts = _require_span(test)
        bend, frames = parts[0], _Frames.of(test, parts)
        outcomes, other = (
            (
                return_failure(self._fit_stiffness)(parts, curvature),
                return_failure(_measure_at_turn)(curvature, frames, "mid-span curvature"),
            )
            for curvature in (bend.shape.axis.mid_span, bend.shape.fewer_terms)
        )
        errors = [_compute_shape_errors(bend, *pair) for pair in zip(outcomes, other, strict=True)]
        if errors[0]:
            errors[0] = {**errors[0], **compute_scale_error(test, outcomes[0])}
        during = test.find_loading_interval()
        return Computed(
            tuple(
                self.make_result(test, outcome, error, output=place, during=during)
                for place, (outcome, error) in enumerate(zip(outcomes, errors, strict=True))
            )
        )

    def _fit_stiffness(self, parts: _Parts, curvature: Floats) -> Estimate:
        bend, curve, branch, time = parts
        inside = (time >= branch.start_time) & (time < branch.stop_time)
        travelled = np.interp(time, curve.time, curve.displacement)
        if not (travelled[inside] > self.stop).any():
            reached = 1e3 * float(np.max(travelled[inside], initial=0.0))
            raise UnavailableError.of(
                "results.loading_not_reached", reached=reached, needed=1e3 * self.stop
            )
        inside &= (travelled >= self.start) & (travelled <= self.stop)
        bent_axis = bend.shape.axis
        force = np.interp(time, curve.time, curve.force, left=np.nan, right=np.nan)
        moment = 0.25 * bent_axis.span * force
        if "large-deflection" in self.corrections:
            sag = np.clip(bent_axis.deflection, 0.0, None)
            moment = moment + 0.5 * force * bent_axis.support_slope * sag
        return fit_secant_stiffness(time, curvature, moment, inside)


def _compute_shape_errors(
    bend: SpanBend, outcome: Estimate | Failure, other: Estimate | Failure
) -> Errors:
    """Compute the errors from fewer terms of the shape and from the side of the markers."""
    if isinstance(outcome, Failure) or isinstance(other, Failure):
        return {}
    side = bend.shape.side_share * abs(outcome.value) / sqrt(3.0)
    return {**compute_shape_error(outcome, other), "side of the markers": side}


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """Times of the frames of a test.

    time : shape (frames,), s, on the clock of the curve; rest : shape (frames,), before the
    loading; cuts : first frames of the branches, and after the last one; seed : of draws
    """

    time: Floats
    rest: Flags
    loading: Branch
    cuts: tuple[int, ...]
    seed: bytes

    @classmethod
    def of(cls, test: ReducedTest, parts: _Parts) -> _Frames:
        bend, curve, branch, time = parts
        ends = [*(branch.start_time for branch in curve.branches), curve.branches[-1].stop_time]
        cuts = tuple(int(cut) for cut in np.searchsorted(time, ends))
        return cls(time, bend.rest, branch, cuts, test.seed)

    def drawn(self, values: Sequence[Floats], weights: Floats, name: str) -> Floats:
        """Draw errors of a weighted sum over the first of several signals, shape (replicates,).

        All signals share one noise process, each with its own size.
        """
        spline_intervals = 40  # per branch
        batch_records = 50
        smooth = [
            fit_smooth_curve(self.time, value, self.cuts, spline_intervals) for value in values
        ]
        spread = [np.nanstd(value - curve) for value, curve in zip(values, smooth, strict=True)]
        shares = [spread[0] / deviation if deviation > 0.0 else 0.0 for deviation in spread]
        values, smooth = (
            [share * one for share, one in zip(shares, value, strict=True)]
            for value in (values, smooth)
        )
        moving = [slice(low, high) for low, high in pairwise(self.cuts)]
        noise = estimate_noise(
            [value[part] for value in values for part in moving],
            [curve[part] for curve in smooth for part in moving],
            [value[: self.cuts[0]] for value in values],
            [value[self.cuts[-1] :] for value in values],
            copies=len(values),
        )
        rng = make_generator(self.seed, name)
        records = [
            noise.draw(len(values[0]), batch_records, rng) @ weights
            for _ in range(N_REPLICATES // batch_records)
        ]
        return np.concatenate(records).astype(np.float64)


def _measure_at_turn(
    values: Floats, frames: _Frames, name: str, similar: Sequence[Floats] = ()
) -> Estimate:
    """Estimate the change of a quantity from rest to the end of loading.

    Its noise is estimated together with that of similar signals.
    """
    at_rest = frames.rest & np.isfinite(values)
    if at_rest.sum() < 8:
        raise UnavailableError.of("results.no_rest", count=int(at_rest.sum()))
    branch = frames.loading
    window = min(_TURN_WINDOW, 0.4 * (branch.stop_time - branch.start_time))
    weights = _compute_turn_weights(frames.time - branch.stop_time, values, window)
    count = int((weights != 0.0).sum())
    weights = weights - at_rest / at_rest.sum()
    value = float(weights @ np.nan_to_num(values))
    errors_of_draws = frames.drawn([values, *similar], weights, name)
    low, high = np.quantile(errors_of_draws, (0.025, 0.975)).tolist()
    return Estimate(value, float(errors_of_draws.std()), count, Interval(value - high, value - low))


def _compute_turn_weights(time: Floats, values: Floats, window: float) -> Floats:
    """Return the weights of frames in the value of two parabolas that meet at time zero."""
    is_near = np.isfinite(values) & (np.abs(time) <= window)
    t = time[is_near]
    if min((t <= 0.0).sum(), (t > 0.0).sum()) < _MIN_SIDE_FRAMES:
        raise UnavailableError.of("results.few_near_turn", count=len(t), window=window)
    ahead, behind = np.maximum(t, 0.0), np.minimum(t, 0.0)
    design = np.column_stack([np.ones_like(t), ahead, ahead**2, behind, behind**2])
    weights = np.zeros(len(time))
    weights[is_near] = np.linalg.pinv(design)[0]
    return weights


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist(Kind):
    """``twist`` (rad): rotation of the section at mid-span about the axis."""

    result: ClassVar = "twist"
    outputs: ClassVar = (Output("twist", "rad", "Twist", ("displacement", "clock")),)
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")

    method: ClassVar = (
        "size of the turn of the markers of the section nearest to mid-span about the axis, where "
        "the motion turns"
    )

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the turn of a section where the motion turns, against rest."""
        parts = _require_span(test)
        bend, shape = parts[0], parts[0].shape
        sections_with_twist = np.flatnonzero(shape.lever > 0.0)
        if not len(sections_with_twist):
            raise UnavailableError.of("results.too_few_markers", sections=len(shape.lever))
        x = np.nanmean(shape.centres[bend.rest][..., 0], axis=0)
        section = int(sections_with_twist[np.argmin(np.abs(x[sections_with_twist]))])
        note = Finding.of("results.twist_section", "markers", at=1e3 * x[section])
        frames = _Frames.of(test, parts)
        other_twists = [shape.twist[:, other] for other in sections_with_twist if other != section]
        similar = [other for other in other_twists if np.isfinite(other).any()]
        twist = return_failure(_measure_at_turn)(shape.twist[:, section], frames, "twist", similar)
        if isinstance(twist, Estimate) and twist.value < 0.0:
            twist = _measure_at_turn(-shape.twist[:, section], frames, "twist", similar)
        number = self.make_result(test, twist, during=test.find_loading_interval())
        return Computed((number,), findings=(note,))
