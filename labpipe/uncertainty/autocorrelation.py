"""Estimate the long-run variance and the spectrum of noise, and fit linear models in such noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.fft import dct, fft
from scipy.special import beta, stdtr, stdtrit

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate

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
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), 3))[0]
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
    lowest : rad per sample, below which flicker noise is constant
    factor : shape (g,), lag-one correlation
    floor : shape (g,), white noise, as a share of the spectrum at frequency zero
    is_mirrored : shape (g,), 1 for a spectrum that rises with the frequency, else 0
    prior : shape (g,)
    time : shape (g,), samples, correlation time
    flicker_power, crossing : shape (g,), 0 and infinite without flicker noise; rad per sample,
        where white noise is as large as flicker noise
    """

    lowest: float
    factor: Floats
    floor: Floats
    is_mirrored: Floats
    prior: Floats
    time: Floats
    flicker_power: Floats
    crossing: Floats

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
    The arrays of `Processes` for white noise, and for each time for the mirror image, without and
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
    return Processes(np.pi, *np.array(list_autoregressive_processes(times, floors)).T)


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
    basis = build_cubic_basis(width)
    variances = np.var(pieces - (pieces @ basis.T) @ basis, axis=1)
    return tuple(pieces[variances <= 4.0 * np.median(variances)])


@lru_cache(maxsize=8)
def build_cubic_basis(count: int) -> Floats:
    """Return orthonormal polynomials up to degree three over even samples, shape (4, count)."""
    basis: Floats = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), 4))[0].T
    return np.ascontiguousarray(basis)


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


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Coefficients of a linear model with noise of unknown correlation.

    Parameters
    ----------
    coefficients : shape (p,)
    covariance : shape (p, p), averaged over the correlation times by their probability
    half_widths : shape (p,), of the 95 % intervals
    n : number of samples
    """

    coefficients: Floats
    covariance: Floats
    half_widths: Floats
    n: int

    def estimate(self, number: int) -> Estimate:
        """Return one coefficient with its standard error and 95 % interval."""
        value, half_width = float(self.coefficients[number]), float(self.half_widths[number])
        error = float(np.sqrt(self.covariance[number, number]))
        return Estimate(value, error, self.n, Interval(value - half_width, value + half_width))


def fit_linear(
    design: Floats,
    values: Floats,
    *,
    weighted: bool = False,
    other_stretches: Sequence[Floats] = (),
) -> LinearFit:
    """Fit by least squares, with intervals that are valid for serially correlated residuals.

    Parameters
    ----------
    design : shape (n, p), full rank, rows evenly sampled in time and without NaN
    values : shape (n,), without NaN
    weighted : False for ordinary least squares; True for generalised least squares, better for a
        jump in strongly correlated noise
    other_stretches : further smooth stretches of the same signal, at least 8 samples each, sampled
        alike and without NaN. Their residuals about a cubic also show the noise; a short window
        alone does not show the correlation time

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
    a fifth of the window, or its mirror image, with more or less added white noise. In cosines over
    the window such noise is uncorrelated to a good approximation (Ahmed, Natarajan and Rao, IEEE
    Trans. Comput. C-23 (1974) 90), with the variance of its spectrum, so that each spectrum has a
    restricted likelihood in closed form (Harville, J. Am. Stat. Assoc. 72 (1977) 320). Given the
    spectrum a coefficient follows Student's t; the interval is that of the mixture over spectra,
    weighted by their likelihood and a prior: of power -0.4 over the logarithm of the correlation
    time, half without and half with white noise, plus one share for white noise alone. Only the 128
    slowest cosines enter (all of them with `weighted`): hum, filters and rounding have no
    information on the mean over a window (as in the equal-weighted cosine estimator: Lazarus et
    al., J. Bus. Econ. Stat. 36 (2018) 541). A curve that the model does not fit looks like slow
    noise and widens the interval. Other stretches multiply the likelihood of each spectrum by
    theirs, with one common variance; the longest of all stretches sets the range of
    correlation times. The window may then be shorter than the correlation time, so the covariance
    of ordinary least squares is then the exact one and not that of cosines.
    """
    count, unknowns = design.shape
    needed = unknowns + (1 if other_stretches else 4)
    if count < needed:
        text = format_sentence(
            "uncertainty.too_few", needed=needed, coefficients=unknowns, count=count
        )
        raise ValueError(text)
    basis, to_coefficients = orthonormalise(design)
    projections = basis @ values
    max_samples = max([count, *map(len, other_stretches)])
    max_cosines = max_samples if weighted else min(max_samples, MAX_COSINES)
    processes = choose_processes(max_samples, max_cosines)
    n_cosines, residuals = count if weighted else MAX_COSINES, values - projections @ basis
    window = SpectrumLikelihood.from_values(basis, residuals, processes, n_cosines)
    likelihoods = [window]
    for length in sorted(set(map(len, other_stretches))):
        stretches = np.stack([x for x in other_stretches if len(x) == length])
        cubics = build_cubic_basis(length)
        stretches -= (stretches @ cubics.T) @ cubics  # rounding would grow with the size of values
        likelihoods.append(
            SpectrumLikelihood.from_values(cubics, stretches, processes, MAX_COSINES)
        )
    noise = SpectrumPosterior.combine(likelihoods, processes.prior)
    shifts, unit_covariance = window.shifts[:, 0], window.unit_covariance
    if not weighted:
        shifts = np.zeros_like(shifts)
        unit_covariance = window.compute_least_squares_covariance()
        if other_stretches:
            unit_covariance = compute_covariance(basis, processes)
    shift = noise.probabilities @ shifts
    covariances = unit_covariance * noise.variances[:, None, None]
    covariances = to_coefficients @ covariances @ to_coefficients.T
    offsets = (shifts - shift) @ to_coefficients.T
    spread = np.einsum("g,gi,gj->ij", noise.probabilities, offsets, offsets)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    return LinearFit(
        coefficients=to_coefficients @ (projections + shift),
        covariance=np.tensordot(noise.probabilities, covariances, axes=1) + spread,
        half_widths=_compute_half_widths(noise, variances, offsets),
        n=count,
    )


def orthonormalise(design: Floats) -> tuple[Floats, Floats]:
    """Return an orthonormal basis of the columns of a design.

    Parameters
    ----------
    design : shape (n, p), full rank, without NaN

    Returns
    -------
    basis : shape (p, n), orthonormal rows
    to_coefficients : shape (p, p); the coefficients of the columns from those of the basis
    """
    scale = np.linalg.norm(design, axis=0)
    columns, triangle = np.linalg.qr(design / scale)
    return np.ascontiguousarray(columns.T), np.linalg.inv(triangle) / scale[:, None]


def _compute_half_widths(noise: SpectrumPosterior, variances: Floats, offsets: Floats) -> Floats:
    """Return half widths that contain 95 % of the mixture of t-distributions.

    By Newton's method: the coverage is concave in the half width, so it does not overshoot.
    """
    # Spectra below this probability do not change a half width.
    min_probability = 1e-15
    deviations = np.sqrt(np.maximum(variances, 0.0))
    positive_deviations = np.where(deviations > 0.0, deviations, 1.0)
    half_widths: Floats = stdtrit(noise.freedom, 0.975) * np.exp(
        noise.probabilities @ np.log(positive_deviations)
    )
    smallest = 0.1 * half_widths
    is_relevant = noise.probabilities > min_probability
    weights, spreads = noise.probabilities[is_relevant], positive_deviations[is_relevant]
    centres, freedom = offsets[is_relevant] / spreads, noise.freedom
    for _ in range(12):
        high, low = half_widths / spreads - centres, half_widths / spreads + centres
        coverage = weights @ (stdtr(freedom, high) - stdtr(freedom, -low))
        density = _compute_density(high, freedom) + _compute_density(low, freedom)
        step = (0.95 - coverage) / (weights @ (density / spreads))
        half_widths = np.maximum(half_widths + step, smallest)
        if np.all(np.abs(step) <= 1e-6 * half_widths):
            break
    return np.where(np.any(deviations > 0.0, axis=0), half_widths, 0.0)


def _compute_density(t: Floats, freedom: int) -> Floats:
    """Return the density of Student's t-distribution."""
    density: Floats = (1.0 + t * t / freedom) ** (-0.5 * (freedom + 1))
    density /= np.sqrt(freedom) * beta(0.5, 0.5 * freedom)
    return density
