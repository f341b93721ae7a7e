"""Moment-curvature laws as plays: curvature as a function of moment and of its history.

A `PlayLaw` is a spring in series with play operators (strands that stick, slip and yield do so one
after the other):

    kappa = M / EI0 + sum_j c_j p_j        p_j <- min(max(p_j, M - r_j), M + r_j)

On first loading p_j = max(0, M - r_j), so the law is a polygon with a corner at each half-width
r_j; after a reversal no play moves until the moment has changed by twice the smallest r_j, so
unloading starts with EI0, loops follow Masing's rule and close, and residual curvature remains at
zero moment. The law is rate-independent. Moments are in N m, curvatures in 1/m.

A law may end at a moment. Functions here continue its last slope, so that a search may pass the
end; `require_within` checks results. A `LoadingTable` is a law on first loading as a table.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, TypeAlias

import numpy as np
from scipy.interpolate import PPoly

from labpipe.records.arrays import ArrayRecord, Flags, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Response of a law to a moment at each station.

    Parameters
    ----------
    curvature : shape (stations,), 1/m
    compliance : shape (stations,), 1/(N m^2), slope of curvature against moment in the direction
        of the step just made
    plays : shape (stations, plays), N m, the history after the step
    """

    curvature: Floats
    compliance: Floats
    plays: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PlayLaw(ArrayRecord):
    """Many plays: any concave first-loading law, with Masing loops and residual curvature.

    Parameters
    ----------
    stiffness : EI0, N m^2
    half_widths : shape (plays,), N m, positive and increasing
    compliances : shape (plays,), 1/(N m^2), not negative
    largest_moment : N m, end of the range of the law; infinite for a law without an end

    Raises
    ------
    ValueError
        If a number is out of its range, or the numbers of half-widths and compliances differ.
    """

    stiffness: float
    half_widths: Annotated[Floats, "plays"] = field(repr=False)
    compliances: Annotated[Floats, "plays"] = field(repr=False)
    largest_moment: float = np.inf

    def __post_init__(self) -> None:
        require_positive("stiffness", self.stiffness)
        require("largest_moment", self.largest_moment, "> 0", holds=self.largest_moment > 0.0)
        ArrayRecord.__post_init__(self)
        widths, compliances = self.half_widths, self.compliances
        require_rising("half_widths", widths)
        are_valid = bool(np.all((compliances >= 0.0) & np.isfinite(compliances)))
        require("compliances", compliances.tolist(), "finite and >= 0", holds=are_valid)

    def make_unbent_history(self, n_stations: int) -> Floats:
        """Return the history of a wire that was never bent, shape (n_stations, plays), N m."""
        return np.zeros((n_stations, len(self.half_widths)))

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute curvatures under new moments, from the history.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : shape (stations, plays), N m, before the step

        Returns
        -------
        Curvature, compliance and the new history. A moment of NaN gives a curvature and a history
        of NaN.

        Notes
        -----
        At a corner of the polygon the compliance is that of a play that does not move yet.
        """
        column = moment[:, None]
        moved = np.minimum(
            np.maximum(history, column - self.half_widths), column + self.half_widths
        )
        flowing = moved != history
        curvature = moment / self.stiffness + moved @ self.compliances
        compliance = 1.0 / self.stiffness + flowing @ self.compliances
        return Response(curvature, compliance, moved)


def make_linear_plays(stiffness: float) -> PlayLaw:
    """Return a constant bending stiffness, N m^2, as a law without plays: kappa = M / EI."""
    return PlayLaw(stiffness, np.zeros(0), np.zeros(0))


def find_corners(law: PlayLaw) -> tuple[Floats, Floats, Floats]:
    """Return the corners of a law on first loading, from zero; arrays of shape (plays + 1,).

    Parameters
    ----------
    law : law of the wire

    Returns
    -------
    Moments, N m; curvatures, 1/m; d(curvature) / d(moment) beyond each corner, 1/(N m^2).
    """
    moment = np.append(0.0, law.half_widths)
    slopes = 1.0 / law.stiffness + np.append(0.0, np.cumsum(law.compliances))
    return moment, np.append(0.0, np.cumsum(slopes[:-1] * np.diff(moment))), slopes


def compute_first_curvature(law: PlayLaw, moment: Floats) -> Floats:
    """Return the curvature of first loading at moments, 1/m.

    Parameters
    ----------
    law : law of the wire; beyond its end the last slope continues
    moment : shape (n,), N m, not negative
    """
    corner_moment, corner_curvature, slopes = find_corners(law)
    corner = np.searchsorted(corner_moment, moment, side="right") - 1
    return corner_curvature[corner] + slopes[corner] * (moment - corner_moment[corner])


def is_within(law: PlayLaw, moment: float) -> bool:
    """Return whether a law covers a moment, N m, of either sign, within rounding."""
    rounding_share = 1e-6  # of the largest moment: searches end within it
    return bool(abs(moment) <= law.largest_moment * (1.0 + rounding_share))


def require_within(law: PlayLaw, moment: Floats, place: str) -> None:
    """Refuse moments beyond the end of a law.

    Parameters
    ----------
    law : law of the wire
    moment : shape (n,), N m
    place : what was computed, for the message

    Raises
    ------
    ValueError
        The message states the curvatures of the wire and of the end of the law.
    """
    largest = float(np.max(np.abs(moment), initial=0.0))
    if is_within(law, largest):
        return
    curvature, last = compute_first_curvature(law, np.array([largest, law.largest_moment]))
    message = (
        f"{place}: expected curvatures up to {last:.4g} 1/m, the end of the law, "
        f"found {curvature:.4g} 1/m"
    )
    raise ValueError(message)


def require(name: str, value: object, condition: str, *, holds: bool) -> None:
    """Refuse a value that does not meet a condition.

    Parameters
    ----------
    name, value, condition : for the message
    holds : whether the value meets the condition

    Raises
    ------
    ValueError
        The message states name, value and condition.
    """
    if not holds:
        message = f"{name}={value!r}: must be {condition}"
        raise ValueError(message)


def require_positive(name: str, value: float) -> None:
    """Refuse a number that is not finite and positive, as `require`."""
    require(name, value, "finite and > 0", holds=bool(0.0 < value < np.inf))


def require_not_negative(name: str, value: float) -> None:
    """Refuse a number that is not finite or is negative, as `require`."""
    require(name, value, "finite and >= 0", holds=bool(0.0 <= value < np.inf))


def require_rising(name: str, values: Floats) -> None:
    """Refuse numbers that are not positive and increasing, as `require`."""
    holds = bool(np.all(np.diff(values, prepend=0.0) > 0.0))
    require(name, values.tolist(), "positive and increasing", holds=holds)


def require_finite(name: str, values: Floats | float) -> None:
    """Refuse numbers that are NaN or infinite, as `require`."""
    holds = bool(np.all(np.isfinite(values)))
    require(name, np.asarray(values).tolist(), "finite", holds=holds)


def make_polygon_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Return the plays of a polygon through the origin and points of a first loading.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 1
    moment : shape (n,), N m; the last is the end of the law

    Raises
    ------
    ValueError
        If the moment does not increase (softens), or a slope is larger than the one before it
        (stiffens); the message states the curvature.
    """
    rounding_share = 1e-7  # of the first slope, from differences of close corners
    slopes = np.diff(moment, prepend=0.0) / np.diff(curvature, prepend=0.0)
    if not np.all(slopes > 0.0):
        kappa = curvature[int(np.argmin(slopes > 0.0))]
        message = f"the law softens before curvature={kappa:.6g} 1/m: the moment must increase"
        raise ValueError(message)
    if np.any(np.diff(slopes) > rounding_share * slopes[0]):
        kappa = curvature[int(np.argmax(np.diff(slopes))) + 1]
        message = f"the law stiffens before curvature={kappa:.6g} 1/m: the slope must not increase"
        raise ValueError(message)
    compliances = np.maximum(np.diff(1.0 / slopes), 0.0)
    return PlayLaw(float(slopes[0]), moment[:-1], compliances, float(moment[-1]))


def make_stick_slip_law(
    *,
    stick_stiffness: float,
    stick_moment: float,
    slip_stiffness: float,
    reference_moment: float,
    hardening: float,
    last_moment: float,
    n_plays: int = 40,
) -> PlayLaw:
    """Return plays for stick, then a power law of slip and yield (Ramberg-Osgood).

    kappa = M / EI0 + (M0 / EI1) (max(M - Ms, 0) / M0)^(1 / n), as a polygon.

    Parameters
    ----------
    stick_stiffness : EI0, N m^2
    stick_moment : Ms, N m, positive, up to which all strands stick
    slip_stiffness : EI1, N m^2, secant stiffness of the power law alone: M0 over its curvature at
        Ms + M0
    reference_moment : M0, N m
    hardening : n between 0 (perfectly plastic) and 1 (two straight lines)
    last_moment : N m, last corner of the polygon; the law continues beyond it
    n_plays : number of plays, at least 1

    Raises
    ------
    ValueError
        If a number is out of its range.
    """
    require_positive("slip_stiffness", slip_stiffness)
    require_positive("reference_moment", reference_moment)
    require("hardening", hardening, "between 0 and 1", holds=0.0 < hardening < 1.0)
    knots = stick_moment + np.linspace(0.0, 1.0, n_plays + 1) ** 2 * (last_moment - stick_moment)
    flow = ((knots - stick_moment) / reference_moment) ** (1.0 / hardening)
    curvature = knots / stick_stiffness + reference_moment / slip_stiffness * flow
    slopes = np.diff(curvature) / np.diff(knots)
    compliances = np.diff(slopes, prepend=1.0 / stick_stiffness)
    return PlayLaw(stick_stiffness, knots[:-1], np.maximum(compliances, 0.0))


CurvatureAndSlope: TypeAlias = tuple[Floats, Floats]
"""Curvature, 1/m, and its derivative by the moment, 1/(N m^2)."""


@dataclass(frozen=True, eq=False)
class LoadingTable:
    """Curvature against moment, cubic between knots (Hermite), straight beyond the last.

    Parameters
    ----------
    moment : shape (knots,), N m, from zero, increasing
    curvature : shape (knots,), 1/m
    first, last : shape (knots - 1,), 1/(N m^2), slope of the curvature at the beginning and at the
        end of each panel: a law may have corners
    first_change, last_change : shape (parameters, knots - 1), derivative of the curvature (1/m) at
        constant moment by each parameter, at the beginning and at the end of each panel
    """

    moment: Floats
    curvature: Floats
    first: Floats
    last: Floats
    first_change: Floats
    last_change: Floats

    @classmethod
    def of_plays(cls, law: PlayLaw) -> LoadingTable:
        """Return the table of a law of plays, which is linear between its corners."""
        moment, curvature, slopes = find_corners(law)
        step = moment[-1] or law.stiffness  # the last panel is as wide as all others together
        moment = np.append(moment, moment[-1] + step)
        curvature = np.append(curvature, curvature[-1] + slopes[-1] * step)
        none = np.zeros((0, len(slopes)))
        return cls(moment, curvature, slopes, slopes, none, none)

    @cached_property
    def curve(self) -> PPoly:
        """Return curvature, its slope and its changes by the parameters, over moment's size."""
        width = np.diff(self.moment)
        chord = np.diff(self.curvature) / width
        cubic = (self.first + self.last - 2.0 * chord) / width**2
        square = (3.0 * chord - 2.0 * self.first - self.last) / width
        panels = np.zeros((4, len(width) + 1, 2 + len(self.first_change)))
        panels[:, :-1, 0] = cubic, square, self.first, self.curvature[:-1]
        panels[2:, -1, 0] = self.last[-1], self.curvature[-1]  # beyond the last knot
        panels[1:, :, 1] = np.array([[3.0], [2.0], [1.0]]) * panels[:3, :, 0]
        panels[2, :-1, 2:] = ((self.last_change - self.first_change) / width).T
        panels[3, :-1, 2:] = self.first_change.T
        panels[3, -1, 2:] = self.last_change[:, -1]
        return PPoly(panels, np.append(self.moment, 2.0 * self.moment[-1]))

    def bend(self, moment: Floats) -> CurvatureAndSlope:
        """Return curvature and slope of first loading at moments of any shape and sign, N m."""
        values = self.curve(np.abs(moment))
        return np.sign(moment) * values[..., 0], values[..., 1]

    def changes(self, moment: Floats) -> Floats:
        """Return the derivatives of the curvature of `bend` by the parameters, axis 0."""
        changes = np.moveaxis(self.curve(np.abs(moment))[..., 2:], -1, 0)
        return np.asarray(np.sign(moment) * changes, dtype=np.float64)

    def bend_on(self, rest: Floats, moment: Floats) -> CurvatureAndSlope:
        """Return curvature and slope after bending from a rest that first loading reached.

        Parameters
        ----------
        rest : shape (stations,), N m, moment at rest
        moment : shape (n, stations), N m; each is reached monotonically

        Notes
        -----
        Masing's rule: after a reversal at M0 the curvature is kappa0 + 2 k((M - M0) / 2), with the
        law k of first loading, until the moment is -M0; from there it is k(M).
        """
        curvature, slope = self.bend(moment)
        reverses = self._reverses(rest, moment)
        if reverses.any():
            half_change = 0.5 * (moment - rest)[reverses]
            half_curvature_change, half_slope = self.bend(half_change)
            turn = np.broadcast_to(self.bend(rest)[0], moment.shape)[reverses]
            curvature[reverses], slope[reverses] = turn + 2.0 * half_curvature_change, half_slope
        return curvature, slope

    def bend_back(self, rest: Floats, peak: Floats, moment: Floats) -> CurvatureAndSlope:
        """Return curvature and slope after bending from a rest to peaks, then unloading.

        Parameters
        ----------
        rest : as for `bend_on`
        peak, moment : shape (n, stations), N m: largest moments so far, and present ones
        """
        curvature, slope = self.bend_on(rest, peak)
        falls = moment < peak
        if falls.any():
            half_curvature_change, half_slope = self.bend(0.5 * (peak - moment)[falls])
            curvature[falls] -= 2.0 * half_curvature_change
            slope[falls] = half_slope
        return curvature, slope

    def changes_on(self, rest: Floats, moment: Floats, rest_change: Floats) -> Floats:
        """Return the derivatives of the curvature of `bend_on`, shape (parameters, n, stations).

        Parameters
        ----------
        rest, moment : as for `bend_on`
        rest_change : shape (parameters, stations), derivative of the rest (N m) by the parameters
        """
        changes = self.changes(moment)
        reverses = self._reverses(rest, moment)
        if reverses.any():
            half_change = 0.5 * (moment - rest)
            slope_drop = self.bend(rest)[1] - self.bend(half_change)[1]
            reversed_changes = self.changes(rest)[:, None, :] + 2.0 * self.changes(half_change)
            reversed_changes = reversed_changes + slope_drop * rest_change[:, None, :]
            changes = np.where(reverses, reversed_changes, changes)
        return changes

    @staticmethod
    def _reverses(rest: Floats, moment: Floats) -> Flags:
        change = moment - rest
        return np.asarray((change * rest < 0.0) & (np.abs(change) < 2.0 * np.abs(rest)))
