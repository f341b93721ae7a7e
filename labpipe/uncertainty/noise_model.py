"""Noise of a signal: which processes it may be by short pieces of it, and drawn anew.

A load cell, a controller and a specimen remember some tenths of a second, and a window of a test
may be no longer than that. There is then no way to estimate the correlation and go on as if it were
known: each replicate draws the process, too, by the chance that the record gives it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress
from math import ceil

import numpy as np
from scipy import fft
from scipy.special import chdtri

from labpipe.records.arrays import Floats, Singles
from labpipe.uncertainty.polynomial_pieces import polynomial_pieces

_PIECES = 12
"""Pieces that the longest branch is cut into: with 8 the curve comes in, and intervals are 3 to 5
times too wide."""
_SHORTEST, LEAST = 50, 5
"""Samples of a piece of a long record, and of the shortest record that has noise."""
SHORT = 150
"""Samples of the longest branch up to which a record is judged by polynomials through it."""
_WAVES = 48
"""Half waves of a piece that the noise is judged by: with 128 hum is taken for memory."""
_CUBIC = 6
"""Columns of the polynomial that is taken out of a piece: degree five."""
_CLIFF = 4.0
"""Times the median variance, beyond which a piece holds a corner or a step of the curve."""
_STEEP, _CROSSINGS = (0.6, 0.8, 1.0, 1.2, 1.5), (np.pi, 2.0, 0.8, 0.3, 0.12, 0.05)
"""Of flicker noise: powers of the frequency; rad per sample at which white noise is as large."""
_FAST, _BAND = 256, 16
"""Half waves over a branch above which the record's own power may stand for a process, in bands."""
_MARGIN = 12
"""Correlation times after which the end of a drawn record has forgotten its beginning."""
_ROUNDING = 1e-9
"""Share of its range below which what a signal has beside a curve is arithmetic and no noise."""
_SURE = 1e-4
"""Chance below which a process is not drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class _Processes:
    """First-order autoregressive noise of many correlation times, with white noise beneath or not.

    Flicker noise, whose power rises with a power of the period up to that of the whole record.

    factor, floor, is_mirrored, prior, time, steep : shape (g,)
    crossing : shape (g,), rad per sample, where white noise is as large as flicker noise
    lowest : rad per sample, where flicker noise rises no more
    """

    factor: Floats
    floor: Floats
    is_mirrored: Floats
    prior: Floats
    time: Floats
    steep: Floats
    crossing: Floats
    lowest: float

    def spectra(self, angle: Floats) -> Floats:
        """Power at angles per sample (k,), 1 at zero: shape (g, k)."""
        a = self.factor[:, None]
        slow = (1.0 - a) ** 2 / (1.0 - 2.0 * a * np.cos(angle) + a * a)
        flickers = self.steep > 0.0
        power = -0.5 * self.steep[flickers, None]
        slow[flickers] = (1.0 + (angle / self.lowest) ** 2) ** power
        mixed = self.floor[:, None] + (1.0 - self.floor[:, None]) * slow
        spectra: Floats = np.where(self.is_mirrored[:, None] > 0.0, 1.0 / slow, mixed)
        return spectra


@lru_cache(maxsize=16)
def _processes(longest: int, count: int) -> _Processes:
    """What is considered of a record of so many samples, whose longest branch has so many."""
    n_times = 24
    # Correlation times in samples, up to this fraction of the longest branch.
    shortest_time = 0.4
    longest_divisor = 20
    # White noise below correlated noise, as shares of the spectrum at frequency zero.
    white_floors = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    prior_power = -0.4
    # Prior of flicker noise without white noise, relative to white noise. Their crossing is uniform
    # in frequency: the later flicker noise rises above white noise, the smaller its prior.
    flicker_prior = 1.0
    times = np.geomspace(
        shortest_time, max(longest / longest_divisor, 2.0 * shortest_time), n_times
    )
    a, prior = np.exp(-1.0 / times), (times / times[0]) ** prior_power
    lowest, kinds, none = np.pi / (2.0 * max(count, 1)), len(white_floors), np.zeros(n_times)
    steep, crossing = np.repeat(_STEEP, len(_CROSSINGS)), np.tile(_CROSSINGS, len(_STEEP))
    flicker = np.ones(len(steep))
    return _Processes(
        factor=np.concatenate([[0.0], a, a, np.tile(a, kinds), 0.0 * flicker]),
        floor=np.concatenate(
            [[0.0], none, none, np.repeat(white_floors, n_times), (lowest / crossing) ** steep]
        ),
        is_mirrored=np.concatenate([[0.0], none + 1.0, none, np.tile(none, kinds), 0.0 * flicker]),
        prior=np.concatenate(
            [
                [1.0],
                prior,
                0.5 * prior,
                np.tile(0.5 * prior / kinds, kinds),
                flicker_prior * crossing / np.pi,
            ]
        ),
        # Its end forgets its beginning no sooner than the record is over.
        time=np.concatenate([[0.0], none, times, np.tile(times, kinds), count / _MARGIN * flicker]),
        steep=np.concatenate([np.zeros(1 + (2 + kinds) * n_times), steep]),
        crossing=np.concatenate([np.full(1 + (2 + kinds) * n_times, np.inf), crossing]),
        lowest=lowest,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What the noise of a signal may be.

    Parameters
    ----------
    chances : shape (g,), of each process, sum to 1
    squares : shape (g,), in the unit of the signal, squared: the variance at frequency zero times
        `freedom`
    freedom : degrees of freedom of the variance
    longest, count : samples of the longest branch, and of all
    angles, power : shape (b,): from the first angle per sample on the record's own power in bands;
        empty for a short record
    """

    chances: Floats
    squares: Floats
    freedom: int
    longest: int
    count: int
    angles: Floats
    power: Floats

    @property
    def memory(self) -> float:
        """Mean correlation time, samples: half of those that count as one in a mean.

        Half the power at frequency zero over the variance: the correlation time of autoregressive
        noise, less of it the more white noise lies beneath, and one half for white noise alone.
        """
        processes = _processes(self.longest, self.count)
        slow = (1.0 - processes.factor) / (1.0 + processes.factor)
        variance = np.where(
            processes.is_mirrored > 0.0, 1.0, processes.floor + (1.0 - processes.floor) * slow
        )
        return float(self.chances @ (0.5 / variance)[: len(self.chances)])

    @property
    def is_none(self) -> bool:
        """Whether the signal has no noise at all."""
        return not self.squares.any()

    def draw(self, count: int, replicates: int, rng: np.random.Generator) -> Singles:
        """Draw noise of a record.

        Parameters
        ----------
        count : samples of the record
        replicates : how many records
        rng : where chance comes from

        Returns
        -------
        Shape (replicates, count), single precision. Of each record the process is drawn by its
        chance, and the variance by its degrees of freedom, so that the doubt about both is inside.
        """
        drawn = rng.choice(len(self.chances), size=replicates, p=self.chances)
        variance = self.squares[drawn] / rng.chisquare(self.freedom, size=replicates)
        processes = _processes(self.longest, self.count)
        memory = _MARGIN * processes.time[drawn].max(initial=0.0)
        if len(self.angles):
            # Power that ends at the edge of a band remembers as long as the band is narrow.
            memory = max(memory, 2.0 * self.longest / _BAND)
        margin = min(count, ceil(memory) + 1)
        length = fft.next_fast_len(count + margin, real=True)
        angle = np.linspace(0.0, np.pi, length // 2 + 1)
        used, which = np.unique(drawn, return_inverse=True)
        arrays = ("factor", "floor", "is_mirrored", "prior", "time", "steep", "crossing")
        drawn_processes = replace(
            processes, **{name: getattr(processes, name)[used] for name in arrays}
        )
        # Half of the power goes to the cosine, half to the sine; the first wave has no sine.
        height = np.sqrt(0.5 * length * drawn_processes.spectra(angle))
        # Nor has the last, where there is one at half the sampling rate.
        height[:, [0, -1] if length % 2 == 0 else [0]] *= np.sqrt(2.0)
        scale = np.sqrt(variance)
        pairs = rng.standard_normal((replicates, len(angle), 2), dtype=np.float32)
        waves = pairs.view(np.complex64)[..., 0]
        fast = np.searchsorted(angle, self.angles[0]) if len(self.angles) else len(angle)
        waves[:, :fast] *= (scale[:, None] * height[which, :fast]).astype(np.float32)
        if len(self.angles):  # the fast waves have the power that the record has there
            band = np.searchsorted(self.angles, angle[fast:], side="right") - 1
            waves[:, fast:] *= np.sqrt(0.5 * length * self.power[band]).astype(np.float32)
        return np.asarray(fft.irfft(waves, length, axis=1)[:, :count], dtype=np.float32)


def noise_of(
    branches: Sequence[Floats],
    smooth: Sequence[Floats],
    before: Sequence[Floats] = (),
    behind: Sequence[Floats] = (),
    *,
    copies: int = 1,
    has_steps: bool = False,
) -> Noise:
    """Judge the noise of a signal by short pieces of all its branches, and by whole rests.

    Parameters
    ----------
    branches : each shape (n,), unfiltered and evenly sampled; where one has NaN, its known samples
        are closed up, less the smooth curve
    smooth : of each branch, shape (n,), the smooth curve through it
    before, behind : each shape (n,), rests before and behind the motion: there waves as long as
        they are seen, and nowhere else; short ones, and ones with NaN, are left out. Behind the
        motion a force relaxes: a parabola is no noise there
    copies : signals of one kind that these are, each with all branches and rests: their noise is
        one process
    has_steps : whether the steps of a converter are an input of their own; they come and go with
        the slope of the curve

    Returns
    -------
    The chance of each process. Without a branch of 5 samples, or without noise, none.

    Notes
    -----
    A record whose longest branch has at most 150 samples is cut where polynomials follow it best
    (`polynomial_pieces`), so that a knee is no noise. Of a longer one a polynomial of degree five
    is taken out of each piece of a twelfth; what is left is judged in the slowest 48
    half waves of a discrete cosine transform, in which such noise is uncorrelated to a good
    approximation (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90), by the restricted
    likelihood (Harville, J. Am. Stat. Assoc. 72 (1977) 320) of white noise, of first-order
    autoregressive noise, of its mirror image, of it on a floor of white noise; of flicker noise
    (power as frequency^-s, s from 0.6 to 1.5), as cameras and amplifiers have it. Faster waves are
    hum, rounding and converters: there the record's own power is taken, in bands of 16 half waves.
    No process is followed to waves that it was not judged by: a correlation time of ten samples of
    20 000 is seen by those alone, and would make the variance 1.6 times too large on average.
    """
    # What stands to the last digit, saturated or frozen, says nothing of the noise.
    # A piece whose residuals have a lower probability than this in the most probable process
    # contains a kink of the curve.
    kink_chance = 1e-3
    max_rounds = 6
    # With fewer pieces alike, the noise varies along the record, and the variance of the noisier
    # half of the pieces is used.
    min_alike_share = 0.6
    moves = [_spread(branch) > 0.0 for branch in branches]
    span = max(map(_spread, branches), default=0.0)
    both = [_closed_up(*pair) for pair in compress(zip(branches, smooth, strict=True), moves)]
    branches, smooth = [branch for branch, _ in both], [curve for _, curve in both]
    longest = max((len(branch) for branch in branches), default=0)
    count = sum(len(branch) for branch in branches) // copies
    if longest <= SHORT:
        rests = [*_still(before, _SHORTEST), *_still(behind, _SHORTEST, is_behind=True)]
        return _of_short_record(branches, rests, longest, count)
    width = min(longest, max(_SHORTEST, longest // _PIECES))
    pieces = [
        branch[first : first + width]
        for branch in branches
        for first in range(0, len(branch) - width + 1, max(width, 1))
    ]
    moving = np.array([piece for piece in pieces if np.ptp(piece) > 0.0])
    if not len(moving):
        return _silence(longest)
    basis = _polynomials(width)
    left = moving - (moving @ basis) @ basis.T
    power = np.sum(left**2, axis=1)
    if np.median(power) <= width * (_ROUNDING * span) ** 2:
        return _silence(longest)
    terms = min(_WAVES, width)
    waves = fft.dct(left, norm="ortho", axis=1)[:, :terms]
    columns = fft.dct(basis, norm="ortho", axis=0)[:terms]
    processes = _processes(longest, count)
    spectra = processes.spectra(np.pi * np.arange(terms) / width)
    is_level = power <= _CLIFF * np.median(power)
    is_alike = is_level.copy()
    for _ in range(max_rounds):
        seen = _likelihood(spectra, waves[is_alike], columns)
        best = spectra[np.argmax(seen[0] + np.log(processes.prior))]
        whitened = _whitened(best, waves[is_alike], columns)
        free = terms - columns.shape[1]
        odd = whitened > np.median(whitened) * chdtri(free, kink_chance) / chdtri(free, 0.5)
        if not odd.any():
            break
        is_alike[is_alike] = ~odd
    still = [*_still(before, width), *_still(behind, width, is_behind=True)]
    likelihood, squares, freedom = _with_rests(processes, still, width, seen)
    chances = processes.prior * np.exp(likelihood - likelihood.max())
    chances[chances < _SURE * chances.max()] = 0.0
    if is_alike.mean() < min_alike_share and not has_steps:
        squares = squares * power[power >= np.median(power)].mean() / power[is_alike].mean()
    angles, fast = _without_corners(*_own_power(branches, smooth), left[is_level])
    return Noise(
        chances / chances.sum(),
        squares,
        freedom,
        longest,
        count,
        angles,
        fast,
    )


def _with_rests(
    processes: _Processes,
    still: Sequence[tuple[Floats, Floats]],
    width: int,
    seen: tuple[Floats, Floats, int],
) -> tuple[Floats, Floats, int]:
    """Likelihood, sums of squares and degrees of freedom with those of rests.

    Without rests nothing is seen of waves as long as the record. Flicker noise is left out there
    where pieces do not tell it from others: in records of less than a dozen pieces, where it rises
    from white noise below their waves, and where it rises as steeply as noise that remembers.
    """
    # Flicker noise is judged without rests only where it exceeds white noise at this multiple of
    # the slowest wave of a piece,
    min_crossing = 2.0
    # and up to this power of the frequency.
    max_flicker_power = 1.2
    likelihood, squares, freedom = seen
    if not still:
        slow, fast = (np.pi * rise / width for rise in (min_crossing * _CUBIC, _WAVES))
        is_seen = (processes.crossing >= slow) & (processes.crossing <= fast)
        # What is white beyond the fastest wave of a piece is alike there.
        is_seen |= processes.crossing == _CROSSINGS[0]
        is_seen &= (processes.steep <= max_flicker_power) & (width > _SHORTEST)
        is_seen |= processes.steep == 0.0
        return np.where(is_seen, likelihood, -np.inf), squares, freedom
    return _added(processes, still, seen)


def _of_short_record(
    branches: Sequence[Floats], rests: Sequence[tuple[Floats, Floats]], longest: int, count: int
) -> Noise:
    """Judge the noise by what polynomials through the branches leave."""
    parts = [
        (branch[start:stop], _legendre(stop - start, degree + 1))
        for branch in branches
        if len(branch) >= LEAST
        for start, stop, degree in polynomial_pieces(branch)
    ]
    span = max(map(_spread, branches), default=0.0)
    left = sum(float(np.sum((part - basis @ (basis.T @ part)) ** 2)) for part, basis in parts)
    if not parts or left <= count * (_ROUNDING * span) ** 2:
        return _silence(longest)
    processes = _processes(longest, count)
    none = np.zeros(len(processes.prior))
    seen = np.where(processes.steep > 0.0, none if rests else -np.inf, none), none, 0
    likelihood, squares, freedom = _added(processes, [*parts, *rests], seen)
    chances = processes.prior * np.exp(likelihood - likelihood.max())
    chances[chances < _SURE * chances.max()] = 0.0
    chances /= chances.sum()
    return Noise(chances, squares, freedom, longest, count, np.zeros(0), np.zeros(0))


def _added(
    processes: _Processes,
    parts: Sequence[tuple[Floats, Floats]],
    seen: tuple[Floats, Floats, int],
) -> tuple[Floats, Floats, int]:
    """Likelihood, sums of squares and degrees of freedom with those of more parts.

    Each part has its samples and the basis, shape (samples, columns), that is no noise in them.
    """
    likelihood, squares, freedom = seen
    least = np.finfo(np.float64).tiny
    logs = likelihood + 0.5 * freedom * np.log(np.maximum(squares, least))
    for rest, basis in parts:
        terms = min(_WAVES, len(rest))
        waves = fft.dct(rest - basis @ (basis.T @ rest), norm="ortho")[None, :terms]
        columns = fft.dct(basis, norm="ortho", axis=0)[:terms]
        spectra = processes.spectra(np.pi * np.arange(terms) / len(rest))
        one, more, free = _likelihood(spectra, waves, columns)
        logs = logs + one + 0.5 * free * np.log(np.maximum(more, least))
        squares, freedom = squares + more, freedom + free
    return logs - 0.5 * freedom * np.log(np.maximum(squares, least)), squares, freedom


def _still(
    rests: Sequence[Floats], least: int, *, is_behind: bool = False
) -> Iterator[tuple[Floats, Floats]]:
    """Middles of rests that are long enough, each with what moves there but for noise."""
    # One tenth of a rest next to the motion is cut off: the motion may have begun or not yet have
    # ended there.
    edge_divisor = 10
    # Polynomial columns removed after the motion, where a specimen relaxes.
    relaxation_columns = 3
    for rest in rests:
        if len(rest) < least or not np.ptp(rest) > 0.0:  # nor of NaN
            continue
        edge = len(rest) // edge_divisor
        middle = rest[edge:] if is_behind else rest[: len(rest) - edge]
        yield middle, _polynomials(len(middle), relaxation_columns if is_behind else 1)


def _spread(values: Floats) -> float:
    """Range of what is known; 0 for nothing."""
    finite = values[~np.isnan(values)]
    return float(np.ptp(finite)) if len(finite) else 0.0


def _closed_up(values: Floats, curve: Floats) -> tuple[Floats, Floats]:
    """A branch and its smooth curve without gaps; with one, less the curve, which jumps there."""
    is_finite = ~np.isnan(values)
    if is_finite.all():
        return values, curve
    return (values - curve)[is_finite], np.zeros(int(is_finite.sum()))


def _silence(longest: int) -> Noise:
    none = np.zeros(0)
    return Noise(np.ones(1), np.zeros(1), 1, max(longest, 1), 0, none, none)


def _polynomials(width: int, most: int = _CUBIC) -> Floats:
    """Orthonormal polynomials over a piece, shape (width, columns)."""
    min_samples_per_column = 8
    return _legendre(width, int(np.clip(width // min_samples_per_column, min(2, most), most)))


def _legendre(width: int, columns: int) -> Floats:
    """The first orthonormal polynomials over so many even samples, shape (width, columns)."""
    at = np.linspace(-1.0, 1.0, width)
    return np.linalg.qr(np.polynomial.legendre.legvander(at, columns - 1))[0]


def _likelihood(spectra: Floats, waves: Floats, columns: Floats) -> tuple[Floats, Floats, int]:
    """Logarithm of the likelihood of each spectrum, its sum of squares, degrees of freedom."""
    inverse = 1.0 / spectra
    count, spent = len(waves), columns.shape[1]
    products = (columns[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
    information = (inverse @ products).reshape(-1, spent, spent)
    weighted = (waves[:, :, None] * columns).transpose(1, 0, 2).reshape(len(columns), -1)
    score = (inverse @ weighted).reshape(len(inverse), count, spent)
    explained = np.einsum("gps,gsr,gpr->g", score, np.linalg.inv(information), score, optimize=True)
    squares = np.maximum(inverse @ np.sum(waves**2, axis=0) - explained, 0.0)
    freedom = count * (len(columns) - spent)
    logs = np.log(spectra).sum(axis=1) + np.linalg.slogdet(information)[1]
    with np.errstate(divide="ignore"):
        likelihood = -0.5 * (count * logs + freedom * np.log(squares))
    return np.nan_to_num(likelihood, posinf=0.0), squares, freedom


def _whitened(spectrum: Floats, waves: Floats, columns: Floats) -> Floats:
    """Sum of squares of each piece, every wave by its own power: alike where the noise is."""
    score = (waves / spectrum) @ columns
    information = columns.T @ (columns / spectrum[:, None])
    explained = np.sum(score * np.linalg.solve(information, score.T).T, axis=1)
    squares: Floats = np.sum(waves**2 / spectrum, axis=1) - explained
    return squares


def _without_corners(angles: Floats, power: Floats, left: Floats) -> tuple[Floats, Floats]:
    """Power of the fast waves by pieces without a corner, where a corner makes most of it."""
    width = left.shape[1]
    first = int(np.ceil(angles[0] * width / np.pi)) if len(angles) else width
    if first + 1 >= width:
        return angles, power
    piece_power = np.mean(fft.dct(left, norm="ortho", axis=1)[:, first:] ** 2, axis=0)
    if power.mean() <= _CLIFF * piece_power.mean():
        return angles, power
    interpolated = np.interp(
        angles, np.pi * (first + np.arange(width - first)) / width, piece_power
    )
    return angles, np.asarray(interpolated, dtype=np.float64)


def _own_power(branches: Sequence[Floats], smooth: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Power of the fast waves of a record in bands, by all branches: angles per sample, power."""
    left = [
        branch - curve
        for branch, curve in zip(branches, smooth, strict=True)
        if len(branch) > 2 * _FAST
    ]
    if not left:
        return np.zeros(0), np.zeros(0)
    longest = max(len(residuals) for residuals in left)
    # Beyond the waves that the pieces are judged by no process is known.
    first = max(_FAST, min(longest // 8, _PIECES * _WAVES))
    angles = np.pi * np.arange(first, longest - _BAND, _BAND) / longest
    total = np.zeros(len(angles))
    for residuals in left:
        sums = np.append(0.0, np.cumsum(fft.dct(residuals, norm="ortho") ** 2))
        at = np.append(angles, np.pi) * len(residuals) / np.pi
        power = np.diff(np.interp(at, np.arange(len(residuals) + 1), sums)) / np.diff(at)
        total += power * len(residuals)
    return angles, total / sum(len(residuals) for residuals in left)
