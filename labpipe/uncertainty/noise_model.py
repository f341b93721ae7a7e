"""Estimate the noise of a signal from short pieces, and draw random records of it.

The noise of a load cell, a controller or a specimen is correlated over tenths of a second, which
may be as long as the window of a fit. The estimated correlation is then uncertain, so each
replicate also draws its noise process by the probability of the process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.special import chdtri

from labpipe.records.arrays import Flags, Floats, Ints, Singles
from labpipe.uncertainty.autocorrelation import (
    Processes,
    SpectrumLikelihood,
    SpectrumPosterior,
    list_autoregressive_processes,
)

_PIECES_PER_BRANCH = 12
"""Pieces of the longest branch. With 8, residuals contain the curve, and intervals are 3 to 5 times
too wide."""
_MIN_PIECE_SAMPLES, MIN_NOISE_SAMPLES = 50, 5
"""Fewest samples of a piece of a long record, and of a branch that has noise."""
SHORT_RECORD_SAMPLES = 150
"""Samples of the longest branch up to which polynomials are fitted to a whole record."""
_HALF_WAVES = 48
"""Half waves of a piece for the estimate of the noise: with 128, hum would count as correlation."""
_POLYNOMIAL_COLUMNS = 6
"""Columns of the polynomial that is removed from a piece: degree five."""
_CORNER_VARIANCE_RATIO = 4.0
"""A piece with more than this multiple of the median variance contains a corner or a step."""
_FLICKER_POWERS, _FLICKER_CROSSINGS = (0.6, 0.8, 1.0, 1.2, 1.5), (np.pi, 2.0, 0.8, 0.3, 0.12, 0.05)
"""Powers of the frequency of flicker noise; rad per sample at which white noise is as large."""
_MIN_RECORD_WAVES, _BAND_WAVES = 256, 16
"""Fewest half waves over the longest branch from which on the power of the record is used; half
waves per band."""
_MARGIN_TIMES = 12
"""Correlation times after which samples of a drawn record count as independent."""
_BATCH_RECORDS = 50
"""Records that are drawn at once: few enough to stay in the cache."""
_ROUNDING_SHARE = 1e-9
"""Share of the range of a signal below which residuals are rounding, not noise."""


@lru_cache(maxsize=16)
def _processes(longest: int, count: int) -> Processes:
    """Return the processes for a record with `count` samples, `longest` in its longest branch."""
    n_times, shortest_time = 24, 0.4
    # White noise in addition to correlated noise, as shares of the spectrum at frequency zero.
    white_floors = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    # Longest correlation time, as a share of the longest branch. A record of fewer than a dozen
    # pieces does not exclude a longer one.
    longest_share = 0.1 if longest < _PIECES_PER_BRANCH * _MIN_PIECE_SAMPLES else 0.05
    # Prior of flicker noise without white noise, relative to white noise. Their crossing is uniform
    # in frequency: the lower the frequency of the crossing, the smaller its prior.
    flicker_prior = 1.0
    times = np.geomspace(shortest_time, max(longest_share * longest, 2.0 * shortest_time), n_times)
    lowest, record_time = np.pi / (2.0 * max(count, 1)), count / _MARGIN_TIMES
    rows = list_autoregressive_processes(times, white_floors)
    # Flicker noise, which is correlated over the whole record.
    for power, crossing in product(_FLICKER_POWERS, _FLICKER_CROSSINGS):
        floor, prior = (lowest / crossing) ** power, flicker_prior * crossing / np.pi
        rows.append((0.0, floor, 0.0, prior, record_time, power, crossing))
    return Processes(lowest, *np.array(rows).T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of a signal as a mixture of processes.

    Parameters
    ----------
    probabilities : shape (g,), probability of each process
    squares : shape (g,), in the unit of the signal, squared: the variance at frequency zero times
        `freedom`
    freedom : degrees of freedom of the variance
    longest, count : samples of the longest branch, and of all branches of one signal
    angles, power : shape (b,), rad per sample at which each band of fast waves begins, and the
        power of the record itself in it; empty without a branch of more than 512 samples
    """

    probabilities: Floats
    squares: Floats
    freedom: int
    longest: int
    count: int
    angles: Floats
    power: Floats

    @property
    def correlation_time(self) -> float:
        """Return the mean correlation time, samples.

        Half the power at frequency zero over the variance: one half for white noise. Added white
        noise reduces it. Flicker noise and mirror images count as white noise.
        """
        processes = _processes(self.longest, self.count)
        slow = (1.0 - processes.factor) / (1.0 + processes.factor)
        mixed = processes.floor + (1.0 - processes.floor) * slow
        variance = np.where(processes.is_mirrored > 0.0, 1.0, mixed)
        return float(self.probabilities @ (0.5 / variance)[: len(self.probabilities)])

    @property
    def is_zero(self) -> bool:
        """Return whether the signal has no noise."""
        return not self.squares.any()

    def draw(self, count: int, replicates: int, rng: np.random.Generator) -> Singles:
        """Draw random noise of a record.

        Parameters
        ----------
        count : samples of the record
        replicates : number of records
        rng : random generator

        Returns
        -------
        Shape (replicates, count), single precision. For each record the process is drawn by its
        probability, and the variance by its degrees of freedom, to include their uncertainty. Fast
        waves always have the power of the estimated record.
        """
        return np.concatenate([*self.draw_batches(count, replicates, rng)])

    def draw_batches(
        self, count: int, replicates: int, rng: np.random.Generator
    ) -> Iterator[Singles]:
        """Draw random noise as `draw`, and yield a few records at a time."""
        chosen = rng.choice(len(self.probabilities), size=replicates, p=self.probabilities)
        variance = self.squares[chosen] / rng.chisquare(self.freedom, size=replicates)
        processes = _processes(self.longest, self.count)
        margin_time = _MARGIN_TIMES * processes.time[chosen].max(initial=0.0)
        if len(self.angles):
            # Power that ends at the edge of a band is correlated over its inverse width.
            margin_time = max(margin_time, 2.0 * self.longest / _BAND_WAVES)
        margin = min(count, ceil(margin_time) + 1)
        length = fft.next_fast_len(count + margin, real=True)
        angle = np.linspace(0.0, np.pi, length // 2 + 1)
        processes_drawn, process_numbers = np.unique(chosen, return_inverse=True)
        # Cosine and sine have half of the power each; the first wave has no sine.
        amplitude = np.sqrt(0.5 * length * processes.spectra(angle, processes_drawn))
        # Nor has the last one at half the sampling rate.
        amplitude[:, [0, -1] if length % 2 == 0 else [0]] *= np.sqrt(2.0)
        scale = np.sqrt(variance)
        fast = np.searchsorted(angle, self.angles[0]) if len(self.angles) else len(angle)
        # Fast waves have the power of the record.
        band = np.searchsorted(self.angles, angle[fast:], side="right") - 1
        fast_amplitude = np.sqrt(0.5 * length * self.power[band]).astype(np.float32)
        slow_amplitude = np.repeat(amplitude[:, :fast], 2, axis=1)
        fast_amplitude = np.repeat(fast_amplitude, 2)
        for first in range(0, replicates, _BATCH_RECORDS):
            rows = slice(first, first + _BATCH_RECORDS)
            numbers = process_numbers[rows]
            waves = rng.standard_normal((len(numbers), 2 * len(angle)), dtype=np.float32)
            amplitudes = scale[rows, None] * slow_amplitude[numbers]
            waves[:, : 2 * fast] *= amplitudes.astype(np.float32)
            waves[:, 2 * fast :] *= fast_amplitude
            records = fft.irfft(waves.view(np.complex64), length, axis=1)
            yield records[:, :count].astype(np.float32, copy=False)


def estimate_noise(
    branches: Sequence[Floats],
    smooth: Sequence[Floats],
    rests_before: Sequence[Floats] = (),
    rests_after: Sequence[Floats] = (),
    *,
    copies: int = 1,
    has_steps: bool = False,
) -> NoiseModel:
    """Estimate the noise of a signal from short pieces of its branches, and from whole rests.

    Parameters
    ----------
    branches : each shape (n,), unfiltered and evenly sampled; NaN are removed, and the smooth
        curve is then subtracted
    smooth : each shape (n,), the smooth curve through each branch
    rests_before, rests_after : each shape (n,), rests before and after the motion, which alone show
        slow waves; rests that are short, constant or have NaN are ignored. After the motion a force
        relaxes, so a parabola is removed there
    copies : number of signals with the same noise process; `branches` and rests are those of all
        signals
    has_steps : whether the steps of a converter are a separate input, as they vary with the slope
        of the curve; noise that varies along the record then does not raise the variance

    Returns
    -------
    The noise model; that of zero noise without noise, or without a branch of 5 samples.

    Notes
    -----
    A record whose longest branch has at most 150 samples is cut where polynomials follow it best
    (`cut_into_polynomials`), so that a knee does not count as noise. A longer record is cut into
    pieces of a twelfth of its longest branch, but of at least 50 samples. From each piece, a
    polynomial of degree five is removed; the residuals are modelled in the slowest 48
    half waves of a discrete cosine transform, in which such noise is uncorrelated to a good
    approximation (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90), by the restricted
    likelihood (Harville, J. Am. Stat. Assoc. 72 (1977) 320) of white noise, of first-order
    autoregressive noise with and without added white noise, of its mirror image, and of flicker
    noise (power as frequency^-s, s from 0.6 to 1.5), as of cameras and amplifiers. Faster waves are
    hum, rounding and converters: their power is that of the record itself, in bands of 16 half
    waves. A process is not extrapolated to them: a correlation time of ten among 20 000
    samples is visible only there, and would make the variance 1.6 times too large on average.
    """
    # A piece whose residuals have a lower probability than this in the most probable process
    # contains a kink of the curve.
    kink_chance = 1e-3
    max_rounds = 6
    # With fewer pieces alike, the noise varies along the record, and the variance of the noisier
    # half of the pieces is used.
    min_alike_share = 0.6
    span = max(map(_compute_range, branches), default=0.0)
    # Constant branches, saturated or frozen, contain no noise.
    pairs = [x for x in zip(branches, smooth, strict=True) if _compute_range(x[0]) > 0.0]
    pairs = [_remove_gaps(*pair) for pair in pairs]
    branches, smooth = [branch for branch, _ in pairs], [curve for _, curve in pairs]
    longest = max((len(branch) for branch in branches), default=0)
    count = sum(len(branch) for branch in branches) // copies
    width = max(_MIN_PIECE_SAMPLES, longest // _PIECES_PER_BRANCH)
    rests = [
        *_cut_rest_middles(rests_before, width),
        *_cut_rest_middles(rests_after, width, is_after_motion=True),
    ]
    if longest <= SHORT_RECORD_SAMPLES:
        return _estimate_short_record_noise(branches, rests, longest, count)
    pieces = [
        branch[first : first + width]
        for branch in branches
        for first in range(0, len(branch) - width + 1, width)
    ]
    moving = np.array([piece for piece in pieces if np.ptp(piece) > 0.0])
    if not len(moving):
        return _make_zero_noise(longest)
    basis = _build_piece_basis(width)
    residuals = moving - (moving @ basis) @ basis.T
    power = np.sum(residuals**2, axis=1)
    if np.median(power) <= width * (_ROUNDING_SHARE * span) ** 2:
        return _make_zero_noise(longest)
    terms = min(_HALF_WAVES, width)
    waves = fft.dct(residuals, norm="ortho", axis=1)[:, :terms]
    columns = fft.dct(basis, norm="ortho", axis=0)[:terms]
    processes = _processes(longest, count)
    spectra = processes.spectra(np.pi * np.arange(terms) / width)
    is_level = power <= _CORNER_VARIANCE_RATIO * np.median(power)
    is_alike = is_level.copy()
    for _ in range(max_rounds):
        window_likelihood = SpectrumLikelihood.from_cosines(spectra, waves[is_alike], columns)
        posterior = SpectrumPosterior.combine([window_likelihood], processes.prior)
        spectrum = spectra[np.argmax(posterior.probabilities)]
        whitened = _compute_whitened_squares(spectrum, waves[is_alike], columns)
        free = terms - columns.shape[1]
        has_kink = whitened > np.median(whitened) * chdtri(free, kink_chance) / chdtri(free, 0.5)
        if not has_kink.any():
            break
        is_alike[is_alike] = ~has_kink
    prior = processes.prior
    if not rests:
        prior = np.where(_flag_observed_processes(processes, width), prior, 0.0)
    parts = [window_likelihood, *(_compute_likelihood(processes, *rest) for rest in rests)]
    variance_ratio = 1.0
    if is_alike.mean() < min_alike_share and not has_steps:
        variance_ratio = power[power >= np.median(power)].mean() / power[is_alike].mean()
    fast = _replace_corner_power(*_measure_fast_wave_power(branches, smooth), residuals[is_level])
    return _make_noise_model(parts, prior, (longest, count), fast, variance_ratio)


def _make_noise_model(
    parts: Sequence[SpectrumLikelihood],
    prior: Floats,
    samples: tuple[int, int],
    fast: tuple[Floats, Floats],
    variance_factor: float = 1.0,
) -> NoiseModel:
    """Return the noise model of the posterior, with its variance multiplied by a factor.

    Improbable processes get the probability zero.

    samples : of the longest branch, and of all; fast : angles and power of fast waves
    """
    posterior = SpectrumPosterior.combine(parts, prior)
    probabilities = posterior.probabilities
    probabilities[probabilities < 1e-4 * probabilities.max()] = 0.0
    squares = posterior.variances * posterior.freedom * variance_factor
    probabilities /= probabilities.sum()
    return NoiseModel(probabilities, squares, posterior.freedom, *samples, *fast)


def _flag_observed_processes(processes: Processes, width: int) -> Flags:
    """Flag the processes that pieces distinguish without rests.

    Waves as long as the record are then not observed. Flicker noise is excluded if it exceeds white
    noise only below the waves of the pieces, or if it is as steep as autocorrelated noise. Of
    processes of a power whose white noise is below flicker noise in all these waves, one is kept.
    """
    # Flicker noise is judged without rests only where it exceeds white noise up to this multiple of
    # the slowest half wave that the polynomial leaves in a piece,
    min_crossing = 2.0
    # and up to this power of the frequency.
    max_flicker_power = 1.2
    crossing = processes.crossing * width / np.pi  # half waves of a piece
    is_observed = (crossing >= min_crossing * _POLYNOMIAL_COLUMNS) & (crossing <= _HALF_WAVES)
    # Processes with more flicker than white noise in all modelled waves of a piece are alike there:
    # the one with the least white noise stands for them.
    is_observed |= processes.crossing == _FLICKER_CROSSINGS[0]
    is_observed &= processes.flicker_power <= max_flicker_power
    return np.asarray(is_observed | (processes.flicker_power == 0.0), dtype=np.bool_)


def _estimate_short_record_noise(
    branches: Sequence[Floats], rests: Sequence[tuple[Floats, Floats]], longest: int, count: int
) -> NoiseModel:
    """Estimate the noise from rests and residuals of polynomials through the branches."""
    parts = [
        (branch[start:stop], _build_legendre_basis(stop - start, degree + 1))
        for branch in branches
        if len(branch) >= MIN_NOISE_SAMPLES
        for start, stop, degree in cut_into_polynomials(branch)
        if stop - start > degree + 1
    ]
    span = max(map(_compute_range, branches), default=0.0)
    squares = [float(np.sum((part - basis @ (basis.T @ part)) ** 2)) for part, basis in parts]
    if sum(squares) <= count * (_ROUNDING_SHARE * span) ** 2:
        return _make_zero_noise(longest)
    processes, empty = _processes(longest, count), np.zeros(0)
    prior = processes.prior
    if not rests:
        prior = np.where(processes.flicker_power > 0.0, 0.0, prior)
    likelihoods = [_compute_likelihood(processes, *part) for part in [*parts, *rests]]
    return _make_noise_model(likelihoods, prior, (longest, count), (empty, empty))


def _compute_likelihood(processes: Processes, part: Floats, basis: Floats) -> SpectrumLikelihood:
    """Return the likelihood of samples with a basis (samples, columns) of the motion."""
    residuals = part - basis @ (basis.T @ part)
    return SpectrumLikelihood.from_values(basis.T, residuals, processes, _HALF_WAVES)


def _cut_rest_middles(
    rests: Sequence[Floats], min_samples: int, *, is_after_motion: bool = False
) -> Iterator[tuple[Floats, Floats]]:
    """Yield each long rest without its tenth next to the motion, and a basis of its drift."""
    # One tenth of a rest next to the motion is cut off: the motion may have begun or not yet have
    # ended there.
    edge_divisor = 10
    # Polynomial columns removed after the motion, where a specimen relaxes.
    relaxation_columns = 3
    for rest in rests:
        if len(rest) < min_samples or not np.ptp(rest) > 0.0:  # nor of NaN
            continue
        edge = len(rest) // edge_divisor
        middle = rest[edge:] if is_after_motion else rest[: len(rest) - edge]
        yield middle, _build_piece_basis(len(middle), relaxation_columns if is_after_motion else 1)


def _compute_range(values: Floats) -> float:
    """Return the range of the finite values, or 0."""
    finite = values[~np.isnan(values)]
    return float(np.ptp(finite)) if len(finite) else 0.0


def _remove_gaps(values: Floats, curve: Floats) -> tuple[Floats, Floats]:
    """Remove gaps from a branch and its smooth curve; the curve is subtracted if there are any."""
    is_finite = ~np.isnan(values)
    if is_finite.all():
        return values, curve
    return (values - curve)[is_finite], np.zeros(int(is_finite.sum()))


def _make_zero_noise(longest: int) -> NoiseModel:
    empty = np.zeros(0)
    return NoiseModel(np.ones(1), np.zeros(1), 1, max(longest, 1), 0, empty, empty)


def _build_piece_basis(width: int, columns: int = _POLYNOMIAL_COLUMNS) -> Floats:
    """Return orthonormal polynomials of a piece, one per 8 samples: (width, at most `columns`)."""
    min_samples_per_column = 8
    fitting = int(np.clip(width // min_samples_per_column, min(2, columns), columns))
    return _build_legendre_basis(width, fitting)


def _build_legendre_basis(width: int, columns: int) -> Floats:
    """Return the first orthonormal polynomials over even samples, shape (width, columns)."""
    places = np.linspace(-1.0, 1.0, width)
    return np.linalg.qr(np.polynomial.legendre.legvander(places, columns - 1))[0]


def _compute_whitened_squares(spectrum: Floats, waves: Floats, columns: Floats) -> Floats:
    """Return the sum of squares of each piece over the power of its waves, less the fitted part."""
    score = (waves / spectrum) @ columns
    information = columns.T @ (columns / spectrum[:, None])
    explained = np.sum(score * np.linalg.solve(information, score.T).T, axis=1)
    squares: Floats = np.sum(waves**2 / spectrum, axis=1) - explained
    return squares


def _replace_corner_power(
    angles: Floats, power: Floats, residuals: Floats
) -> tuple[Floats, Floats]:
    """Replace the power of fast waves by that of pieces without corners, if corners dominate it."""
    width = residuals.shape[1]
    first = int(np.ceil(angles[0] * width / np.pi)) if len(angles) else width
    if first + 1 >= width:
        return angles, power
    piece_power = np.mean(fft.dct(residuals, norm="ortho", axis=1)[:, first:] ** 2, axis=0)
    if power.mean() <= _CORNER_VARIANCE_RATIO * piece_power.mean():
        return angles, power
    return angles, np.interp(angles, np.pi * np.arange(first, width) / width, piece_power)


def _measure_fast_wave_power(
    branches: Sequence[Floats], smooth: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """Return the power of fast waves of long branches: first angle of each band, and its power."""
    residual_pieces = [
        branch - curve
        for branch, curve in zip(branches, smooth, strict=True)
        if len(branch) > 2 * _MIN_RECORD_WAVES
    ]
    if not residual_pieces:
        return np.zeros(0), np.zeros(0)
    longest = max(len(residuals) for residuals in residual_pieces)
    # Processes are known only for the waves of the pieces.
    first = max(_MIN_RECORD_WAVES, min(longest // 8, _PIECES_PER_BRANCH * _HALF_WAVES))
    angles = np.pi * np.arange(first, longest - _BAND_WAVES, _BAND_WAVES) / longest
    total = np.zeros(len(angles))
    for residuals in residual_pieces:
        sums = np.append(0.0, np.cumsum(fft.dct(residuals, norm="ortho") ** 2))
        waves = np.append(angles, np.pi) * len(residuals) / np.pi
        band_sums = np.diff(np.interp(waves, np.arange(len(residuals) + 1), sums))
        total += band_sums / np.diff(waves) * len(residuals)
    return angles, total / sum(len(residuals) for residuals in residual_pieces)


class Piece(NamedTuple):
    """Samples of a record with one polynomial, and its degree."""

    start: int
    stop: int
    degree: int


def cut_into_polynomials(values: Floats) -> tuple[Piece, ...]:
    """Cut a short record into at most three pieces for polynomials.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN; n at least 4

    Returns
    -------
    Pieces in order, each of degree 1 to 3. Their number, ends and degrees have the lowest corrected
    information criterion of Schwarz, ln(RSS / n) + k ln(n) / (n - k - 2), with k coefficients and
    cuts (McQuarrie, Stat. Probab. Lett. 44 (1999) 79), in white noise or from 40 samples on in
    noise of one of four correlations, which counts as a coefficient: otherwise pieces would follow
    slow noise.

    Examples
    --------
    >>> knee = np.minimum(np.arange(40.0), 20.0)
    >>> noise = np.random.default_rng(1).normal(0.0, 0.1, 40)
    >>> [piece.degree for piece in cut_into_polynomials(knee + noise)]
    [1, 1]
    """
    return _find_pieces(np.ascontiguousarray(values, dtype=np.float64).tobytes())


@lru_cache(maxsize=64)
def _find_pieces(record: bytes) -> tuple[Piece, ...]:
    """Find the pieces of a record; cached, as the noise and the smooth curve both use them."""
    # Correlations of neighbouring samples of the noise, up to a correlation time of six samples.
    correlations: tuple[float, ...] = (0.0, 0.3, 0.5, 0.7, 0.85)
    # Fewer samples do not distinguish correlated noise from a bend of the curve.
    min_correlation_samples = 40
    values = np.frombuffer(record)
    count = len(values)
    if count < min_correlation_samples:
        correlations = correlations[:1]
    rounding = count * (1e-9 * float(np.ptp(values))) ** 2
    best_pieces: tuple[Piece, ...] = (Piece(0, count, 1),)
    lowest = np.inf
    for correlation in correlations:
        # The innovations of a polynomial are a polynomial of the same degree.
        innovations = values[1:] - correlation * values[:-1] if correlation else values
        skipped = count - len(innovations)
        for degrees, residual_squares, ends in _list_best_cuts(_compute_squares(innovations)):
            n_parameters = sum(degrees) + 2 * len(degrees) - 1 + skipped
            if count - n_parameters - 2 <= 0:
                continue
            penalty = n_parameters * np.log(count) / (count - n_parameters - 2)
            squares = max(residual_squares, rounding, np.finfo(float).tiny)
            criterion = np.log(squares / len(innovations)) + penalty
            if criterion < lowest:
                lowest = criterion
                cuts = [skipped + end for end in ends]
                best_pieces = tuple(map(Piece, (0, *cuts), (*cuts, count), degrees))
    return best_pieces


def _list_best_cuts(squares: Floats) -> Iterator[tuple[tuple[int, ...], float, tuple[int, ...]]]:
    """Yield the degrees of up to three pieces, their smallest sum of squares, and their cuts.

    squares : shape (degrees, n + 1, n + 1), of samples [i, j)
    """
    max_pieces = 3
    allowed = range(len(squares))
    until, cuts = squares[:, 0], list[Ints]()
    for number in range(1, max_pieces + 1):
        for places in product(allowed, repeat=number):
            ends = list[int]()
            end = squares.shape[-1] - 1
            for depth in range(number - 1, 0, -1):
                end = int(cuts[depth - 1][places[: depth + 1]][end])
                ends.insert(0, end)
            yield tuple(place + 1 for place in places), float(until[places][-1]), tuple(ends)
        if number < max_pieces:
            total = until[..., None, :, None] + squares
            cuts.append(np.argmin(total, axis=-2))
            until = np.min(total, axis=-2)


_build_cached_basis = lru_cache(maxsize=512)(_build_legendre_basis)


def _compute_squares(values: Floats) -> Floats:
    """Return residual sums of squares of samples [i, j) about polynomials of degree 1 to 3.

    Shape (3, n + 1, n + 1); inf for too few samples.
    """
    max_degree = 3
    count = len(values)
    sums = np.full((max_degree, count + 1, count + 1), np.inf)
    for length in range(2, count + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        windows = windows - windows.mean(axis=1, keepdims=True)
        degree = min(length - 1, max_degree)
        polynomials = _build_cached_basis(length, degree + 1)
        explained = np.cumsum((windows @ polynomials[:, 1:]) ** 2, axis=1)
        first = np.arange(count - length + 1)
        residual_squares = np.sum(windows**2, axis=1)[:, None] - explained
        sums[:degree, first, first + length] = np.maximum(residual_squares, 0.0).T
    return sums


MODES = 3
"""Modes of a zero drift: they contain 93 % of the variance of a random walk."""


def compute_drift_modes(times: Floats, drift: float) -> list[Floats]:
    """Compute the modes of a zero drift, to be multiplied by independent standard normal draws.

    The modes of a Wiener process on [0, 1] are sqrt(2) sin((k - 1/2) pi t) / ((k - 1/2) pi)
    (Karhunen-Loeve; M. Loeve, Probability Theory II, 4th ed., 1978). They are scaled so that the
    variance at the end is the stated one.

    Parameters
    ----------
    times : shape (n,), s, time from where the zero was taken; at least one is not zero
    drift : standard uncertainty of the zero at the largest time, in any unit

    Returns
    -------
    `MODES` of shape (n,), in the unit of `drift`; none for a zero without drift.
    """
    if not drift:
        return []
    places = np.pi * (np.arange(MODES) + 0.5)
    scale = drift / float(np.sqrt(np.sum(places**-2.0)))
    return [np.sin(place * times / times.max()) * scale / place for place in places.tolist()]
