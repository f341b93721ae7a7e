"""How uncertain a fitted number is when the residuals of its fit are serially correlated."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats

_BLOCK = 20


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
    known = residuals[~np.isnan(residuals)]
    count = len(known)
    if count < parameters + 3:
        return float("nan")
    centred = known - known.mean()
    lags = min(int(1.3 * np.sqrt(count)), count // 4)
    plain = float(centred @ centred) / count
    total = plain
    for lag in range(1, lags + 1):
        covariance = float(centred[lag:] @ centred[:-lag]) / count
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * covariance
    # A fit takes low frequencies out of its residuals: the triangle then sums to too little.
    lost = 1.0 - min(0.5, parameters * (lags + 1.0) / count)
    return max(total / lost, 0.5 * plain) * count / (count - parameters)


def fast_noise(values: Floats) -> float:
    """Standard deviation of a signal about parabolas through blocks of 20 samples; the median.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN; n at least 4

    Returns
    -------
    In the unit of the values. Noise that remembers longer than a block passes for signal.

    Examples
    --------
    >>> round(fast_noise(3.0 + np.random.default_rng(0).normal(0.0, 0.01, 4000)), 3)
    0.01
    """
    size = min(_BLOCK, len(values))
    rows = values[: len(values) // size * size].reshape(-1, size)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), 3))[0]
    left = rows - rows @ basis @ basis.T
    return float(np.median(np.sqrt(np.sum(left**2, axis=1) / (size - 3))))
