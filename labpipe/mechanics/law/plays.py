"""Define laws of the curvature as a function of the moment and its history.

A `PlayLaw` represents a wire whose strands stick, slip and yield one after the other. It is a
spring in series with play operators:

    kappa = M / EI0 + sum_j c_j p_j        p_j <- min(max(p_j, M - r_j), M + r_j)

On first loading p_j = max(0, M - r_j). The law is then a polygon with a corner at each half-width
r_j. After first loading beyond the smallest r_j and a reversal, no play moves until the moment
has changed by twice this r_j.
Unloading therefore starts with the stiffness EI0, loops follow Masing's rule and close, and a
residual curvature remains at zero moment. The law is rate-independent. Moments are in N m,
curvatures in 1/m.

A law may have a largest moment. Beyond it, functions of this module extrapolate with the last
slope, and iterations may therefore leave the range. `require_within` checks final moments. A
`LoadingTable` tabulates a law on first loading.
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
    """Response of a law to a change of the moment at each station.

    Parameters
    ----------
    curvature : shape (stations,), 1/m
    compliance : shape (stations,), 1/(N m^2), derivative of the curvature with respect to the
        moment at the end of the change, from within it; 1 / EI0 if the moment did not change
    history : history after the change of the moment, in the shape and unit of
        `make_unbent_history` of the law
    """

    curvature: Floats
    compliance: Floats
    history: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PlayLaw(ArrayRecord):
    """Law of plays: no stiffening on first loading, Masing loops, and residual curvature.

    Parameters
    ----------
    stiffness : EI0, N m^2, bending stiffness before any play moves
    half_widths : r_j, shape (plays,), N m, half-width of each play, positive and increasing
    compliances : c_j, shape (plays,), 1/(N m^2), compliance of each play, not negative
    largest_moment : N m, end of the range of the law; infinite for a law with unlimited range

    Raises
    ------
    ValueError
        If a parameter is outside its range, or `half_widths` and `compliances` differ in length.
    """

    stiffness: float
    half_widths: Annotated[Floats, "plays"] = field(repr=False)
    compliances: Annotated[Floats, "plays"] = field(repr=False)
    largest_moment: float = np.inf

    def __post_init__(self) -> None:
        require_positive("stiffness", self.stiffness)
        require("largest_moment", self.largest_moment, "> 0", holds=self.largest_moment > 0.0)
        ArrayRecord.__post_init__(self)
        require_rising("half_widths", self.half_widths)
        are_valid = bool(np.all((self.compliances >= 0.0) & np.isfinite(self.compliances)))
        require("compliances", self.compliances.tolist(), "finite and >= 0", holds=are_valid)

    def make_unbent_history(self, n_stations: int) -> Floats:
        """Return the history of a wire never bent before, shape (n_stations, plays), N m."""
        return np.zeros((n_stations, len(self.half_widths)))

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute curvatures, compliances and history after a change of the moments.

        Parameters
        ----------
        moment : shape (stations,), N m, after the change; each is reached monotonically
        history : shape (stations, plays), N m, history before the change

        Returns
        -------
        Response with the new history, shape (stations, plays), N m. For a moment of NaN, curvature
        and history are NaN.

        Notes
        -----
        At a corner of the polygon, the compliance excludes the play that starts to move there.
        """
        column = moment[:, None]
        plays = np.clip(history, column - self.half_widths, column + self.half_widths)
        curvature = moment / self.stiffness + plays @ self.compliances
        compliance = 1.0 / self.stiffness + (plays != history) @ self.compliances
        return Response(curvature, compliance, plays)


def make_elastic_law(stiffness: float) -> PlayLaw:
    """Build the linear elastic law kappa = M / EI from the stiffness EI, N m^2."""
    return PlayLaw(stiffness, np.zeros(0), np.zeros(0))


def find_corners(law: PlayLaw) -> tuple[Floats, Floats, Floats]:
    """Return the corners of a law on first loading; the first is the origin.

    Parameters
    ----------
    law : law of the wire

    Returns
    -------
    moment : shape (plays + 1,), N m
    curvature : shape (plays + 1,), 1/m
    compliances : shape (plays + 1,), 1/(N m^2), slope of curvature over moment beyond each corner
    """
    moment = np.append(0.0, law.half_widths)
    compliances = 1.0 / law.stiffness + np.append(0.0, np.cumsum(law.compliances))
    return moment, np.append(0.0, np.cumsum(compliances[:-1] * np.diff(moment))), compliances


def compute_first_curvature(law: PlayLaw, moment: Floats) -> Floats:
    """Return the curvature of first loading at each moment, 1/m.

    Parameters
    ----------
    law : law of the wire; beyond its largest moment, it is extrapolated linearly
    moment : shape (n,), N m, not negative
    """
    corner_moment, corner_curvature, compliances = find_corners(law)
    corner = np.searchsorted(corner_moment, moment, side="right") - 1
    return corner_curvature[corner] + compliances[corner] * (moment - corner_moment[corner])


def is_within(law: PlayLaw, moment: Floats) -> Flags:
    """Return whether each moment of either sign, N m, is within the range of a law."""
    relative_tolerance = 1e-6  # iterations may end this far beyond the largest moment
    return np.asarray(np.abs(moment) <= law.largest_moment * (1.0 + relative_tolerance))


def require_within(law: PlayLaw, moment: Floats, context: str) -> None:
    """Raise ValueError if a moment is beyond the range of a law.

    Parameters
    ----------
    law : law of the wire
    moment : shape (n,), N m, either sign
    context : description of the computation, for the message

    Raises
    ------
    ValueError
        If `is_within` is false for a moment. The message states the curvatures at the moment
        of largest magnitude and at the end of the law.
    """
    if is_within(law, moment).all():
        return
    moments = np.array([np.max(np.abs(moment)), law.largest_moment])
    curvature, end_curvature = compute_first_curvature(law, moments)
    message = (
        f"{context}: expected curvatures up to {end_curvature:.4g} 1/m, the end of the law, "
        f"found {curvature:.4g} 1/m"
    )
    raise ValueError(message)


def require(name: str, value: object, condition: str, *, holds: bool) -> None:
    """Raise ValueError unless a value meets a condition.

    Parameters
    ----------
    name : name of the value, for the message
    value : value, for the message
    condition : text of the condition, for the message, such as ``> 0``
    holds : whether the value meets the condition

    Raises
    ------
    ValueError
        If `holds` is false; the message states name, value and condition.
    """
    if not holds:
        message = f"{name}={value!r}: must be {condition}"
        raise ValueError(message)


def require_positive(name: str, value: float) -> None:
    """Raise ValueError unless a value is finite and positive; see `require`."""
    require(name, value, "finite and > 0", holds=bool(0.0 < value < np.inf))


def require_whole(name: str, value: object, minimum: int) -> None:
    """Raise ValueError unless a value is a whole number of at least `minimum`; see `require`."""
    holds = isinstance(value, int | np.integer) and bool(value >= minimum)
    require(name, value, f"a whole number >= {minimum}", holds=holds)


def require_not_negative(name: str, value: float) -> None:
    """Raise ValueError unless a value is finite and not negative; see `require`."""
    require(name, value, "finite and >= 0", holds=bool(0.0 <= value < np.inf))


def require_rising(name: str, values: Floats) -> None:
    """Raise ValueError unless values are positive and increasing; see `require`."""
    holds = bool(np.all(np.diff(values, prepend=0.0) > 0.0))
    require(name, values.tolist(), "positive and increasing", holds=holds)


def require_finite(name: str, values: Floats | float) -> None:
    """Raise ValueError unless all values are finite; see `require`."""
    require(name, np.asarray(values).tolist(), "finite", holds=bool(np.isfinite(values).all()))


def make_polygon_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Build the law whose first loading is the polygon through the origin and given points.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 1
    moment : shape (n,), N m, positive and increasing; the last is the largest moment of the law

    Raises
    ------
    ValueError
        If the moment does not increase (softening), or a slope is larger than the preceding slope
        (stiffening). The message states the curvature of a faulty corner.
    """
    # Largest increase, relative to the first slope, that is a rounding error of close corners.
    slope_tolerance = 1e-7
    slopes = np.diff(moment, prepend=0.0) / np.diff(curvature, prepend=0.0)
    if not np.all(slopes > 0.0):
        kappa = curvature[int(np.argmin(slopes > 0.0))]
        message = f"the law softens before curvature={kappa:.6g} 1/m: the moment must increase"
        raise ValueError(message)
    if np.any(np.diff(slopes) > slope_tolerance * slopes[0]):
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
    """Build a law that is linear up to a moment, and a Ramberg-Osgood curve beyond it.

    The law is a polygon with corners on
    kappa = M / EI0 + (M0 / EI1) (max(M - Ms, 0) / M0)^(1 / n).

    Parameters
    ----------
    stick_stiffness : EI0, N m^2, bending stiffness while all strands stick
    stick_moment : Ms, N m, moment up to which all strands stick, positive
    slip_stiffness : EI1, N m^2, M0 divided by the second term of the curvature at Ms + M0
    reference_moment : M0, N m, by which the moment above Ms is divided
    hardening : exponent n, between 0 (perfectly plastic) and 1 (linear), both excluded
    last_moment : N m, moment at the last point of the polygon, above Ms; the law is linear beyond
    n_plays : number of plays, at least 1

    Raises
    ------
    ValueError
        If a parameter is outside its range.
    """
    require_positive("slip_stiffness", slip_stiffness)
    require_positive("reference_moment", reference_moment)
    require("hardening", hardening, "between 0 and 1", holds=0.0 < hardening < 1.0)
    require("last_moment", last_moment, "above stick_moment", holds=last_moment > stick_moment)
    require_whole("n_plays", n_plays, 1)
    moment = stick_moment + np.linspace(0.0, 1.0, n_plays + 1) ** 2 * (last_moment - stick_moment)
    power = ((moment - stick_moment) / reference_moment) ** (1.0 / hardening)
    curvature = moment / stick_stiffness + reference_moment / slip_stiffness * power
    segment_compliances = np.diff(curvature) / np.diff(moment)
    compliances = np.diff(segment_compliances, prepend=1.0 / stick_stiffness)
    return PlayLaw(stick_stiffness, moment[:-1], np.maximum(compliances, 0.0))


CurvatureAndCompliance: TypeAlias = tuple[Floats, Floats]
"""Curvature, 1/m, and its derivative with respect to the moment, 1/(N m^2)."""


@dataclass(frozen=True, eq=False)
class LoadingTable:
    """Table of a law on first loading, a cubic Hermite spline between knots and linear beyond.

    Parameters
    ----------
    moment : shape (knots,), N m, from zero, increasing
    curvature : shape (knots,), 1/m
    start_compliance, end_compliance : shape (knots - 1,), 1/(N m^2), derivative of the curvature
        with respect to the moment, at the start and at the end of each interval between knots. The
        two values at a knot may differ
    start_sensitivity, end_sensitivity : shape (parameters, knots - 1), 1/m, derivative of the
        curvature at constant moment with respect to the logarithm of each parameter, at the start
        and at the end of each interval between knots. Sensitivities are linear in between
    """

    moment: Floats
    curvature: Floats
    start_compliance: Floats
    end_compliance: Floats
    start_sensitivity: Floats
    end_sensitivity: Floats

    @classmethod
    def of_plays(cls, law: PlayLaw) -> LoadingTable:
        """Tabulate a `PlayLaw`; the table is exact, because the law is linear between corners."""
        moment, curvature, compliances = find_corners(law)
        # The width of the last interval is arbitrary: the law is linear beyond the last corner.
        step = moment[-1] or law.stiffness
        moment = np.append(moment, moment[-1] + step)
        curvature = np.append(curvature, curvature[-1] + compliances[-1] * step)
        no_sensitivity = np.zeros((0, len(compliances)))
        return cls(moment, curvature, compliances, compliances, no_sensitivity, no_sensitivity)

    @cached_property
    def curve(self) -> PPoly:
        """Piecewise polynomial of curvature, compliance and sensitivities over |moment|."""
        width, start, end = np.diff(self.moment), self.start_compliance, self.end_compliance
        chord = np.diff(self.curvature) / width
        cubic = (start + end - 2.0 * chord) / width**2
        square = (3.0 * chord - 2.0 * start - end) / width
        # Axes: power from 3 to 0, interval (the last is beyond the last knot), value.
        coefficients = np.zeros((4, len(width) + 1, 2 + len(self.start_sensitivity)))
        coefficients[:, :-1, 0] = cubic, square, start, self.curvature[:-1]
        coefficients[2:, -1, 0] = end[-1], self.curvature[-1]
        coefficients[1:, :, 1] = np.array([[3.0], [2.0], [1.0]]) * coefficients[:3, :, 0]
        coefficients[2, :-1, 2:] = ((self.end_sensitivity - self.start_sensitivity) / width).T
        coefficients[3, :-1, 2:] = self.start_sensitivity.T
        coefficients[3, -1, 2:] = self.end_sensitivity[:, -1]
        return PPoly(coefficients, np.append(self.moment, 2.0 * self.moment[-1]))

    def bend(self, moment: Floats) -> CurvatureAndCompliance:
        """Return curvature and compliance of first loading at moments, N m, any shape and sign."""
        values = self.curve(np.abs(moment))
        return np.sign(moment) * values[..., 0], values[..., 1]

    def compute_sensitivities(self, moment: Floats) -> Floats:
        """Return the sensitivities of the curvature of `bend`, 1/m.

        They are derivatives with respect to the logarithm of each parameter. Axis 0 is the
        parameter.
        """
        sensitivities = np.moveaxis(self.curve(np.abs(moment))[..., 2:], -1, 0)
        return np.asarray(np.sign(moment) * sensitivities, dtype=np.float64)

    def bend_from_rest(self, rest_moment: Floats, moment: Floats) -> CurvatureAndCompliance:
        """Return curvature and compliance after bending from rest.

        Parameters
        ----------
        rest_moment : shape (stations,), N m, moment at rest, reached by first loading
        moment : shape (n, stations), N m; each moment is reached monotonically

        Notes
        -----
        By Masing's rule, the curvature after a reversal at the moment Mr at rest is
        k(Mr) + 2 k((M - Mr) / 2) until the moment is -Mr, and k(M) beyond. k is the law of first
        loading.
        """
        curvature, compliance = self.bend(moment)
        is_reversed = self._is_reversed(rest_moment, moment)
        if is_reversed.any():
            half_change = 0.5 * (moment - rest_moment)[is_reversed]
            half_curvature_change, reversed_compliance = self.bend(half_change)
            rest_curvature = np.broadcast_to(self.bend(rest_moment)[0], moment.shape)[is_reversed]
            curvature[is_reversed] = rest_curvature + 2.0 * half_curvature_change
            compliance[is_reversed] = reversed_compliance
        return curvature, compliance

    def bend_from_peak(
        self, rest_moment: Floats, peak_moment: Floats, moment: Floats
    ) -> CurvatureAndCompliance:
        """Return curvature and compliance after loading from rest to a peak and unloading.

        Parameters
        ----------
        rest_moment : as for `bend_from_rest`
        peak_moment : shape (n, stations), N m, largest moment so far
        moment : shape (n, stations), N m, current moment, not above `peak_moment`
        """
        curvature, compliance = self.bend_from_rest(rest_moment, peak_moment)
        is_unloaded = moment < peak_moment
        if is_unloaded.any():
            half_change = 0.5 * (peak_moment - moment)[is_unloaded]
            half_curvature_change, compliance[is_unloaded] = self.bend(half_change)
            curvature[is_unloaded] -= 2.0 * half_curvature_change
        return curvature, compliance

    def compute_sensitivities_from_rest(
        self, rest_moment: Floats, moment: Floats, rest_sensitivity: Floats
    ) -> Floats:
        """Return the sensitivities of the curvature of `bend_from_rest`.

        Parameters
        ----------
        rest_moment, moment : as for `bend_from_rest`
        rest_sensitivity : shape (parameters, stations), N m, derivative of `rest_moment` with
            respect to the logarithm of each parameter

        Returns
        -------
        Derivatives of the curvature with respect to the logarithm of each parameter, shape
        (parameters, n, stations), 1/m.
        """
        sensitivities = self.compute_sensitivities(moment)
        is_reversed = self._is_reversed(rest_moment, moment)
        if is_reversed.any():
            half_change = 0.5 * (moment - rest_moment)
            compliance_difference = self.bend(rest_moment)[1] - self.bend(half_change)[1]
            half_sensitivities = self.compute_sensitivities(half_change)
            reversed_part = self.compute_sensitivities(rest_moment)[:, None, :]
            reversed_part = reversed_part + 2.0 * half_sensitivities
            reversed_part = reversed_part + compliance_difference * rest_sensitivity[:, None, :]
            sensitivities = np.where(is_reversed, reversed_part, sensitivities)
        return sensitivities

    @staticmethod
    def _is_reversed(rest_moment: Floats, moment: Floats) -> Flags:
        """Return whether the moment has reversed and is not yet beyond -rest_moment."""
        change = moment - rest_moment
        is_opposite = change * rest_moment < 0.0
        return np.asarray(is_opposite & (np.abs(change) < 2.0 * np.abs(rest_moment)))
