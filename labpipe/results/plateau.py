"""Measure where a loading curve levels off: the slope at its end, and the onset of its plateau."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.causes import TANGENT
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import CURVE, Length, Output, Share, StiffnessName
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.records.result import Result
from labpipe.results.curve_replicates import make_trace, select_first_loading
from labpipe.results.cycles import find_cut_cycle
from labpipe.results.kinds import Computed, Kind, find_marked_slips
from labpipe.results.least_squares import CommonPath, find_finite_samples, require_samples
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.uncertainty.extractors import Decide, Reading, Trace
from labpipe.uncertainty.intervals import Measured, measure_numbers
from labpipe.uncertainty.replicates import Input, Replicates

_TANGENTS_PER_LENGTH = 8
"""Tangents per length of a tangent."""


_MIN_TANGENT_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangents of a loading curve, from its end backwards; their samples are chosen on one curve.

    Parameters
    ----------
    path : of the samples with both quantities, in order of time
    length : m, of a tangent
    places : shape (p,), m, middles of the tangents, an eighth of `length` apart, from the end
        backwards
    rows : shape (p, k), 1/m, weights of the forces in each slope
    first : shape (k,), weights of the forces in the level of the first tangent in its middle
    last : shape (m,), numbers of the samples of the first tangent
    """

    path: CommonPath
    length: float
    places: Floats
    rows: Floats
    first: Floats
    last: Ints

    @classmethod
    def of(cls, displacement: Floats, force: Floats, *, length: float) -> Tangents:
        """Decide the samples of the tangents of a curve.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled;
            NaN are ignored
        length : m, of a tangent

        Returns
        -------
        Tangents up to the first place without one.

        Raises
        ------
        UnavailableError
            Without one at the end: ``not_reached`` (the curve is shorter than two of them),
            ``too_few_samples`` (8), ``no_travel``.

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola in the middle of its stretch, so
        that the curvature of the curve is not taken for noise. A stretch contains the samples from
        when the curve first reached its start to when it first reached its end.
        """
        samples = find_finite_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * length:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            raise UnavailableError.of("results.too_short", reached=reached, length=1e3 * length)
        low, high = float(d.min()) + 0.5 * length, float(d.max()) - 0.5 * length
        stretches = _Stretches.of(d, np.arange(high, low, -length / _TANGENTS_PER_LENGTH), length)
        require_samples(int(stretches.products[0, 0, 0]), _MIN_TANGENT_SAMPLES)
        if not stretches.is_enough[0]:
            raise UnavailableError.of("results.displacement_jumps")
        usable = slice(int(np.argmin([*stretches.is_enough, False])))
        levels, slopes = (
            stretches.expand(weight)[usable] for weight in stretches.compute_weights()
        )
        path = CommonPath.of(displacement, force, samples)
        last = stretches.samples[0][stretches.samples[0] < len(d)]
        return cls(path, length, stretches.places[usable], slopes, levels[0], last)

    @property
    def ends(self) -> tuple[float, float]:
        """Return the smallest and largest displacement over the last stretch, m."""
        d = self.path.displacement[self.last]
        return float(d.min()), float(d.max())

    def fit_end_slope(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Return the slope over the last stretch of each curve.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        N/m, shape (...).
        """
        slope: Floats = self.path.move_force(force, displacement) @ self.rows[0]
        return slope

    def compute_level(self, place: float, force: Floats) -> float:
        """Return the force of the tangent over the last stretch at a place, N.

        Parameters
        ----------
        place : m
        force : shape (n,), N
        """
        path_force = self.path.move_force(force)
        return float(path_force @ self.first + path_force @ self.rows[0] * (place - self.places[0]))

    def find_onset(
        self,
        force: Floats,
        initial: Floats,
        displacement: Floats | None = None,
        *,
        slope_below: float,
    ) -> tuple[Floats, Floats]:
        """Find the place beyond which tangents stay below a share of the initial slope.

        Parameters
        ----------
        force, displacement : as for `fit_end_slope`
        initial : shape (...), N/m, slope at the start of each curve
        slope_below : share of `initial`

        Returns
        -------
        m, N, each of shape (...): from the end backwards, where the tangent first reaches the
        share, interpolated. NaN for a curve that is never so steep. The force is that of the
        parabola over half of `length` around the place: a parabola cuts a corner in proportion to
        its length.

        Examples
        --------
        >>> d = np.linspace(0.0, 0.05, 501)
        >>> f = np.where(d < 0.03, 400.0 * d - 6500.0 * d**2, 6.15)
        >>> tangents = Tangents.of(d, f, length=2e-3)
        >>> place, force = tangents.find_onset(f, np.array(400.0), slope_below=0.1)
        >>> round(1e3 * float(place), 1), round(float(force), 2)
        (27.7, 6.09)
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        share = slope_below * np.broadcast_to(initial, shape).reshape(-1)
        place = _find_first_place(self.places, f @ self.rows.T, share)
        levels = _fit_levels(self.path.displacement, f, place, 0.5 * self.length)
        return place.reshape(shape), levels.reshape(shape)

    def measure_corner_changes(
        self,
        force: Floats,
        onset: Floats | float,
        slope: Floats | float,
        displacement: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Measure how an onset changes with tangents of half the length, for each curve.

        Parameters
        ----------
        force, displacement : as for `fit_end_slope`
        onset : shape (...), m, the onset
        slope : shape (...), N/m, of the tangent there

        Returns
        -------
        Each of shape (...): change of the place, m, and of the force there, N; and the slope half a
        tangent beyond the place, N/m. A tangent smears a corner over its length, which moves the
        onset; the parabola for the force cuts it.
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        onset, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (onset, slope))
        # One place for all curves: noise moves it by a small part of a tangent.
        d, half, middle = self.path.displacement, 0.5 * self.length, float(np.nanmean(onset))
        tangent_positions = middle + self.length * np.linspace(
            0.5, -0.5, 2 * _TANGENTS_PER_LENGTH + 1
        )
        is_inside = (tangent_positions <= d.max() - 0.5 * half) & (
            tangent_positions >= d.min() + 0.5 * half
        )
        stretches = _Stretches.of(d, tangent_positions[is_inside], half)
        usable = stretches.is_enough
        rows = stretches.expand(stretches.compute_weights()[1])[usable]
        reached = _find_first_place(stretches.places[usable], f @ rows.T, slope)
        at = np.full(len(f), middle)
        full, short = (_fit_levels(d, f, at, length) for length in (self.length, half))
        places, slopes = self.places[::-1], (f @ self.rows.T)[:, ::-1]
        beyond = np.array([np.interp(middle + half, places, slope) for slope in slopes])
        moved = np.where(np.isnan(reached), 0.0, reached - onset)
        return moved.reshape(shape), (short - full).reshape(shape), beyond.reshape(shape)


def _find_first_place(places: Floats, slopes: Floats, required: Floats) -> Floats:
    """Return the first place (p,) at which slopes (R, p) reach wanted ones (R,), or NaN."""
    is_steep = slopes >= required[:, None]
    number, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    ahead = np.maximum(number - 1, 0)
    rise = slopes[rows, number] - slopes[rows, ahead]
    share = (required - slopes[rows, ahead]) / np.where(number > 0, rise, np.inf)
    place = places[ahead] + share * (places[number] - places[ahead])
    reached: Floats = np.where(is_steep[rows, number], place, np.nan)
    return reached


def _fit_levels(d: Floats, f: Floats, places: Floats, length: float) -> Floats:
    """Return forces of curves (R, k) at places (R,), from parabolas around them."""
    is_finite = np.isfinite(places)
    levels = np.full(len(places), np.nan)
    if is_finite.any():
        stretches = _Stretches.of(d, places[is_finite], length)
        inside = np.minimum(stretches.samples, len(d) - 1)  # padding has zero weight
        weights, _ = stretches.compute_weights()
        taken = np.take_along_axis(f[is_finite], inside, axis=1)
        level = np.einsum("rm,rm->r", weights, taken)
        levels[is_finite] = np.where(stretches.is_enough, level, np.nan)
    return levels


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Samples of a path around places, with powers of their distances.

    Parameters
    ----------
    places : shape (p,), m
    length : m
    samples : shape (p, m), padded with the number of all samples
    count : of all samples
    powers : shape (p, 3, m), of the distance from the place over `length`; 0 where padded
    products : shape (p, 3, 3), of the powers with one another
    is_enough : shape (p,), whether they determine a parabola
    """

    places: Floats
    length: float
    samples: Ints
    count: int
    powers: Floats
    products: Floats
    is_enough: Flags

    @classmethod
    def of(cls, d: Floats, places: Floats, length: float) -> _Stretches:
        edge_share = 1e-9  # a sample this close to an end counts as on it, despite rounding
        # Of the products of 1, x, x^2 per sample: rounding for samples at two places; 5e-4 for
        # evenly spaced samples.
        min_determinant = 1e-9
        reached = np.maximum.accumulate(d)
        begin, end = places - (0.5 + edge_share) * length, places + (0.5 - edge_share) * length
        start = np.searchsorted(reached, begin)
        stop = np.minimum(np.searchsorted(reached, end) + 1, len(d))
        samples = start[:, None] + np.arange(int((stop - start).max()))
        is_inside = samples < stop[:, None]
        samples = np.where(is_inside, samples, len(d))
        x = np.where(is_inside, (np.append(d, 0.0)[samples] - places[:, None]) / length, 0.0)
        travel = np.ptp(np.where(is_inside, x, x[:, :1]), axis=1)
        powers = np.stack([is_inside * x**power for power in range(3)], axis=1)
        products = powers @ powers.transpose(0, 2, 1)
        count = products[:, 0, 0]
        is_wide = (travel >= 0.5) & (np.linalg.det(products) > min_determinant * count**3)
        return cls(
            places,
            length,
            samples,
            len(d),
            powers,
            products,
            (count >= _MIN_TANGENT_SAMPLES) & is_wide,
        )

    def expand(self, weights: Floats) -> Floats:
        """Expand weights (p, m) of the samples of each stretch to all samples (p, k)."""
        columns = np.zeros((len(self.places), self.count + 1))
        np.put_along_axis(columns, self.samples, weights, axis=1)
        return columns[:, :-1]

    def compute_weights(self) -> tuple[Floats, Floats]:
        """Return the weights of forces in level and slope of the parabolas, shapes (p, m)."""
        products = np.where(self.is_enough[:, None, None], self.products, np.eye(3))
        level, slope, _ = np.moveaxis(np.linalg.solve(products, self.powers), 1, 0)
        return level, slope / self.length


@dataclass(frozen=True, slots=True, eq=False)
class _Corner:
    """Change of the onset with shorter tangents, and the noise of this change.

    Half of the change is in the estimate, so half of its noise is in the interval.

    Parameters
    ----------
    size : shape (2,), m and N, the change without the effect of noise
    share : shape (2,), ratio of `size` to the observed change
    base : shape (2,), change on the smooth curve, plus the mean effect of noise
    """

    size: Floats
    share: Floats
    base: Floats

    @classmethod
    def of(cls, change: Floats, base: Floats, noise: Floats) -> _Corner:
        """Remove noise from a corner.

        Parameters
        ----------
        seen, base : shape (2,), of the measured and of the smooth curve
        noise : shape (2, replicates), effect of noise on it

        Notes
        -----
        On average noise adds its variance to the square of a corner, which is subtracted: a share
        s = sqrt(1 - v / c^2) of a corner c remains, or none if noise explains all of it.
        """
        average, variance = np.nanmean(noise, axis=1), np.nanvar(noise, axis=1)
        change_without_noise = change - average
        by_noise = np.divide(
            variance, change_without_noise**2, out=np.ones(2), where=change_without_noise != 0.0
        )
        share = np.sqrt(np.maximum(1.0 - by_noise, 0.0))
        return cls(share * change_without_noise, share, base + average)

    def in_noise(self, corners: Floats) -> Floats:
        """Return the effect of noise on the estimate through the corner, shape (2, ...)."""
        return 0.5 * self.share[:, None] * (corners - self.base[:, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau(Kind):
    """``end_slope`` (1), ``plateau_displacement`` (m), ``plateau_force`` (N): end of a loading."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1", "End slope", can_be_negative=True),
        Output("plateau_displacement", "m", "Displacement at the plateau"),
        Output("plateau_force", "N", "Plateau force"),
    )
    method: ClassVar = "slope over the last {over_mm:g} mm of first loading / {of}"
    slope_below: Annotated[Share, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005

    def compute(self, test: ReducedTest) -> Computed:
        """Measure the plateau; without the slope at the end, the onset is not available."""
        computed = super(Plateau, self).compute(test)
        is_available = computed.results[0].value is not None
        return computed if is_available else replace(computed, results=computed.results[:1])

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the slope at the end of the first loading, and the onset of a plateau."""
        initial = test.stiffnesses.get(self.of)
        if initial is None:
            raise test.make_error(Failure.of("results.no_stiffness", name=self.of))
        outcome = test.measure_one(partial(self._decide_end, initial=initial.decide))
        tangents, _ = self._choose_tangents(make_trace(test), initial.decide)
        first = test.cycles[0][:1]
        doubts = (
            find_marked_slips(test, initial.bends_with)
            or find_cut_cycle(test, first, CURVE)
            or _find_gap_at_end(test, first[0])
        )
        number = self.make_result(test, outcome, during=test.find_loading_interval(), doubts=doubts)
        onset, findings = self._list_onset_results(test, initial, number)
        _, f = _read_loading(make_trace(test))
        start, stop = tangents.ends
        slope, level = float(tangents.fit_end_slope(f)), tangents.compute_level(start, f)
        line = FittedLine("slope_at_end", slope, level, start, stop)
        return Computed((number, *onset), lines=(line,), findings=findings)

    def _choose_tangents(self, trace: Trace, initial: Decide) -> tuple[Tangents, Reading]:
        """Return the tangents of the first loading, and the slope at its start."""
        slope = initial(trace)
        value = float(slope.numbers(trace)[0])
        if value <= 0.0:
            raise UnavailableError.of("results.no_initial_slope", value=value)
        return Tangents.of(*_read_loading(trace), length=self.over), slope

    def _decide_end(self, trace: Trace, *, initial: Decide) -> Reading:
        """Decide the samples for the slope at the end over that at the start."""
        tangents, slope = self._choose_tangents(trace, initial)
        steeper = self._change_per_step(trace, tangents)

        def numbers(trace: Trace) -> tuple[Floats]:
            end = (
                tangents.fit_end_slope(*reversed(_read_loading(trace)))
                + trace.steps_beyond * steeper
            )
            return (np.asarray(end / slope.numbers(trace)[0], dtype=np.float64),)

        return Reading(numbers, len(tangents.last), ends_at_samples=slope.ends_at_samples)

    def _change_per_step(self, trace: Trace, tangents: Tangents) -> float:
        """Return the change of the slope at the end with one more sampling step, N/m.

        From the step before: the machine turned somewhere between two samples.
        """
        d, f = _read_loading(trace)
        before = return_failure(Tangents.of)(d[:-1], f[:-1], length=self.over)
        if isinstance(before, Failure):
            return 0.0
        return float(tangents.fit_end_slope(f) - before.fit_end_slope(f[:-1]))

    def _decide_onset(
        self, trace: Trace, *, initial: Decide, corner: _Corner | None = None
    ) -> Reading:
        """Decide the samples for the onset of the plateau and its force.

        With `corner`, the numbers include the error from the length of the tangents.
        """
        choice = self._choose_tangents(trace, initial)
        tangents, slope = choice

        def plain(trace: Trace) -> tuple[Floats, Floats]:
            (d, f), begin = _read_loading(trace), slope.numbers(trace)[0]
            return tangents.find_onset(f, begin, d, slope_below=self.slope_below)

        if np.isnan(plain(trace)[1]):
            raise UnavailableError.of("results.no_onset")
        if corner is None:
            return Reading(plain, len(tangents.last))

        def numbers(trace: Trace) -> tuple[Floats, Floats]:
            (place, level), shorter = plain(trace), trace.sizes.get(TANGENT, 0.0)
            return place + shorter * corner.size[0], level + shorter * corner.size[1]

        def in_noise(trace: Trace) -> tuple[Floats, Floats]:
            by = corner.in_noise(self._measure_corners(trace, choice))
            return tuple(value + more for value, more in zip(plain(trace), by, strict=True))

        return Reading(numbers, len(tangents.last), in_noise)

    def _measure_corners(self, trace: Trace, choice: tuple[Tangents, Reading]) -> Floats:
        """Return the largest error of the onset from the length of tangents, m and N, (2, ...)."""
        # In multiples of the change with tangents of half the length. A corner is smeared in
        # proportion to the length, so it is twice that change away; a smooth bend in proportion to
        # its square, so it is 4/3 of it away.
        smearing_factor = 3.0
        cut_factor = 2.0  # the force from half the length loses once or a third of its change
        (tangents, slope), (d, f) = choice, _read_loading(trace)
        initial = slope.numbers(trace)[0]
        place, _ = tangents.find_onset(f, initial, d, slope_below=self.slope_below)
        smeared, cut, beyond = tangents.measure_corner_changes(
            f, place, self.slope_below * initial, d
        )
        moved = smearing_factor * smeared
        return np.stack([moved, cut_factor * cut + moved * beyond])

    def _estimate_corner(self, replicates: Replicates, initial: Decide) -> _Corner:
        """Return that error for the measured curve, less noise.

        The smooth curve may have no corners of this size.
        """
        change = self._measure_corners(
            replicates.measured, self._choose_tangents(replicates.measured, initial)
        )
        smooth = return_failure(self._choose_tangents)(replicates.smooth, initial)
        if isinstance(smooth, Failure):
            return _Corner(change, np.zeros(2), np.zeros(2))
        base = self._measure_corners(replicates.smooth, smooth)
        noise = [
            self._measure_corners(trace, smooth) - base[:, None] for trace in replicates.traces()
        ]
        return _Corner.of(change, base, np.concatenate(noise, axis=1))

    def _list_onset_results(
        self, test: ReducedTest, initial: Stiffness, end: Result
    ) -> tuple[tuple[Result, ...], tuple[Finding, ...]]:
        """Return the results of the onset, or a note without a plateau, which is not a failure."""
        if end.interval is None:
            return (), ()
        is_plateau = end.interval.upper < self.slope_below
        outcomes = return_failure(self._measure_onset)(test, initial) if is_plateau else None
        during, (d, _) = test.find_loading_interval(), _read_loading(make_trace(test))
        if outcomes is None or isinstance(outcomes, Failure):
            note = Finding.of(
                "results.no_plateau",
                test.signals.force,
                over=1e3 * self.over,
                slope=1e2 * (end.value or 0.0),
                of=self.of,
                low=1e2 * end.interval.lower,
                high=1e2 * end.interval.upper,
                slope_below=1e2 * self.slope_below,
                reached=1e3 * float(np.nanmax(d)),
            )
            return (), (note,)
        method = (
            f"tangents over {1e3 * self.over:g} mm, below {1e2 * self.slope_below:g} % of "
            f"{self.of} up to the end of first loading"
        )
        doubts = find_marked_slips(test, initial.bends_with) or _find_gap_at_end(
            test, test.cycles[0][0]
        )
        common = {"method": method, "during": during, "doubts": doubts}
        return self.make_results(test, outcomes, first=1, **common), ()

    def _measure_onset(self, test: ReducedTest, initial: Stiffness) -> tuple[Measured, ...]:
        """Measure the onset, with the length of the tangents as a further input."""

        def shorten(trace: Trace, x: float) -> Trace:
            return replace(trace, sizes={**trace.sizes, TANGENT: x})

        replicates = test.require(test.replicates)
        more = (*replicates.inputs, Input(TANGENT, shorten, law="ends"))
        decide = partial(self._decide_onset, initial=initial.decide)
        decide(replicates.measured)
        decide = partial(decide, corner=self._estimate_corner(replicates, initial.decide))
        return measure_numbers(replace(replicates, inputs=more), decide)


def _read_loading(trace: Trace) -> tuple[Floats, Floats]:
    """Return displacement and force of the first loading."""
    stretch = select_first_loading(trace)
    return trace.displacement[..., stretch], trace.force[..., stretch]


def _find_gap_at_end(test: ReducedTest, branch: Branch) -> tuple[Reason, ...]:
    """Return a doubt if the force was not recorded up to the end of a loading branch."""
    curve = test.required_curve
    d, f = (values[branch.start : branch.stop] for values in (curve.displacement, curve.force))
    finite = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    if not len(finite) or finite[-1] >= len(d) - 3:  # lost when two clocks are joined
        return ()
    end, missing = 1e3 * float(d[finite[-1]]), len(d) - 1 - finite[-1]
    return (Reason.of("results.gap_at_end", end=end, missing=missing),)
