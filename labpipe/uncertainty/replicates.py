"""Replicates of a measured curve: its smooth curve with random noise.

JCGM 101:2008 (GUM supplement 1): the uncertainty of a number is its spread over draws of all
quantities on which it depends. The noise of the signals is drawn as records; an input that is the
same for the whole record (a gain, a zero, an offset) is one draw per record, and its effect is
computed once, on the smooth curve.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import ndtri

from labpipe.records.arrays import Floats
from labpipe.records.causes import RESOLUTION
from labpipe.records.curve import Branch
from labpipe.records.quality import Reason
from labpipe.uncertainty.extractors import Trace
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
_MIN_INTERVAL_SAMPLES = 8
_SPLINE_DEGREE = 3

Filter: TypeAlias = Callable[[Floats], Floats]
Distribution: TypeAlias = Literal["normal", "uniform", "step", "ends"]
"""Distribution of an input, in its standard uncertainties: normal; rectangular; rectangular over
the step after the last sample; or at either end of that step, with equal probability."""


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """An uncertain input quantity of a whole record.

    Parameters
    ----------
    cause : a key of `labpipe.records.causes.IS_COMMON`
    perturb : returns a trace with the input changed by a number of standard uncertainties
    distribution : of its error
    moves_curve : whether it changes the curve; windows are then chosen again
    draws : shape (replicates,), in standard uncertainties; None if they are not drawn yet
    stream : name of its random stream; the cause if empty
    doubts : reasons why its uncertainty, and that of dependent numbers, may be wrong
    """

    cause: str
    perturb: Callable[[Trace, float], Trace]
    distribution: Distribution = "normal"
    moves_curve: bool = True
    draws: Floats | None = None
    stream: str = ""
    doubts: tuple[Reason, ...] = ()

    @property
    def deviation(self) -> float:
        """Return the standard deviation of its draws, in the unit of `perturb`."""
        return {"step": float(1.0 / np.sqrt(12.0)), "ends": 0.5}.get(self.distribution, 1.0)


Curves: TypeAlias = dict[tuple[Input | None, float, int], Trace]
"""Curves by changed input, its change in standard uncertainties, and parts per sampling step."""


@dataclass(frozen=True, slots=True, eq=False)
class Replicates:
    """A curve and its `N_REPLICATES` replicates.

    Parameters
    ----------
    measured : curve from which numbers are computed
    blocks : the measured curve on the samples of `smooth`
    smooth : the curve without noise and filters, possibly on fewer samples
    displacement, force : shape (replicates, n), m, N: the smooth curve with noise, filtered
    inputs : further uncertain inputs
    seed : of all draws
    noises : noise models of force and displacement, for those that have noise
    curves : cache of curves made from `smooth`
    """

    measured: Trace
    blocks: Trace
    smooth: Trace
    displacement: Floats
    force: Floats
    inputs: tuple[Input, ...]
    seed: bytes
    noises: Mapping[str, NoiseModel]
    curves: Curves = field(init=False, default_factory=dict)

    def traces(self) -> Iterator[Trace]:
        """Yield the replicates in batches."""
        for first in range(0, len(self.force), _BATCH_REPLICATES):
            rows = slice(first, first + _BATCH_REPLICATES)
            displacement, force = self.displacement[rows], self.force[rows]
            yield replace(self.smooth, displacement=displacement, force=force)

    def draw_input(self, quantity: Input) -> Floats:
        """Return the draws of an input, in standard uncertainties, shape (replicates,).

        Parameters
        ----------
        quantity : the input; its name selects the random stream
        """
        if quantity.draws is not None:
            return quantity.draws
        rng, count = make_generator(self.seed, quantity.stream or quantity.cause), len(self.force)
        # Stratified: one draw in each of as many equal parts.
        quantiles = (rng.permutation(count) + rng.uniform(0.0, 1.0, count)) / count
        draws: dict[Distribution, Callable[[Floats], Floats]] = {
            "normal": ndtri,
            "uniform": lambda x: np.sqrt(3.0) * (2.0 * x - 1.0),
            "step": np.negative,
            "ends": lambda x: -np.rint(x),
        }
        return np.asarray(draws[quantity.distribution](quantiles), dtype=np.float64)

    def has_noise(self, name: str) -> bool:
        """Return whether the noise of a signal is more than 1e-4 of its range.

        Parameters
        ----------
        name : ``force`` or ``displacement``
        """
        smooth: Floats = getattr(self.smooth, name)
        noise = np.nanstd(getattr(self, name)[:_BATCH_REPLICATES] - smooth)
        return bool(noise > 1e-4 * (np.nanmax(smooth) - np.nanmin(smooth)))

    def shift_displacement(self, by: float, *inputs: Input) -> Replicates:
        """Return the curves with another zero of displacement.

        Parameters
        ----------
        by : m, added to every displacement
        inputs : further inputs to add
        """
        return replace(
            self,
            measured=replace(self.measured, displacement=self.measured.displacement + by),
            blocks=replace(self.blocks, displacement=self.blocks.displacement + by),
            smooth=replace(self.smooth, displacement=self.smooth.displacement + by),
            displacement=self.displacement + by,
            inputs=(*self.inputs, *inputs),
        )


def make_generator(seed: bytes, name: str) -> np.random.Generator:
    """Make a random generator that depends only on seed and name.

    Parameters
    ----------
    seed : of the record
    name : of a signal or an input
    """
    digest = hashlib.sha256(seed + name.encode()).digest()[:8]
    return np.random.Generator(np.random.SFC64(int.from_bytes(digest, "little")))


def count_spline_intervals(trace: Trace) -> int:
    """Return the number of spline intervals per piece of a record.

    Parameters
    ----------
    trace : the record; one with several branches is cyclic
    """
    # With 40 intervals, the spline of a tensile curve would follow slow noise.
    return 40 if len(trace.branches) > 1 else 12


def fit_smooth_curve(
    time: Floats,
    values: Floats,
    cuts: Sequence[int],
    max_intervals: int,
    *,
    jump: int | None = None,
    branches: Sequence[Branch] | None = None,
) -> Floats:
    """Fit least-squares cubic splines with even intervals to the pieces of a record.

    Parameters
    ----------
    time, values : shape (n,); NaN stay NaN
    cuts : samples at which a new piece begins: turns, slips, the failure
    max_intervals : largest number of spline intervals per piece
    jump : cut at which the curve may jump; at all other cuts the pieces are joined
    branches : branches with motion; None if the whole record is in motion

    Returns
    -------
    Shape (n,). Short pieces have fewer intervals, the shortest a straight line.
    """
    # Fewer intervals in pieces at rest: a curve that follows the noise of a plateau reaches the
    # largest of its samples, and the interval of a peak would be too high.
    max_rest_intervals = 4
    min_rest_samples = 50
    from scipy.interpolate import make_lsq_spline

    smooth, ends = values.copy(), sorted({0, len(values), *cuts})
    for low, high in pairwise(ends):
        is_finite = ~np.isnan(values[low:high])
        t, y = time[low:high][is_finite], values[low:high][is_finite]
        if len(y) < MIN_NOISE_SAMPLES or t[-1] <= t[0]:
            if len(y) > 2 and np.ptp(t) > 0.0:  # else too few samples for a straight line
                lever = t - t.mean()
                smooth[low:high][is_finite] = y.mean() + lever * (lever @ y / (lever @ lever))
            continue
        x = (t - t[0]) / (t[-1] - t[0])
        is_rest = branches is not None and not any(x.start <= low < x.stop for x in branches)
        if len(y) <= SHORT_RECORD_SAMPLES and not is_rest:
            smooth[low:high][is_finite] = _fit_polynomials(x, y)
            continue
        min_samples = min_rest_samples if is_rest else _MIN_INTERVAL_SAMPLES
        max_pieces = max_rest_intervals if is_rest else max_intervals
        count = int(np.clip(len(y) // min_samples, 1, max_pieces))
        knots = np.concatenate([[0.0] * 4, np.arange(1, count) / count, [1.0] * 4])
        curve = make_lsq_spline(x, y, _select_supported_knots(knots, x), _SPLINE_DEGREE)(x)
        is_constant = is_rest and _is_constant(y, curve, count + _SPLINE_DEGREE)
        smooth[low:high][is_finite] = y.mean() if is_constant else curve
    for previous, cut, following in zip(ends, ends[1:], ends[2:], strict=False):
        if cut != jump and cut - previous > 1 and following - cut > 1:
            _join_pieces(smooth, cut)
    return smooth


def _fit_polynomials(x: Floats, y: Floats) -> Floats:
    """Fit polynomials to the pieces of a short record."""
    polynomials = np.empty(len(y))
    for start, stop, degree in cut_into_polynomials(y):
        piece = slice(start, stop)
        polynomials[piece] = np.polynomial.Polynomial.fit(x[piece], y[piece], degree)(x[piece])
    return polynomials


def _is_constant(values: Floats, curve: Floats, parameters: int) -> bool:
    """Return whether the mean of a rest fits as well as a curve.

    By the information criterion of Schwarz, Ann. Stat. 6 (1978) 461. A curve through noise is
    highest at an end of the rest, and a peak there would be too high.
    """
    count = len(values)
    about_mean, about_curve = np.var(values), np.mean((values - curve) ** 2)
    limit = np.exp((parameters - 1) * np.log(count) / count)
    return bool(about_mean <= limit * about_curve)


def _join_pieces(values: Floats, cut: int) -> None:
    """Join two pieces where they cross: a turn is between two samples, not at the cut.

    A piece that begins a sample early, or ends one late, runs past the corner. There the other
    piece is extrapolated by a sample: the lower of both if the slope falls, else the higher. Pieces
    farther apart than their slopes explain, as at a slip, are not changed.
    """
    max_gap_steps = 2.5
    step_before, step_after = values[cut - 1] - values[cut - 2], values[cut + 1] - values[cut]
    extrapolated = np.array([values[cut] - step_after, values[cut - 1] + step_before])
    max_gap = max_gap_steps * max(abs(step_before), abs(step_after))
    if abs(extrapolated[1] - values[cut]) <= max_gap:
        select = np.fmin if step_before > step_after else np.fmax
        values[cut - 1 : cut + 1] = select(values[cut - 1 : cut + 1], extrapolated)


def _select_supported_knots(knots: Floats, x: Floats) -> Floats:
    """Remove knots in gaps, so that every spline of the basis has samples."""
    inner = knots[4:-4]
    counts = np.diff(np.searchsorted(x, np.append(0.0, inner)))
    supported = inner[counts > _SPLINE_DEGREE].tolist()
    while supported and (x > supported[-1]).sum() <= _SPLINE_DEGREE:
        supported.pop()
    return np.concatenate([knots[:4], supported, knots[-4:]])


def draw_replicates(
    measured: Trace,
    unfiltered: Trace,
    cuts: Sequence[int],
    filters: tuple[Filter, Filter],
    inputs: tuple[Input, ...],
    *,
    seed: bytes,
    compliance: float = 0.0,
    blocks: Trace | None = None,
) -> Replicates:
    """Draw replicates of a measured curve.

    Parameters
    ----------
    measured : curve from which numbers are computed
    unfiltered : the same without filters, on at most about 20 000 samples
    cuts : samples of `unfiltered` at which a new piece begins
    filters : filters of the protocol for displacements and for forces (..., n)
    inputs : further uncertain inputs
    seed : of all draws
    compliance : m/N; times the force, it is subtracted from the displacement of `unfiltered`
    blocks : `measured` on the samples of `unfiltered`; None if they are the same

    Returns
    -------
    The replicates, the same for the same seed.
    """
    n_intervals, branches = count_spline_intervals(unfiltered), unfiltered.branches
    time, noisy, noises, smooth = unfiltered.time, [], {}, []
    failed = None if unfiltered.failed_at is None else unfiltered.failed_at + 1
    is_coarse = any(quantity.cause == RESOLUTION for quantity in inputs)
    for name, function in zip(("displacement", "force"), filters, strict=True):
        values: Floats = getattr(unfiltered, name)
        curve = fit_smooth_curve(time, values, cuts, n_intervals, jump=failed, branches=branches)
        has_steps = is_coarse and name == "force"
        noise = _estimate_record_noise(values, curve, unfiltered, cuts, has_steps=has_steps)
        noisy.append(_add_noise_and_filter(curve, noise, function, make_generator(seed, name)))
        noises[name] = noise
        smooth.append(curve)
    for curves in (smooth, noisy) if compliance else ():
        curves[0] = curves[0] - compliance * curves[1]
    base = replace(unfiltered, displacement=smooth[0], force=smooth[1], is_smooth=True)
    traces, (displacement, force) = (measured, blocks or measured, base), noisy
    replicates = Replicates(*traces, displacement, force, inputs, seed, noises)
    noises = {name: noise for name, noise in noises.items() if replicates.has_noise(name)}
    return replace(replicates, noises=noises)


def _add_noise_and_filter(
    curve: Floats, noise: NoiseModel, function: Filter, rng: np.random.Generator
) -> Floats:
    """Add drawn noise to a curve and filter it, in batches: shape (replicates, n)."""
    if noise.is_zero:
        return np.broadcast_to(function(curve[None]), (N_REPLICATES, len(curve)))
    filtered, first = np.empty((N_REPLICATES, len(curve))), 0
    for records in noise.draw_batches(len(curve), N_REPLICATES, rng):
        filtered[first : first + len(records)] = function(curve + records)
        first += len(records)
    return filtered


def _estimate_record_noise(
    values: Floats, curve: Floats, trace: Trace, cuts: Sequence[int], *, has_steps: bool
) -> NoiseModel:
    """Estimate the noise of a record from its branches up to the failure, or from all pieces."""
    last = len(values) if trace.failed_at is None else trace.failed_at + 1
    pieces = _list_pieces(cuts, last)
    if max(piece.stop - piece.start for piece in pieces) < _MIN_INTERVAL_SAMPLES:
        pieces = _list_pieces(cuts, len(values))
    rests: tuple[list[Floats], list[Floats]] = [], []
    if len(trace.branches) > 1:  # before the first branch of a cyclic test and after its last one
        rests = [values[: trace.branches[0].start]], [values[trace.branches[-1].stop :]]
    curves = [values[piece] for piece in pieces], [curve[piece] for piece in pieces]
    return estimate_noise(*curves, *rests, has_steps=has_steps)


def _list_pieces(cuts: Sequence[int], last: int) -> list[slice]:
    ends = sorted({0, last, *(cut for cut in cuts if cut < last)})
    return [slice(low, high) for low, high in pairwise(ends)]
