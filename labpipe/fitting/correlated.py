"""Linear fits whose intervals hold when the residuals know their neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.fitting.cosines import slowest_cosines
from labpipe.fitting.estimates import Estimate
from labpipe.fitting.student import density, half_width, share_within
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

TERMS = 128
"""Cosines that the noise is judged by: half waves over the window."""
_LONGEST = 0.2
"""Longest correlation time that is considered, as a share of the window."""
_SPECTRA = 24
_FLOORS = (0.003, 0.01, 0.03, 0.1, 0.3)
"""White noise beneath correlated noise, as shares of the spectrum at frequency zero."""
_PRIOR = -0.4
"""Power of the correlation time in the prior; with it coverage agrees with 95 % from white noise to
correlation over a tenth of the window (the studies beside the tests)."""
_LONG = 10_000
"""Samples above which the time of a fit is that of passing over them."""
_INDEPENDENT = 1e8
"""Condition of the products of columns below which two steps of Cholesky are exact to rounding."""
_NOTHING = 1e-15
"""Chance of a spectrum below which it cannot move a half width."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Coefficients of a linear model with noise of unknown correlation.

    Parameters
    ----------
    coefficients : shape (p,)
    covariance : shape (p, p), averaged over the correlation times that the residuals allow
    half_widths : shape (p,), of the 95 % intervals
    unit_errors : shape (p,), standard errors in independent noise of variance 1
    residual_deviation : residual standard deviation, n - p degrees of freedom
    n : number of samples
    """

    coefficients: Floats
    covariance: Floats
    half_widths: Floats
    unit_errors: Floats
    residual_deviation: float
    n: int

    def estimate(self, number: int) -> Estimate:
        """One coefficient with its standard error and 95 % interval."""
        value, half = float(self.coefficients[number]), float(self.half_widths[number])
        error = float(np.sqrt(self.covariance[number, number]))
        return Estimate(value, error, self.n, Interval(value - half, value + half))

    def along(self, direction: Floats) -> Estimate:
        """A linear combination of the coefficients, with the widest of their t-quantiles."""
        value = float(direction @ self.coefficients)
        error = float(np.sqrt(direction @ self.covariance @ direction))
        half = self.quantile * error
        return Estimate(value, error, self.n, Interval(value - half, value + half))

    @property
    def classical_errors(self) -> Floats:
        """Standard errors (p,) as if the residuals were independent."""
        return self.residual_deviation * self.unit_errors

    @property
    def quantile(self) -> float:
        """Half width over standard error, the largest of the coefficients."""
        errors = np.sqrt(np.diag(self.covariance))
        known = errors > 0.0
        return float(np.max(self.half_widths[known] / errors[known])) if known.any() else 1.96


def fit_linear(design: Floats, values: Floats, *, weighted: bool = False) -> LinearFit:
    """Least squares with intervals that hold for serially correlated residuals.

    Parameters
    ----------
    design : shape (n, p), full rank, rows evenly sampled in time and without NaN
    values : shape (n,), without NaN
    weighted : False for ordinary least squares, whose coefficients everybody gets; True for
        generalised least squares, better where a jump is looked for in strongly correlated noise

    Returns
    -------
    Coefficients, covariance and 95 % half widths.

    Raises
    ------
    ValueError
        For fewer than p + 4 samples.

    Notes
    -----
    The noise is taken for a first-order autoregressive process of unknown correlation time, white
    in the middle, a fifth of the window long at one end, the mirror image of that at the other,
    with more or less white noise beneath. In cosines over the window such noise is uncorrelated to
    a good approximation (Ahmed, Natarajan and Rao, IEEE Trans. Comput. C-23 (1974) 90), with the
    variance of its spectrum, so that each spectrum has a restricted likelihood in closed form
    (Harville, J. Am. Stat. Assoc. 72 (1977) 320). Given the spectrum a coefficient follows
    Student's t; the interval is that of the mixture over spectra, weighted by their likelihood and
    a prior: of power -0.4 over the logarithm of the correlation time, half without and half with
    white noise, plus one share for white noise alone. Only the 128 slowest cosines enter (all of
    them with `weighted`): hum, filters and rounding do not speak of the mean over a window (the
    thought of the equal-weighted cosine estimator: Lazarus et al., J. Bus. Econ. Stat. 36 (2018)
    541). A curve that is not of the model's shape looks like slow noise and widens the interval.
    """
    count, spent = design.shape
    if count < spent + 4:
        message = f"expected at least {spent + 4} samples for {spent} coefficients, found {count}"
        raise ValueError(message)
    basis, to_coefficients = orthonormal(design)
    plain = basis @ values
    residuals = values - plain @ basis
    terms = count if weighted else min(count, TERMS)
    waves = slowest_cosines([*basis, residuals], terms).T
    noise = _Noise.of(_spectra(count, terms), waves[:, :spent], waves[:, spent])
    shifts, unit = noise.weighted_fit() if weighted else noise.plain_fit(waves[:, :spent])
    shift = noise.chances @ shifts
    deviation = float(np.sqrt(residuals @ residuals / (count - spent)))
    each = to_coefficients @ (unit * noise.variances[:, None, None]) @ to_coefficients.T
    offsets = (shifts - shift) @ to_coefficients.T
    spread = np.einsum("g,gi,gj->ij", noise.chances, offsets, offsets)
    return LinearFit(
        coefficients=to_coefficients @ (plain + shift),
        covariance=np.tensordot(noise.chances, each, axes=1) + spread,
        half_widths=_half_widths(noise, np.diagonal(each, axis1=1, axis2=2), offsets),
        unit_errors=np.asarray(np.linalg.norm(to_coefficients, axis=1), dtype=np.float64),
        residual_deviation=deviation,
        n=count,
    )


def orthonormal(design: Floats) -> tuple[Floats, Floats]:
    """Orthonormal basis of the columns of a design.

    Parameters
    ----------
    design : shape (n, p), full rank, without NaN

    Returns
    -------
    basis : shape (p, n), orthonormal rows
    to_coefficients : shape (p, p); the coefficients of the columns from those of the basis

    Notes
    -----
    Of long columns by two steps of Cholesky (Fukaya et al., SIAM J. Sci. Comput. 42 (2020) A477),
    which only form products: as good as Householder's reflections as long as the columns are far
    from dependent, and several times as fast. Else by reflections.
    """
    scale = np.sqrt(np.einsum("np,np->p", design, design))
    if len(design) > _LONG:
        gram = (design.T @ design) / np.outer(scale, scale)
        if np.linalg.cond(gram) < _INDEPENDENT:
            first = np.linalg.inv(np.linalg.cholesky(gram)) / scale
            basis = first @ design.T
            second = np.linalg.inv(np.linalg.cholesky(basis @ basis.T))
            return second @ basis, (second @ first).T
    columns, triangle = np.linalg.qr(design / scale)
    return np.ascontiguousarray(columns.T), np.linalg.inv(triangle) / scale[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Spectra of noise at the cosines (g, terms), 1 / spectra, sums of logs (g,), prior (g,)."""

    spectra: Floats
    inverse: Floats
    logs: Floats
    prior: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """What the residuals say of each correlation time on the grid.

    spectra (g, terms); chances (g,) sum to 1; variances (g,) scale of each spectrum; freedom.
    """

    spectra: Floats
    chances: Floats
    variances: Floats
    freedom: int
    shifts: Floats
    unit: Floats

    @classmethod
    def of(cls, grid: _Spectra, waves: Floats, residuals: Floats) -> _Noise:
        terms, spent = waves.shape
        freedom = terms - spent
        information = (grid.inverse @ _products(waves)).reshape(-1, spent, spent)
        inverse: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
        score = grid.inverse @ (residuals[:, None] * waves)
        shifts: Floats = np.einsum("gij,gj->gi", inverse, score)
        squares = grid.inverse @ residuals**2 - np.einsum("gi,gi->g", shifts, score)
        squares = np.asarray(np.maximum(squares, np.finfo(float).tiny), dtype=np.float64)
        likelihood = -0.5 * (
            grid.logs + np.linalg.slogdet(information)[1] + freedom * np.log(squares)
        )
        chances = grid.prior * np.exp(likelihood - likelihood.max())
        variances: Floats = np.asarray(squares / freedom, dtype=np.float64)
        return cls(grid.spectra, chances / chances.sum(), variances, freedom, shifts, inverse)

    def weighted_fit(self) -> tuple[Floats, Floats]:
        """Generalised least squares for each spectrum: change of coefficients, unit covariance."""
        return self.shifts, self.unit

    def plain_fit(self, waves: Floats) -> tuple[Floats, Floats]:
        """Ordinary least squares: its covariance under each spectrum.

        What the basis has beyond the last cosine meets noise of at most that cosine's power.
        """
        spent = waves.shape[1]
        beyond = np.eye(spent) - waves.T @ waves
        unit = (self.spectra @ _products(waves)).reshape(-1, spent, spent)
        return np.zeros_like(self.shifts), unit + self.spectra[:, -1, None, None] * beyond


def _products(waves: Floats) -> Floats:
    """All products of two columns, shape (terms, p^2)."""
    return (waves[:, :, None] * waves[:, None, :]).reshape(len(waves), -1)


@lru_cache(maxsize=8)
def _spectra(count: int, terms: int) -> _Spectra:
    """Spectra of autoregressive noise at the cosines, 1 at frequency zero, and their prior.

    Each with floors of white noise beneath, from none to a third: a load cell has both, and a pure
    first-order process that is to explain the white part comes out too quick and too small.
    """
    longest = _LONGEST * count
    times = np.geomspace(longest / (_LONGEST * 4.0 * terms), longest, _SPECTRA - 1)
    factors = np.append(0.0, np.exp(-1.0 / times))[:, None]
    turns = np.cos(np.pi * np.arange(terms) / count)
    spectra: Floats = (1.0 - factors) ** 2 / (1.0 - 2.0 * factors * turns + factors**2)
    prior = np.append(1.0, (times / times[0]) ** _PRIOR)
    # The mirror images rise with frequency. Without them white noise would lie at the edge of what
    # is allowed, and its intervals would come out too wide.
    mirrored = slice(None, 0, -1)
    mixed = [floor + (1.0 - floor) * spectra[1:] for floor in _FLOORS]
    half = 0.5 * prior[1:]  # white noise beneath, or none: the one as likely as the other
    likely = [prior[mirrored], prior[:1], half, *[half / len(_FLOORS)] * len(_FLOORS)]
    each = np.vstack([1.0 / spectra[mirrored], spectra, *mixed])
    return _Spectra(each, 1.0 / each, np.log(each).sum(axis=1), np.concatenate(likely))


def _half_widths(noise: _Noise, variances: Floats, offsets: Floats) -> Floats:
    """Half widths that hold 95 % of the mixture of t-distributions.

    Newton's steps: the share that a half width holds is concave, so they do not overshoot.
    """
    deviations = np.sqrt(np.maximum(variances, 0.0))
    safe = np.where(deviations > 0.0, deviations, 1.0)
    half: Floats = half_width(0.95, noise.freedom) * np.exp(noise.chances @ np.log(safe))
    least = 0.1 * half
    counted = noise.chances > _NOTHING
    chances, safe, offsets = noise.chances[counted], safe[counted], offsets[counted]
    for _ in range(12):
        share, slope = _held(half, safe, offsets, noise.freedom)
        step = (0.95 - chances @ share) / (chances @ slope)
        half = np.maximum(half + step, least)
        if np.all(np.abs(step) <= 1e-6 * half):
            break
    return np.where(np.any(deviations > 0.0, axis=0), half, 0.0)


def _held(half: Floats, safe: Floats, offsets: Floats, freedom: int) -> tuple[Floats, Floats]:
    """Share that a half width holds of each t-distribution, and what it gains per width."""
    if not offsets.any():
        t = half / safe
        return share_within(t, freedom), 2.0 * density(t, freedom) / safe
    high, low = (half - offsets) / safe, (half + offsets) / safe
    share = 0.5 * (share_within(high, freedom) + share_within(low, freedom))
    return share, (density(high, freedom) + density(low, freedom)) / safe
