"""Fit of the moment-curvature law to the marker positions of a first loading.

The shapes of a law are compared with the markers; nothing is differentiated, so that curvatures are
much more accurate than from single frames.

The wire keeps its length and its direction at the clamp. Its angle in frame f is

    theta_f(s) = theta_rest(s) + integral from 0 to s of [kappa(M_f) - kappa(M_rest)] ds'

with one law kappa(M) for all places and frames. If the weight of the specimen or at its tip had
bent it the other way, it reverses by Masing's rule until it is bent as much this way:

    kappa - kappa(M_rest) = 2 kappa((M_f - M_rest) / 2).

x = integral cos theta, y = integral sin theta, and markers are offset along the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.messages import sentence
from labpipe.records.arrays import Flags, Floats, Ints

RECTANGLE = 1.0 / np.sqrt(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """A law, and its dependence on the markers.

    Parameters
    ----------
    basis : of the law
    compliance : shape (knots,), 1/(N m^2), none negative
    covariance : shape (knots, knots), from the scatter of the markers about the law
    sensitivity : shape (knots, n, 2 markers), change of the compliances per metre of a marker
        coordinate
    residual : m, root mean square misfit per coordinate
    n : number of marker coordinates in all frames
    variance : m^2, of independent noise with the same overall scatter of the compliances
    """

    basis: LawBasis
    compliance: Floats
    covariance: Floats
    sensitivity: Floats
    residual: float
    n: int
    variance: float

    def shift(self, movement: Floats) -> Floats:
        """Return the change of the compliances for another movement of the markers.

        Parameters
        ----------
        movement : shape (n, 2 markers), m, additional movement with the same law

        Returns
        -------
        shape (knots,), to first order.
        """
        return np.asarray(-np.tensordot(self.sensitivity, movement, axes=2), dtype=np.float64)


def refine_law(loaded: Loaded) -> tuple[LawFit, Floats]:
    """Fit a law with as many knots as the markers determine.

    Parameters
    ----------
    loaded : moments, markers and rest

    Returns
    -------
    The law, and the standard error of its compliances from the number of knots, fully correlated:
    shape (knots,), the change with half as many knots.

    Raises
    ------
    ValueError
        As `fit_law`.

    Notes
    -----
    Thirteen knots describe a smooth law to 0.1 % of its moment. A wire whose strands all slip at
    once has a law with a kink: the number is doubled if that reduces the sum of squares by more
    than log n times the variance of the noise for each added knot (Schwarz, Ann. Stat. 6 (1978)
    461).
    """
    # Each level has all the knots of the one before.
    level_knots = (7, 13, 25)
    largest = float(loaded.moment.max())
    coarse, fit, fine = (fit_law(loaded, law_knots(largest, count)) for count in level_knots)
    better = fine.n * (fit.residual**2 - fine.residual**2)
    if better > fine.variance * np.log(fine.n) * (level_knots[2] - level_knots[1]):
        coarse, fit = fit, fine
    # The knots of the coarse law are among those of the fine one.
    coarse_compliance: Floats = coarse.basis.slopes(fit.basis.knots) @ coarse.compliance
    return fit, RECTANGLE * (coarse_compliance - fit.compliance)


def fit_law(loaded: Loaded, basis: LawBasis) -> LawFit:
    """Fit the law to the marker positions by least squares.

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
        If the markers do not determine all compliances: too few frames, or moments too small.

    Notes
    -----
    Gauss-Newton; the inner step is non-negative least squares (Lawson and Hanson, Solving Least
    Squares Problems, 1974, chapter 23) if the unconstrained one is negative. Every marker
    coordinate has its own offset, known from the frames at rest: so the noise of the mean at rest,
    common to all frames, is in the covariance. That is a sandwich estimator with the long-run
    covariance of the residuals between coordinates (Newey and West, Econometrica 55 (1987) 703):
    the pivot of the clamp and the force move all of them, and a smoothed force for several frames.
    """
    max_rounds = 12
    convergence_share = 1e-7
    seen = np.isfinite(loaded.moved)
    measured = np.where(seen, loaded.moved, 0.0)
    shapes = LawShapes.of(loaded, basis)
    compliance = _uniform_compliance(shapes, measured)
    for _ in range(max_rounds):
        moved, design = shapes.predict(compliance)
        residuals = _centred(
            np.where(seen, measured - moved, 0.0)[..., None], seen, loaded.rest_weight
        )
        design = _centred(np.where(seen[..., None], design, 0.0), seen, loaded.rest_weight)
        flat, residual = design.reshape(-1, design.shape[2]), residuals.ravel()
        normal = flat.T @ flat
        better = _solve(normal, flat.T @ residual + normal @ compliance)
        change = float(np.abs(better - compliance).max() / np.abs(better).max())
        compliance = better
        if change < convergence_share:
            break
    spread = _inverse(normal)
    pushes = np.einsum("kj,nmj->knm", spread, design)
    covariance = _covariance(pushes[:, :-1], residuals[:-1, :, 0], seen)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=pushes[:, :-1],
        residual=float(np.sqrt((residuals[:-1] ** 2).sum() / max(int(seen.sum()), 1))),
        n=int(seen.sum()),
        variance=float(np.trace(covariance @ normal)) / len(compliance),
    )


def _uniform_compliance(shapes: LawShapes, measured: Floats) -> Floats:
    """Return one compliance for all knots with about the observed movement of the markers."""
    one = np.ones(shapes.turns.shape[2])
    moved = shapes.predict(0.0 * one)[1] @ one
    scale = float((moved**2).sum())
    if not scale > 0.0:
        raise ValueError(sentence("results.no_change_of_moment"))
    return np.asarray(one * abs(float((moved * measured).sum())) / scale, dtype=np.float64)


def _centred(values: Floats, seen: Flags, rest_weight: float) -> Floats:
    """Subtract the offset of each marker coordinate; an additional last row is the rest.

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
    from scipy.optimize import nnls  # slow import, not for all tests

    triangle = np.linalg.cholesky(normal / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right / scale))[0] / scale


def _inverse(normal: Floats) -> Floats:
    max_condition = 1e12
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > max_condition:
        raise ValueError(sentence("results.law_not_determined", knots=len(scale)))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(inverse, dtype=np.float64)


def _covariance(pushes: Floats, residuals: Floats, seen: Flags) -> Floats:
    """Return the covariance of the compliances from residuals of shape (n, 2 markers)."""
    freedom = max(float(seen.sum()) - len(pushes) - seen.shape[1], 1.0)
    covariance = _long_run(residuals, seen) * float(seen.sum()) / freedom
    middle = np.einsum("knm,ml,jnl->kj", pushes, covariance, pushes, optimize=True)
    return np.asarray(middle, dtype=np.float64)


def _long_run(residuals: Floats, seen: Flags) -> Floats:
    """Return the long-run covariance between columns of residuals, with Bartlett's weights."""
    count = len(residuals)
    lags = min(round(4.0 * (count / 100.0) ** (2.0 / 9.0)) + 1, count // 4)
    weights = seen.astype(np.float64)
    total = residuals.T @ residuals / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, lags + 1):
        together = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        later = residuals[lag:].T @ residuals[:-lag] / together
        total += (1.0 - lag / (lags + 1.0)) * (later + later.T)
    return np.asarray(total, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Points along the wire for the integration of its shape.

    Parameters
    ----------
    arc_length : shape (points,), m, from the clamped end to the tip
    markers : shape (markers,), which of them are markers
    """

    arc_length: Floats
    markers: Ints

    @classmethod
    def through(cls, places: Floats, length: float) -> Line:
        """Divide a wire finely, with points at the markers and at the tip."""
        max_step = 0.0015  # m
        ends = np.concatenate([[0.0], places, [length]])
        ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
        counts = np.maximum(np.ceil(np.diff(ends) / max_step).astype(np.int64), 1)
        parts = [
            np.linspace(first, last, count, endpoint=False)
            for first, last, count in zip(ends[:-1], ends[1:], counts, strict=True)
        ]
        points = np.concatenate([*parts, ends[-1:]])
        return cls(points, np.searchsorted(points, places - 1e-10).astype(np.int64))

    def integral(self, values: Floats) -> Floats:
        """Integrate values (n, points, ...) from the clamped end by trapezoids."""
        from scipy.integrate import cumulative_trapezoid  # slow import, not for all tests

        return cumulative_trapezoid(values, self.arc_length, axis=1, initial=0)


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """Data for the fit of a law.

    Parameters
    ----------
    line : points along the wire
    moment : shape (n, points), N m, of the loaded frames
    moment_at_rest : shape (points,), N m
    angle_at_rest : shape (points,), rad
    markers : shape (n, markers, 2), m, in the plane of bending, from the clamped end; NaN are
        ignored
    markers_at_rest : shape (markers, 2), m
    rest_weight : frames of the rest over frames of a mean
    centre_offset : m, axis to marker centre
    """

    line: Line
    moment: Floats
    moment_at_rest: Floats
    angle_at_rest: Floats
    markers: Floats
    markers_at_rest: Floats
    rest_weight: float
    centre_offset: float

    @property
    def moved(self) -> Floats:
        """Return the displacements from rest, shape (n, 2 markers), m: x of all markers, then y."""
        moved = self.markers - self.markers_at_rest
        return np.concatenate([moved[..., 0], moved[..., 1]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class LawShapes:
    """Shapes for laws of one basis, with all that is independent of the compliances.

    Parameters
    ----------
    loaded : moments and rest
    turns : shape (n, points, knots), rad, of the wire from rest, per unit of compliance
    still : shape (1, 2 markers), m, marker centres at rest: x of all, then y
    """

    loaded: Loaded
    turns: Floats
    still: Floats

    @classmethod
    def of(cls, loaded: Loaded, basis: LawBasis) -> LawShapes:
        """Prepare the laws of a basis."""
        turns = loaded.line.integral(basis.changes(loaded.moment_at_rest, loaded.moment))
        begin = loaded.angle_at_rest[None]
        return cls(loaded, turns, _centres(loaded, np.sin(begin), np.cos(begin)))

    def movement(self, compliance: Floats) -> Floats:
        """Return the movement of the markers from rest for a law, shape (n, 2 markers), m."""
        return _centres(self.loaded, *self._directions(compliance)) - self.still

    def predict(self, compliance: Floats) -> tuple[Floats, Floats]:
        """Return the movement of the markers from rest for a law, and its derivatives.

        Parameters
        ----------
        compliance : shape (knots,), 1/(N m^2)

        Returns
        -------
        Movement, shape (n, 2 markers), m, and its derivatives, shape (n, 2 markers, knots).
        """
        line, height, turns = self.loaded.line, self.loaded.centre_offset, self.turns
        sine, cosine = self._directions(compliance)
        moved = _centres(self.loaded, sine, cosine) - self.still
        along = -line.integral(sine[..., None] * turns)
        across = line.integral(cosine[..., None] * turns)
        markers = line.markers
        along = along[:, markers] - height * cosine[:, markers, None] * turns[:, markers]
        across = across[:, markers] - height * sine[:, markers, None] * turns[:, markers]
        return moved, np.concatenate([along, across], axis=1)

    def _directions(self, compliance: Floats) -> tuple[Floats, Floats]:
        """Return sine and cosine of the angle of the wire, shape (n, points) each."""
        angle = self.loaded.angle_at_rest + self.turns @ compliance
        return np.sin(angle), np.cos(angle)


def _centres(loaded: Loaded, sine: Floats, cosine: Floats) -> Floats:
    """Return the marker centres, shape (n, 2 markers): x of all, then y."""
    line, height = loaded.line, loaded.centre_offset
    markers = line.markers
    x = line.integral(cosine)[:, markers] - height * sine[:, markers]
    y = line.integral(sine)[:, markers] + height * cosine[:, markers]
    return np.concatenate([x, y], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class LawBasis:
    """Laws whose slope d kappa / d M is linear between knots, and constant beyond the last.

    Parameters
    ----------
    knots : shape (knots,), N m, from 0 up
    """

    knots: Floats

    def slopes(self, moment: Floats) -> Floats:
        """Return the slope of the law per unit of compliance at each knot; (*moment, knots)."""
        size = np.clip(np.abs(moment), 0.0, self.knots[-1])
        place = np.searchsorted(self.knots, size, side="right") - 1
        place = np.clip(place, 0, len(self.knots) - 2)
        share = (size - self.knots[place]) / np.diff(self.knots)[place]
        slopes = np.zeros((*np.shape(size), len(self.knots)))
        np.put_along_axis(slopes, place[..., None], (1.0 - share)[..., None], axis=-1)
        np.put_along_axis(slopes, place[..., None] + 1, share[..., None], axis=-1)
        return slopes

    def values(self, moment: Floats) -> Floats:
        """Return the curvature per unit of compliance at each knot, odd; (*moment, knots)."""
        widths, size = np.diff(self.knots), np.abs(moment)
        inside = np.clip(np.clip(size, 0.0, self.knots[-1])[..., None] - self.knots[:-1], 0, widths)
        rising = inside**2 / (2.0 * widths)
        values = np.zeros((*np.shape(size), len(self.knots)))
        values[..., :-1] += inside - rising
        values[..., 1:] += rising
        values[..., -1] += np.maximum(size - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * values, dtype=np.float64)

    def changes(self, rest: Floats, moment: Floats) -> Floats:
        """Return the change of curvature from a rest after first loading, per unit of compliance.

        Parameters
        ----------
        rest : shape (points,), N m
        moment : shape (n, points), N m

        Returns
        -------
        shape (n, points, knots).
        """
        plain = self.values(moment) - self.values(rest)
        moment_change = moment - rest
        turned = (moment_change * rest < 0.0) & (np.abs(moment_change) < 2.0 * np.abs(rest))
        plain[turned] = 2.0 * self.values(0.5 * moment_change[turned])
        return plain


def law_knots(largest: float, count: int) -> LawBasis:
    """Choose knots, denser near zero, where every frame has a part of its wire.

    Parameters
    ----------
    largest : N m, the largest moment
    count : of knots, at least 2
    """
    return LawBasis(largest * (np.arange(count) / (count - 1)) ** 1.6)
