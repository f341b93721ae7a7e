"""Noise that remembers: its long-run variance, and its spectrum from stretches of a signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, pi

import numpy as np
from scipy.fft import dct
from scipy.special import factorial

from labpipe.records.arrays import Floats

TERMS = 128
"""Cosines that the noise is judged by: half waves over the window."""
_FLOORS = (0.003, 0.01, 0.03, 0.1, 0.3)
"""White noise beneath correlated noise, as shares of the spectrum at frequency zero."""
_ORDER = np.arange(16)
"""Powers of a phase of half a radian, beyond which its sine and cosine are exact."""


def long_run_variance(residuals: Floats, *, parameters: int) -> float:
    """Variance that the mean of n residuals has, times n.

    Parameters
    ----------
    residuals : shape (n,), evenly sampled; NaN count as absent
    parameters : number of parameters that the fit behind the residuals spent

    Returns
    -------
    In the unit of the residuals, squared. NaN for fewer than `parameters` + 3 residuals.

    Notes
    -----
    Newey and West, Econometrica 55 (1987) 703: autocovariances to lag 1.3 n^(1/2), weighted by
    Bartlett's triangle; scaled by n / (n - parameters). Never below half the plain variance.
    For white noise it is the plain variance.
    """
    values = residuals[~np.isnan(residuals)]
    count = len(values)
    if count < parameters + 3:
        return float("nan")
    centred = values - values.mean()
    lags = min(int(1.3 * np.sqrt(count)), count // 4)
    plain = float(centred @ centred) / count
    total = plain
    for lag in range(1, lags + 1):
        covariance = float(centred[lag:] @ centred[:-lag]) / count
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * covariance
    # A fit takes low frequencies out of its residuals: the triangle then sums to too little.
    lost = 1.0 - min(0.5, parameters * (lags + 1.0) / count)
    return max(total / lost, 0.5 * plain) * count / (count - parameters)


def fast_noise(values: Floats) -> Floats:
    """Standard deviation of a signal about parabolas through blocks of 20 samples; the median.

    Parameters
    ----------
    values : shape (..., n), evenly sampled, without NaN; n at least 4

    Returns
    -------
    Shape (...), in the unit of the values. Noise that remembers longer than a block passes for
    signal.

    Examples
    --------
    >>> round(float(fast_noise(3.0 + np.random.default_rng(0).normal(0.0, 0.01, 4000))), 3)
    0.01
    """
    block_samples = 20
    size = min(block_samples, values.shape[-1])
    count = values.shape[-1] // size
    rows = values[..., : count * size].reshape(*values.shape[:-1], count, size)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), 3))[0]
    left = rows - rows @ basis @ basis.T
    deviation: Floats = np.median(np.sqrt(np.sum(left**2, axis=-1) / (size - 3)), axis=-1)
    return deviation


def limits_by_noise(limit: float, rows: Floats) -> Floats:
    """A limit that was set by the fast noise of one record, as that of many like it would be.

    Parameters
    ----------
    limit : any unit
    rows : shape (rows, n), of such records; columns with a NaN are left out

    Returns
    -------
    Shape (rows,), as much above or below `limit` as the noise of each is beside that of all.
    """
    noise = fast_noise(rows[:, ~np.isnan(rows).any(axis=0)])
    middle = float(noise.mean())
    return limit * noise / middle if middle > 0.0 else np.full(len(rows), limit)


@dataclass(frozen=True, slots=True)
class Grid:
    """Correlation times that are considered.

    Parameters
    ----------
    count : samples of the longest stretch; the longest time is a fifth of it
    terms : cosines of it that are looked at
    """

    count: int
    terms: int

    @property
    def times(self) -> Floats:
        """In samples, shape (times,)."""
        longest_share = 0.2
        n_spectra = 24
        longest = longest_share * self.count
        shortest = longest / (longest_share * 4.0 * self.terms)
        return np.geomspace(shortest, longest, n_spectra - 1)

    @property
    def prior(self) -> Floats:
        """Prior of each spectrum, shape (g,)."""
        # With this power, intervals cover 95 % from white noise to correlation over a tenth of the
        # window (see the studies).
        prior_power = -0.4
        prior = (self.times / self.times[0]) ** prior_power
        half = 0.5 * prior  # white noise beneath, or none: the one as likely as the other
        return np.concatenate([prior[::-1], [1.0], half, *[half / len(_FLOORS)] * len(_FLOORS)])


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Spectra of noise at the cosines (g, terms), 1 / spectra, sums of logs (g,)."""

    spectra: Floats
    inverse: Floats
    logs: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ReducedTest:
    """Likelihood of each of g spectra by one stretch.

    Parameters
    ----------
    spectra : shape (g, terms)
    waves : shape (terms, p), cosines of its basis
    likelihood : shape (g,), its logarithm but for the sum of squares
    squares : shape (g,), whitened sum of squares
    freedom : cosines less coefficients
    shifts : shape (g, p), of the coefficients by generalised least squares
    unit : shape (g, p, p), their covariance for noise whose spectrum is 1 at frequency zero
    """

    spectra: Floats
    waves: Floats
    likelihood: Floats
    squares: Floats
    freedom: int
    shifts: Floats
    unit: Floats

    @classmethod
    def of(cls, basis: Floats, values: Floats, grid: Grid, most: int) -> ReducedTest:
        """Restricted likelihood (Harville, J. Am. Stat. Assoc. 72 (1977) 320) in cosines.

        Parameters
        ----------
        basis : shape (p, n), orthonormal rows
        values : shape (n,), without NaN; what the basis explains of them does not matter
        grid : of the spectra
        most : cosines that are looked at, the slowest
        """
        spent, count = basis.shape
        terms = min(count, most)
        cosines = slowest_cosines(np.vstack([basis, values]), terms).T
        waves, left = cosines[:, :spent], cosines[:, spent]
        spectra = _spectra(grid, count, terms)
        information = (spectra.inverse @ _products(waves)).reshape(-1, spent, spent)
        unit: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
        score = spectra.inverse @ (left[:, None] * waves)
        shifts: Floats = np.einsum("gij,gj->gi", unit, score)
        squares: Floats = spectra.inverse @ left**2 - np.einsum("gi,gi->g", shifts, score)
        likelihood: Floats = -0.5 * (spectra.logs + np.linalg.slogdet(information)[1])
        return cls(spectra.spectra, waves, likelihood, squares, terms - spent, shifts, unit)

    def plain_covariance(self) -> Floats:
        """Covariance of ordinary least squares under each spectrum.

        What the basis has beyond the last cosine meets noise of at most that cosine's power.
        """
        spent = self.waves.shape[1]
        beyond = np.eye(spent) - self.waves.T @ self.waves
        unit = (self.spectra @ _products(self.waves)).reshape(-1, spent, spent)
        covariance: Floats = unit + self.spectra[:, -1, None, None] * beyond
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Chance of each of g spectra by all stretches together.

    Parameters
    ----------
    chances : shape (g,), sum to 1
    variances : shape (g,), of each spectrum at frequency zero
    freedom : of the variances
    """

    chances: Floats
    variances: Floats
    freedom: int

    @classmethod
    def of(cls, stretches: Sequence[ReducedTest], grid: Grid) -> Noise:
        """Likelihoods multiplied, the variance common to all, and the prior of the grid."""
        freedom = sum(stretch.freedom for stretch in stretches)
        squares = np.sum([stretch.squares for stretch in stretches], axis=0)
        squares = np.asarray(np.maximum(squares, np.finfo(float).tiny), dtype=np.float64)
        likelihood = np.sum([stretch.likelihood for stretch in stretches], axis=0)
        likelihood = likelihood - 0.5 * freedom * np.log(squares)
        chances = grid.prior * np.exp(likelihood - likelihood.max())
        return cls(chances / chances.sum(), squares / freedom, freedom)


def slowest_cosines(rows: Floats, terms: int) -> Floats:
    """Coefficients of the slowest cosines of a discrete cosine transform.

    Parameters
    ----------
    rows : shape (p, n), without NaN
    terms : number of cosines, at most n; the first one is constant

    Returns
    -------
    shape (p, terms), the first columns of the orthonormal transform of type 2.

    Notes
    -----
    Long records are cut into blocks so short that the phase of the quickest cosine stays within
    half a radian of that in the middle. There each cosine is its power series, and of each block
    only its first moments are needed: O(n) for any n. The whole transform takes four times as long
    for 400 000 samples, and forty times where the number of samples is a prime.

    Examples
    --------
    >>> slowest_cosines(np.full((1, 4), 3.0), 2).round(12)
    array([[6., 0.]])
    """
    # Samples per block.
    long_block = 128
    count, blocks = rows.shape[1], ceil(pi * terms)
    if count <= long_block * blocks:
        return np.asarray(dct(rows, norm="ortho")[:, :terms])
    size = ceil(count / blocks)
    cut = np.pad(rows, ((0, 0), (0, -count % size))).reshape(len(rows), -1, size)
    inside = (np.arange(size) - 0.5 * (size - 1)) / size
    moments = cut @ np.vander(inside, len(_ORDER), increasing=True)
    cosine = np.arange(terms)
    # Whole numbers of a quarter turn over n, so that no phase loses digits to its many turns.
    quarters = np.outer(2 * np.arange(cut.shape[1]) + 1, cosine * size) % (4 * count)
    middles = np.exp(0.5j * pi / count * quarters)
    series = (1j * pi / count * size * cosine[:, None]) ** _ORDER / factorial(_ORDER)
    turned = np.tensordot(moments, middles, axes=(1, 0))
    waves: Floats = np.einsum("wmk,km->wk", turned, series).real
    waves *= np.sqrt(2.0 / count)
    waves[:, 0] *= np.sqrt(0.5)
    return waves


def smooth_stretches(values: Floats, *, width: int = 100) -> tuple[Floats, ...]:
    """Cut a signal into stretches that can stand beside a fit.

    Parameters
    ----------
    values : shape (n,); NaN are left out
    width : samples of each

    Returns
    -------
    Neighbouring stretches, what is left over lying at the beginning; without those whose residuals
    about a cubic have more than four times the median variance of all: a corner, a cliff or a step
    is in them.
    """
    finite = values[~np.isnan(values)]
    count = len(finite) // width
    if count == 0:
        return ()
    pieces = finite[len(finite) - count * width :].reshape(count, width)
    basis = cubic_basis(width)
    variances = np.var(pieces - (pieces @ basis.T) @ basis, axis=1)
    return tuple(pieces[variances <= 4.0 * np.median(variances)])


@lru_cache(maxsize=8)
def cubic_basis(count: int) -> Floats:
    """Orthonormal polynomials to degree three over so many even samples, shape (4, count)."""
    basis: Floats = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), 4))[0].T
    return np.ascontiguousarray(basis)


def exact_covariance(basis: Floats, grid: Grid) -> Floats:
    """Covariance of the projections on a basis (p, n) under each spectrum, shape (g, p, p)."""
    spent, count = basis.shape
    covariances = _covariances(grid, count)
    unit = np.empty((len(covariances), spent, spent))
    for one in range(spent):
        for other in range(spent):
            both = np.correlate(basis[one], basis[other], mode="full")
            lagged = both[count - 1 :].copy()
            lagged[1:] += both[: count - 1][::-1]
            unit[:, one, other] = covariances @ lagged
    return unit


def _covariances(grid: Grid, count: int) -> Floats:
    """Covariances at each lag of noise with the spectra of `_spectra`, shape (g, count)."""
    lags, factors = np.arange(count), np.exp(-1.0 / grid.times)[:, None]
    slow = (1.0 - factors) / (1.0 + factors) * factors**lags
    white = (lags == 0).astype(np.float64)[None, :]
    moving = ((1.0 + factors**2) * white - factors * (lags == 1)) / (1.0 - factors) ** 2
    mixed = [floor * white + (1.0 - floor) * slow for floor in _FLOORS]
    return np.vstack([moving[::-1], white, slow, *mixed])


def _products(waves: Floats) -> Floats:
    """All products of two columns, shape (terms, p^2)."""
    return (waves[:, :, None] * waves[:, None, :]).reshape(len(waves), -1)


@lru_cache(maxsize=16)
def _spectra(grid: Grid, count: int, terms: int) -> _Spectra:
    """Spectra of autoregressive noise at the cosines, 1 at frequency zero.

    Each with floors of white noise beneath, from none to a third: a load cell has both, and a pure
    first-order process that is to explain the white part comes out too quick and too small.
    """
    factors = np.append(0.0, np.exp(-1.0 / grid.times))[:, None]
    turns = np.cos(np.pi * np.arange(terms) / count)
    spectra: Floats = (1.0 - factors) ** 2 / (1.0 - 2.0 * factors * turns + factors**2)
    # The mirror images rise with frequency. Without them white noise would lie at the edge of what
    # is allowed, and its intervals would come out too wide.
    mixed = [floor + (1.0 - floor) * spectra[1:] for floor in _FLOORS]
    all_spectra = np.vstack([1.0 / spectra[:0:-1], spectra, *mixed])
    return _Spectra(all_spectra, 1.0 / all_spectra, np.log(all_spectra).sum(axis=1))
