"""Results from the shape of the specimen: tip travel, bending law, three-point bending."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import Annotated, ClassVar, Literal

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.causes import MARKER_SIDE, SCALE_OF_FORCE, SHAPE
from labpipe.records.curve import Bending, Branch, Curve, Interval, MeasuredLaw
from labpipe.records.declarations import CURVE, Curvature, Needs, Output, Snake
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.records.result import Result
from labpipe.results.kinds import Computed, Kind, compute_scale_error
from labpipe.results.least_squares import require_samples
from labpipe.results.reduced_test import ReducedTest, SpanBend
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
        outcome = return_failure(self._read_stiffness)(law)
        scale = 0.0 if isinstance(outcome, Failure) else law.scale_error * abs(outcome.value)
        error, during = {SCALE_OF_FORCE: scale}, test.find_loading_interval()
        doubts = tuple(self.list_doubts(test, bending, law))
        return Computed((self.make_result(test, outcome, error, during=during, doubts=doubts),))

    def _read_stiffness(self, law: MeasuredLaw) -> Estimate:
        if self.at > (largest := float(law.curvature[-1])):
            raise UnavailableError.of(
                "results.curvature_not_reached", largest=largest, needed=self.at
            )
        if self.at <= law.floor:
            raise UnavailableError.of("results.below_noise", floor=law.floor, needed=self.at)
        from labpipe.results.measured_law import evaluate_law  # only these tests load it

        covariance, curvature = law.compliance_covariance, np.array([self.at])
        points = evaluate_law(law.knots, law.compliance, covariance, curvature, scale_error=0.0)
        value, error = getattr(points, self.kind), getattr(points, f"{self.kind}_error")
        return Estimate(float(value[0]), float(error[0]), law.n_frames)

    def list_doubts(
        self, test: ReducedTest, bending: Bending, law: MeasuredLaw
    ) -> Iterator[Reason]:
        """Yield doubts about the law: shapes, earlier bending, and the weight of the specimen.

        Parameters
        ----------
        test, bending, law : of the test
        """
        shape, limits, limit = test.shape, test.setup.limits, 3.0 * law.noise + 2e-5  # m
        if shape is not None and law.residual > limit:
            residual = 1e6 * law.residual
            yield Reason.of("results.law_misfit", residual=residual, limit=1e6 * limit)
            return
        moment = float(np.interp(self.at, law.curvature, law.moment))
        resting = float(np.nanmax(np.abs(bending.cloud.moment_at_rest)))
        if resting > moment:
            facts = 1e3 * resting, 1e3 * moment
            yield Reason.of("results.bent_before", resting=facts[0], moment=facts[1], at=self.at)
        if test.setup.mass_per_length is not None or shape is None:
            return
        own_moment = 0.5 * GRAVITY * limits.unstated_mass * shape.length**2
        if own_moment > limits.weight_share * moment:
            yield Reason.of(
                "results.weight_matters",
                mass=1e3 * limits.unstated_mass,
                moment=1e6 * own_moment,
                share=limits.weight_share,
                at=self.at,
            )


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
        frames = _SpanFrames.of(test)
        shape, results = frames.bend.shape, list[Result]()
        outcomes, with_fewer_terms = (
            (
                return_failure(self._fit_stiffness)(frames, curvature),
                return_failure(_measure_at_turn)(curvature, frames, "mid-span curvature"),
            )
            for curvature in (shape.axis.mid_span, shape.fewer_terms)
        )
        for output, (outcome, other) in enumerate(zip(outcomes, with_fewer_terms, strict=True)):
            errors: dict[str, float] = {}
            if not (isinstance(outcome, Failure) or isinstance(other, Failure)):
                # Half-widths of rectangular distributions.
                errors[SHAPE] = abs(other.value - outcome.value) / sqrt(3.0)
                errors[MARKER_SIDE] = shape.side_share * abs(outcome.value) / sqrt(3.0)
                errors |= compute_scale_error(test, outcome) if output == 0 else {}
            during = test.find_loading_interval()
            results.append(self.make_result(test, outcome, errors, output=output, during=during))
        return Computed(tuple(results))

    def _fit_stiffness(self, frames: _SpanFrames, curvature: Floats) -> Estimate:
        curve, branch, time = frames.curve, frames.loading, frames.time
        inside = (time >= branch.start_time) & (time < branch.stop_time)
        travelled = np.interp(time, curve.time, curve.displacement)
        if not (travelled[inside] > self.stop).any():
            reached = 1e3 * float(np.max(travelled[inside], initial=0.0))
            raise UnavailableError.of(
                "results.loading_not_reached", reached=reached, needed=1e3 * self.stop
            )
        inside &= (travelled >= self.start) & (travelled <= self.stop)
        bent_axis = frames.bend.shape.axis
        force = np.interp(time, curve.time, curve.force, left=np.nan, right=np.nan)
        moment = 0.25 * bent_axis.span * force
        if "large-deflection" in self.corrections:
            sag = np.clip(bent_axis.deflection, 0.0, None)
            moment = moment + 0.5 * force * bent_axis.support_slope * sag
        return fit_secant_stiffness(time, curvature, moment, inside)


@dataclass(frozen=True, slots=True, eq=False)
class _SpanFrames:
    """Frames of a bent span, with the curve of the test and its first loading.

    time : shape (frames,), s, on the clock of the curve; seed : of draws
    """

    bend: SpanBend
    curve: Curve
    loading: Branch
    time: Floats
    seed: bytes

    @classmethod
    def of(cls, test: ReducedTest) -> _SpanFrames:
        bend, loading = test.require(test.span), test.require(test.first_loading)
        fit = test.clocks.others.get(test.signals.raw[_SPAN].clock)
        time = bend.time if fit is None else fit.to_marker_time(bend.time)
        return cls(bend, test.required_curve, loading, time, test.seed)

    def draw(self, values: Sequence[Floats], weights: Floats, name: str) -> Floats:
        """Draw errors of a weighted sum over the first of several signals, shape (replicates,).

        All signals share one noise process, each with its own size.
        """
        spline_intervals = 40  # per branch
        batch_records = 50
        branches = self.curve.branches
        ends = [*(branch.start_time for branch in branches), branches[-1].stop_time]
        cuts: list[int] = np.searchsorted(self.time, ends).tolist()
        smooth = [fit_smooth_curve(self.time, value, cuts, spline_intervals) for value in values]
        spread = [np.nanstd(value - curve) for value, curve in zip(values, smooth, strict=True)]
        shares = [spread[0] / deviation if deviation > 0.0 else 0.0 for deviation in spread]
        values, smooth = (
            [share * one for share, one in zip(shares, value, strict=True)]
            for value in (values, smooth)
        )
        moving = [slice(low, high) for low, high in pairwise(cuts)]
        noise = estimate_noise(
            [value[part] for value in values for part in moving],
            [curve[part] for curve in smooth for part in moving],
            [value[: cuts[0]] for value in values],
            [value[cuts[-1] :] for value in values],
            copies=len(values),
        )
        rng = make_generator(self.seed, name)
        records = [
            noise.draw(len(values[0]), batch_records, rng) @ weights
            for _ in range(N_REPLICATES // batch_records)
        ]
        return np.concatenate(records).astype(np.float64)


def _measure_at_turn(
    values: Floats, frames: _SpanFrames, name: str, similar: Sequence[Floats] = ()
) -> Estimate:
    """Estimate the change of a quantity from rest to the end of loading.

    The value there is that of two parabolas that meet. Its noise is estimated together with that
    of similar signals.
    """
    is_finite = np.isfinite(values)
    at_rest = frames.bend.rest & is_finite
    if at_rest.sum() < 8:
        raise UnavailableError.of("results.no_rest", count=int(at_rest.sum()))
    branch = frames.loading
    window = min(_TURN_WINDOW, 0.4 * (branch.stop_time - branch.start_time))
    time = frames.time - branch.stop_time
    is_near = is_finite & (np.abs(time) <= window)
    t = time[is_near]
    if min((t <= 0.0).sum(), (t > 0.0).sum()) < _MIN_SIDE_FRAMES:
        raise UnavailableError.of("results.few_near_turn", count=len(t), window=window)
    ahead, behind = np.maximum(t, 0.0), np.minimum(t, 0.0)
    design = np.column_stack([np.ones_like(t), ahead, ahead**2, behind, behind**2])
    weights = np.zeros(len(time))
    weights[is_near] = np.linalg.pinv(design)[0]
    count = int((weights != 0.0).sum())
    weights = weights - at_rest / at_rest.sum()
    value = float(weights @ np.nan_to_num(values))
    errors_of_draws = frames.draw([values, *similar], weights, name)
    low, high = np.quantile(errors_of_draws, (0.025, 0.975)).tolist()
    return Estimate(value, float(errors_of_draws.std()), count, Interval(value - high, value - low))


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
        frames = _SpanFrames.of(test)
        shape = frames.bend.shape
        sections = np.flatnonzero(shape.lever > 0.0)  # whose markers show a twist
        if not len(sections):
            raise UnavailableError.of("results.too_few_markers", sections=len(shape.lever))
        x = np.nanmean(shape.centres[frames.bend.rest][..., 0], axis=0)
        section = int(sections[np.argmin(np.abs(x[sections]))])
        note = Finding.of("results.twist_section", "markers", at=1e3 * x[section])
        other_twists = [shape.twist[:, other] for other in sections if other != section]
        similar = [other for other in other_twists if np.isfinite(other).any()]
        twist = return_failure(_measure_at_turn)(shape.twist[:, section], frames, "twist", similar)
        if isinstance(twist, Estimate) and twist.value < 0.0:
            twist = _measure_at_turn(-shape.twist[:, section], frames, "twist", similar)
        number = self.make_result(test, twist, during=test.find_loading_interval())
        return Computed((number,), findings=(note,))
