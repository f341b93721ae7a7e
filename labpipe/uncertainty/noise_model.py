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
_MIN_PIECE_SAMPLES, MIN_NOISE_SAMPLES = 50, 5
"""Smallest numbers of samples of a piece of a long record, and of a branch for a noise estimate."""
SHORT_RECORD_SAMPLES = 150
"""Number of samples of the longest branch up to which polynomials are fitted to a whole record."""
_HALF_WAVES = 48
"""Number of half waves of a piece in which noise is modelled. With 128, hum looks correlated."""
_POLYNOMIAL_COLUMNS = 6
"""Number of coefficients of the polynomial that is removed from a piece: degree five."""
_CORNER_VARIANCE_RATIO = 4.0
"""Multiple of the median variance above which a piece contains a corner or a step."""
_FLICKER_POWERS, _FLICKER_CROSSINGS = (0.6, 0.8, 1.0, 1.2, 1.5), (np.pi, 2.0, 0.8, 0.3, 0.12, 0.05)
"""Exponents of flicker noise, whose power falls as frequency^-s; frequencies, rad per sample, at
which white noise is as large."""
_MIN_RECORD_WAVES, _BAND_WAVES = 256, 16
"""Lowest half wave of the longest branch with the power of the record; half waves of a band."""
_MARGIN_TIMES = 12
"""Number of correlation times after which samples of a drawn record count as independent."""
_BATCH_RECORDS = 50
"""Number of records that are drawn at once, few enough to stay in the cache of the processor."""
_ROUNDING_FRACTION = 1e-9
"""Fraction of the range of a signal below which residuals are rounding, not noise."""


@lru_cache(maxsize=16)
def _list_processes(longest: int, count: int) -> Processes:
    """List the processes for a record with `count` samples, `longest` in its longest branch."""
    n_times, shortest_time = 24, 0.4
    # White noise in addition to correlated noise, as fractions of the spectrum at frequency zero.
    white_floors = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    # Longest correlation time as a fraction of the longest branch. A record of fewer than a dozen
    # pieces does not exclude longer times.
    max_time_fraction = 0.1 if longest < _PIECES_PER_BRANCH * _MIN_PIECE_SAMPLES else 0.05
    longest_time = max(max_time_fraction * longest, 2.0 * shortest_time)
    times = np.geomspace(shortest_time, longest_time, n_times)
    lowest, record_time = np.pi / (2.0 * max(count, 1)), count / _MARGIN_TIMES
    rows = list_autoregressive_processes(times, white_floors)
    # Flicker noise is correlated over the whole record. Its crossing with white noise is uniform in
    # frequency: the lower the frequency of the crossing, the smaller its prior.
    for power, crossing in product(_FLICKER_POWERS, _FLICKER_CROSSINGS):
        floor, prior = (lowest / crossing) ** power, crossing / np.pi
        rows.append((0.0, floor, 0.0, prior, record_time, power, crossing))
    return Processes(lowest, *np.array(rows).T)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of a signal as a mixture of processes.

    Parameters
    ----------
    probabilities : shape (g,), probability of each process
    squares : shape (g,), variance at frequency zero times `dof`, for each process, in the
        squared unit of the signal
    dof : degrees of freedom of the variance
    longest, count : number of samples of the longest branch, and of all branches of one signal
    angles, power : shape (b,), rad per sample at which each band of fast waves begins, and the
        power of the record in each band; empty without a branch of more than 512 samples
    """

    probabilities: Floats
    squares: Floats
    dof: int
    longest: int
    count: int
    angles: Floats
    power: Floats

    @property
    def correlation_time(self) -> float:
        """Mean correlation time, samples.

        The correlation time is half the power at frequency zero divided by the variance, which is
        one half for white noise. Added white noise reduces the time. Flicker noise and reciprocal
        spectra count as white noise.
        """
        processes = _list_processes(self.longest, self.count)
        slow_variance = (1.0 - processes.correlation) / (1.0 + processes.correlation)
        mixed_variance = processes.floor + (1.0 - processes.floor) * slow_variance
        variance = np.where(processes.is_reciprocal > 0.0, 1.0, mixed_variance)
        return float(self.probabilities @ (0.5 / variance)[: len(self.probabilities)])

    def draw(self, count: int, replicates: int, rng: np.random.Generator) -> Singles:
        """Draw random noise of a record.

        Parameters
        ----------
        count : number of samples of a record
        replicates : number of records
        rng : random generator

        Returns
        -------
        Shape (replicates, count), single precision. Process and variance of each record are drawn
        from their probability and chi-squared distributions, to include their uncertainty. Fast
        waves always have the power of the estimated record.
        """
        return np.concatenate([*self.draw_batches(count, replicates, rng)])

    def draw_batches(
        self, count: int, replicates: int, rng: np.random.Generator
    ) -> Iterator[Singles]:
        """Draw the same random noise as `draw`, but yield a few records at a time."""
        chosen = rng.choice(len(self.probabilities), size=replicates, p=self.probabilities)
        scale = np.sqrt(self.squares[chosen] / rng.chisquare(self.dof, size=replicates))
        processes = _list_processes(self.longest, self.count)
        margin_time = _MARGIN_TIMES * processes.time[chosen].max(initial=0.0)
        if len(self.angles):
            # Power that ends at the edge of a band is correlated over its inverse width.
            margin_time = max(margin_time, 2.0 * self.longest / _BAND_WAVES)
        margin = min(count, ceil(margin_time) + 1)
        length = scipy.fft.next_fast_len(count + margin, real=True)
        angle = np.linspace(0.0, np.pi, length // 2 + 1)
        drawn_processes, process_indices = np.unique(chosen, return_inverse=True)
        # Cosine and sine have half of the power each. The first wave, and the wave at half the
        # sampling rate, have no sine.
        amplitude = np.sqrt(0.5 * length * processes.compute_spectra(angle, drawn_processes))
        amplitude[:, [0, -1] if length % 2 == 0 else [0]] *= np.sqrt(2.0)
        first_fast = np.searchsorted(angle, self.angles[0]) if len(self.angles) else len(angle)
        # Fast waves have the power of the record.
        band = np.searchsorted(self.angles, angle[first_fast:], side="right") - 1
        fast_amplitude = np.sqrt(0.5 * length * self.power[band]).astype(np.float32)
        slow_amplitude = np.repeat(amplitude[:, :first_fast], 2, axis=1)
        fast_amplitude = np.repeat(fast_amplitude, 2)
        for first in range(0, replicates, _BATCH_RECORDS):
            rows = slice(first, first + _BATCH_RECORDS)
            indices = process_indices[rows]
            waves = rng.standard_normal((len(indices), 2 * len(angle)), dtype=np.float32)
            amplitudes = scale[rows, None] * slow_amplitude[indices]
            waves[:, : 2 * first_fast] *= amplitudes.astype(np.float32)
            waves[:, 2 * first_fast :] *= fast_amplitude
            records = scipy.fft.irfft(waves.view(np.complex64), length, axis=1)
            yield records[:, :count].astype(np.float32, copy=False)


def estimate_noise(
    branches: Sequence[Floats],
    smooth_curves: Sequence[Floats],
    rests_before: Sequence[Floats] = (),
    rests_after: Sequence[Floats] = (),
    *,
    n_signals: int = 1,
    has_steps: bool = False,
) -> NoiseModel:
    """Estimate the noise of a signal from short pieces of its branches, and from whole rests.

    Parameters
    ----------
    branches : each shape (n,), unfiltered and evenly sampled. From a branch with NaN, its smooth
        curve is subtracted and the NaN are removed
    smooth_curves : each shape (n,), smooth curve through each branch
    rests_before, rests_after : each shape (n,), rests before and after the motion, which alone show
        slow waves; rests that are short, constant or have NaN are ignored. After the motion a force
        relaxes, so a parabola is removed there
    n_signals : number of signals with the same noise process, to which branches and rests belong
    has_steps : whether the steps of a converter are a separate input. Such steps vary with the
        slope of the curve, so noise that varies along the record then does not increase the
        variance

    Returns
    -------
    The noise model, with zero variance if there is no noise, or no branch of at least 5 samples.

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
    span = max(map(_compute_range, branches), default=0.0)
    # Constant branches, saturated or frozen, contain no noise.
    pairs = [x for x in zip(branches, smooth_curves, strict=True) if _compute_range(x[0]) > 0.0]
    pairs = [_remove_gaps(*pair) for pair in pairs]
    branches, smooth_curves = [branch for branch, _ in pairs], [curve for _, curve in pairs]
    longest = max((len(branch) for branch in branches), default=0)
    count = sum(len(branch) for branch in branches) // n_signals
    width = max(_MIN_PIECE_SAMPLES, longest // _PIECES_PER_BRANCH)
    rests = [*_cut_rest_middles(rests_before, width)]
    rests += _cut_rest_middles(rests_after, width, is_after_motion=True)
    if longest <= SHORT_RECORD_SAMPLES:
        return _estimate_short_record_noise(branches, rests, longest, count)
    whole_pieces = [branch[: len(branch) // width * width] for branch in branches]
    pieces = np.concatenate(whole_pieces).reshape(-1, width)
    moving_pieces = pieces[np.ptp(pieces, axis=1) > 0.0]
    if not len(moving_pieces):
        return _make_zero_noise(longest)
    basis = _build_piece_basis(width)
    residuals = moving_pieces - (moving_pieces @ basis) @ basis.T
    power = np.sum(residuals**2, axis=1)
    if np.median(power) <= width * (_ROUNDING_FRACTION * span) ** 2:
        return _make_zero_noise(longest)
    terms = min(_HALF_WAVES, width)
    waves = scipy.fft.dct(residuals, norm="ortho", axis=1)[:, :terms]
    columns = scipy.fft.dct(basis, norm="ortho", axis=0)[:terms]
    processes = _list_processes(longest, count)
    spectra = processes.compute_spectra(np.pi * np.arange(terms) / width)
    is_level = power <= _CORNER_VARIANCE_RATIO * np.median(power)
    is_similar = is_level.copy()
    for _ in range(max_rounds):
        window_likelihood = SpectrumLikelihood.from_cosines(spectra, waves[is_similar], columns)
        posterior = SpectrumPosterior.combine([window_likelihood], processes.prior)
        most_probable = spectra[np.argmax(posterior.probabilities)]
        whitened = _compute_whitened_squares(most_probable, waves[is_similar], columns)
        dof = terms - columns.shape[1]
        limit_ratio = scipy.special.chdtri(dof, kink_probability) / scipy.special.chdtri(dof, 0.5)
        has_kink = whitened > np.median(whitened) * limit_ratio
        if not has_kink.any():
            break
        is_similar[is_similar] = ~has_kink
    prior = processes.prior
    if not rests:
        prior = np.where(_flag_observed_processes(processes, width), prior, 0.0)
    likelihoods = [window_likelihood, *(_compute_likelihood(processes, *rest) for rest in rests)]
    variance_factor = 1.0
    if is_similar.mean() < min_similar_fraction and not has_steps:
        variance_factor = power[power >= np.median(power)].mean() / power[is_similar].mean()
    fast_waves = _measure_fast_wave_power(branches, smooth_curves, residuals[is_level])
    return _make_noise_model(likelihoods, prior, (longest, count), fast_waves, variance_factor)


def _make_noise_model(
    likelihoods: Sequence[SpectrumLikelihood],
    prior: Floats,
    sample_counts: tuple[int, int],
    fast_waves: tuple[Floats, Floats],
    variance_factor: float = 1.0,
) -> NoiseModel:
    """Make the noise model of the posterior, with its variance multiplied by a factor.

    `sample_counts` are `longest` and `count` of the model, and `fast_waves` its `angles` and
    `power`. Improbable processes get the probability zero.
    """
    # Processes below this fraction of the highest probability are not drawn.
    min_probability_ratio = 1e-4
    posterior = SpectrumPosterior.combine(likelihoods, prior)
    probabilities = posterior.probabilities
    probabilities[probabilities < min_probability_ratio * probabilities.max()] = 0.0
    squares = posterior.variances * posterior.dof * variance_factor
    probabilities /= probabilities.sum()
    return NoiseModel(probabilities, squares, posterior.dof, *sample_counts, *fast_waves)


def _flag_observed_processes(processes: Processes, width: int) -> Flags:
    """Flag the processes that pieces distinguish in a record without rests.

    Waves as long as the record are then not observed. Flicker noise is excluded if it exceeds white
    noise only below the waves of the pieces, or if it is as steep as autocorrelated noise. If white
    noise is below flicker noise in all these waves, one process represents each exponent.
    """
    # Flicker noise must exceed white noise up to this multiple of the slowest half wave that the
    # polynomial leaves in a piece.
    min_crossing = 2.0
    # Steeper flicker noise looks like autocorrelated noise.
    max_flicker_power = 1.2
    crossing = processes.crossing * width / np.pi  # half waves of a piece
    is_observed = (crossing >= min_crossing * _POLYNOMIAL_COLUMNS) & (crossing <= _HALF_WAVES)
    # Processes with more flicker than white noise in all modelled waves of a piece are equal there:
    # the process with the least white noise represents them.
    is_observed |= processes.crossing == _FLICKER_CROSSINGS[0]
    is_observed &= processes.flicker_exponent <= max_flicker_power
    return np.asarray(is_observed | (processes.flicker_exponent == 0.0), dtype=np.bool_)


def _estimate_short_record_noise(
    branches: Sequence[Floats], rests: Sequence[tuple[Floats, Floats]], longest: int, count: int
) -> NoiseModel:
    """Estimate the noise from rests and residuals of polynomials through the branches."""
    pieces = [
        (branch[start:stop], build_polynomial_basis(stop - start, degree + 1))
        for branch in branches
        if len(branch) >= MIN_NOISE_SAMPLES
        for start, stop, degree in cut_into_polynomials(branch)
        if stop - start > degree + 1
    ]
    span = max(map(_compute_range, branches), default=0.0)
    squares = [float(np.sum((piece - basis @ (basis.T @ piece)) ** 2)) for piece, basis in pieces]
    if sum(squares) <= count * (_ROUNDING_FRACTION * span) ** 2:
        return _make_zero_noise(longest)
    processes, empty = _list_processes(longest, count), np.zeros(0)
    prior = processes.prior
    if not rests:
        prior = np.where(processes.flicker_exponent > 0.0, 0.0, prior)
    likelihoods = [_compute_likelihood(processes, *piece) for piece in [*pieces, *rests]]
    return _make_noise_model(likelihoods, prior, (longest, count), (empty, empty))


def _compute_likelihood(processes: Processes, piece: Floats, basis: Floats) -> SpectrumLikelihood:
    """Compute the likelihood of samples (n,) about a motion in the span of a basis (n, columns)."""
    residuals = piece - basis @ (basis.T @ piece)
    return SpectrumLikelihood.from_values(basis.T, residuals, processes, _HALF_WAVES)


def _cut_rest_middles(
    rests: Sequence[Floats], min_samples: int, *, is_after_motion: bool = False
) -> Iterator[tuple[Floats, Floats]]:
    """Yield each long rest without its tenth next to the motion, and a basis of its drift."""
    # A tenth of a rest next to the motion is cut off: the motion may have begun there, or not yet
    # have ended. A parabola (3 columns) is removed after the motion, where a specimen relaxes.
    edge_divisor, relaxation_columns = 10, 3
    for rest in rests:
        if len(rest) < min_samples or not np.ptp(rest) > 0.0:  # constant, or with a NaN
            continue
        edge = len(rest) // edge_divisor
        middle = rest[edge:] if is_after_motion else rest[: len(rest) - edge]
        yield middle, _build_piece_basis(len(middle), relaxation_columns if is_after_motion else 1)


def _compute_range(values: Floats) -> float:
    """Return the range of the values that are not NaN, or 0 if there are none."""
    finite_values = values[~np.isnan(values)]
    return float(np.ptp(finite_values)) if len(finite_values) else 0.0


def _remove_gaps(values: Floats, curve: Floats) -> tuple[Floats, Floats]:
    """Remove the NaN of a branch; if it has any, subtract its smooth curve first."""
    is_finite = ~np.isnan(values)
    if is_finite.all():
        return values, curve
    return (values - curve)[is_finite], np.zeros(int(is_finite.sum()))


def _make_zero_noise(longest: int) -> NoiseModel:
    return NoiseModel(np.ones(1), np.zeros(1), 1, max(longest, 1), 0, np.zeros(0), np.zeros(0))


def _build_piece_basis(width: int, columns: int = _POLYNOMIAL_COLUMNS) -> Floats:
    """Build orthonormal polynomials of a piece, one per 8 samples: (width, at most `columns`)."""
    min_samples_per_column = 8
    n_polynomials = int(np.clip(width // min_samples_per_column, min(2, columns), columns))
    return build_polynomial_basis(width, n_polynomials)


def _compute_whitened_squares(spectrum: Floats, waves: Floats, columns: Floats) -> Floats:
    """Compute the whitened sum of squares of each piece about the fitted polynomial."""
    score = (waves / spectrum) @ columns
    information = columns.T @ (columns / spectrum[:, None])
    explained = np.sum(score * np.linalg.solve(information, score.T).T, axis=1)
    return np.asarray(np.sum(waves**2 / spectrum, axis=1) - explained)


def _measure_fast_wave_power(
    branches: Sequence[Floats], smooth_curves: Sequence[Floats], level_residuals: Floats
) -> tuple[Floats, Floats]:
    """Measure the power of fast waves of long branches: first angle and power of each band.

    If corners dominate the power, it is replaced by that of pieces without corners. Their residuals
    about a polynomial are `level_residuals`, of shape (pieces, width).
    """
    pairs = zip(branches, smooth_curves, strict=True)
    branch_residuals = [x - curve for x, curve in pairs if len(x) > 2 * _MIN_RECORD_WAVES]
    if not branch_residuals:
        return np.zeros(0), np.zeros(0)
    longest = max(map(len, branch_residuals))
    # Processes are known only for the waves of the pieces.
    first = max(_MIN_RECORD_WAVES, min(longest // 8, _PIECES_PER_BRANCH * _HALF_WAVES))
    angles = np.pi * np.arange(first, longest - _BAND_WAVES, _BAND_WAVES) / longest
    power = np.zeros(len(angles))
    for residuals in branch_residuals:
        sums = np.append(0.0, np.cumsum(scipy.fft.dct(residuals, norm="ortho") ** 2))
        waves = np.append(angles, np.pi) * len(residuals) / np.pi
        band_sums = np.diff(np.interp(waves, np.arange(len(residuals) + 1), sums))
        power += band_sums / np.diff(waves) * len(residuals) / sum(map(len, branch_residuals))
    piece_power = np.mean(scipy.fft.dct(level_residuals, norm="ortho", axis=1) ** 2, axis=0)
    piece_angles = np.pi * np.arange(len(piece_power)) / len(piece_power)
    is_fast = piece_angles >= angles[0]
    piece_power, piece_angles = piece_power[is_fast], piece_angles[is_fast]
    if len(piece_power) > 1 and power.mean() > _CORNER_VARIANCE_RATIO * piece_power.mean():
        power = np.interp(angles, piece_angles, piece_power)
    return angles, power


class Piece(NamedTuple):
    """A piece of a record that one polynomial fits: its first sample, its end, and the degree."""

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
    cuts (McQuarrie, Stat. Probab. Lett. 44 (1999) 79). The noise is white or, from 40 samples on,
    also autoregressive with one of four correlations, which counts as a coefficient: otherwise
    pieces would follow slow noise.

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
    """Find the pieces of a record. They are cached, since noise model and smooth curve use them."""
    values = np.frombuffer(record)
    # Correlations of neighbouring samples of the noise, up to a correlation time of six samples.
    correlations: tuple[float, ...] = (0.0, 0.3, 0.5, 0.7, 0.85)
    # Fewer samples do not distinguish correlated noise from a bend of the curve.
    min_correlation_samples = 40
    count = len(values)
    if count < min_correlation_samples:
        correlations = correlations[:1]
    rounding = count * (_ROUNDING_FRACTION * float(np.ptp(values))) ** 2
    pieces: tuple[Piece, ...] = (Piece(0, count, 1),)
    lowest_criterion = np.inf
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
            if criterion < lowest_criterion:
                lowest_criterion = criterion
                cuts = [skipped + end for end in ends]
                pieces = tuple(map(Piece, (0, *cuts), (*cuts, count), degrees))
    return pieces


def _list_best_cuts(squares: Floats) -> Iterator[tuple[tuple[int, ...], float, tuple[int, ...]]]:
    """Yield the degrees of up to three pieces, their smallest sum of squares, and their cuts.

    `squares`, of shape (degrees, n + 1, n + 1), are residual sums of squares of samples [i, j).
    """
    max_pieces = 3
    # Smallest sum of squares of the samples [0, j), by the degree of each piece, and its last cut.
    smallest, last_cuts = squares[:, 0], list[Ints]()
    for n_pieces in range(1, max_pieces + 1):
        for rows in product(range(len(squares)), repeat=n_pieces):
            ends = list[int]()
            end = squares.shape[-1] - 1
            for depth in range(n_pieces - 1, 0, -1):
                end = int(last_cuts[depth - 1][rows[: depth + 1]][end])
                ends.insert(0, end)
            yield tuple(row + 1 for row in rows), float(smallest[rows][-1]), tuple(ends)
        if n_pieces < max_pieces:
            total = smallest[..., None, :, None] + squares
            last_cuts.append(np.argmin(total, axis=-2))
            smallest = np.min(total, axis=-2)


def _compute_squares(values: Floats) -> Floats:
    """Compute residual sums of squares of samples [i, j) about polynomials of degree 1 to 3.

    The sums have the shape (3, n + 1, n + 1), and are infinite for too few samples.
    """
    max_degree = 3
    count = len(values)
    sums = np.full((max_degree, count + 1, count + 1), np.inf)
    for length in range(2, count + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        windows = windows - windows.mean(axis=1, keepdims=True)
        degree = min(length - 1, max_degree)
        polynomials = build_polynomial_basis(length, degree + 1)
        explained = np.cumsum((windows @ polynomials[:, 1:]) ** 2, axis=1)
        first = np.arange(count - length + 1)
        residual_squares = np.sum(windows**2, axis=1)[:, None] - explained
        sums[:degree, first, first + length] = np.maximum(residual_squares, 0.0).T
    return sums


N_MODES = 3
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
    `N_MODES` arrays of shape (n,), in the unit of `drift`; an empty list for zero drift.
    """
    if not drift:
        return []
    frequencies = np.pi * (np.arange(N_MODES) + 0.5)
    scale = drift / float(np.sqrt(np.sum(frequencies**-2.0)))
    return [np.sin(w * times / times.max()) * scale / w for w in frequencies.tolist()]
