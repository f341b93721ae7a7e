"""Estimate the noise of a signal from short pieces, and draw random records of it.

The noise of a load cell, a controller or a specimen is correlated over tenths of a second, which
may be as long as the window of a fit. The estimated correlation is then uncertain, so the noise
process of each replicate is drawn as well, with the probability of that process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np
import scipy

from labpipe.records.arrays import Flags, Floats, Ints, Singles
from labpipe.uncertainty.autocorrelation import (
    Processes,
    SpectrumLikelihood,
    SpectrumPosterior,
    build_polynomial_basis,
    list_autoregressive_processes,
)

_PIECES_PER_BRANCH = 12
"""Number of pieces into which the longest branch is cut. With 8 pieces, residuals contain the
curve, and intervals are 3 to 5 times too wide."""
_MIN_PIECE_SAMPLES = 50
"""Smallest number of samples of a piece of a long record."""
MIN_NOISE_SAMPLES = 5
"""Smallest number of samples of a branch from which noise is estimated."""
SHORT_RECORD_SAMPLES = 150
"""Number of samples of the longest branch up to which polynomials are fitted to a whole record."""
_N_HALF_WAVES = 48
"""Number of half waves of a piece in which noise is modelled. With 128, hum looks correlated."""
_N_POLYNOMIALS = 6
"""Number of coefficients of the polynomial that is removed from a piece: degree five."""
_CORNER_VARIANCE_RATIO = 4.0
"""Multiple of the median variance above which a piece contains a corner or a step."""
_FLICKER_EXPONENTS = (0.6, 0.8, 1.0, 1.2, 1.5)
"""Exponents s of flicker noise, whose power falls as frequency^-s."""
_CROSSING_FREQUENCIES = (np.pi, 2.0, 0.8, 0.3, 0.12, 0.05)
"""Frequencies, rad per sample, at which white noise is as large as flicker noise."""
_FIRST_FAST_WAVE, _WAVES_PER_BAND = 256, 16
"""Number of the lowest half wave of the longest branch whose power is that of the record; number of
half waves of a band."""
_MARGIN_TIMES = 12
"""Number of correlation times after which samples of a drawn record count as independent."""
_BATCH_RECORDS = 50
"""Number of records that are drawn at once, few enough to stay in the cache of the processor."""
_ROUNDING_FRACTION = 1e-9
"""Fraction of the range of a signal below which residuals are rounding, not noise."""


@lru_cache(maxsize=16)
def _list_processes(longest_branch: int, n_samples: int) -> Processes:
    """List the candidate processes for a record with `n_samples` samples.

    The longest of its branches has `longest_branch` samples.
    """
    n_times, shortest_time = 24, 0.4
    # White noise in addition to correlated noise, as fractions of the spectrum at frequency zero.
    white_floors = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    # Longest correlation time as a fraction of the longest branch. A record of fewer than a dozen
    # pieces does not exclude longer times.
    is_short = longest_branch < _PIECES_PER_BRANCH * _MIN_PIECE_SAMPLES
    longest_time = max((0.1 if is_short else 0.05) * longest_branch, 2.0 * shortest_time)
    times = np.geomspace(shortest_time, longest_time, n_times)
    lowest_frequency, record_time = np.pi / (2.0 * max(n_samples, 1)), n_samples / _MARGIN_TIMES
    rows = list_autoregressive_processes(times, white_floors)
    # Flicker noise is correlated over the whole record. Its crossing with white noise is uniform in
    # frequency: the lower the frequency of the crossing, the smaller its prior.
    for exponent, crossing in product(_FLICKER_EXPONENTS, _CROSSING_FREQUENCIES):
        white_floor, prior = (lowest_frequency / crossing) ** exponent, crossing / np.pi
        rows.append((0.0, white_floor, 0.0, prior, record_time, exponent, crossing))
    return Processes(lowest_frequency, *np.array(rows).T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of a signal as a mixture of processes.

    Parameters
    ----------
    probabilities : shape (g,), probability of each process
    squares : shape (g,), variance at frequency zero times `dof`, for each process, in the
        squared unit of the signal
    dof : degrees of freedom of the variance
    longest_branch : number of samples of the longest branch
    n_samples : number of samples of all branches of one signal
    band_frequencies : shape (b,), rad per sample, frequency at which each band of fast waves
        begins; empty without a branch of more than 512 samples
    band_power : shape (b,), power of the record in each band, in the squared unit of the signal
    """

    probabilities: Floats
    squares: Floats
    dof: int
    longest_branch: int
    n_samples: int
    band_frequencies: Floats
    band_power: Floats

    @property
    def correlation_time(self) -> float:
        """Mean correlation time, samples.

        The correlation time is half the power at frequency zero divided by the variance, which is
        one half for white noise. Added white noise reduces the time. Flicker noise and reciprocal
        spectra count as white noise.
        """
        processes = _list_processes(self.longest_branch, self.n_samples)
        slow_variance = (1.0 - processes.correlation) / (1.0 + processes.correlation)
        mixed_variance = processes.white_floor + (1.0 - processes.white_floor) * slow_variance
        variance = np.where(processes.is_reciprocal > 0.0, 1.0, mixed_variance)
        return float(self.probabilities @ (0.5 / variance)[: len(self.probabilities)])

    def draw(self, n_samples: int, n_records: int, rng: np.random.Generator) -> Singles:
        """Draw random noise of several records.

        Parameters
        ----------
        n_samples : number of samples of a record
        n_records : number of records
        rng : random generator

        Returns
        -------
        Shape (n_records, n_samples), single precision, in the unit of the signal. Process and
        variance of each record are drawn from their probability and chi-squared distributions, to
        include their uncertainty. Fast waves always have the power of the estimated record.
        """
        return np.concatenate([*self.draw_batches(n_samples, n_records, rng)])

    def draw_batches(
        self, n_samples: int, n_records: int, rng: np.random.Generator
    ) -> Iterator[Singles]:
        """Draw the same random noise as `draw`, but yield a few records at a time."""
        indices = rng.choice(len(self.probabilities), size=n_records, p=self.probabilities)
        scale = np.sqrt(self.squares[indices] / rng.chisquare(self.dof, size=n_records))
        processes = _list_processes(self.longest_branch, self.n_samples)
        margin_time = _MARGIN_TIMES * processes.correlation_time[indices].max(initial=0.0)
        if len(self.band_frequencies):
            # Power that ends at the edge of a band is correlated over its inverse width.
            margin_time = max(margin_time, 2.0 * self.longest_branch / _WAVES_PER_BAND)
        margin = min(n_samples, ceil(margin_time) + 1)
        length = scipy.fft.next_fast_len(n_samples + margin, real=True)
        frequency = np.linspace(0.0, np.pi, length // 2 + 1)
        distinct_indices, process_rows = np.unique(indices, return_inverse=True)
        # Cosine and sine have half of the power each. The first wave, and the wave at half the
        # sampling rate, have no sine.
        spectra = processes.compute_spectra(frequency, distinct_indices)
        slow_amplitude = np.sqrt(0.5 * length * spectra)
        slow_amplitude[:, [0, -1] if length % 2 == 0 else [0]] *= np.sqrt(2.0)
        first_fast = int(np.searchsorted(frequency, [*self.band_frequencies, np.inf][0]))
        # Fast waves have the power of the record.
        bands = np.searchsorted(self.band_frequencies, frequency[first_fast:], side="right") - 1
        fast_amplitude = np.sqrt(0.5 * length * self.band_power[bands]).astype(np.float32)
        slow_amplitude = np.repeat(slow_amplitude[:, :first_fast], 2, axis=1)
        fast_amplitude = np.repeat(fast_amplitude, 2)
        for first in range(0, n_records, _BATCH_RECORDS):
            batch = slice(first, first + _BATCH_RECORDS)
            rows = process_rows[batch]
            waves = rng.standard_normal((len(rows), 2 * len(frequency)), dtype=np.float32)
            amplitudes = scale[batch, None] * slow_amplitude[rows]
            waves[:, : 2 * first_fast] *= amplitudes.astype(np.float32)
            waves[:, 2 * first_fast :] *= fast_amplitude
            records = scipy.fft.irfft(waves.view(np.complex64), length, axis=1)
            yield records[:, :n_samples].astype(np.float32, copy=False)


def estimate_noise(
    branches: Sequence[Floats],
    smooth_curves: Sequence[Floats],
    rests_before: Sequence[Floats] = (),
    rests_after: Sequence[Floats] = (),
    *,
    n_signals: int = 1,
    has_steps: bool = False,
) -> NoiseModel:
    """Estimate the noise of a signal from short pieces of its branches, and from its rests.

    Parameters
    ----------
    branches : each shape (n,), unfiltered and evenly sampled. From a branch with NaN, its smooth
        curve is subtracted and the NaN are removed
    smooth_curves : each shape (n,), smooth curve through each branch
    rests_before, rests_after : each shape (n,), rests before and after the motion, which alone show
        slow waves; rests that are short, constant or have NaN are ignored. After the motion a force
        relaxes, so a parabola is removed there
    n_signals : number of signals with the same noise process, to which branches and rests belong
    has_steps : whether the steps of a converter are a separate input. The variance is then that of
        similar pieces alone, even if the noise varies along the record, because the effect of such
        steps varies with the slope of the curve

    Returns
    -------
    The noise model, with zero variance for no noise, or for no branch of at least 5 samples.

    Notes
    -----
    A record whose longest branch has at most 150 samples is cut where polynomials follow it best
    (`cut_into_polynomials`), so that a knee does not count as noise. A longer record is cut into
    pieces of a twelfth of its longest branch, but of at least 50 samples.

    A polynomial of degree five is removed from each piece. The residuals are modelled in the
    slowest 48 half waves of a discrete cosine transform, in which such noise is uncorrelated to a
    good approximation (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90). Candidates
    are white noise, first-order autoregressive noise with and without added white noise, noise with
    the reciprocal spectrum, and flicker noise of cameras and amplifiers (power as frequency^-s, s
    from 0.6 to 1.5). Each has a restricted likelihood (Harville, J. Am. Stat. Assoc. 72 (1977)
    320).

    Faster waves contain hum, rounding and the steps of converters. Their power is that of the
    record itself, in bands of 16 half waves. Processes are not extrapolated to these waves. A
    correlation time of ten samples among 20 000 is visible only there, and an extrapolation would
    make the variance 1.6 times too large on average.
    """
    # A piece contains a kink of the curve if its residuals have a lower probability than this under
    # the most probable process.
    kink_probability = 1e-3
    max_rounds = 6
    # With a smaller fraction of similar pieces, the noise varies along the record, and the variance
    # of the noisier half of the pieces is used.
    min_similar_fraction = 0.6
    value_range = max(map(_compute_range, branches), default=0.0)
    # Constant branches, saturated or frozen, contain no noise.
    pairs = [x for x in zip(branches, smooth_curves, strict=True) if _compute_range(x[0]) > 0.0]
    pairs = [_remove_gaps(*pair) for pair in pairs]
    branches, smooth_curves = [branch for branch, _ in pairs], [curve for _, curve in pairs]
    longest_branch = max((len(branch) for branch in branches), default=0)
    n_samples = sum(len(branch) for branch in branches) // n_signals
    width = max(_MIN_PIECE_SAMPLES, longest_branch // _PIECES_PER_BRANCH)
    rests = [*_cut_rest_middles(rests_before, width)]
    rests += _cut_rest_middles(rests_after, width, is_after_motion=True)
    if longest_branch <= SHORT_RECORD_SAMPLES:
        return _estimate_short_record_noise(branches, rests, longest_branch, n_samples)
    whole_pieces = [branch[: len(branch) // width * width] for branch in branches]
    pieces = np.concatenate(whole_pieces).reshape(-1, width)
    moving_pieces = pieces[np.ptp(pieces, axis=1) > 0.0]
    if not len(moving_pieces):
        return _make_zero_noise(longest_branch)
    basis = _build_piece_basis(width)
    residuals = moving_pieces - (moving_pieces @ basis) @ basis.T
    squares = np.sum(residuals**2, axis=1)
    if np.median(squares) <= width * (_ROUNDING_FRACTION * value_range) ** 2:
        return _make_zero_noise(longest_branch)
    n_cosines = min(_N_HALF_WAVES, width)
    cosines = scipy.fft.dct(residuals, norm="ortho", axis=1)[:, :n_cosines]
    basis_cosines = scipy.fft.dct(basis, norm="ortho", axis=0)[:n_cosines]
    processes = _list_processes(longest_branch, n_samples)
    spectra = processes.compute_spectra(np.pi * np.arange(n_cosines) / width)
    has_no_corner = squares <= _CORNER_VARIANCE_RATIO * np.median(squares)
    is_similar = has_no_corner.copy()
    for _ in range(max_rounds):
        likelihood = SpectrumLikelihood.from_cosines(spectra, cosines[is_similar], basis_cosines)
        posterior = SpectrumPosterior.combine([likelihood], processes.prior)
        spectrum = spectra[np.argmax(posterior.probabilities)]
        whitened = _compute_whitened_squares(spectrum, cosines[is_similar], basis_cosines)
        dof = n_cosines - basis_cosines.shape[1]
        limit_ratio = scipy.special.chdtri(dof, kink_probability) / scipy.special.chdtri(dof, 0.5)
        has_kink = whitened > np.median(whitened) * limit_ratio
        if not has_kink.any():
            break
        is_similar[is_similar] = ~has_kink
    prior = processes.prior
    if not rests:
        prior = np.where(_flag_observed_processes(processes, width), prior, 0.0)
    likelihoods = [likelihood, *(_compute_likelihood(processes, *rest) for rest in rests)]
    variance_factor = 1.0
    if is_similar.mean() < min_similar_fraction and not has_steps:
        variance_factor = squares[squares >= np.median(squares)].mean() / squares[is_similar].mean()
    bands = _measure_fast_wave_power(branches, smooth_curves, residuals[has_no_corner])
    mixture = _compute_mixture(likelihoods, prior, variance_factor)
    return NoiseModel(*mixture, longest_branch, n_samples, *bands)


def _compute_mixture(
    likelihoods: Sequence[SpectrumLikelihood], prior: Floats, variance_factor: float = 1.0
) -> tuple[Floats, Floats, int]:
    """Compute `probabilities`, `squares` and `dof` of the noise model of a posterior.

    The variance is multiplied by a factor. Improbable processes get the probability zero.
    """
    # Processes below this fraction of the highest probability are not drawn.
    min_probability_ratio = 1e-4
    posterior = SpectrumPosterior.combine(likelihoods, prior)
    probabilities = posterior.probabilities
    probabilities[probabilities < min_probability_ratio * probabilities.max()] = 0.0
    probabilities /= probabilities.sum()
    return probabilities, posterior.variances * posterior.dof * variance_factor, posterior.dof


def _flag_observed_processes(processes: Processes, width: int) -> Flags:
    """Flag the processes that pieces of `width` samples distinguish in a record without rests.

    Waves as long as the record are then not observed. Flicker noise is excluded if it exceeds white
    noise only below the waves of the pieces, or if it is as steep as autocorrelated noise. If white
    noise is below flicker noise in all these waves, one process represents each exponent.
    """
    # Flicker noise must exceed white noise up to this multiple of the slowest half wave that the
    # polynomial leaves in a piece.
    min_crossing = 2.0
    # Steeper flicker noise looks like autocorrelated noise.
    max_exponent = 1.2
    crossing_waves = processes.crossing_frequency * width / np.pi  # half waves of a piece
    is_observed = crossing_waves >= min_crossing * _N_POLYNOMIALS
    is_observed &= crossing_waves <= _N_HALF_WAVES
    # Processes with more flicker than white noise in all modelled waves of a piece are equal there:
    # the process with the least white noise represents them.
    is_observed |= processes.crossing_frequency == _CROSSING_FREQUENCIES[0]
    is_observed &= processes.flicker_exponent <= max_exponent
    return np.asarray(is_observed | (processes.flicker_exponent == 0.0), dtype=np.bool_)


def _estimate_short_record_noise(
    branches: Sequence[Floats],
    rests: Sequence[tuple[Floats, Floats]],
    longest_branch: int,
    n_samples: int,
) -> NoiseModel:
    """Estimate the noise from rests and residuals of polynomials through the branches."""
    pieces = [
        (branch[start:stop], build_polynomial_basis(stop - start, degree + 1))
        for branch in branches
        if len(branch) >= MIN_NOISE_SAMPLES
        for start, stop, degree in cut_into_polynomials(branch)
        if stop - start > degree + 1
    ]
    value_range = max(map(_compute_range, branches), default=0.0)
    squares = [float(np.sum((piece - basis @ (basis.T @ piece)) ** 2)) for piece, basis in pieces]
    if sum(squares) <= n_samples * (_ROUNDING_FRACTION * value_range) ** 2:
        return _make_zero_noise(longest_branch)
    processes = _list_processes(longest_branch, n_samples)
    prior = processes.prior
    if not rests:
        prior = np.where(processes.flicker_exponent > 0.0, 0.0, prior)
    likelihoods = [_compute_likelihood(processes, *piece) for piece in [*pieces, *rests]]
    mixture = _compute_mixture(likelihoods, prior)
    return NoiseModel(*mixture, longest_branch, n_samples, np.zeros(0), np.zeros(0))


def _compute_likelihood(processes: Processes, piece: Floats, basis: Floats) -> SpectrumLikelihood:
    """Compute the likelihood of samples (n,) about a combination of polynomials (n, columns)."""
    residuals = piece - basis @ (basis.T @ piece)
    return SpectrumLikelihood.from_values(basis.T, residuals, processes, _N_HALF_WAVES)


def _cut_rest_middles(
    rests: Sequence[Floats], min_samples: int, *, is_after_motion: bool = False
) -> Iterator[tuple[Floats, Floats]]:
    """Yield long rests without the tenth next to the motion, and the polynomials of their drift."""
    # The motion may extend into the tenth of a rest next to it, which is cut off. A parabola (3
    # polynomials) is removed after the motion, where a specimen relaxes.
    edge_divisor, n_polynomials = 10, 3 if is_after_motion else 1
    for rest in rests:
        if len(rest) < min_samples or not np.ptp(rest) > 0.0:  # constant, or with a NaN
            continue
        edge = len(rest) // edge_divisor
        middle = rest[edge:] if is_after_motion else rest[: len(rest) - edge]
        yield middle, _build_piece_basis(len(middle), n_polynomials)


def _compute_range(values: Floats) -> float:
    """Compute the range of the values that are not NaN, or 0 if all are NaN."""
    finite_values = values[~np.isnan(values)]
    return float(np.ptp(finite_values)) if len(finite_values) else 0.0


def _remove_gaps(values: Floats, curve: Floats) -> tuple[Floats, Floats]:
    """Remove the NaN of a branch; if it has any, subtract its smooth curve first."""
    is_finite = ~np.isnan(values)
    if is_finite.all():
        return values, curve
    return (values - curve)[is_finite], np.zeros(int(is_finite.sum()))


def _make_zero_noise(longest_branch: int) -> NoiseModel:
    return NoiseModel(
        np.ones(1), np.zeros(1), 1, max(longest_branch, 1), 0, np.zeros(0), np.zeros(0)
    )


def _build_piece_basis(width: int, max_polynomials: int = _N_POLYNOMIALS) -> Floats:
    """Build orthonormal polynomials of a piece, one per 8 samples: (width, at most the maximum)."""
    n_polynomials = int(np.clip(width // 8, min(2, max_polynomials), max_polynomials))
    return build_polynomial_basis(width, n_polynomials)


def _compute_whitened_squares(spectrum: Floats, cosines: Floats, basis_cosines: Floats) -> Floats:
    """Compute the whitened sum of squares of each piece about the fitted polynomial."""
    score = (cosines / spectrum) @ basis_cosines
    information = basis_cosines.T @ (basis_cosines / spectrum[:, None])
    explained = np.sum(score * np.linalg.solve(information, score.T).T, axis=1)
    return np.asarray(np.sum(cosines**2 / spectrum, axis=1) - explained)


def _measure_fast_wave_power(
    branches: Sequence[Floats], smooth_curves: Sequence[Floats], residuals_without_corners: Floats
) -> tuple[Floats, Floats]:
    """Measure the power of fast waves of long branches: first frequency and power of each band.

    If corners dominate the power, it is replaced by that of the pieces without corners, whose
    residuals about a polynomial have the shape (pieces, width).
    """
    pairs = zip(branches, smooth_curves, strict=True)
    branch_residuals = [x - curve for x, curve in pairs if len(x) > 2 * _FIRST_FAST_WAVE]
    if not branch_residuals:
        return np.zeros(0), np.zeros(0)
    longest = max(map(len, branch_residuals))
    # Processes are known only for the waves of the pieces.
    first_wave = max(_FIRST_FAST_WAVE, min(longest // 8, _PIECES_PER_BRANCH * _N_HALF_WAVES))
    waves = np.arange(first_wave, longest - _WAVES_PER_BAND, _WAVES_PER_BAND)
    frequencies = np.pi * waves / longest
    power = np.zeros(len(frequencies))
    for residuals in branch_residuals:
        sums = np.append(0.0, np.cumsum(scipy.fft.dct(residuals, norm="ortho") ** 2))
        edges = np.append(frequencies, np.pi) * len(residuals) / np.pi
        band_sums = np.diff(np.interp(edges, np.arange(len(residuals) + 1), sums))
        power += band_sums / np.diff(edges) * len(residuals) / sum(map(len, branch_residuals))
    piece_power = np.mean(scipy.fft.dct(residuals_without_corners, norm="ortho") ** 2, axis=0)
    piece_frequencies = np.pi * np.arange(len(piece_power)) / len(piece_power)
    is_fast = piece_frequencies >= frequencies[0]
    piece_power, piece_frequencies = piece_power[is_fast], piece_frequencies[is_fast]
    if len(piece_power) > 1 and power.mean() > _CORNER_VARIANCE_RATIO * piece_power.mean():
        power = np.interp(frequencies, piece_frequencies, piece_power)
    return frequencies, power


class Piece(NamedTuple):
    """A piece of a record to which one polynomial is fitted.

    Parameters
    ----------
    start, stop : first sample, and the sample after the last one
    degree : degree of the polynomial
    """

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
    information criterion of Schwarz, ln(RSS / n) + k ln(n) / (n - k - 2), where k is the number of
    coefficients and cuts (McQuarrie, Stat. Probab. Lett. 44 (1999) 79). The noise is white or, from
    40 samples on, also autoregressive with one of four correlations. The correlation counts as a
    coefficient. With white noise alone, the pieces would follow slow noise.

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
    """Find the pieces of a record; cached, because noise model and smooth curve use them.

    `record` has the bytes of the values as double precision numbers.
    """
    values = np.frombuffer(record)
    # Correlations of neighbouring samples of the noise, up to a correlation time of six samples.
    # Fewer than 40 samples do not distinguish correlated noise from a bend of the curve.
    n_samples = len(values)
    correlations = (0.0, 0.3, 0.5, 0.7, 0.85) if n_samples >= 40 else (0.0,)
    rounding_squares = n_samples * (_ROUNDING_FRACTION * float(np.ptp(values))) ** 2
    pieces: tuple[Piece, ...] = (Piece(0, n_samples, 1),)
    lowest_criterion = np.inf
    for correlation in correlations:
        # The innovations of a polynomial are a polynomial of the same degree.
        innovations = values[1:] - correlation * values[:-1] if correlation else values
        n_skipped = n_samples - len(innovations)
        for degrees, residual_squares, ends in _list_best_cuts(_compute_squares(innovations)):
            n_parameters = sum(degrees) + 2 * len(degrees) - 1 + n_skipped
            if n_samples - n_parameters - 2 <= 0:
                continue
            penalty = n_parameters * np.log(n_samples) / (n_samples - n_parameters - 2)
            squares = max(residual_squares, rounding_squares, np.finfo(float).tiny)
            criterion = np.log(squares / len(innovations)) + penalty
            if criterion < lowest_criterion:
                lowest_criterion = criterion
                cuts = [n_skipped + end for end in ends]
                pieces = tuple(map(Piece, (0, *cuts), (*cuts, n_samples), degrees))
    return pieces


def _list_best_cuts(squares: Floats) -> Iterator[tuple[tuple[int, ...], float, tuple[int, ...]]]:
    """Yield the degrees of up to three pieces, their smallest sum of squares, and their cuts.

    `squares`, of shape (degrees, n + 1, n + 1), are residual sums of squares of samples [i, j).
    """
    max_pieces = 3
    # Smallest sum of squares of the samples [0, j), by the degree of each piece, and its last cut.
    smallest, last_cuts = squares[:, 0], list[Ints]()
    for n_pieces in range(1, max_pieces + 1):
        for degree_indices in product(range(len(squares)), repeat=n_pieces):
            cuts = list[int]()
            cut = squares.shape[-1] - 1
            for depth in range(n_pieces - 1, 0, -1):
                cut = int(last_cuts[depth - 1][degree_indices[: depth + 1]][cut])
                cuts.insert(0, cut)
            yield (
                tuple(index + 1 for index in degree_indices),
                float(smallest[degree_indices][-1]),
                tuple(cuts),
            )
        if n_pieces < max_pieces:
            total = smallest[..., None, :, None] + squares
            last_cuts.append(np.argmin(total, axis=-2))
            smallest = np.min(total, axis=-2)


def _compute_squares(values: Floats) -> Floats:
    """Compute residual sums of squares of samples [i, j) about polynomials of degree 1 to 3.

    The sums have the shape (3, n + 1, n + 1), and are infinite for too few samples.
    """
    max_degree = 3
    n_samples = len(values)
    sums = np.full((max_degree, n_samples + 1, n_samples + 1), np.inf)
    for length in range(2, n_samples + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        windows = windows - windows.mean(axis=1, keepdims=True)
        degree = min(length - 1, max_degree)
        polynomials = build_polynomial_basis(length, degree + 1)
        explained = np.cumsum((windows @ polynomials[:, 1:]) ** 2, axis=1)
        first = np.arange(n_samples - length + 1)
        residual_squares = np.sum(windows**2, axis=1)[:, None] - explained
        sums[:degree, first, first + length] = np.maximum(residual_squares, 0.0).T
    return sums


N_DRIFT_MODES = 3
"""Number of modes of a zero drift, which contain 93 % of the variance of a random walk."""


def compute_drift_modes(times: Floats, drift: float) -> list[Floats]:
    """Compute the modes of a zero drift, to be multiplied by independent standard normal draws.

    The modes of a Wiener process on [0, 1] are sqrt(2) sin((k - 1/2) pi t) / ((k - 1/2) pi)
    (Karhunen-Loeve; M. Loeve, Probability Theory II, 4th ed., 1978). They are scaled so that the
    variance at the end is the stated one.

    Parameters
    ----------
    times : shape (n,), s, time since the zero was taken; at least one is not zero
    drift : standard uncertainty of the zero at the largest time, in any unit

    Returns
    -------
    `N_DRIFT_MODES` arrays of shape (n,), in the unit of `drift`; an empty list for zero drift.
    """
    if not drift:
        return []
    frequencies = np.pi * (np.arange(N_DRIFT_MODES) + 0.5)
    scale = drift / float(np.sqrt(np.sum(frequencies**-2.0)))
    return [np.sin(w * times / times.max()) * scale / w for w in frequencies.tolist()]
