"""The moment-curvature law that the shapes of a first loading obey, all frames together.

Shapes that a law makes are compared with the markers; nothing is differentiated, so that curvatures
are known far better than from any one frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from labpipe.processing.law_basis import LawBasis, law_knots
from labpipe.processing.law_shapes import LawShapes, Loaded
from labpipe.records.arrays import Flags, Floats

_ROUNDS = 12
_SETTLED = 1e-7
_SINGULAR = 1e12
_LEVELS = (7, 13, 25)
"""Numbers of knots, each level with all the knots of the one before."""
_RECTANGLE = 1.0 / np.sqrt(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """A law, and how it hangs on the markers.

    Parameters
    ----------
    basis : of the law
    compliance : shape (knots,), 1/(N m^2), none negative
    covariance : shape (knots, knots), from what the markers scatter about the law
    sensitivity : shape (knots, n, 2 markers), what the compliances gain per metre that a marker
        coordinate is moved
    residual : m, root mean square misfit per coordinate
    n : marker coordinates seen in all frames together
    variance : m^2, of independent noise that would scatter the compliances as much on the whole
    """

    basis: LawBasis
    compliance: Floats
    covariance: Floats
    sensitivity: Floats
    residual: float
    n: int
    variance: float

    def shift(self, movement: Floats) -> Floats:
        """Change of the compliances if the law moved the markers otherwise.

        Parameters
        ----------
        movement : shape (n, 2 markers), m, by how much more with the same law

        Returns
        -------
        shape (knots,), to first order.
        """
        return np.asarray(-np.tensordot(self.sensitivity, movement, axes=2), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A law with as many knots as the markers can tell of.

    Parameters
    ----------
    fit : the law
    change : shape (knots,), standard error of the compliances for want of more knots, all of them
        together
    """

    fit: LawFit
    change: Floats


def refine_law(loaded: Loaded) -> Refined:
    """Find a law with enough knots for its bends.

    Parameters
    ----------
    loaded : moments, markers and rest

    Returns
    -------
    The law and what half as many knots change in it.

    Raises
    ------
    ValueError
        As `fit_law`.

    Notes
    -----
    Thirteen knots follow a smooth law to 0.1 % of its moment. A wire whose strands all slip at once
    has a law with a kink: the number is doubled if that lowers the sum of squares by more than log
    n times the variance of the noise for each knot on top (Schwarz, Ann. Stat. 6 (1978) 461).
    """
    largest = float(loaded.moment.max())
    coarse, fit, fine = (fit_law(loaded, law_knots(largest, count)) for count in _LEVELS)
    better = fine.n * (fit.residual**2 - fine.residual**2)
    if better > fine.variance * np.log(fine.n) * (_LEVELS[2] - _LEVELS[1]):
        coarse, fit = fit, fine
    return Refined(fit, _RECTANGLE * (_at_knots_of(fit, coarse) - fit.compliance))


def _at_knots_of(fine: LawFit, coarse: LawFit) -> Floats:
    """Compliances of a law at the knots of another, which hold its own."""
    return np.asarray(coarse.basis.slopes(fine.basis.knots) @ coarse.compliance, dtype=np.float64)


def fit_law(loaded: Loaded, basis: LawBasis) -> LawFit:
    """Find the law that explains where the markers are, by least squares.

    Parameters
    ----------
    loaded : moments, markers and rest
    basis : knots of the law

    Returns
    -------
    The law.

    Raises
    ------
    ValueError
        If the markers do not fix all compliances: too few frames, or moments too small.

    Notes
    -----
    Gauss-Newton; the inner step is non-negative least squares (Lawson and Hanson, Solving Least
    Squares Problems, 1974, chapter 23) where the plain one goes below zero. Every marker coordinate
    may have an offset of its own, known from the frames at rest: so the noise of the mean at rest,
    which all frames share, is in the covariance. That is a sandwich with the residuals' long-run
    covariance between coordinates in the middle (Newey and West, Econometrica 55 (1987) 703): the
    clamp's pivot and the force move all of them, and a smoothed force for several frames.
    """
    seen = np.isfinite(loaded.moved)
    found = np.where(seen, loaded.moved, 0.0)
    shapes = LawShapes.of(loaded, basis)
    compliance = _straight(shapes, found)
    for _ in range(_ROUNDS):
        moved, design = shapes.predict(compliance)
        left = _centred(np.where(seen, found - moved, 0.0)[..., None], seen, loaded.rest_weight)
        design = _centred(np.where(seen[..., None], design, 0.0), seen, loaded.rest_weight)
        flat, residual = design.reshape(-1, design.shape[2]), left.ravel()
        normal = flat.T @ flat
        better = _solve(normal, flat.T @ residual + normal @ compliance)
        change = float(np.abs(better - compliance).max() / np.abs(better).max())
        compliance = better
        if change < _SETTLED:
            break
    spread = _inverse(normal)
    pushes = np.einsum("kj,nmj->knm", spread, design)
    covariance = _covariance(pushes[:, :-1], left[:-1, :, 0], seen)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=pushes[:, :-1],
        residual=float(np.sqrt((left[:-1] ** 2).sum() / max(int(seen.sum()), 1))),
        n=int(seen.sum()),
        variance=float(np.trace(covariance @ normal)) / len(compliance),
    )


def _straight(shapes: LawShapes, found: Floats) -> Floats:
    """One compliance for all knots that moves the markers about as far as they moved."""
    one = np.ones(shapes.turns.shape[2])
    moved = shapes.predict(0.0 * one)[1] @ one
    scale = float((moved**2).sum())
    if not scale > 0.0:
        message = "moment: expected moments other than those at rest, found none"
        raise ValueError(message)
    return np.asarray(one * abs(float((moved * found).sum())) / scale, dtype=np.float64)


def _centred(values: Floats, seen: Flags, rest_weight: float) -> Floats:
    """Take out the offset of each marker coordinate; one more row at the end stands for the rest.

    Values and result of shape (n, 2 markers, k) and (n + 1, 2 markers, k).
    """
    offset = values.sum(axis=0) / (seen.sum(axis=0) + rest_weight)[:, None]
    centred = np.where(seen[..., None], values - offset, 0.0)
    return np.concatenate([centred, -np.sqrt(rest_weight) * offset[None]])


def _solve(normal: Floats, right: Floats) -> Floats:
    """Solve for compliances, none of them negative."""
    scale = np.sqrt(np.diag(normal))
    inverse = _inverse(normal)
    plain: Floats = inverse @ right
    if (plain >= 0.0).all():
        return plain
    triangle = np.linalg.cholesky(normal / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right / scale))[0] / scale


def _inverse(normal: Floats) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > _SINGULAR:
        message = (
            f"knots={len(scale)}: expected markers that fix the law at every knot, found too few "
            "frames or movements"
        )
        raise ValueError(message)
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(inverse, dtype=np.float64)


def _covariance(pushes: Floats, left: Floats, seen: Flags) -> Floats:
    """Covariance of the compliances from residuals of shape (n, 2 markers)."""
    freedom = max(float(seen.sum()) - len(pushes) - seen.shape[1], 1.0)
    between = _long_run(left, seen) * float(seen.sum()) / freedom
    middle = np.einsum("knm,ml,jnl->kj", pushes, between, pushes, optimize=True)
    return np.asarray(middle, dtype=np.float64)


def _long_run(left: Floats, seen: Flags) -> Floats:
    """Long-run covariance between the columns of residuals along axis 0, Bartlett's weights."""
    count = len(left)
    lags = min(round(4.0 * (count / 100.0) ** (2.0 / 9.0)) + 1, count // 4)
    weights = seen.astype(np.float64)
    total = left.T @ left / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, lags + 1):
        together = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        later = left[lag:].T @ left[:-lag] / together
        total += (1.0 - lag / (lags + 1.0)) * (later + later.T)
    return np.asarray(total, dtype=np.float64)
