"""Moment-curvature laws, explicit in curvature as a function of moment and of its history.

Every law here is a spring in series with play operators (PHYSICS 4: strands that stick, slip and
yield do so one after the other):

    kappa = M / EI0 + sum_j c_j p_j        p_j <- min(max(p_j, M - r_j), M + r_j)

On first loading p_j = max(0, M - r_j), so the law is a polygon with a corner at each half-width
r_j; after a reversal no play moves until the moment has changed by twice the smallest r_j, so
unloading starts with EI0, loops follow Masing's rule and close, and residual curvature remains at
zero moment. The law is rate-independent. Moments are in N m, curvatures in 1/m.

A law may end at a moment. Functions here do not stop there, so that a search may pass it; results
are checked by `require_within`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats


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


class MomentLaw(Protocol):
    """A moment-curvature law with memory; one law serves all stations along a wire."""

    @property
    def stiffness(self) -> float:
        """Return the bending stiffness EI0 of the first, elastic response, N m^2."""

    @property
    def half_widths(self) -> Floats:
        """Return the half-widths r_j of the plays, N m, shape (plays,), increasing."""

    @property
    def compliances(self) -> Floats:
        """Return the compliances c_j of the plays when they move, 1/(N m^2), shape (plays,)."""

    @property
    def largest_moment(self) -> float:
        """Return the end of the law, N m, either sign; may be infinite."""


@dataclass(frozen=True, slots=True)
class LinearLaw:
    """Constant bending stiffness: kappa = M / EI, no memory.

    Parameters
    ----------
    stiffness : EI, N m^2
    """

    stiffness: float

    def __post_init__(self) -> None:
        require_positive("stiffness", self.stiffness)

    @property
    def largest_moment(self) -> float:
        """Return infinity."""
        return np.inf

    @property
    def half_widths(self) -> Floats:
        """Return an empty array: there are no plays."""
        return np.zeros(0)

    @property
    def compliances(self) -> Floats:
        """Return an empty array: there are no plays."""
        return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class PlayLaw(ArrayRecord):
    """Many plays: any concave first-loading law, with Masing loops and residual curvature.

    Parameters
    ----------
    stiffness : EI0, N m^2
    half_widths : shape (plays,), N m, positive and increasing
    compliances : shape (plays,), 1/(N m^2), none negative
    largest_moment : N m, end of the range of the law

    Raises
    ------
    ValueError
        If a number is out of its range, or the law would soften.
    """

    stiffness: float
    half_widths: Annotated[Floats, "plays"] = field(repr=False)
    compliances: Annotated[Floats, "plays"] = field(repr=False)
    largest_moment: float = np.inf

    def __post_init__(self) -> None:
        require_positive("stiffness", self.stiffness)
        if not self.largest_moment > 0.0:
            message = f"largest_moment={self.largest_moment!r}: must be > 0"
            raise ValueError(message)
        ArrayRecord.__post_init__(self)
        widths, compliances = self.half_widths, self.compliances
        if widths.size and not (widths[0] > 0.0 and np.all(np.diff(widths) > 0.0)):
            message = f"half_widths={widths}: must be positive and increasing"
            raise ValueError(message)
        if not (np.all(np.isfinite(compliances)) and np.all(compliances >= 0.0)):
            message = f"compliances={compliances}: must be finite and >= 0"
            raise ValueError(message)


def unbent_plays(law: MomentLaw, n_stations: int) -> Floats:
    """Return the history of a wire that was never bent, shape (n_stations, plays), N m."""
    return np.zeros((n_stations, len(law.half_widths)))


def respond(law: MomentLaw, moment: Floats, plays: Floats) -> Response:
    """Compute curvatures under new moments, from the history.

    Parameters
    ----------
    law : the law of every station
    moment : shape (stations,), N m; each is reached monotonically
    plays : shape (stations, plays), N m, history before the step

    Returns
    -------
    Curvature, compliance and the new history. NaN in gives NaN out.

    Notes
    -----
    The compliance at a corner of the polygon is that of the play at rest.
    """
    column = moment[:, None]
    moved = np.minimum(np.maximum(plays, column - law.half_widths), column + law.half_widths)
    flowing = moved != plays
    curvature = moment / law.stiffness + moved @ law.compliances
    compliance = 1.0 / law.stiffness + flowing @ law.compliances
    return Response(curvature, compliance, moved)


def corners_of(law: MomentLaw) -> tuple[Floats, Floats, Floats]:
    """Return the corners of a law on first loading, from zero, each of shape (plays + 1,).

    Parameters
    ----------
    law : the law

    Returns
    -------
    Moments, N m; curvatures, 1/m; d(curvature) / d(moment) behind each, 1/(N m^2).
    """
    moment = np.append(0.0, law.half_widths)
    slopes = 1.0 / law.stiffness + np.append(0.0, np.cumsum(law.compliances))
    return moment, np.append(0.0, np.cumsum(slopes[:-1] * np.diff(moment))), slopes


def first_curvature(law: MomentLaw, moment: Floats) -> Floats:
    """Return the curvature of first loading at moments, 1/m.

    Parameters
    ----------
    law : the law; beyond its end the last slope is taken
    moment : shape (n,), N m, not negative
    """
    corner, reached, slopes = corners_of(law)
    last = np.searchsorted(corner, moment, side="right") - 1
    return np.asarray(reached[last] + slopes[last] * (moment - corner[last]))


def is_within(law: MomentLaw, moment: float) -> bool:
    """Return whether a law covers a moment, N m, either sign, within rounding."""
    rounding_share = 1e-6  # of the last moment, to which a moment is searched
    return bool(abs(moment) <= law.largest_moment * (1.0 + rounding_share))


def require_within(law: MomentLaw, moment: Floats, what: str) -> None:
    """Refuse moments beyond the end of a law.

    Parameters
    ----------
    law : the law
    moment : shape (n,), N m
    what : place, for the message

    Raises
    ------
    ValueError
        With the curvatures of the wire and of the end of the law.
    """
    largest = float(np.max(np.abs(moment), initial=0.0))
    if is_within(law, largest):
        return
    bent, last = first_curvature(law, np.array([largest, law.largest_moment]))
    message = (
        f"{what}: expected curvatures up to {last:.4g} 1/m, the end of the law, "
        f"found {bent:.4g} 1/m"
    )
    raise ValueError(message)


def require_positive(name: str, value: float) -> None:
    """Refuse a number that is not finite and positive.

    Raises
    ------
    ValueError
        With the name, the value and what is allowed.
    """
    if not (np.isfinite(value) and value > 0.0):
        message = f"{name}={value!r}: must be finite and > 0"
        raise ValueError(message)


def require_not_negative(name: str, value: float) -> None:
    """Refuse a number that is not finite, or negative.

    Raises
    ------
    ValueError
        With the name, the value and what is allowed.
    """
    if not (np.isfinite(value) and value >= 0.0):
        message = f"{name}={value!r}: must be finite and >= 0"
        raise ValueError(message)


def require_finite(name: str, values: Floats | float) -> None:
    """Refuse numbers that are NaN or infinite.

    Raises
    ------
    ValueError
        With the name, the values and what is allowed.
    """
    if not np.all(np.isfinite(values)):
        message = f"{name}={np.asarray(values).tolist()}: must be finite"
        raise ValueError(message)
