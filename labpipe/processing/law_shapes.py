"""The shapes that a moment-curvature law makes of a clamped wire, and where its markers then are.

The wire keeps its length and its direction at the clamp. Its angle in frame f is

    theta_f(s) = theta_rest(s) + integral from 0 to s of [kappa(M_f) - kappa(M_rest)] ds'

with one law kappa(M) for all places and frames; x = integral cos theta, y = integral sin theta, and
markers stand off along the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.processing.law_basis import LawBasis
from labpipe.records.arrays import Floats, Ints

_STEP = 0.0015  # m, of the integrals along the wire


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Points along the wire that its shape is integrated over.

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
        ends = np.concatenate([[0.0], places, [length]])
        ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
        counts = np.maximum(np.ceil(np.diff(ends) / _STEP).astype(np.int64), 1)
        parts = [
            np.linspace(first, last, count, endpoint=False)
            for first, last, count in zip(ends[:-1], ends[1:], counts, strict=True)
        ]
        points = np.concatenate([*parts, ends[-1:]])
        return cls(points, np.searchsorted(points, places - 1e-10).astype(np.int64))

    def integral(self, values: Floats) -> Floats:
        """Integral from the clamped end, trapezoids; values of shape (n, points, ...)."""
        steps = np.diff(self.arc_length).reshape(-1, *([1] * (values.ndim - 2)))
        parts = 0.5 * steps * (values[:, 1:] + values[:, :-1])
        out = np.zeros_like(values)
        np.cumsum(parts, axis=1, out=out[:, 1:])
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """What a law is found from.

    Parameters
    ----------
    line : points along the wire
    moment : shape (n, points), N m, of the loaded frames
    moment_at_rest : shape (points,), N m
    angle_at_rest : shape (points,), rad
    markers : shape (n, markers, 2), m, in the plane of bending, from the clamped end; NaN is left
        out
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
        """How far the markers have moved from rest, shape (n, 2 markers), m: x of all, then y."""
        moved = self.markers - self.markers_at_rest
        return np.concatenate([moved[..., 0], moved[..., 1]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class LawShapes:
    """The shapes that laws of one basis make, with all that their compliances do not change.

    Parameters
    ----------
    loaded : moments and rest
    turns : shape (n, points, knots), rad, of the wire from rest, per unit of compliance
    still : shape (1, 2 markers), m, where the markers' centres are at rest: x of all, then y
    """

    loaded: Loaded
    turns: Floats
    still: Floats

    @classmethod
    def of(cls, loaded: Loaded, basis: LawBasis) -> LawShapes:
        """Prepare the laws of a basis."""
        at_rest = basis.values(loaded.moment_at_rest)
        turns = loaded.line.integral(basis.values(loaded.moment) - at_rest)
        begin = loaded.angle_at_rest[None]
        return cls(loaded, turns, _centres(loaded, np.sin(begin), np.cos(begin)))

    def movement(self, compliance: Floats) -> Floats:
        """How far the markers move from rest under a law, shape (n, 2 markers), m."""
        return _centres(self.loaded, *self._directions(compliance)) - self.still

    def predict(self, compliance: Floats) -> tuple[Floats, Floats]:
        """How far the markers move from rest under a law, and how that changes with the law.

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
        at = line.markers
        along = along[:, at] - height * cosine[:, at, None] * turns[:, at]
        across = across[:, at] - height * sine[:, at, None] * turns[:, at]
        return moved, np.concatenate([along, across], axis=1)

    def _directions(self, compliance: Floats) -> tuple[Floats, Floats]:
        """Sine and cosine of the wire's angle, shape (n, points) each."""
        angle = self.loaded.angle_at_rest + self.turns @ compliance
        return np.sin(angle), np.cos(angle)


def _centres(loaded: Loaded, sine: Floats, cosine: Floats) -> Floats:
    """Places of the markers' centres, shape (n, 2 markers): x of all, then y."""
    line, height = loaded.line, loaded.centre_offset
    at = line.markers
    x = line.integral(cosine)[:, at] - height * sine[:, at]
    y = line.integral(sine)[:, at] + height * cosine[:, at]
    return np.concatenate([x, y], axis=1)
