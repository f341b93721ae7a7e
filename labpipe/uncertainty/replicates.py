"""Draw replicates of a measured curve, and compute numbers from them.

A replicate is the smooth curve with random noise, filtered.

According to JCGM 101:2008 (GUM supplement 1), the uncertainty of a number is its spread over draws
of all quantities on which it depends. The noise of a signal is drawn for every sample of a
replicate. An input that is the same for the whole record (a gain, a zero, an offset) has one draw
per replicate. The effect of the input on a number is computed on the smooth curve alone.

A number is a function of a curve. Its samples (windows, turns, the failure) are chosen once, on one
curve; the number is then computed for all replicates at once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy

from labpipe.records.arrays import Floats, Samples
from labpipe.records.causes import RESOLUTION_OF_FORCE
from labpipe.records.curve import Branch
from labpipe.records.quality import Reason
from labpipe.uncertainty.noise_model import (
    MIN_NOISE_SAMPLES,
    SHORT_RECORD_SAMPLES,
    NoiseModel,
    cut_into_polynomials,
    estimate_noise,
)

N_REPLICATES = 400
"""Number of replicates, for which widths of intervals repeat within 5 %."""
_BATCH_REPLICATES = 50
"""Number of replicates for which numbers are computed at once."""
_MIN_INTERVAL_SAMPLES = 8
"""Smallest mean number of samples in an interval of a spline."""
_SPLINE_DEGREE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A curve, or replicates of it, from which numbers are computed.

    Parameters
    ----------
    time : shape (n,), s; row numbers for a record without times
    displacement, force : shape (..., n), m, N; NaN where unknown
    branches : loading and unloading branches, in samples of the curve
    failed_at : index of the sample of the failure, or None
    sizes : dimensions of specimen and rig, m (an area m^2), keyed by their key in the protocol
    steps_to_event : time from the last sample before a failure or a turn to the failure or turn, in
        sampling steps
    parts_per_step : number of parts into which each original sampling step is divided
    is_smooth : whether the curve has no noise; limits that depend on noise are then taken from the
        measured curve
    """

    time: Floats
    displacement: Floats
    force: Floats
    branches: tuple[Branch, ...] = ()
    failed_at: int | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    steps_to_event: float = 0.0
    parts_per_step: int = 1
    is_smooth: bool = False

    def refine(self, parts: int, *, has_corners: bool = False) -> Trace:
        """Divide each sampling step of the curve into parts.

        Parameters
        ----------
        parts : number of parts of each step
        has_corners : whether a step is replaced by the continuations of its neighbours to their
            intersection. Otherwise it is interpolated linearly

        Returns
        -------
        The curve on the finer samples, of which every `parts`-th one is an original sample.
        """
        positions = np.arange(len(self.time))
        fine_positions = np.arange((len(positions) - 1) * parts + 1) / parts
        time, displacement, force = (
            np.interp(fine_positions, positions, values)
            for values in (self.time, self.displacement, self.force)
        )
        if has_corners:
            displacement = displacement + _compute_corner_excess(self.displacement, parts)
            force = force + _compute_corner_excess(self.force, parts)
        branches = tuple(
            replace(branch, start=parts * branch.start, stop=max(parts * (branch.stop - 1) + 1, 0))
            for branch in self.branches
        )
        return replace(
            self,
            time=time,
            displacement=displacement,
            force=force,
            branches=branches,
            failed_at=None if self.failed_at is None else parts * self.failed_at,
            parts_per_step=parts * self.parts_per_step,
        )


def _compute_corner_excess(values: Floats, parts: int) -> Floats:
    """Compute how far corners in all steps exceed linear interpolation, at each part of the steps.

    The corner of a step is the intersection of its neighbours, continued linearly. The excess is
    zero in a step without such an intersection, and in the first and the last step.
    """
    excess = np.zeros((len(values) - 1, parts))
    steps = np.diff(values)
    if len(steps) >= 3:
        x = np.arange(parts) / parts
        bends = -np.diff(steps)
        start_bend, end_bend = bends[:-1], bends[1:]  # change of slope at both ends of a step
        lines = np.stack([np.outer(start_bend, x), np.outer(end_bend, 1.0 - x)])
        corners = np.where(start_bend > 0.0, lines.min(axis=0).T, lines.max(axis=0).T).T
        excess[1:-1] = np.where((start_bend * end_bend > 0.0)[:, None], corners, 0.0)
    return np.append(excess.ravel(), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Extractor:
    """Functions that compute the numbers of a trace from chosen samples.

    Parameters
    ----------
    compute_numbers : function that computes the numbers of a trace with the same samples, each of
        shape (...); NaN for a curve without the number
    n : number of samples from which the numbers are computed
    compute_noisy_numbers : function for curves with noise; None if it is `compute_numbers`
    ends_at_samples : whether the windows end at samples, and nothing else depends on the sampling.
        The numbers on finer samples then show the effect of the sampling
    depends_on_corners : whether this effect is computed on the measured curve, because the numbers
        depend on corners that the smooth curve rounds off
    sampling_correction : correction of each number to infinitely fine samples; None if unknown
    values : numbers of the measured curve if they are computed from more samples than those of the
        trace, else empty
    """

    compute_numbers: Callable[[Trace], tuple[Floats, ...]]
    n: int
    compute_noisy_numbers: Callable[[Trace], tuple[Floats, ...]] | None = None
    ends_at_samples: bool = False
    depends_on_corners: bool = False
    sampling_correction: tuple[float, ...] | None = None
    values: tuple[float, ...] = ()

    @property
    def compute_replicates(self) -> Callable[[Trace], tuple[Floats, ...]]:
        """Function that computes the numbers of replicates, which have noise."""
        return self.compute_noisy_numbers or self.compute_numbers


Choice: TypeAlias = Callable[[Trace], Extractor]
"""Function that chooses the samples of numbers on one curve, or raises `UnavailableError`."""


def restrict(
    function: Callable[[Floats, Floats], Floats], samples: Samples
) -> Callable[[Trace], tuple[Floats]]:
    """Restrict a function of displacement and force to some samples of a trace.

    Parameters
    ----------
    function : function of displacement and force, shape (..., m), m, N, with values of shape (...)
    samples : the m samples of the trace

    Returns
    -------
    A function that computes the number of a trace.
    """
    return lambda trace: (function(trace.displacement[..., samples], trace.force[..., samples]),)


def combine_numbers(function: Callable[..., Floats], *choices: Choice) -> Choice:
    """Combine several numbers into one number.

    Parameters
    ----------
    function : function of a trace and of the first number of each choice
    choices : functions that choose the samples of the numbers on which the combination depends

    Returns
    -------
    The function that chooses the samples of the combination.
    """

    def choose_samples(trace: Trace) -> Extractor:
        extractors = [choose(trace) for choose in choices]
        return Extractor(
            lambda trace: (function(trace, *(x.compute_numbers(trace)[0] for x in extractors)),),
            extractors[0].n,
            lambda trace: (function(trace, *(x.compute_replicates(trace)[0] for x in extractors)),),
            ends_at_samples=all(extractor.ends_at_samples for extractor in extractors),
            depends_on_corners=any(extractor.depends_on_corners for extractor in extractors),
        )

    return choose_samples


Filter: TypeAlias = Callable[[Floats], Floats]
"""Function that filters signals along their last axis."""
Distribution: TypeAlias = Literal["normal", "uniform", "step", "ends"]
"""Distribution of the error of an input. Normal and uniform errors have a standard deviation of one
unit of `Input.perturb`. For a true value up to one unit above the reading, the error is uniform
between -1 and 0 units (``step``), or -1 or 0 units with equal probability (``ends``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """An uncertain input quantity of a whole record.

    Parameters
    ----------
    cause : name of the cause of the error, a key of `labpipe.records.causes.IS_COMMON`
    perturb : function that returns a trace with the input changed by a number of units. The unit is
        the standard uncertainty or, for ``step`` and ``ends``, a step
    distribution : distribution of the error
    moves_curve : whether a change of the input changes the curve; windows are then chosen again
    drawn_errors : shape (replicates,), errors in units of `perturb`; None to draw them from
        `distribution`
    stream : name of the random stream; if empty, the cause is the name
    doubts : reasons why the uncertainty of the input, and of dependent numbers, may be wrong
    """

    cause: str
    perturb: Callable[[Trace, float], Trace]
    distribution: Distribution = "normal"
    moves_curve: bool = True
    drawn_errors: Floats | None = None
    stream: str = ""
    doubts: tuple[Reason, ...] = ()

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of the error, in the unit of `perturb`."""
        return {"step": float(1.0 / np.sqrt(12.0)), "ends": 0.5}.get(self.distribution, 1.0)


CurveCache: TypeAlias = dict[tuple[Input | None, float, int], Trace]
"""Smooth curves, keyed by the changed input (None without a change), its change in the unit of
`Input.perturb`, and the number of parts of a sampling step."""


@dataclass(frozen=True, slots=True, eq=False)
class Replicates:
    """A curve and its `N_REPLICATES` replicates.

    Parameters
    ----------
    measured_trace : curve from which numbers are computed
    averaged_trace : the measured curve, averaged over the samples of `smooth_trace`
    smooth_trace : the curve without noise and filters, possibly on fewer samples
    displacement, force : shape (replicates, n), m, N, smooth curve with random noise, filtered
    inputs : uncertain inputs of the whole record
    seed : seed of all random draws
    noise_models : noise models of the signals with noise, keyed by ``force`` and ``displacement``
    cache : cache of curves made from `smooth_trace`
    """

    measured_trace: Trace
    averaged_trace: Trace
    smooth_trace: Trace
    displacement: Floats
    force: Floats
    inputs: tuple[Input, ...]
    seed: bytes
    noise_models: Mapping[str, NoiseModel]
    cache: CurveCache = field(init=False, default_factory=dict)

    def iterate_traces(self) -> Iterator[Trace]:
        """Yield batches of replicates, each as one trace of shape (batch, n)."""
        for first in range(0, len(self.force), _BATCH_REPLICATES):
            rows = slice(first, first + _BATCH_REPLICATES)
            displacement, force = self.displacement[rows], self.force[rows]
            yield replace(self.smooth_trace, displacement=displacement, force=force)

    def draw_errors(self, quantity: Input) -> Floats:
        """Draw the errors of an input, in units of `Input.perturb`, shape (replicates,).

        Parameters
        ----------
        quantity : the input, with drawn errors, or with a distribution and a random stream
        """
        if quantity.drawn_errors is not None:
            return quantity.drawn_errors
        rng = make_generator(self.seed, quantity.stream or quantity.cause)
        # The draws are stratified: there is one in each of `n_draws` equal parts of the
        # distribution.
        n_draws = len(self.force)
        quantiles = (rng.permutation(n_draws) + rng.uniform(0.0, 1.0, n_draws)) / n_draws
        compute_errors: dict[Distribution, Callable[[Floats], Floats]] = {
            "normal": scipy.special.ndtri,
            "uniform": lambda x: np.sqrt(3.0) * (2.0 * x - 1.0),
            "step": np.negative,
            "ends": lambda x: -np.rint(x),
        }
        return np.asarray(compute_errors[quantity.distribution](quantiles), dtype=np.float64)

    def shift_displacement(self, offset: float, *inputs: Input) -> Replicates:
        """Shift the displacements of the curve and of all replicates.

        Parameters
        ----------
        offset : m, length that is added to every displacement
        inputs : uncertain inputs on which the offset depends
        """
        traces: dict[str, Any] = {}
        for name in ("measured_trace", "averaged_trace", "smooth_trace"):
            trace: Trace = getattr(self, name)
            traces[name] = replace(trace, displacement=trace.displacement + offset)
        displacement, all_inputs = self.displacement + offset, (*self.inputs, *inputs)
        return replace(self, **traces, displacement=displacement, inputs=all_inputs)


def make_generator(seed: bytes, name: str) -> np.random.Generator:
    """Make a random generator that depends only on a seed and a name.

    Parameters
    ----------
    seed : seed of the record
    name : name of a signal or of a random stream
    """
    digest = hashlib.sha256(seed + name.encode()).digest()[:8]
    return np.random.Generator(np.random.SFC64(int.from_bytes(digest, "little")))


def fit_smooth_trace(
    trace: Trace, values: Floats, cuts: Sequence[int], *, jump: int | None = None
) -> Floats:
    """Fit a smooth curve to a quantity on the samples of a trace.

    Parameters
    ----------
    trace : one curve
    values, cuts, jump : as for `fit_smooth_curve`
    """
    # With 40 intervals, the spline of a tensile curve would follow noise of low frequency.
    max_intervals, branches = 40 if len(trace.branches) > 1 else 12, trace.branches
    return fit_smooth_curve(trace.time, values, cuts, max_intervals, jump=jump, branches=branches)


def fit_smooth_curve(
    time: Floats,
    values: Floats,
    cuts: Sequence[int],
    max_intervals: int,
    *,
    jump: int | None = None,
    branches: Sequence[Branch] | None = None,
) -> Floats:
    """Fit a smooth curve to each piece of a record, and join the pieces.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN stay NaN
    cuts : indices of the samples at which a new piece begins: turns, slips, the failure
    max_intervals : largest number of spline intervals in a piece
    jump : cut at which the curve may jump; at all other cuts the pieces are joined
    branches : branches with motion; None if the whole record is in motion

    Returns
    -------
    Shape (n,), in the unit of the values. Pieces of fewer than `MIN_NOISE_SAMPLES` samples are
    straight lines. Other pieces in motion are polynomials if they have at most
    `SHORT_RECORD_SAMPLES` samples, else cubic splines with equal intervals. Pieces at rest are
    splines, or constant where a spline fits no better than the mean.
    """
    from scipy.interpolate import make_lsq_spline

    smooth, edges = values.copy(), sorted({0, len(values), *cuts})
    for start, stop in pairwise(edges):
        is_finite = ~np.isnan(values[start:stop])
        t, y = time[start:stop][is_finite], values[start:stop][is_finite]
        if len(y) < MIN_NOISE_SAMPLES or t[-1] <= t[0]:
            if len(y) > 2 and np.ptp(t) > 0.0:  # otherwise the samples remain unchanged
                x = t - t.mean()
                smooth[start:stop][is_finite] = y.mean() + x * (x @ y / (x @ x))
            continue
        x = (t - t[0]) / (t[-1] - t[0])
        is_rest = branches is not None and not any(b.start <= start < b.stop for b in branches)
        if len(y) <= SHORT_RECORD_SAMPLES and not is_rest:
            polynomials = [
                np.polynomial.Polynomial.fit(x[first:last], y[first:last], degree)(x[first:last])
                for first, last, degree in cut_into_polynomials(y)
            ]
            smooth[start:stop][is_finite] = np.concatenate(polynomials)
            continue
        # Pieces at rest have fewer intervals. A spline that follows the noise of a plateau would
        # reach its largest samples, and the uncertainty interval of a peak would lie too high.
        min_samples, max_count = (50, 4) if is_rest else (_MIN_INTERVAL_SAMPLES, max_intervals)
        n_intervals = int(np.clip(len(y) // min_samples, 1, max_count))
        knots = np.concatenate([[0.0] * 4, np.arange(1, n_intervals) / n_intervals, [1.0] * 4])
        curve = make_lsq_spline(x, y, _select_supported_knots(knots, x), _SPLINE_DEGREE)(x)
        is_constant = is_rest and _is_constant(y, curve, n_intervals + _SPLINE_DEGREE)
        smooth[start:stop][is_finite] = y.mean() if is_constant else curve
    for previous, cut, following in zip(edges, edges[1:], edges[2:], strict=False):
        if cut != jump and cut - previous > 1 and following - cut > 1:
            _join_pieces(smooth, cut)
    return smooth


def _is_constant(values: Floats, curve: Floats, n_parameters: int) -> bool:
    """Return whether the mean of a piece at rest fits as well as a curve of `n_parameters`.

    The criterion is the information criterion of Schwarz, Ann. Stat. 6 (1978) 461. A curve that
    follows the noise is highest at an end of the rest, and would raise a peak there.
    """
    n_samples = len(values)
    variance_about_mean, variance_about_curve = np.var(values), np.mean((values - curve) ** 2)
    limit = np.exp((n_parameters - 1) * np.log(n_samples) / n_samples)
    return bool(variance_about_mean <= limit * variance_about_curve)


def _join_pieces(values: Floats, cut: int) -> None:
    """Change the two samples at a cut, in place, so that the pieces meet at their intersection.

    A turn is between two samples, not at the cut. A piece that begins one sample early, or ends one
    late, therefore continues beyond the corner. Each of the two samples is compared with the other
    piece, extrapolated by one sample. The lower value is used if the slope decreases at the cut,
    otherwise the higher value. Pieces that are farther apart than their slopes explain, as at a
    slip, are not changed.
    """
    max_gap_steps = 2.5  # multiple of the larger step beside the cut
    step_before, step_after = values[cut - 1] - values[cut - 2], values[cut + 1] - values[cut]
    extrapolated = np.array([values[cut] - step_after, values[cut - 1] + step_before])
    max_gap = max_gap_steps * max(abs(step_before), abs(step_after))
    if abs(extrapolated[1] - values[cut]) <= max_gap:
        select = np.fmin if step_before > step_after else np.fmax
        values[cut - 1 : cut + 1] = select(values[cut - 1 : cut + 1], extrapolated)


def _select_supported_knots(knots: Floats, x: Floats) -> Floats:
    """Select the knots outside gaps of the samples, so that every basis spline has samples."""
    inner_knots = knots[4:-4]
    counts = np.diff(np.searchsorted(x, np.append(0.0, inner_knots)))
    supported_knots = inner_knots[counts > _SPLINE_DEGREE].tolist()
    while supported_knots and (x > supported_knots[-1]).sum() <= _SPLINE_DEGREE:
        supported_knots.pop()
    return np.concatenate([knots[:4], supported_knots, knots[-4:]])


def draw_replicates(
    measured_trace: Trace,
    unfiltered_trace: Trace,
    cuts: Sequence[int],
    filters: tuple[Filter, Filter],
    inputs: tuple[Input, ...],
    *,
    seed: bytes,
    compliance: float = 0.0,
    averaged_trace: Trace | None = None,
) -> Replicates:
    """Draw replicates of a measured curve.

    Parameters
    ----------
    measured_trace : curve from which numbers are computed
    unfiltered_trace : the same curve without filters and without correction for compliance,
        averaged to at most about 20 000 samples
    cuts : indices of the samples of `unfiltered_trace` at which a new piece begins
    filters : filters of the protocol for displacements and for forces, shape (..., n)
    inputs : uncertain inputs of the whole record
    seed : seed of all random draws
    compliance : m/N; compliance times force is subtracted from the displacements
    averaged_trace : `measured_trace`, averaged over the samples of `unfiltered_trace`; None if the
        samples are the same

    Returns
    -------
    The replicates, equal for equal arguments.
    """
    min_noise_fraction = 1e-4  # of the range of a signal; a model of less noise is omitted
    noisy_records, noise_models, smooth_curves = [], {}, []
    jump = None if unfiltered_trace.failed_at is None else unfiltered_trace.failed_at + 1
    has_resolution = any(quantity.cause == RESOLUTION_OF_FORCE for quantity in inputs)
    for name, apply_filters in zip(("displacement", "force"), filters, strict=True):
        values: Floats = getattr(unfiltered_trace, name)
        curve = fit_smooth_trace(unfiltered_trace, values, cuts, jump=jump)
        has_steps = has_resolution and name == "force"
        noise = _estimate_record_noise(values, curve, unfiltered_trace, cuts, has_steps=has_steps)
        rng = make_generator(seed, name)
        noisy_records.append(_add_noise_and_filter(curve, noise, apply_filters, rng))
        noise_models[name] = noise
        smooth_curves.append(curve)
    for curves in (smooth_curves, noisy_records) if compliance else ():
        curves[0] = curves[0] - compliance * curves[1]
    for name, curve, records in zip([*noise_models], smooth_curves, noisy_records, strict=True):
        noise_level = np.nanstd(records[:_BATCH_REPLICATES] - curve)
        if not noise_level > min_noise_fraction * (np.nanmax(curve) - np.nanmin(curve)):
            del noise_models[name]
    displacement, force = smooth_curves
    smooth_trace = replace(unfiltered_trace, displacement=displacement, force=force, is_smooth=True)
    return Replicates(
        measured_trace=measured_trace,
        averaged_trace=averaged_trace or measured_trace,
        smooth_trace=smooth_trace,
        displacement=noisy_records[0],
        force=noisy_records[1],
        inputs=inputs,
        seed=seed,
        noise_models=noise_models,
    )


def _add_noise_and_filter(
    curve: Floats, noise: NoiseModel, apply_filters: Filter, rng: np.random.Generator
) -> Floats:
    """Add random noise to a curve and filter the result, shape (replicates, n)."""
    if not noise.squares.any():  # no noise
        return np.broadcast_to(apply_filters(curve[None]), (N_REPLICATES, len(curve)))
    filtered, first = np.empty((N_REPLICATES, len(curve))), 0
    for batch in noise.draw_batches(len(curve), N_REPLICATES, rng):
        rows = filtered[first : first + len(batch)]
        rows[:] = apply_filters(np.add(curve, batch, out=rows))
        first += len(batch)
    return filtered


def _estimate_record_noise(
    values: Floats, curve: Floats, trace: Trace, cuts: Sequence[int], *, has_steps: bool
) -> NoiseModel:
    """Estimate the noise up to the failure, or of the whole record if all pieces are short."""
    stop = len(values) if trace.failed_at is None else trace.failed_at + 1
    pieces = _list_pieces(cuts, stop)
    if max(piece.stop - piece.start for piece in pieces) < _MIN_INTERVAL_SAMPLES:
        pieces = _list_pieces(cuts, len(values))
    rests: tuple[list[Floats], list[Floats]] = [], []
    if len(trace.branches) > 1:  # before the first branch of a cyclic test and after its last one
        rests = [values[: trace.branches[0].start]], [values[trace.branches[-1].stop :]]
    signals = [values[piece] for piece in pieces], [curve[piece] for piece in pieces]
    return estimate_noise(*signals, *rests, has_steps=has_steps)


def _list_pieces(cuts: Sequence[int], stop: int) -> list[slice]:
    """List the pieces between cuts, up to the sample `stop`."""
    edges = sorted({0, stop, *(cut for cut in cuts if cut < stop)})
    return [slice(*piece) for piece in pairwise(edges)]
