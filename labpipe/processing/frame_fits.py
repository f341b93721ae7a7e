"""Least-squares curves through the markers of many frames at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.processing.arc_curves import CurveBasis, coupled_design, curve_basis
from labpipe.processing.frames import Selection
from labpipe.processing.tracklets import in_sight
from labpipe.records.arrays import Flags, Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class EndConditions:
    """What is known of the ends of the curve.

    Parameters
    ----------
    length : m, arc length of the last point
    direction : shape (3,), unit tangent at the clamped end, which is the origin; None where the
        beginning is as free as the rest
    free_tip : no moment at the last point
    """

    length: float
    direction: Floats | None
    free_tip: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameFits:
    """Fitted curves of all frames; NaN where markers are too few.

    Parameters
    ----------
    coefficients : shape (frames, 3, terms), m, power series in s / length
    misfit : shape (frames, 2, markers), m, marker minus curve in x and y
    gain : shape (frames, 3), standard error of the last point per standard deviation of one
        coordinate of one marker
    freedom : shape (frames,), degrees of freedom per coordinate
    needed : markers that a frame must show
    """

    coefficients: Floats
    misfit: Floats
    gain: Floats
    freedom: Ints
    needed: int

    @property
    def last_point(self) -> Floats:
        """Position at s = length, shape (frames, 3), m."""
        return np.asarray(self.coefficients.sum(axis=2), dtype=np.float64)

    @property
    def spare(self) -> int:
        """Coefficients that could be had on top with all markers in sight."""
        return int(self.misfit.shape[2]) - self.needed

    @property
    def residual(self) -> Floats:
        """Root mean square misfit per coordinate, shape (frames,), m."""
        seen = np.isfinite(self.misfit)
        squares = np.where(seen, self.misfit, 0.0) ** 2
        count = seen.sum(axis=(1, 2))
        mean = squares.sum(axis=(1, 2)) / np.maximum(count, 1)
        return np.asarray(np.where(count > 0, np.sqrt(mean), np.nan), dtype=np.float64)

    def noise(self, rest: Selection) -> float:
        """Standard deviation of a marker coordinate, m, from the scatter of the misfit at rest.

        What the curve cannot follow stays the same at rest and drops out with the mean.
        """
        misfit, freedom = self.misfit[rest], self.freedom[rest]
        whole = np.isfinite(misfit).all(axis=(1, 2))
        if whole.sum() < 2 or freedom[whole][0] < 1:
            return float("nan")
        scatter = np.var(misfit[whole], axis=0, ddof=1).mean()
        return float(np.sqrt(scatter * misfit.shape[2] / freedom[whole][0]))


def fit_frames(
    markers: Floats,
    arc_length: Floats,
    centre_offset: float,
    conditions: EndConditions,
    *,
    terms: int,
) -> FrameFits:
    """Fit one curve per frame, all frames that show the same markers together.

    Parameters
    ----------
    markers : shape (frames, markers, 3), m; NaN where missing
    arc_length : shape (markers,), m, of the markers
    centre_offset : m, from the axis to the marker centre
    conditions : at the ends
    terms : coefficients per coordinate

    Returns
    -------
    The fits.

    Raises
    ------
    ValueError
        If there are fewer markers than free coefficients per coordinate.

    Notes
    -----
    The design matrix depends on arc length alone, so its pseudo-inverse serves every frame with the
    same markers in sight.
    """
    free = conditions.direction is None
    basis = curve_basis(
        terms=terms,
        length=conditions.length,
        clamped=not free,
        free_tip=conditions.free_tip,
    )
    frames, count = markers.shape[:2]
    if basis.unknowns > count:
        most = terms - basis.unknowns + count
        message = f"terms={terms}: expected at most {most} for {count} markers"
        raise ValueError(message)
    fixed = np.zeros((3, terms))
    fixed[:, 1] = 0.0 if conditions.direction is None else conditions.direction * conditions.length
    data = markers - _known_part(conditions.direction, arc_length, centre_offset)
    fits = FrameFits(
        coefficients=np.full((frames, 3, terms), np.nan),
        misfit=np.full((frames, 2, count), np.nan),
        gain=np.full((frames, 3), np.nan),
        freedom=np.zeros(frames, dtype=np.int64),
        needed=basis.unknowns,
    )
    for pattern, chosen in _patterns(in_sight(markers)):
        if pattern.sum() >= basis.unknowns:
            places = np.flatnonzero(pattern)
            unknowns, misfit, gain = _solve(
                data[np.ix_(chosen, places)], basis, arc_length[pattern], centre_offset
            )
            series = unknowns.reshape(-1, basis.unknowns) @ np.ascontiguousarray(basis.matrix.T)
            fits.coefficients[chosen] = fixed + series.reshape(-1, 3, terms)
            fits.misfit[np.ix_(chosen, np.arange(2), places)] = misfit
            fits.gain[chosen] = gain
            fits.freedom[chosen] = len(places) - basis.unknowns
    return fits


def _solve(
    data: Floats, basis: CurveBasis, arc_length: Floats, centre_offset: float
) -> tuple[Floats, Floats, Floats]:
    """Fit frames that show the same markers.

    Gives unknowns (frames, 3, unknowns), misfit (frames, 2, markers) and gain of the end (3,).
    """
    count = basis.unknowns
    design, value = coupled_design(basis, arc_length, centre_offset), basis.value(arc_length)
    solve, solve_across = np.linalg.pinv(design), np.linalg.pinv(value)
    flat = np.concatenate([data[..., 0], data[..., 1]], axis=1)
    plane = flat @ solve.T
    across = np.ascontiguousarray(data[..., 2]) @ solve_across.T
    unknowns = np.stack([plane[:, :count], plane[:, count:], across], axis=1)
    misfit = (flat - plane @ design.T).reshape(len(data), 2, -1)
    end = basis.value(np.array([basis.length]))[0]
    parts = (solve[:count], solve[count:], solve_across)
    gain = np.array([np.linalg.norm(end @ part) for part in parts])
    return unknowns, misfit, gain


def _known_part(direction: Floats | None, arc_length: Floats, centre_offset: float) -> Floats:
    """Where the given beginning alone would put the markers, shape (markers, 3), m."""
    if direction is None:
        return np.zeros((len(arc_length), 3))
    normal = np.array([-direction[1], direction[0], 0.0])
    return np.asarray(arc_length[:, None] * direction + centre_offset * normal, dtype=np.float64)


def _patterns(seen: Flags) -> list[tuple[Flags, Ints]]:
    """Sets of markers in sight, and the frames that show just these."""
    codes = seen @ (1 << np.arange(seen.shape[1]))  # sorting rows themselves is far slower
    first, which = np.unique(codes, return_index=True, return_inverse=True)[1:]
    return [(seen[row], np.flatnonzero(which == number)) for number, row in enumerate(first)]
