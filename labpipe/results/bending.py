"""Measure stiffnesses of beams, shapes from cameras, and moment-curvature laws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import sqrt
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np

from labpipe.errors import Fault
from labpipe.records.arrays import Flags, Floats
from labpipe.records.causes import MARKER_SIDE, SCALE_OF_FORCE, SHAPE
from labpipe.records.curve import Bending, Branch, Curve, Interval, MeasuredLaw
from labpipe.records.declarations import (
    CURVE_QUANTITIES,
    Curvature,
    Distance,
    Length,
    Needs,
    Output,
    Ratio,
    SnakeName,
    StiffnessName,
)
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.results import kinds
from labpipe.results.curves import compute_slope, require_samples, require_travel
from labpipe.results.kinds import Kind, MeasuredItem, ReducedTest, Stiffness
from labpipe.results.stiffness import DerivedKind, RangeKind
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance
from labpipe.uncertainty.noise_model import estimate_noise
from labpipe.uncertainty.replicates import (
    N_REPLICATES,
    Trace,
    combine_numbers,
    fit_smooth_curve,
    make_generator,
)
from labpipe.units import GRAVITY

SUPPORTS: Final = MappingProxyType({"cantilever": ("length", 3.0), "three-point": ("span", 48.0)})
"""Key of the length L in the protocol, and divisor of L^3, by support. The load is at the end of a
cantilever, or at the centre of a span."""


def compute_beam_factor(length: float, support: str) -> float:
    """Compute the ratio of bending stiffness EI to stiffness of a straight uniform beam, m^3.

    Parameters
    ----------
    length : m, free length of a cantilever, or span between two supports
    support : one of `SUPPORTS`

    Returns
    -------
    L^3 / 3 or L^3 / 48.

    Notes
    -----
    The beam is an Euler-Bernoulli beam with small slopes (Young and Budynas, Roark's Formulas for
    Stress and Strain, 7th ed. 2002, table 8.1, cases 1a and 1e). A relative error of the length is
    tripled.

    Examples
    --------
    >>> round(480.0 * compute_beam_factor(0.1, "three-point"), 9)
    0.01
    """
    return length**3 / SUPPORTS[support][1]


def compute_prop_force(self_weight: float, length: float) -> float:
    """Compute the force that supports the tip of a level specimen at rest, N: 3 w L / 8.

    Parameters
    ----------
    self_weight : N/m, weight of the specimen per length
    length : m, free length of the specimen

    Notes
    -----
    The formula holds for a small sag and a linear law. The laws of stranded wires change it by at
    most 0.03 % (A2 at 85 mm, B1 at 100 mm, A3 at 120 mm). The tip of a freely hanging specimen has
    the same deflection as under this force alone.
    """
    return 0.375 * self_weight * length


@dataclass(frozen=True, slots=True)
class Rollers:
    """Two roller supports of a beam.

    Parameters
    ----------
    span : m, distance between the centres of the rollers
    radius : m, distance from the centre of a roller to the axis of the specimen; 0 for knife edges
    friction : coefficient of friction of fixed rollers; 0 for turning ones
    """

    span: float
    radius: float = 0.0
    friction: float = 0.0


def compute_roller_load(rollers: Rollers) -> tuple[Floats, Floats]:
    """Compute deflection and load of an elastic beam of EI = 1 N m^2 on rollers.

    Parameters
    ----------
    rollers : the supports

    Returns
    -------
    deflection : shape (n,), m, travel of the load towards the supports, from 0
    load : shape (n,), N, for EI = 1 N m^2, from 0

    Notes
    -----
    Half of the beam reaches from mid-span (slope 0) to the roller (slope a). It touches the roller
    where a radius of the roller is normal to the beam. The roller pushes with a force N along that
    normal and, because the beam slides inwards over the roller, with mu N outwards along the beam.
    The roller exerts no moment. The first integral of the elastica (Love, A Treatise on the
    Mathematical Theory of Elasticity, 4th ed. 1927, secs. 260-263) with p = a - slope is then

    EI (d slope / ds)^2 / 2 = N (sin p + mu (1 - cos p)).

    Its integral over the horizontal must be span / 2 - radius sin a, which gives N. The load is
    2 N (cos a + mu sin a), and the deflection is the rise over that half plus radius (1 - cos a).
    The integrals are Gauss quadratures in sqrt(p). In this model friction acts at the axis.
    Friction at the surface of a specimen of depth h has an effect of the other sign, of the order
    of mu h / span at small deflections. The correction of ASTM D790 (sec. 12, large span-to-depth
    ratios) is for the stress in the outer fibre, not for the stiffness.
    """
    n_nodes, n_slopes = 48, 600
    max_slope = 1.35  # rad, 77 deg at the supports
    angle = np.linspace(0.0, max_slope, n_slopes + 1)[1:, None]
    node, weight = np.polynomial.legendre.leggauss(n_nodes)
    root = 0.5 * np.sqrt(angle) * (node + 1.0)
    p = root**2
    mu = rollers.friction
    curvature = np.sqrt(np.sin(p) + mu * (1.0 - np.cos(p)))
    arc_step = 0.5 * np.sqrt(angle) * weight * 2.0 * root / curvature
    width = np.sum(arc_step * np.cos(angle - p), axis=1)
    rise = np.sum(arc_step * np.sin(angle - p), axis=1)
    a = angle[:, 0]
    scale = (0.5 * rollers.span - rollers.radius * np.sin(a)) / width
    normal_force = 0.5 / scale**2
    load = 2.0 * normal_force * (np.cos(a) + mu * np.sin(a))
    deflection = scale * rise + rollers.radius * (1.0 - np.cos(a))
    return np.append(0.0, deflection), np.append(0.0, load)


def compute_stiffness_ratio(rollers: Rollers, *, start: float, stop: float) -> float:
    """Compute the slope of load against deflection over a range, as a multiple of 48 EI / span^3.

    Parameters
    ----------
    rollers : the supports
    start, stop : m, ends of the range of the least-squares line

    Raises
    ------
    UnavailableError
        ``beyond_elastica`` if the beam would slip through, or is less than half as stiff as at
        small deflections.

    Examples
    --------
    >>> round(compute_stiffness_ratio(Rollers(0.1), start=0.0, stop=0.001), 4)
    0.9991
    """
    n_samples = 200
    min_ratio = 0.5  # below this ratio, the geometry has more effect than the specimen
    deflection, load = compute_roller_load(rollers)
    falling_samples = np.flatnonzero(np.diff(deflection) <= 0.0)
    last = int(falling_samples[0]) if len(falling_samples) else len(deflection) - 1
    if stop > deflection[last]:
        limit, high = 1e3 * deflection[last], 1e3 * stop
        raise UnavailableError.of("results.slips_through", limit=limit, high=high)
    deflections = np.linspace(start, stop, n_samples)
    loads = np.interp(deflections, deflection[: last + 1], load[: last + 1])
    ratio = float(compute_slope(deflections, loads)) * rollers.span**3 / 48.0
    if ratio < min_ratio:
        facts = {"low": 1e3 * start, "high": 1e3 * stop, "ratio": ratio}
        raise UnavailableError.of("results.beyond_elastica", **facts, needed=min_ratio)
    return ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class Roller:
    """Settings of the rollers of two supports."""

    diameter: Length | None = None
    friction: Annotated[Ratio | None, "Coefficient of friction of fixed rollers"] = None


_CORRECTION_ORDER = ("large-deflection", "roller-radius", "roller-friction")
"""Order in which corrections are applied."""


class BendingStiffness(DerivedKind):
    """``<name>`` (N m^2): bending stiffness EI of a beam, from a stiffness and its length."""

    result: ClassVar = "bending-stiffness"
    outputs: ClassVar = (Output("{name}", "N*m^2", is_slope=True),)
    method: ClassVar = "{of} x L^3 / 3 or L^3 / 48"
    of: Annotated[StiffnessName, "Name of a stiffness above, such as initial_stiffness"]
    support: Annotated[
        Literal["cantilever", "three-point"],
        "cantilever: K L^3 / 3, L specimen.length; three-point: K L^3 / 48, L the span",
    ]
    length_uncertainty: Annotated[
        Distance | None, "Standard uncertainty of L, if specimen.uncertainty does not state it"
    ] = None
    name: Annotated[SnakeName, "Such as bending_stiffness_at_start"] = "bending_stiffness"
    corrections: Annotated[
        tuple[Literal["large-deflection", "roller-radius", "roller-friction"], ...],
        "For three-point: effects that the formula for small deflections omits",
    ] = ()
    roller: Roller | None = None

    @property
    def length_key(self) -> str:
        """Key of the length of the formula in the sizes of the test."""
        return SUPPORTS[self.support][0]

    def find_value_faults(self) -> Iterator[Fault]:
        """Yield faults of corrections: for a cantilever, without input or 'large-deflection'."""
        names = self.corrections
        if names and self.support == "cantilever":
            yield Fault.of("results.corrected_cantilever", ("corrections",))
            return
        for name, key in (("roller-radius", "diameter"), ("roller-friction", "friction")):
            if name in names and "large-deflection" not in names:
                yield Fault.of("results.no_large_deflection", ("corrections",), name=name)
            if name in names and getattr(self.roller, key, None) is None:
                yield Fault.of("results.no_roller", ("corrections",), name=name, key=key)

    def measure_outcome(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure the bending stiffness from a stiffness and the length of the beam."""
        sizes = test.setup.sizes
        if self.length_key not in sizes:
            is_span = self.length_key == "span"
            raise UnavailableError.of("results.no_span" if is_span else "results.no_length")
        self._compute_ratio(sizes, stiffness.window)

        def compute_rigidity(trace: Trace, slope: Floats) -> Floats:
            """Compute bending stiffnesses, N m^2, NaN if an elastic beam would slip through."""
            ratio = return_failure(self._compute_ratio)(trace.sizes, stiffness.window)
            rigidity = slope * compute_beam_factor(trace.sizes[self.length_key], self.support)
            return np.asarray(rigidity / (np.nan if isinstance(ratio, Failure) else ratio[0]))

        return test.measure_number(combine_numbers(compute_rigidity, stiffness.choose_samples))

    def collect_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return the method with its formula, and a remark on the effects of the corrections."""
        ratio = return_failure(self._compute_ratio)(test.setup.sizes, stiffness.window)
        key, divisor = SUPPORTS[self.support]
        method = f"{{of}} x L^3 / {divisor:g}, L = specimen.{key}"
        return {"method": method, "remark": "" if isinstance(ratio, Failure) else ratio[1]}

    def _compute_ratio(
        self, sizes: Mapping[str, float], window: tuple[float, float]
    ) -> tuple[float, str]:
        """Compute the stiffness of an elastic beam over that of the formula, and make a remark."""
        span = sizes.get("span")
        if not self.corrections or span is None:
            return 1.0, ""
        ratio, radius, friction, effects = 1.0, 0.0, 0.0, list[str]()
        roller = self.roller or Roller()
        for name in sorted(self.corrections, key=_CORRECTION_ORDER.index):
            if name == "roller-radius":
                radius = 0.5 * ((roller.diameter or 0.0) + sizes.get("outer_diameter", 0.0))
            if name == "roller-friction":
                friction = roller.friction or 0.0
            rollers = Rollers(span, radius, friction)
            next_ratio = compute_stiffness_ratio(rollers, start=window[0], stop=window[1])
            effects.append(f"{name} {1e2 * (ratio / next_ratio - 1.0):+.3g} %")
            ratio = next_ratio
        return ratio, f"corrected as an elastic beam: {', '.join(effects)}"


def fit_secant_stiffness(
    time: Floats, displacement: Floats, force: Floats, is_chosen: Flags
) -> Estimate:
    """Fit the slope of force against displacement over chosen samples.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; NaN are ignored
    is_chosen : shape (n,), whether the sample is used

    Returns
    -------
    The slope, N/m, with its standard error.

    Raises
    ------
    UnavailableError
        ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    The slope is k = sum (t - mean t) F / sum (t - mean t) d, with time as the instrument, as in
    `labpipe.results.stiffness.choose_window`. The standard error is from the long-run variance of
    F - k d less a cubic in time, which removes the shape of the curve.
    """
    is_used = is_chosen & ~np.isnan(displacement) & ~np.isnan(force)
    n_samples = int(is_used.sum())
    require_samples(n_samples, 8)
    t, d, f = time[is_used], displacement[is_used], force[is_used]
    require_travel(d)
    centred_time = t - t.mean()
    path_sum = float(centred_time @ (d - d.mean()))
    slope = float(centred_time @ (f - f.mean())) / path_sum
    scaled_time = centred_time / np.abs(centred_time).max()
    residuals = f - slope * d
    noise = residuals - np.polynomial.Polynomial.fit(scaled_time, residuals, 3)(scaled_time)
    variance = estimate_long_run_variance(noise, n_parameters=4)
    error = float(np.sqrt(variance * (centred_time @ centred_time)) / abs(path_sum))
    return Estimate(slope, error, n_samples)


_MID_SPAN = "mid_span"
"""Name of the signal of mid-span from cameras, and of the quantity on which its results depend."""
_MID_SPAN_QUANTITIES = ("displacement", "clock", _MID_SPAN)
"""Quantities on which a result of the signal of mid-span alone depends."""


class TipTravel(Kind):
    """``tip_travel`` (m): largest distance of the tip from its first position."""

    result: ClassVar = "tip-travel"
    outputs: ClassVar = (Output("tip_travel", "m", "Travel of the tip", ("displacement",)),)
    needs: ClassVar = Needs(shape="fit-shape")
    method: ClassVar = (
        "largest distance of the last point of the shape from its mean over five frames"
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the largest distance of the last point of the shape from its first position."""
        if test.shape is None:
            raise UnavailableError.of("results.no_shape")
        min_frames, n_first_frames = 16, 5
        tips = test.shape.positions[:, -1]
        tips = tips[np.isfinite(tips).all(axis=1)]
        if len(tips) < min_frames:
            raise UnavailableError.of("results.few_tips", count=len(tips))
        distances = np.linalg.norm(tips - tips[:n_first_frames].mean(axis=0), axis=1)
        error = float(np.sqrt(2.0) * estimate_noise_level(distances))
        yield self.make_result(test, Estimate(float(distances.max()), error, len(tips)))


class MomentCurvature(Kind):
    """``<name>`` (N m^2): bending stiffness by the measured moment-curvature law."""

    result: ClassVar = "moment-curvature"
    outputs: ClassVar = (Output("{name}", "N*m^2"),)
    needs: ClassVar = Needs(branches=True, shape="fit-shape", clamp=True)
    method: ClassVar = (
        "{kind} at {at:g} 1/m of the monotone law fitted to all shapes of the first loading"
    )
    at: Annotated[Curvature, "Curvature of the first loading"]
    kind: Annotated[
        Literal["secant", "tangent"], "secant: moment / curvature; tangent: slope of the law"
    ] = "secant"
    name: Annotated[SnakeName, "Such as bending_stiffness_at_20"] = "bending_stiffness"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the secant or tangent stiffness of the law at a curvature."""
        bending = test.require(test.bending, Failure.of("results.no_bent_loading"))
        law = test.require(bending.law or bending.reason, Failure.of("results.no_law"))
        outcome = return_failure(self._compute_stiffness)(law)
        scale = 0.0 if isinstance(outcome, Failure) else law.scale_error * abs(outcome.value)
        errors, period = {SCALE_OF_FORCE: scale}, test.find_loading_period()
        doubts = tuple(self.list_doubts(test, bending, law))
        yield self.make_result(test, outcome, errors, period=period, doubts=doubts)

    def _compute_stiffness(self, law: MeasuredLaw) -> Estimate:
        """Compute the stiffness of a law at the curvature `at`."""
        if self.at > (largest := float(law.curvature[-1])):
            facts = {"largest": largest, "needed": self.at}
            raise UnavailableError.of("results.curvature_not_reached", **facts)
        if self.at <= law.floor:
            raise UnavailableError.of("results.below_noise", floor=law.floor, needed=self.at)
        from labpipe.results.measured_law import evaluate_law  # only these tests load it

        covariance, curvature = law.compliance_covariance, np.array([self.at])
        quantities = evaluate_law(law.knots, law.compliance, covariance, curvature, scale_error=0.0)
        value, error = quantities[self.kind]
        return Estimate(float(value[0]), float(error[0]), law.n_frames)

    def list_doubts(
        self, test: ReducedTest, bending: Bending, law: MeasuredLaw
    ) -> Iterator[Reason]:
        """Yield doubts about the law: misfit to the shapes, bending at rest, unstated weight.

        Parameters
        ----------
        test : reduced test
        bending : measured moment and curvature of the test
        law : law that is fitted to them
        """
        # The residual of the law may be three times the noise of the markers, plus 20 um.
        shape, limits, max_residual = test.shape, test.setup.limits, 3.0 * law.noise + 2e-5
        if shape is not None and law.residual > max_residual:
            facts = {"residual": 1e6 * law.residual, "limit": 1e6 * max_residual}
            yield Reason.of("results.law_misfit", **facts)
            return
        moment = float(np.interp(self.at, law.curvature, law.moment))
        rest_moment = float(np.nanmax(np.abs(bending.cloud.moment_at_rest)))
        if rest_moment > moment:
            facts = {"resting": 1e3 * rest_moment, "moment": 1e3 * moment, "at": self.at}
            yield Reason.of("results.bent_before", **facts)
        if test.setup.mass_per_length is not None or shape is None:
            return
        weight_moment = 0.5 * GRAVITY * limits.unstated_mass * shape.length**2
        if weight_moment > limits.weight_share * moment:
            facts = {"mass": 1e3 * limits.unstated_mass, "moment": 1e6 * weight_moment}
            facts |= {"share": limits.weight_share, "at": self.at}
            yield Reason.of("results.weight_matters", **facts)


class MidSpan(RangeKind):
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m): beam at mid-span."""

    result: ClassVar = "mid-span"
    outputs: ClassVar = (
        Output(
            "mid_span_bending_stiffness",
            "N*m^2",
            "Mid-span bending stiffness",
            (*CURVE_QUANTITIES, _MID_SPAN),
        ),
        Output("mid_span_curvature", "1/m", "Mid-span curvature", _MID_SPAN_QUANTITIES),
    )
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")
    methods: ClassVar = (
        "slope of the moment P L / 4 against the curvature at mid-span "
        "from {start_mm:g} mm to {stop_mm:g} mm of the first loading, time as instrument",
        "curvature at mid-span at the turn of the motion, less that at rest",
    )
    corrections: Annotated[
        tuple[Literal["large-deflection"], ...],
        "large-deflection: the supports push along the specimen as well",
    ] = ()

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slope of moment against mid-span curvature, and the curvature at the turn."""
        frames = _SpanFrames.of(test)
        shape = frames.span.shape
        measure_at_turn = partial(_measure_at_turn, frames=frames, name="mid-span curvature")
        for output, measure in enumerate((partial(self._fit_stiffness, frames), measure_at_turn)):
            outcome = return_failure(measure)(shape.axis.mid_span_curvature)
            alternative = return_failure(measure)(shape.curvature_fewer_terms)
            errors: dict[str, float] = {}
            if not (isinstance(outcome, Failure) or isinstance(alternative, Failure)):
                # The changes are half-widths of rectangular distributions.
                errors[SHAPE] = abs(alternative.value - outcome.value) / sqrt(3.0)
                errors[MARKER_SIDE] = shape.side_change * abs(outcome.value) / sqrt(3.0)
                errors |= kinds.compute_scale_error(test, outcome) if output == 0 else {}
            context: dict[str, Any] = {"output": output, "period": test.find_loading_period()}
            if "large-deflection" in self.corrections:
                moment = "P L / 4 + P tan(slope at the supports) x deflection / 2"
                context["method"] = self.methods[output].replace("P L / 4", moment)
            yield self.make_result(test, outcome, errors, **context)

    def _fit_stiffness(self, frames: _SpanFrames, curvature: Floats) -> Estimate:
        """Fit the slope of the moment against a curvature (frames,), 1/m, over the range."""
        curve, branch, time = frames.curve, frames.loading, frames.time
        is_in_branch = (time >= branch.start_time) & (time < branch.stop_time)
        displacement = np.interp(time, curve.time, curve.displacement)
        largest = float(np.fmax.reduce(displacement[is_in_branch], initial=0.0))
        if not largest > self.stop:
            facts = {"reached": 1e3 * largest, "needed": 1e3 * self.stop}
            raise UnavailableError.of("results.loading_not_reached", **facts)
        is_in_range = is_in_branch & (displacement >= self.start) & (displacement <= self.stop)
        axis = frames.span.shape.axis
        force = np.interp(time, curve.time, curve.force, left=np.nan, right=np.nan)
        moment = 0.25 * axis.span * force
        if "large-deflection" in self.corrections:
            sag = np.clip(axis.deflection, 0.0, None)
            moment = moment + 0.5 * force * axis.mean_support_gradient * sag
        return fit_secant_stiffness(time, curvature, moment, is_in_range)


@dataclass(frozen=True, slots=True, eq=False)
class _SpanFrames:
    """Frames of a bent span, with the curve of the test and its first loading.

    Parameters
    ----------
    span : bent axis in every frame
    curve, loading : curve of the test, and branch of its first loading
    time : shape (frames,), s on the clock of the curve
    seed : seed of random draws
    """

    span: kinds.SpanBend
    curve: Curve
    loading: Branch
    time: Floats
    seed: bytes

    @classmethod
    def of(cls, test: ReducedTest) -> _SpanFrames:
        """Select the frames of a test, with times on the clock of its curve."""
        span, loading = test.require(test.span), test.require(test.first_loading)
        fit = test.clocks.other_fits.get(test.signals.raw[_MID_SPAN].clock)
        time = span.time if fit is None else fit.to_marker_time(span.time)
        return cls(span, test.required_curve, loading, time, test.seed)

    def draw_errors(self, signals: Sequence[Floats], weights: Floats, name: str) -> Floats:
        """Draw errors of a weighted sum of the values of the first signal, shape (replicates,).

        The noise of all signals (frames,) has one process, and a standard deviation for each
        signal. `name` is the name of the random stream.
        """
        max_intervals, batch_records = 40, 50  # of a spline in a branch; drawn at once
        branches = self.curve.branches
        ends = [*(branch.start_time for branch in branches), branches[-1].stop_time]
        cuts: list[int] = np.searchsorted(self.time, ends).tolist()
        smooth = [fit_smooth_curve(self.time, signal, cuts, max_intervals) for signal in signals]
        deviations = [np.nanstd(x - curve) for x, curve in zip(signals, smooth, strict=True)]
        scales = np.array([deviations[0] / x if x > 0.0 else 0.0 for x in deviations])[:, None]
        scaled, smooth_scaled = scales * np.array(signals), scales * np.array(smooth)
        pieces = [slice(start, stop) for start, stop in pairwise(cuts)]
        noise = estimate_noise(
            [signal[piece] for signal in scaled for piece in pieces],
            [curve[piece] for curve in smooth_scaled for piece in pieces],
            [signal[: cuts[0]] for signal in scaled],
            [signal[cuts[-1] :] for signal in scaled],
            n_signals=len(signals),
        )
        draw = partial(noise.draw, len(weights), batch_records, make_generator(self.seed, name))
        records = [draw() @ weights for _ in range(N_REPLICATES // batch_records)]
        return np.concatenate(records).astype(np.float64)


def _measure_at_turn(
    values: Floats, frames: _SpanFrames, name: str, similar_signals: Sequence[Floats] = ()
) -> Estimate:
    """Estimate the change of a quantity (frames,) from rest to the end of loading.

    Two parabolas that meet at the turn give the value there. The noise is estimated from this
    quantity and from `similar_signals`. `name` is the name of the random stream.
    """
    min_rest_frames, min_side_frames, max_window = 8, 5, 2.0  # window on each side, s
    is_finite = np.isfinite(values)
    is_at_rest = frames.span.is_at_rest & is_finite
    if is_at_rest.sum() < min_rest_frames:
        raise UnavailableError.of("results.no_rest", count=int(is_at_rest.sum()))
    branch = frames.loading
    # The window before the turn lies within the loading, even for a fast loading.
    window = min(max_window, 0.4 * (branch.stop_time - branch.start_time))
    time = frames.time - branch.stop_time
    is_in_window = is_finite & (np.abs(time) <= window)
    time_from_turn = time[is_in_window]
    if min((time_from_turn <= 0.0).sum(), (time_from_turn > 0.0).sum()) < min_side_frames:
        raise UnavailableError.of("results.few_near_turn", count=len(time_from_turn), window=window)
    time_after, time_before = np.maximum(time_from_turn, 0.0), np.minimum(time_from_turn, 0.0)
    ones = np.ones_like(time_after)
    design = np.column_stack([ones, time_after, time_after**2, time_before, time_before**2])
    weights = np.where(is_at_rest, -1.0 / is_at_rest.sum(), 0.0)
    weights[is_in_window] += np.linalg.pinv(design)[0]
    value = float(weights @ np.nan_to_num(values))
    errors = frames.draw_errors([values, *similar_signals], weights, name)
    lower, upper = np.quantile(errors, (0.025, 0.975)).tolist()
    interval = Interval(value - upper, value - lower)
    return Estimate(value, float(errors.std()), len(time_from_turn), interval)


class Twist(Kind):
    """``twist`` (rad): rotation of the section at mid-span about the axis."""

    result: ClassVar = "twist"
    outputs: ClassVar = (Output("twist", "rad", "Twist", ("displacement", "clock")),)
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")
    method: ClassVar = (
        "rotation about the axis of the markers of the section nearest to mid-span, at the turn of "
        "the motion"
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the rotation of a section from rest to the turn of the motion, without sign."""
        frames = _SpanFrames.of(test)
        shape = frames.span.shape
        sections = np.flatnonzero(shape.lever_arm > 0.0)  # sections whose markers show a twist
        if not len(sections):
            raise UnavailableError.of("results.too_few_markers", sections=len(shape.lever_arm))
        x = np.nanmean(shape.centres[frames.span.is_at_rest][..., 0], axis=0)
        section = int(sections[np.argmin(np.abs(x[sections]))])
        yield Finding.of("results.twist_section", "markers", at=1e3 * x[section])
        twists = [shape.twist[:, index] for index in sections if index != section]
        similar_twists = [twist for twist in twists if np.isfinite(twist).any()]
        measure = return_failure(_measure_at_turn)
        twist = measure(shape.twist[:, section], frames, "twist", similar_twists)
        if isinstance(twist, Estimate) and twist.value < 0.0:
            twist = measure(-shape.twist[:, section], frames, "twist", similar_twists)
        yield self.make_result(test, twist, period=test.find_loading_period())
