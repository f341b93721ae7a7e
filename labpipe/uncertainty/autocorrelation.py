"""Estimate autocorrelated noise: its long-run variance, and its spectrum from stretches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.fft import dct, fft

from labpipe.records.arrays import Floats, Ints

MAX_COSINES = 128
"""Maximum number of cosines, half waves over the window, from which the noise is estimated."""


def estimate_long_run_variance(residuals: Floats, *, parameters: int) -> float:
    """Estimate n times the variance of the mean of n residuals.

    Parameters
    ----------
    residuals : shape (n,), evenly sampled; NaN are ignored
    parameters : number of parameters of the fit with these residuals

    Returns
    -------
    In the unit of the residuals, squared. NaN for fewer than `parameters` + 3 residuals.

    Notes
    -----
    Newey and West, Econometrica 55 (1987) 703: autocovariances to lag 1.3 n^(1/2), weighted by
    Bartlett's triangle; increased for the low frequencies that the fit has removed, and scaled by
    n / (n - parameters). At least half the plain variance; about equal to it for white noise.
    """
    values = residuals[~np.isnan(residuals)]
    count = len(values)
    if count < parameters + 3:
        return float("nan")
    centred = values - values.mean()
    lags = min(int(1.3 * np.sqrt(count)), count // 4)
    variance = float(centred @ centred) / count
    long_run = variance
    for lag in range(1, lags + 1):
        covariance = float(centred[lag:] @ centred[:-lag]) / count
        long_run += 2.0 * (1.0 - lag / (lags + 1.0)) * covariance
    # A fit removes low frequencies from its residuals, so the weighted sum is too small.
    remaining_share = 1.0 - min(0.5, parameters * (lags + 1.0) / count)
    return max(long_run / remaining_share, 0.5 * variance) * count / (count - parameters)


def estimate_fast_noise(values: Floats) -> Floats:
    """Estimate the median standard deviation about parabolas through blocks of 20 samples.

    Parameters
    ----------
    values : shape (..., n), evenly sampled, without NaN; n at least 4

    Returns
    -------
    Shape (...), in the unit of the values. Noise with a correlation time longer than a block counts
    as signal.

    Examples
    --------
    >>> round(float(estimate_fast_noise(3.0 + np.random.default_rng(0).normal(0.0, 0.01, 4000))), 3)
    0.01
    """
    block_samples = 20
    size = min(block_samples, values.shape[-1])
    count = values.shape[-1] // size
    rows = values[..., : count * size].reshape(*values.shape[:-1], count, size)
    basis = build_polynomials(size, 2)
    residuals = rows - rows @ basis @ basis.T
    deviation: Floats = np.median(np.sqrt(np.sum(residuals**2, axis=-1) / (size - 3)), axis=-1)
    return deviation


def scale_limit_by_noise(limit: float, rows: Floats) -> Floats:
    """Scale a limit to the fast noise of each of many similar records.

    Parameters
    ----------
    limit : for the mean noise of the records, in any unit
    rows : shape (rows, n), records; columns with a NaN are ignored

    Returns
    -------
    Shape (rows,): `limit` times the noise of each row over their mean noise.
    """
    noise = estimate_fast_noise(rows[:, ~np.isnan(rows).any(axis=0)])
    mean_noise = float(noise.mean())
    return limit * noise / mean_noise if mean_noise > 0.0 else np.full(len(rows), limit)


@dataclass(frozen=True, slots=True, eq=False)
class Processes:
    """Candidate processes: autoregressive noise with and without white noise, and flicker noise.

    The power of flicker noise rises with a power of the period, up to four lengths of the record.

    Parameters
    ----------
    factor : shape (g,), lag-one correlation
    floor : shape (g,), white noise, as a share of the spectrum at frequency zero
    is_mirrored : shape (g,), 1 for a spectrum that rises with the frequency, else 0
    prior : shape (g,)
    time : shape (g,), samples, correlation time
    flicker_power, crossing : shape (g,), 0 and infinite without flicker noise; rad per sample,
        where white noise is as large as flicker noise
    lowest : rad per sample, below which flicker noise is constant
    """

    factor: Floats
    floor: Floats
    is_mirrored: Floats
    prior: Floats
    time: Floats
    flicker_power: Floats
    crossing: Floats
    lowest: float = np.pi

    def spectra(self, angle: Floats, chosen: Ints | slice = slice(None)) -> Floats:
        """Return the power at angles per sample (k,), 1 at zero, of chosen processes: (g, k)."""
        flicker_power, floor = self.flicker_power[chosen], self.floor[chosen, None]
        a = self.factor[chosen, None]
        spectra: Floats = (1.0 - a) ** 2 / (1.0 - 2.0 * a * np.cos(angle) + a * a)
        is_flicker = flicker_power > 0.0
        powers = -0.5 * flicker_power[is_flicker, None]
        spectra[is_flicker] = (1.0 + (angle / self.lowest) ** 2) ** powers
        mixed = floor + (1.0 - floor) * spectra
        return np.where(self.is_mirrored[chosen, None] > 0.0, 1.0 / spectra, mixed)


def list_autoregressive_processes(
    times: Floats, floors: Sequence[float]
) -> list[tuple[float, ...]]:
    """List white noise, and autoregressive noise of several correlation times.

    Parameters
    ----------
    times : shape (n,), samples, increasing
    floors : white noise added to correlated noise, as shares of the spectrum at frequency zero

    Returns
    -------
    The fields of `Processes` for white noise, and for each time for the mirror image, without and
    with white noise, the last two equally probable. A load cell has both kinds: the fit of a pure
    first-order process would have too short a correlation time and too small a variance. Without
    mirror images, white noise would be at the edge, and its intervals would be too wide.
    """
    # With this power, intervals cover 95 % from white noise to correlation over a tenth of the
    # window (see the studies).
    prior_power = -0.4
    factors, priors = np.exp(-1.0 / times), (times / times[0]) ** prior_power
    slow, share = list(zip(factors, priors, times, strict=True)), 0.5 / len(floors)
    return [
        (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, np.inf),
        *((a, 0.0, 1.0, prior, 0.0, 0.0, np.inf) for a, prior, _ in slow),
        *((a, 0.0, 0.0, 0.5 * prior, time, 0.0, np.inf) for a, prior, time in slow),
        *(
            (a, floor, 0.0, share * prior, time, 0.0, np.inf)
            for floor, (a, prior, time) in product(floors, slow)
        ),
    ]


@lru_cache(maxsize=16)
def choose_processes(count: int, terms: int) -> Processes:
    """Choose the processes whose noise a fit may have.

    Parameters
    ----------
    count : samples of the longest stretch; the longest correlation time is a fifth of it
    terms : number of cosines used of that stretch
    """
    n_times, longest_share = 23, 0.2
    times = np.geomspace(count / (4.0 * terms), longest_share * count, n_times)
    floors = (0.003, 0.01, 0.03, 0.1, 0.3)
    return Processes(*np.array(list_autoregressive_processes(times, floors)).T)


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumLikelihood:
    """Likelihood of each of g spectra from stretches of a signal with the same basis.

    Parameters
    ----------
    spectra : shape (g, terms)
    columns : shape (terms, p), cosines of the basis
    likelihood : shape (g,), log likelihood without the sum of squares
    squares : shape (g,), whitened sum of squares
    freedom : degrees of freedom: cosines minus coefficients
    shifts : shape (g, stretches, p), change of the coefficients by generalised least squares
    unit_covariance : shape (g, p, p), of these coefficients for a spectrum of 1 at frequency zero
    """

    spectra: Floats
    columns: Floats
    likelihood: Floats
    squares: Floats
    freedom: int
    shifts: Floats
    unit_covariance: Floats

    @classmethod
    def from_values(
        cls, basis: Floats, values: Floats, processes: Processes, n_cosines: int
    ) -> SpectrumLikelihood:
        """Compute the likelihood by the slowest cosines of stretches.

        Parameters
        ----------
        basis : shape (p, n), orthonormal rows
        values : shape (n,) or (stretches, n), without NaN; the part that the basis explains has no
            effect
        processes : of the spectra
        n_cosines : number of cosines used, the slowest
        """
        n_coefficients, count = basis.shape
        terms = min(count, n_cosines)
        cosines = np.asarray(dct(np.vstack([basis, values]), norm="ortho"))[:, :terms]
        spectra = processes.spectra(np.pi * np.arange(terms) / count)
        return cls.from_cosines(spectra, cosines[n_coefficients:], cosines[:n_coefficients].T)

    @classmethod
    def from_cosines(cls, spectra: Floats, waves: Floats, columns: Floats) -> SpectrumLikelihood:
        """Compute the restricted likelihood in cosines (Harville, JASA 72 (1977) 320).

        Parameters
        ----------
        spectra : shape (g, terms)
        waves : shape (stretches, terms), cosines of the values
        columns : shape (terms, p), those of the basis
        """
        inverse, (count, n_coefficients) = 1.0 / spectra, (len(waves), columns.shape[1])
        information = _weigh_products(inverse, columns)
        weighted = (waves[:, :, None] * columns).transpose(1, 0, 2).reshape(len(columns), -1)
        score = (inverse @ weighted).reshape(len(inverse), count, n_coefficients)
        unit_covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        shifts: Floats = score @ unit_covariance
        explained = np.vecdot(
            shifts.reshape(len(unit_covariance), -1), score.reshape(len(unit_covariance), -1)
        )
        squares = np.maximum(inverse @ np.sum(waves**2, axis=0) - explained, 0.0)
        logs = np.log(spectra).sum(axis=1) + np.linalg.slogdet(information)[1]
        freedom = count * (len(columns) - n_coefficients)
        return cls(spectra, columns, -0.5 * count * logs, squares, freedom, shifts, unit_covariance)

    def compute_least_squares_covariance(self) -> Floats:
        """Return the covariance of ordinary least squares under each spectrum, shape (g, p, p).

        It is for a spectrum of 1 at frequency zero. Beyond the last cosine, the noise is assumed to
        have the power of that cosine.
        """
        n_coefficients = self.columns.shape[1]
        beyond = np.eye(n_coefficients) - self.columns.T @ self.columns
        unit_covariance = _weigh_products(self.spectra, self.columns)
        covariance: Floats = unit_covariance + self.spectra[:, -1, None, None] * beyond
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumPosterior:
    """Posterior probability of each of g spectra from all stretches.

    Parameters
    ----------
    probabilities : shape (g,), sum 1
    variances : shape (g,), of each spectrum at frequency zero
    freedom : degrees of freedom of the variances
    """

    probabilities: Floats
    variances: Floats
    freedom: int

    @classmethod
    def combine(cls, stretches: Sequence[SpectrumLikelihood], prior: Floats) -> SpectrumPosterior:
        """Compute the posterior from the likelihoods, with one common variance, and the prior."""
        freedom = sum(stretch.freedom for stretch in stretches)
        squares = np.sum([stretch.squares for stretch in stretches], axis=0)
        logs = np.sum([stretch.likelihood for stretch in stretches], axis=0)
        logs -= 0.5 * freedom * np.log(np.maximum(squares, np.finfo(float).tiny))
        probabilities = prior * np.exp(logs - logs[prior > 0.0].max())
        return cls(probabilities / probabilities.sum(), squares / freedom, freedom)


def cut_smooth_stretches(values: Floats, *, width: int = 100) -> tuple[Floats, ...]:
    """Cut a signal into stretches without corners.

    Parameters
    ----------
    values : shape (n,); NaN are ignored
    width : samples of each stretch

    Returns
    -------
    Consecutive stretches up to the end of the signal. Stretches with a corner or a step are
    omitted: their residuals about a cubic have more than four times the median variance.
    """
    finite = values[~np.isnan(values)]
    count = len(finite) // width
    if count == 0:
        return ()
    pieces = finite[len(finite) - count * width :].reshape(count, width)
    basis = build_polynomials(width)
    variances = np.var(pieces - (pieces @ basis) @ basis.T, axis=1)
    return tuple(pieces[variances <= 4.0 * np.median(variances)])


def build_polynomials(count: int, degree: int = 3) -> Floats:
    """Return orthonormal polynomials over even samples, shape (count, degree + 1)."""
    places = np.linspace(-1.0, 1.0, count)
    return np.linalg.qr(np.polynomial.legendre.legvander(places, degree))[0]


def compute_covariance(basis: Floats, processes: Processes) -> Floats:
    """Return the covariance of projections on a basis (p, n) for each spectrum, (g, p, p).

    It is the sum of the spectrum over the waves of the padded basis; the noise is no longer
    correlated over the padding.
    """
    length = basis.shape[1] + int(40.0 * processes.time.max())
    waves = fft(basis, length, axis=1).T / np.sqrt(length)
    spectra = processes.spectra(2.0 * np.pi * np.arange(length) / length)
    return _weigh_products(spectra, waves.real) + _weigh_products(spectra, waves.imag)


def _weigh_products(weights: Floats, columns: Floats) -> Floats:
    """Return the weighted sums of all products of two columns, shape (g, p, p).

    weights : shape (g, terms); columns : shape (terms, p)
    """
    count = columns.shape[1]
    products = (columns[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
    return (weights @ products).reshape(-1, count, count)
