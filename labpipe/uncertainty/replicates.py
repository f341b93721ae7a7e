"""Curves that a measured one may have been: its smooth record, with noise drawn anew.

JCGM 101:2008 (GUM supplement 1): the uncertainty of a number is the spread of the number over draws
of everything it rests on. The noise of the signals is drawn as records; an input that is the same
for the whole record (a gain, a zero, an offset) is one draw a record, and what it changes is seen
once, on the smooth record.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import ndtri

from labpipe.records.arrays import Floats, Singles
from labpipe.records.causes import RESOLUTION
from labpipe.records.curve import Branch
from labpipe.records.quality import Reason
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.noise_model import LEAST, SHORT, Noise, noise_of
from labpipe.uncertainty.polynomial_pieces import polynomial_pieces

COUNT = 400
"""Replicates: widths of intervals repeat within 5 %."""
_CHUNK = 50
"""Replicates that are read at once."""
_PARTS, _PARTS_OF_CYCLE = 12, 40
"""Intervals of the spline through a single loading, and through a branch of a cyclic test: with 40
a tensile curve follows slow noise."""
_PER_PART = 8
"""Samples of an interval at least."""
_DUST = 1e-4
"""Share of the range of a signal below which its noise may be of any kind."""
_DEGREE = 3

Filter: TypeAlias = Callable[[Floats], Floats]
Law: TypeAlias = Literal["normal", "uniform", "step"]
"""What an input is drawn from, in its standard uncertainties: a normal or a rectangular
distribution; a whole step of which the truth lies somewhere inside, behind the last sample."""
STEP_DEVIATION = 1.0 / np.sqrt(12.0)


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """Something that a whole record rests on, and that is known with an uncertainty.

    Parameters
    ----------
    cause : in words, such as ``gain of the load cell``
    moved : a trace as it is with the input so many standard uncertainties higher
    law : what it is drawn from
    moves_curve : whether it moves the curve, so that windows are decided anew
    draws : shape (replicates,), in standard uncertainties, where the input has been drawn before
    stream : name of its stream of chance; the cause where it is empty
    doubts : why its uncertainty may not be trusted; nor may numbers that rest on it
    """

    cause: str
    moved: Callable[[Trace, float], Trace]
    law: Law = "normal"
    moves_curve: bool = True
    draws: Floats | None = None
    stream: str = ""
    doubts: tuple[Reason, ...] = ()

    @property
    def deviation(self) -> float:
        """Standard deviation of its draws, in the unit of `moved`."""
        return float(STEP_DEVIATION) if self.law == "step" else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Replicates:
    """A curve and `COUNT` others that it may have been.

    Parameters
    ----------
    measured : the curve that numbers are read from
    smooth : without its noise and without filters, perhaps on fewer samples
    displacement, force : shape (replicates, n), m, N: the smooth curve with noise, filtered
    inputs : what else is drawn
    seed : of all draws
    noises : what the noise of force and displacement was taken for; of those that have noise
    before_filters : shape (replicates, n), N, what noise adds to the force before all filters; None
        where it is not known, or filters do nothing
    """

    measured: Trace
    smooth: Trace
    displacement: Floats
    force: Floats
    inputs: tuple[Input, ...]
    seed: bytes
    noises: Mapping[str, Noise]
    before_filters: Singles | None = None

    def traces(self) -> Iterator[Trace]:
        """The replicates, some at a time."""
        for first in range(0, len(self.force), _CHUNK):
            rows = slice(first, first + _CHUNK)
            displacement, force = self.displacement[rows], self.force[rows]
            noise = None if self.before_filters is None else self.before_filters[rows]
            yield replace(self.smooth, displacement=displacement, force=force, noise=noise)

    def draws(self, quantity: Input) -> Floats:
        """Draws of an input, in its standard uncertainties, shape (replicates,): always the same.

        Parameters
        ----------
        quantity : by whose cause the stream of numbers is chosen
        """
        if quantity.draws is not None:
            return quantity.draws
        rng, count = stream(self.seed, quantity.stream or quantity.cause), len(self.force)
        # One draw in each of as many equal parts: its spread does not depend on luck.
        chance = (rng.permutation(count) + rng.uniform(0.0, 1.0, count)) / count
        if quantity.law == "normal":
            return np.asarray(ndtri(chance), dtype=np.float64)
        if quantity.law == "uniform":
            return np.asarray(np.sqrt(3.0) * (2.0 * chance - 1.0), dtype=np.float64)
        return np.asarray(-chance, dtype=np.float64)

    def has_noise(self, name: str) -> bool:
        """Whether the noise of a signal is more than dust beside its range.

        Parameters
        ----------
        name : ``force`` or ``displacement``
        """
        smooth: Floats = getattr(self.smooth, name)
        noise = np.nanstd(getattr(self, name)[:_CHUNK] - smooth)
        return bool(noise > _DUST * (np.nanmax(smooth) - np.nanmin(smooth)))

    def displaced(self, by: float, *inputs: Input) -> Replicates:
        """The same curves, displacement counted from another place.

        Parameters
        ----------
        by : m, added to every displacement
        inputs : that come in with it
        """
        return replace(
            self,
            measured=replace(self.measured, displacement=self.measured.displacement + by),
            smooth=replace(self.smooth, displacement=self.smooth.displacement + by),
            displacement=self.displacement + by,
            inputs=(*self.inputs, *inputs),
        )


def stream(seed: bytes, name: str) -> np.random.Generator:
    """Make a stream of chance of its own for a name, the same for the same record.

    Parameters
    ----------
    seed : of the record
    name : of a signal or an input
    """
    digest = hashlib.sha256(seed + name.encode()).digest()[:8]
    return np.random.Generator(np.random.SFC64(int.from_bytes(digest, "little")))


def parts_of(trace: Trace) -> int:
    """Intervals of the smooth curve through each piece of a record.

    Parameters
    ----------
    trace : the record; one with a branch back is cyclic
    """
    return _PARTS_OF_CYCLE if len(trace.branches) > 1 else _PARTS


def smooth_curve(
    time: Floats,
    values: Floats,
    cuts: Sequence[int],
    parts: int,
    *,
    broken: int | None = None,
    branches: Sequence[Branch] | None = None,
) -> Floats:
    """Smooth curve through a record, piece by piece: least-squares cubic splines of even intervals.

    Parameters
    ----------
    time, values : shape (n,); NaN stay NaN
    cuts : numbers of the samples at which a new piece begins: turns, slips, the failure
    parts : intervals of each piece at most
    broken : the cut at which the curve may jump; at all others the pieces meet
    branches : in which something moves; None where it does all the time

    Returns
    -------
    Shape (n,). A piece of few samples gets fewer intervals, and a straight line at last.
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
        if len(y) < LEAST or t[-1] <= t[0]:
            smooth[low:high][is_finite] = _line(t, y)
            continue
        x = (t - t[0]) / (t[-1] - t[0])
        rests = branches is not None and not any(x.start <= low < x.stop for x in branches)
        if len(y) <= SHORT and not rests:
            smooth[low:high][is_finite] = _polynomials(x, y)
            continue
        min_samples, most = (min_rest_samples, max_rest_intervals) if rests else (_PER_PART, parts)
        count = int(np.clip(len(y) // min_samples, 1, most))
        knots = np.concatenate([[0.0] * 4, np.arange(1, count) / count, [1.0] * 4])
        curve = make_lsq_spline(x, y, _with_samples(knots, x), _DEGREE)(x)
        stands = rests and _stands(y, curve, count + _DEGREE)
        smooth[low:high][is_finite] = y.mean() if stands else curve
    for before, cut, after in zip(ends, ends[1:], ends[2:], strict=False):
        if cut != broken and cut - before > 1 and after - cut > 1:
            _meet(smooth, cut)
    return smooth


def _polynomials(x: Floats, y: Floats) -> Floats:
    """Polynomials through the pieces of a short record."""
    polynomials = np.empty(len(y))
    for start, stop, degree in polynomial_pieces(y):
        piece = slice(start, stop)
        polynomials[piece] = np.polynomial.Polynomial.fit(x[piece], y[piece], degree)(x[piece])
    return polynomials


def _stands(values: Floats, curve: Floats, parameters: int) -> bool:
    """Whether the mean of a rest says as much as a curve through it.

    By the information criterion of Schwarz, Ann. Stat. 6 (1978) 461. A curve through noise is
    highest at an end of the rest, and a peak that is read there comes out too high.
    """
    count = len(values)
    about_mean, about_curve = np.var(values), np.mean((values - curve) ** 2)
    limit = np.exp((parameters - 1) * np.log(count) / count)
    return bool(about_mean <= limit * about_curve)


def _meet(values: Floats, cut: int) -> None:
    """Let two pieces meet where they cross: a turn lies between two samples, not at the cut.

    A piece that begins a sample early, or ends one late, runs past the corner. There the other one
    holds, carried on by a sample: the lower of both where the slope falls, else the higher. Pieces
    that are farther apart than their slopes explain, as at a slip, stay as they are.
    """
    max_gap_steps = 2.5
    left, right = values[cut - 1] - values[cut - 2], values[cut + 1] - values[cut]
    ahead, back = values[cut - 1] + left, values[cut] - right
    if not abs(ahead - values[cut]) <= max_gap_steps * max(abs(left), abs(right)):
        return
    pick = min if left > right else max
    values[cut - 1], values[cut] = pick(values[cut - 1], back), pick(values[cut], ahead)


def _with_samples(knots: Floats, x: Floats) -> Floats:
    """Knots without those in gaps, so that every spline of the basis has samples beneath it."""
    inner = knots[4:-4]
    counts = np.diff(np.searchsorted(x, np.concatenate([[0.0], inner, [1.0]])))
    supported = [knot for knot, before in zip(inner, counts[:-1], strict=True) if before > _DEGREE]
    while supported and (x > supported[-1]).sum() <= _DEGREE:
        supported.pop()
    return np.concatenate([knots[:4], supported, knots[-4:]])


def _line(t: Floats, y: Floats) -> Floats:
    """Straight line through a few samples; fewer than three are taken as they are."""
    if len(y) < 3 or np.ptp(t) == 0.0:
        return y
    lever = t - t.mean()
    line: Floats = y.mean() + lever * ((lever @ y) / (lever @ lever))
    return line


def replicated(
    measured: Trace,
    unfiltered: Trace,
    cuts: Sequence[int],
    filters: tuple[Filter, Filter],
    inputs: tuple[Input, ...],
    *,
    seed: bytes,
    compliance: float = 0.0,
) -> Replicates:
    """Draw curves that a measured one may have been.

    Parameters
    ----------
    measured : numbers are read from
    unfiltered : the same without filters, on at most some 20 000 samples
    cuts : samples of `unfiltered` at which a new piece begins
    filters : what the protocol's filters make of displacements and of forces (..., n)
    inputs : what else is drawn
    seed : of all draws
    compliance : m/N, times the force to be taken off the displacement of `unfiltered`

    Returns
    -------
    The same for the same seed.
    """
    parts, before = parts_of(unfiltered), None
    time, drawn, noises, smooth = unfiltered.time, [], {}, []
    failed = None if unfiltered.failed_at is None else unfiltered.failed_at + 1
    is_coarse = any(quantity.cause == RESOLUTION for quantity in inputs)
    for name, act in zip(("displacement", "force"), filters, strict=True):
        values: Floats = getattr(unfiltered, name)
        curve = smooth_curve(time, values, cuts, parts, broken=failed, branches=unfiltered.branches)
        noise = _noise(values, curve, unfiltered, cuts, has_steps=is_coarse and name == "force")
        before = None if noise.is_none else noise.draw(len(time), COUNT, stream(seed, name))
        drawn.append(_filtered(curve, before, act))
        noises[name] = noise
        smooth.append(curve)
    displacement, force = drawn
    if compliance:
        smooth[0] = smooth[0] - compliance * smooth[1]
        displacement = displacement - compliance * force
    base = replace(unfiltered, displacement=smooth[0], force=smooth[1])
    replicates = Replicates(measured, base, displacement, force, inputs, seed, noises, before)
    noises = {name: noise for name, noise in noises.items() if replicates.has_noise(name)}
    return replace(replicates, noises=noises)


def _filtered(curve: Floats, noise: Singles | None, act: Filter) -> Floats:
    """A curve with each noise, filtered: shape (replicates, n), some at a time."""
    if noise is None:
        return np.broadcast_to(act(curve[None]), (COUNT, len(curve)))
    filtered = np.empty(noise.shape)
    for first in range(0, len(noise), _CHUNK):
        rows = slice(first, first + _CHUNK)
        filtered[rows] = act(curve + noise[rows])
    return filtered


def _noise(
    values: Floats, curve: Floats, trace: Trace, cuts: Sequence[int], *, has_steps: bool
) -> Noise:
    """Noise of a record by its branches up to where the specimen failed, or by all pieces."""
    last = len(values) if trace.failed_at is None else trace.failed_at + 1
    pieces = _pieces(cuts, last)
    if max(piece.stop - piece.start for piece in pieces) < _PER_PART:
        pieces = _pieces(cuts, len(values))
    of_pieces = [values[piece] for piece in pieces], [curve[piece] for piece in pieces]
    if len(trace.branches) < 2:
        return noise_of(*of_pieces, has_steps=has_steps)
    # Before the first branch of a cyclic test and behind its last one nothing moves.
    before, behind = values[: trace.branches[0].start], values[trace.branches[-1].stop :]
    return noise_of(*of_pieces, [before], [behind], has_steps=has_steps)


def _pieces(cuts: Sequence[int], last: int) -> list[slice]:
    ends = sorted({0, last, *(cut for cut in cuts if cut < last)})
    return [slice(low, high) for low, high in pairwise(ends)]
