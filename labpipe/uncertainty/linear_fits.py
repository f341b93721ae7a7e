"""Fit linear models, with intervals that are valid for serially correlated residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import beta, stdtr, stdtrit

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate
from labpipe.uncertainty.autocorrelation import (
    MAX_COSINES,
    SpectrumLikelihood,
    SpectrumPosterior,
    build_polynomials,
    choose_processes,
    compute_covariance,
)


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
        value, half = float(self.coefficients[number]), float(self.half_widths[number])
        error = float(np.sqrt(self.covariance[number, number]))
        return Estimate(value, error, self.n, Interval(value - half, value + half))


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
        cubics = build_polynomials(length).T
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
    half: Floats = stdtrit(noise.freedom, 0.975) * np.exp(
        noise.probabilities @ np.log(positive_deviations)
    )
    smallest = 0.1 * half
    is_relevant = noise.probabilities > min_probability
    weights, spreads = noise.probabilities[is_relevant], positive_deviations[is_relevant]
    centres, freedom = offsets[is_relevant] / spreads, noise.freedom
    for _ in range(12):
        high, low = half / spreads - centres, half / spreads + centres
        coverage = weights @ (stdtr(freedom, high) - stdtr(freedom, -low))
        density = _compute_density(high, freedom) + _compute_density(low, freedom)
        step = (0.95 - coverage) / (weights @ (density / spreads))
        half = np.maximum(half + step, smallest)
        if np.all(np.abs(step) <= 1e-6 * half):
            break
    return np.where(np.any(deviations > 0.0, axis=0), half, 0.0)


def _compute_density(t: Floats, freedom: int) -> Floats:
    """Return the density of Student's t-distribution."""
    density: Floats = (1.0 + t * t / freedom) ** (-0.5 * (freedom + 1))
    density /= np.sqrt(freedom) * beta(0.5, 0.5 * freedom)
    return density
