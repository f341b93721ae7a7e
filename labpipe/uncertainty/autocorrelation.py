"""Estimate the long-run variance and the spectrum of noise, and fit linear models in such noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Self

import numpy as np
import scipy

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate

MAX_COSINES = 128
"""Largest number of coefficients of the discrete cosine transform from which noise is estimated."""


def estimate_long_run_variance(residuals: Floats, *, n_parameters: int) -> float:
    """Estimate n times the variance of the mean of n residuals.

    Parameters
    ----------
    residuals : shape (n,), evenly sampled; NaN are ignored
    n_parameters : number of parameters of the fit that leaves these residuals

    Returns
    -------
    Long-run variance, in the squared unit of the residuals; NaN for fewer than `n_parameters` + 3
    residuals.

    Notes
    -----
    The estimator of Newey and West, Econometrica 55 (1987) 703, adds the autocovariances up to lag
    min(1.3 n^(1/2), n / 4), weighted by Bartlett's triangle. The sum is increased for the low
    frequencies that the fit has removed, and scaled by n / (n - p) for p parameters. The result is
    at least half the ordinary variance, and about equal to the variance for white noise.
    """
    values = residuals[~np.isnan(residuals)]
    n = len(values)
    if n < n_parameters + 3:
        return float("nan")
    centred = values - values.mean()
    max_lag = min(int(1.3 * np.sqrt(n)), n // 4)
    variance = float(centred @ centred) / n
    long_run = variance
    for lag in range(1, max_lag + 1):
        covariance = float(centred[lag:] @ centred[:-lag]) / n
        long_run += 2.0 * (1.0 - lag / (max_lag + 1.0)) * covariance
    # A fit removes low frequencies from its residuals, so the weighted sum is too small.
    remaining_fraction = 1.0 - min(0.5, n_parameters * (max_lag + 1.0) / n)
    return max(long_run / remaining_fraction, 0.5 * variance) * n / (n - n_parameters)


def estimate_fast_noise(values: Floats) -> Floats:
    """Estimate noise by the median standard deviation about a parabola of 20-sample blocks.

    Parameters
    ----------
    values : shape (..., n), evenly sampled, without NaN; n at least 4

    Returns
    -------
    Shape (...), in the unit of the values. Noise with a correlation time longer than a block is not
    included.

    Examples
    --------
    >>> round(float(estimate_fast_noise(3.0 + np.random.default_rng(0).normal(0.0, 0.01, 4000))), 3)
    0.01
    """
    width = min(20, values.shape[-1])  # samples of a block
    n_blocks = values.shape[-1] // width
    blocks = values[..., : n_blocks * width].reshape(*values.shape[:-1], n_blocks, width)
    basis = build_polynomial_basis(width, 3)
    residuals = blocks - blocks @ basis @ basis.T
    return np.asarray(np.median(np.sqrt(np.sum(residuals**2, axis=-1) / (width - 3)), axis=-1))


def scale_limit_by_noise(limit: float, records: Floats) -> Floats:
    """Scale a limit to the fast noise of each of many similar records.

    Parameters
    ----------
    limit : limit for a record with the mean noise, in any unit
    records : shape (m, n), one record per row; samples that are NaN in a record are ignored in
        all records

    Returns
    -------
    Shape (m,): `limit` times the noise of each record, divided by the mean noise of all records;
    `limit` itself without noise.
    """
    noise = estimate_fast_noise(records[:, ~np.isnan(records).any(axis=0)])
    mean_noise = float(noise.mean())
    return limit * noise / mean_noise if mean_noise > 0.0 else np.full(len(records), limit)


@dataclass(frozen=True, slots=True, eq=False)
class Processes:
    """Candidate processes of noise: autoregressive with and without white noise, and flicker noise.

    The spectrum of flicker noise falls as frequency^-s above the corner frequency.

    Parameters
    ----------
    corner_frequency : frequency, rad per sample, below which the power of flicker noise is constant
    correlation : shape (g,) for g processes, lag-one correlation of the autoregressive part
    white_floor : shape (g,), white noise, as a fraction of the spectrum at frequency zero
    is_reciprocal : shape (g,), 1 for the reciprocal of an autoregressive spectrum, else 0
    prior : shape (g,), prior probability relative to that of white noise
    correlation_time : shape (g,), samples; 0 for white noise and reciprocal spectra
    flicker_exponent : shape (g,), exponent s of flicker noise; 0 for other processes
    crossing_frequency : shape (g,), frequency, rad per sample, at which white noise is as large as
        flicker noise; infinite for other processes
    """

    corner_frequency: float
    correlation: Floats
    white_floor: Floats
    is_reciprocal: Floats
    prior: Floats
    correlation_time: Floats
    flicker_exponent: Floats
    crossing_frequency: Floats

    def compute_spectra(self, frequency: Floats, indices: Ints | slice = slice(None)) -> Floats:
        """Compute the spectra of some or all processes, relative to frequency zero.

        Parameters
        ----------
        frequency : shape (k,), rad per sample
        indices : indices of the processes

        Returns
        -------
        Shape (processes, k).
        """
        flicker_exponent = self.flicker_exponent[indices]
        white_floor, a = self.white_floor[indices, None], self.correlation[indices, None]
        spectra: Floats = (1.0 - a) ** 2 / (1.0 - 2.0 * a * np.cos(frequency) + a * a)
        is_flicker = flicker_exponent > 0.0
        exponents = -0.5 * flicker_exponent[is_flicker, None]
        spectra[is_flicker] = (1.0 + (frequency / self.corner_frequency) ** 2) ** exponents
        mixed_spectra = white_floor + (1.0 - white_floor) * spectra
        return np.where(self.is_reciprocal[indices, None] > 0.0, 1.0 / spectra, mixed_spectra)


def list_autoregressive_processes(
    correlation_times: Floats, white_floors: Sequence[float]
) -> list[tuple[float, ...]]:
    """List the parameters of white noise, and of autoregressive noise of several correlation times.

    Parameters
    ----------
    correlation_times : shape (n,), samples, increasing
    white_floors : amounts of added white noise, as fractions of the spectrum at frequency zero

    Returns
    -------
    The fields of `Processes` after `corner_frequency`, one row per process: white noise, the
    reciprocal spectra of all times, correlated noise of all times, and for each floor the sum of
    correlated and white noise of all times. The last two kinds are equally probable, because a load
    cell has both kinds of noise: a fit of correlated noise alone would have too short a correlation
    time and too small a variance. Without reciprocal spectra, white noise would be an extreme
    candidate, and intervals in white noise would be too wide.
    """
    # With this exponent, the intervals covered 95 % in simulations, for white noise and for noise
    # that is correlated over up to a tenth of the window.
    prior_exponent = -0.4
    correlations = np.exp(-1.0 / correlation_times)
    priors = (correlation_times / correlation_times[0]) ** prior_exponent
    correlated = list(zip(correlations, priors, correlation_times, strict=True))
    floor_weight = 0.5 / len(white_floors)
    return [
        (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, np.inf),
        *((a, 0.0, 1.0, prior, 0.0, 0.0, np.inf) for a, prior, _ in correlated),
        *((a, 0.0, 0.0, 0.5 * prior, time, 0.0, np.inf) for a, prior, time in correlated),
        *(
            (a, white_floor, 0.0, floor_weight * prior, time, 0.0, np.inf)
            for white_floor, (a, prior, time) in product(white_floors, correlated)
        ),
    ]


@lru_cache(maxsize=16)
def choose_processes(n_samples: int, n_cosines: int) -> Processes:
    """Choose the candidate processes for the noise of a fit, without flicker noise.

    Parameters
    ----------
    n_samples : number of samples of the longest stretch; the longest candidate correlation time is
        a fifth of it
    n_cosines : number of coefficients of the cosine transform of that stretch that are used
    """
    n_times, max_time_fraction = 23, 0.2
    times = np.geomspace(n_samples / (4.0 * n_cosines), max_time_fraction * n_samples, n_times)
    white_floors = (0.003, 0.01, 0.03, 0.1, 0.3)
    return Processes(np.pi, *np.array(list_autoregressive_processes(times, white_floors)).T)


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumLikelihood:
    """Likelihood of each of g candidate spectra, given stretches of a signal.

    All stretches have the same length and the same basis of p functions.

    Parameters
    ----------
    spectra : shape (g, cosines), power of each coefficient of the cosine transform
    basis_cosines : shape (cosines, p), cosine transforms of the basis
    log_determinant_term : shape (g,), logarithm of the likelihood without the sum of squares
    squares : shape (g,), whitened sum of squares of the residuals
    dof : degrees of freedom: number of cosines less p, summed over the stretches
    shifts : shape (g, stretches, p), difference between the coefficients of generalised and of
        ordinary least squares
    unit_covariance : shape (g, p, p), covariance of the coefficients of generalised least squares
        for a spectrum of 1 at frequency zero
    """

    spectra: Floats
    basis_cosines: Floats
    log_determinant_term: Floats
    squares: Floats
    dof: int
    shifts: Floats
    unit_covariance: Floats

    @classmethod
    def from_values(
        cls, basis: Floats, values: Floats, processes: Processes, n_cosines: int
    ) -> Self:
        """Compute the likelihood of stretches from their lowest frequencies.

        Parameters
        ----------
        basis : shape (p, n), orthonormal rows
        values : shape (n,) or (stretches, n), without NaN; components along the basis have no
            effect
        processes : candidate processes with the g spectra
        n_cosines : number of the lowest frequencies of the cosine transform to use
        """
        n_coefficients, n_samples = basis.shape
        n_cosines = min(n_samples, n_cosines)
        cosines = np.asarray(scipy.fft.dct(np.vstack([basis, values]), norm="ortho"))[:, :n_cosines]
        spectra = processes.compute_spectra(np.pi * np.arange(n_cosines) / n_samples)
        return cls.from_cosines(spectra, cosines[n_coefficients:], cosines[:n_coefficients].T)

    @classmethod
    def from_cosines(cls, spectra: Floats, cosines: Floats, basis_cosines: Floats) -> Self:
        """Compute the restricted likelihood of cosine transforms (Harville, JASA 72 (1977) 320).

        Parameters
        ----------
        spectra : shape (g, cosines), power of each coefficient of the transform
        cosines : shape (stretches, cosines), cosine transforms of the values
        basis_cosines : shape (cosines, p), cosine transforms of the basis
        """
        inverse, n_stretches = 1.0 / spectra, len(cosines)
        n_cosines, n_coefficients = basis_cosines.shape
        information = _weigh_products(inverse, basis_cosines)
        products = (cosines[:, :, None] * basis_cosines).transpose(1, 0, 2).reshape(n_cosines, -1)
        score = (inverse @ products).reshape(len(inverse), n_stretches, n_coefficients)
        unit_covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        shifts: Floats = score @ unit_covariance
        explained = np.sum(shifts * score, axis=(1, 2))
        squares = np.maximum(inverse @ np.sum(cosines**2, axis=0) - explained, 0.0)
        logs = np.log(spectra).sum(axis=1) + np.linalg.slogdet(information)[1]
        log_term, dof = -0.5 * n_stretches * logs, n_stretches * (n_cosines - n_coefficients)
        return cls(spectra, basis_cosines, log_term, squares, dof, shifts, unit_covariance)

    def compute_least_squares_covariance(self) -> Floats:
        """Compute the covariance of ordinary least squares under each spectrum, shape (g, p, p).

        The covariance is scaled to a spectrum of 1 at frequency zero. Beyond the last frequency of
        the transform, the noise is assumed to have the power at that frequency.
        """
        basis_cosines = self.basis_cosines
        products_beyond = np.eye(basis_cosines.shape[1]) - basis_cosines.T @ basis_cosines
        covariance = _weigh_products(self.spectra, basis_cosines)
        return covariance + self.spectra[:, -1, None, None] * products_beyond


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumPosterior:
    """Posterior probability of each of g candidate spectra, from all stretches.

    Parameters
    ----------
    probabilities : shape (g,), which sum to 1
    variances : shape (g,), estimated power at frequency zero for each spectrum, in the squared unit
        of the signal
    dof : degrees of freedom of the variances
    """

    probabilities: Floats
    variances: Floats
    dof: int

    @classmethod
    def combine(cls, likelihoods: Sequence[SpectrumLikelihood], prior: Floats) -> Self:
        """Combine likelihoods and prior probabilities (g,), with one variance for all stretches."""
        dof = sum(likelihood.dof for likelihood in likelihoods)
        squares = np.sum([likelihood.squares for likelihood in likelihoods], axis=0)
        logs = np.sum([likelihood.log_determinant_term for likelihood in likelihoods], axis=0)
        logs -= 0.5 * dof * np.log(np.maximum(squares, np.finfo(float).tiny))
        probabilities = prior * np.exp(logs - logs[prior > 0.0].max())
        return cls(probabilities / probabilities.sum(), squares / dof, dof)


def cut_smooth_stretches(values: Floats, *, width: int = 100) -> tuple[Floats, ...]:
    """Cut a signal into stretches without corners.

    Parameters
    ----------
    values : shape (n,); NaN are ignored
    width : number of samples of each stretch

    Returns
    -------
    Consecutive stretches up to the end of the signal. A stretch is omitted as a corner or a step if
    the variance of its residuals about a cubic exceeds four times the median.
    """
    finite_values = values[~np.isnan(values)]
    n_stretches = len(finite_values) // width
    if n_stretches == 0:
        return ()
    stretches = finite_values[len(finite_values) - n_stretches * width :].reshape(-1, width)
    cubics = build_polynomial_basis(width, 4)
    variances = np.var(stretches - (stretches @ cubics) @ cubics.T, axis=1)
    return tuple(stretches[variances <= 4.0 * np.median(variances)])


@lru_cache(maxsize=512)
def build_polynomial_basis(n_samples: int, n_polynomials: int) -> Floats:
    """Build the first orthonormal polynomials over evenly spaced samples.

    Parameters
    ----------
    n_samples : number of samples
    n_polynomials : number of polynomials, one more than the largest degree

    Returns
    -------
    Shape (n_samples, n_polynomials).
    """
    x = np.linspace(-1.0, 1.0, n_samples)
    return np.linalg.qr(np.polynomial.legendre.legvander(x, n_polynomials - 1))[0]


def compute_covariance(basis: Floats, processes: Processes) -> Floats:
    """Compute the covariance of projections of noise on a basis for each process.

    Parameters
    ----------
    basis : shape (p, n), orthonormal rows
    processes : the g candidate processes

    Returns
    -------
    Shape (g, p, p): the sums over frequency of the spectrum times products of the Fourier
    transforms of the basis. The basis is padded with zeros over more than the correlation time.
    """
    padding_times = 40.0  # correlation times
    length = basis.shape[1] + int(padding_times * processes.correlation_time.max())
    transforms = scipy.fft.fft(basis, length, axis=1).T / np.sqrt(length)
    spectra = processes.compute_spectra(2.0 * np.pi * np.arange(length) / length)
    return _weigh_products(spectra, transforms.real) + _weigh_products(spectra, transforms.imag)


def _weigh_products(weights: Floats, columns: Floats) -> Floats:
    """Compute the weighted sums of products of each pair of columns, shape (g, p, p).

    The columns have the shape (rows, p), and the weights of the rows the shape (g, rows).
    """
    products = (columns[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
    return (weights @ products).reshape(len(weights), columns.shape[1], -1)


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Coefficients of a linear model with noise of unknown correlation.

    Parameters
    ----------
    coefficients : shape (p,), in the unit of the values over that of the column of the design
    covariance : shape (p, p), covariance of the coefficients, averaged over the candidate processes
        by their probability
    half_widths : shape (p,), half widths of the 95 % intervals of the coefficients
    n : number of samples
    """

    coefficients: Floats
    covariance: Floats
    half_widths: Floats
    n: int

    def make_estimate(self, index: int) -> Estimate:
        """Make the estimate of one coefficient, with its standard error and 95 % interval."""
        value, half_width = float(self.coefficients[index]), float(self.half_widths[index])
        error = float(np.sqrt(self.covariance[index, index]))
        return Estimate(value, error, self.n, Interval(value - half_width, value + half_width))


def fit_linear(
    design: Floats,
    values: Floats,
    *,
    is_weighted: bool = False,
    other_stretches: Sequence[Floats] = (),
) -> LinearFit:
    """Fit a linear model by least squares, with intervals valid for serially correlated residuals.

    Parameters
    ----------
    design : shape (n, p), full rank, rows evenly sampled in time and without NaN
    values : shape (n,), without NaN
    is_weighted : False for ordinary least squares; True for generalised least squares, which is
        more accurate for a jump in strongly correlated noise
    other_stretches : further smooth stretches of the same signal, at least 8 samples each, without
        NaN and at the same sampling rate. The noise is also estimated from their residuals about a
        cubic, because a short window alone does not show the correlation time

    Returns
    -------
    Coefficients, covariance and 95 % half widths.

    Raises
    ------
    ValueError
        For fewer than p + 4 samples; with other stretches, for fewer than p + 1.

    Notes
    -----
    The noise is modelled as a first-order autoregressive process of unknown correlation time, up to
    a fifth of the window, with or without added white noise, or as noise with the reciprocal
    spectrum. The coefficients of its discrete cosine transform over the window are uncorrelated to
    a good approximation (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90), and the
    variance of a coefficient is the spectrum at its frequency. Each spectrum therefore has a
    restricted likelihood in closed form (Harville, J. Am. Stat. Assoc. 72 (1977) 320).

    Given the spectrum, a coefficient follows Student's t-distribution. The interval is that of the
    mixture over spectra, weighted by their likelihood and their prior. The prior of a correlation
    time, on a logarithmic scale, is in proportion to the time to the power -0.4. It is divided
    equally between noise with and without added white noise. White noise alone has the prior of the
    shortest time.

    Only the 128 lowest frequencies are used (all frequencies of the window if `is_weighted`),
    because higher ones, with hum, filters and rounding, contain no information about the mean over
    a window (as in the equal-weighted cosine estimator: Lazarus et al., J. Bus. Econ. Stat. 36
    (2018) 541). A misfit of the model counts as slow noise and widens the interval.

    Other stretches multiply the likelihood of each spectrum by theirs, with one common variance;
    the longest of window and stretches sets the range of correlation times. The window may then be
    shorter than the correlation time, so the covariance of ordinary least squares is computed
    exactly.
    """
    n_samples, n_coefficients = design.shape
    n_needed = n_coefficients + (1 if other_stretches else 4)
    if n_samples < n_needed:
        facts = {"needed": n_needed, "coefficients": n_coefficients, "count": n_samples}
        raise ValueError(format_sentence("uncertainty.too_few", **facts))
    basis, to_coefficients = orthonormalise(design)
    projections = basis @ values
    residuals = values - projections @ basis
    longest = max([n_samples, *map(len, other_stretches)])
    processes = choose_processes(longest, longest if is_weighted else min(longest, MAX_COSINES))
    n_cosines = n_samples if is_weighted else MAX_COSINES
    window = SpectrumLikelihood.from_values(basis, residuals, processes, n_cosines)
    likelihoods = [window]
    for length in sorted(set(map(len, other_stretches))):
        stretches = np.stack([x for x in other_stretches if len(x) == length])
        cubics = build_polynomial_basis(length, 4)
        stretches -= (stretches @ cubics) @ cubics.T  # against rounding errors of large values
        likelihood = SpectrumLikelihood.from_values(cubics.T, stretches, processes, MAX_COSINES)
        likelihoods.append(likelihood)
    posterior = SpectrumPosterior.combine(likelihoods, processes.prior)
    shifts, unit_covariance = window.shifts[:, 0], window.unit_covariance
    if not is_weighted:
        shifts = np.zeros_like(shifts)
        unit_covariance = window.compute_least_squares_covariance()
        if other_stretches:
            unit_covariance = compute_covariance(basis, processes)
    mean_shift = posterior.probabilities @ shifts
    covariances = unit_covariance * posterior.variances[:, None, None]
    covariances = to_coefficients @ covariances @ to_coefficients.T
    offsets = (shifts - mean_shift) @ to_coefficients.T
    offset_covariance = np.einsum("g,gi,gj->ij", posterior.probabilities, offsets, offsets)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    return LinearFit(
        coefficients=to_coefficients @ (projections + mean_shift),
        covariance=np.tensordot(posterior.probabilities, covariances, axes=1) + offset_covariance,
        half_widths=_compute_half_widths(posterior, variances, offsets),
        n=n_samples,
    )


def orthonormalise(design: Floats) -> tuple[Floats, Floats]:
    """Compute an orthonormal basis of the columns of a design.

    Parameters
    ----------
    design : shape (n, p), full rank, without NaN

    Returns
    -------
    basis : shape (p, n), orthonormal rows
    to_coefficients : shape (p, p), matrix from coefficients of the basis to those of the design
    """
    norms = np.linalg.norm(design, axis=0)
    orthonormal_columns, triangle = np.linalg.qr(design / norms)
    return np.ascontiguousarray(orthonormal_columns.T), np.linalg.inv(triangle) / norms[:, None]


def _compute_half_widths(mixture: SpectrumPosterior, variances: Floats, offsets: Floats) -> Floats:
    """Compute the half widths that contain 95 % of the mixture of t-distributions, shape (p,).

    Each spectrum has a variance and an offset from the mean for each coefficient, shape (g, p).
    """
    from scipy.optimize import brentq  # a slow import

    min_probability = 1e-15  # spectra with a lower probability are ignored
    is_relevant, dof = mixture.probabilities > min_probability, mixture.dof
    weights, half_widths = mixture.probabilities[is_relevant], np.zeros(variances.shape[1])

    def compute_excess(half_width: float, scales: Floats, centres: Floats) -> float:
        upper, lower = half_width / scales - centres, half_width / scales + centres
        inside = scipy.special.stdtr(dof, upper) - scipy.special.stdtr(dof, -lower)
        return float(weights @ inside) - 0.95

    for column in np.flatnonzero((variances > 0.0).any(axis=0)):
        scales = np.sqrt(variances[is_relevant, column])
        centres = offsets[is_relevant, column] / scales
        largest = 2.0 * np.max(scales * (np.abs(centres) + scipy.special.stdtrit(dof, 0.975)))
        half_widths[column] = brentq(
            compute_excess, 0.0, largest, (scales, centres), xtol=1e-12 * largest
        )
    return half_widths
