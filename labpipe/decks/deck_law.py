"""What every deck has of its wire: few points of the law, facts and range, names."""

from __future__ import annotations

import re
import unicodedata
import zlib
from dataclasses import dataclass

import numpy as np

from labpipe import __version__
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector
from labpipe.records.wire import WireTable

_CORNER = 1e-6  # of a slope: what a later slope must at least be below the one before
_ENOUGH = 1e-6  # of the tolerance: where halving it ends
_FIRST_CUT = 0.1  # of the tolerance, until one is found that is too small


@dataclass(frozen=True, slots=True, eq=False)
class Thinned(ArrayRecord):
    """Points of a moment-curvature law, the slope between them always falling.

    Parameters
    ----------
    curvature : shape (points,), 1/m, from 0 to the end of the range
    moment : shape (points,), N m
    error : largest distance, at any curvature of the range, of the straight lines between these
        points from those between the points that they were chosen from, as a share of the moment
        there
    """

    curvature: Vector
    moment: Vector
    error: float


def thin(curvature: Floats, moment: Floats, *, most: int) -> Thinned:
    """Choose at most so many points of a law, zero and the end included.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing; n >= 2
    moment : shape (n,), N m, from 0, increasing
    most : points, at least 2

    Returns
    -------
    The points. Each slope is below the one before by at least a millionth: programs that take the
    first slope as the elastic one ask for it.

    Raises
    ------
    ValueError
        If fewer than two points are asked for or given; if a value is NaN or not finite; if the
        law does not begin at zero; if it softens (the message says the curvature).

    Notes
    -----
    The error relative to the moment is a quotient of straight lines between neighbouring points of
    the law, so that it is largest at one of these points: it need not be looked for between them.

    Chosen from are the corners of the concave hull (Andrew's monotone chain). On a concave polygon
    the error between two corners grows with their distance, so that going as far as a tolerance
    lets one needs the fewest points (Imai and Iri 1986), and the tolerance is halved until as many
    are left as asked for. For a law that never stiffens no other choice has a smaller error; what a
    law that stiffens loses to its hull is in the error that is stated.

    References
    ----------
    H. Imai and M. Iri, Computational-geometric methods for polygonal approximations of a curve,
    Computer Vision, Graphics, and Image Processing 36 (1986) 31-41.
    A. M. Andrew, Another efficient algorithm for convex hulls in two dimensions, Information
    Processing Letters 9 (1979) 216-219.
    """
    _require_law(curvature, moment, most)
    corners = _hull(curvature.tolist(), moment.tolist())  # plain numbers are faster one by one
    x, y = curvature[corners], moment[corners]
    chosen = np.arange(len(x)) if len(x) <= most else _fewest_error(x, y, most)
    return Thinned(x[chosen], y[chosen], _error(x[chosen], y[chosen], curvature, moment))


def _require_law(curvature: Floats, moment: Floats, most: int) -> None:
    if most < 2:
        message = f"most={most}: allowed are numbers of points >= 2"
        raise ValueError(message)
    if len(curvature) < 2 or len(moment) != len(curvature):
        message = (
            f"{len(curvature)} curvatures and {len(moment)} moments: allowed are as many of both, "
            f"at least 2"
        )
        raise ValueError(message)
    finite = np.all(np.isfinite(curvature)) and np.all(np.isfinite(moment))
    if not finite or curvature[0] != 0.0 or moment[0] != 0.0 or np.any(np.diff(curvature) <= 0.0):
        message = "the law does not go from zero: allowed are finite, increasing curvatures from 0"
        raise ValueError(message)
    if np.any(np.diff(moment) <= 0.0):
        at = curvature[int(np.argmax(np.diff(moment) <= 0.0)) + 1]
        message = f"the law softens before curvature={at:.6g} 1/m: allowed is a moment that grows"
        raise ValueError(message)


def _hull(x: list[float], y: list[float]) -> Ints:
    """Corners of the concave hull, the two ends included."""
    kept: list[int] = [0]
    for new in range(1, len(x)):
        while len(kept) > 1:
            before, last = kept[-2], kept[-1]
            arrives = (y[last] - y[before]) / (x[last] - x[before])
            leaves = (y[new] - y[last]) / (x[new] - x[last])
            if leaves < arrives * (1.0 - _CORNER):
                break
            kept.pop()
        kept.append(new)
    return np.array(kept, dtype=np.int64)


def _fewest_error(x: Floats, y: Floats, most: int) -> Ints:
    """Among the choices of at most so many corners, the one with the smallest error."""
    best = np.array([0, len(x) - 1])
    low, high = 0.0, _error(x[best], y[best], x, y)
    plain_x, plain_y = x.tolist(), y.tolist()
    while high - low > _ENOUGH * high:
        middle = 0.5 * (low + high) if low > 0.0 else _FIRST_CUT * high
        found = _as_far_as_allowed(plain_x, plain_y, middle, most)
        if len(found) > most:
            low = middle
        else:
            best = np.array(found)
            high = min(middle, _error(x[best], y[best], x, y))
    return best


def _as_far_as_allowed(x: list[float], y: list[float], tolerance: float, most: int) -> list[int]:
    """Go from corner to corner as far as the tolerance lets one; end with one too many."""
    chosen, steepest = [0], -np.inf
    for new in range(1, len(x)):
        at = chosen[-1]
        # a chord passes below the corners it skips: it must be as steep as each of them asks for
        if y[new] - y[at] < steepest * (x[new] - x[at]):
            at, steepest = new - 1, -np.inf
            chosen.append(at)
            if len(chosen) == most:
                break
        slope = ((1.0 - tolerance) * y[new] - y[at]) / (x[new] - x[at])
        steepest = slope if slope > steepest else steepest  # `max` takes as long as all the rest
    return [*chosen, len(x) - 1]


def _error(x: Floats, y: Floats, curvature: Floats, moment: Floats) -> float:
    """Largest distance at the points of the law, as a share of the moment there."""
    lines = np.interp(curvature[1:], x, y)
    return float(np.max(np.abs(lines / moment[1:] - 1.0)))


UNITS = "Units: m, N, kg, s, rad; curvature and twist 1/m, moment N m, stiffness N m^2."
FIRST_LOADING = "The law is that of the first loading of a wire that was never bent before."


_NEAR = 0.05  # of the moment, within which a linear law is as good as the wire's


def facts(table: WireTable, name: str) -> tuple[str, ...]:
    """Sentences at the head of every deck.

    Parameters
    ----------
    table : law of the wire
    name : of the wire, as the deck may write it
    """
    end = float(table.curvature[-1])
    return (
        f"Wire {name}, made by labpipe {__version__}.",
        UNITS,
        f"Range: curvature from 0 to {end:.6g} 1/m (bending radius {1.0 / end:.4g} m and more).",
        "Beyond this range the deck is not valid.",
        FIRST_LOADING,
    )


def linear_range(table: WireTable, stiffness: float) -> tuple[float, float] | None:
    """Curvatures between which a constant stiffness is as good as the wire's law.

    Parameters
    ----------
    table : law of the wire
    stiffness : N m^2, of the linear law

    Returns
    -------
    From and to, 1/m: the first stretch on which the two are within 5 % of the wire's moment of each
    other. None if there is none within the table.

    Notes
    -----
    Between two points the moment is on a straight line a + b kappa, so that stiffness kappa =
    (1 -+ 0.05) (a + b kappa) is solved there.
    """
    knots = np.union1d(
        table.curvature,
        np.concatenate([_meets(table, stiffness, 1.0 + off) for off in (-_NEAR, _NEAR)]),
    )
    middle = 0.5 * (knots[1:] + knots[:-1])
    moment = np.interp(middle, table.curvature, table.moment)
    inside = np.abs(stiffness * middle / moment - 1.0) <= _NEAR
    if not inside.any():
        return None
    first = int(np.argmax(inside))
    leaves = np.flatnonzero(~inside[first:])
    last = first + int(leaves[0]) if len(leaves) else len(inside)
    return float(knots[first]), float(knots[last])


def _meets(table: WireTable, stiffness: float, bound: float) -> Floats:
    """Curvatures, beside the points, at which the linear moment is so many times the wire's."""
    left, right = table.curvature[:-1], table.curvature[1:]
    slope = np.diff(table.moment) / np.diff(table.curvature)
    apart = stiffness - bound * slope
    start = bound * (table.moment[:-1] - slope * left)
    at = start / np.where(apart == 0.0, np.inf, apart)
    return at[(at > left) & (at < right)]


def skew_excess(table: WireTable) -> float:
    """By how much bending askew comes out too stiff where the two axes do not know of each other.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    The largest share, over the range, by which the moment of two laws at 45 degrees is above that
    of one: sqrt(2) M(kappa / sqrt(2)) / M(kappa) - 1.
    """
    kappa = table.curvature[1:]
    part = np.interp(kappa / np.sqrt(2.0), table.curvature, table.moment)
    return float(np.max(np.sqrt(2.0) * part / table.moment[1:] - 1.0))


def solid_area(table: WireTable) -> float:
    """Area of the strands and the insulation across the wire, m^2."""
    layout = table.layout
    tube = np.pi * (layout.wire_radius**2 - layout.bore_radius**2)
    return float(np.sum(np.pi / 4.0 * layout.diameter**2) + tube)


def second_moment(table: WireTable) -> float:
    """Second moment of that area, the mean over all axes through the middle, m^4."""
    layout = table.layout
    tube = np.pi / 4.0 * (layout.wire_radius**4 - layout.bore_radius**4)
    area = np.pi / 4.0 * layout.diameter**2
    arms = 0.5 * (layout.x**2 + layout.y**2)
    return float(np.sum(np.pi / 64.0 * layout.diameter**4 + area * arms) + tube)


ABAQUS_MOST = 80
"""Characters of an Abaqus label (Abaqus Analysis User's Guide, input syntax rules)."""
ANSYS_MOST = 8
"""Characters of the name of an Ansys section (``SECTYPE``)."""
COMMENT_MOST = 32
"""Characters of a wire's name in a comment of an Ansys deck."""
FILE_MOST = 100
"""Characters of a file's name without its ending."""

_SUM = 8  # hexadecimal digits of the check sum


def abaqus_label(name: str) -> str:
    """Label of an element set: begins with a letter, then letters, digits, ``_``, ``-``.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is a label already. Else what is left of it, with a check sum of the name, so
    that labels of different names stay different.

    Notes
    -----
    Abaqus takes labels without quotes in any case for the same: wires whose names differ in nothing
    else need names of their own.

    Examples
    --------
    >>> abaqus_label("FLRY-B_0.35")
    'FLRY-B_0_35_f1a89d0a'
    """
    return _reduced(name, allowed="A-Za-z0-9_-", first="A-Za-z", most=ABAQUS_MOST)


def ansys_name(name: str) -> str:
    """Name of a section: at most eight letters and digits, the first a letter.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it will do, else what is left of it. It only labels: sections go by their number,
    so that it need not be the only one of its kind.

    Examples
    --------
    >>> ansys_name("FLRY-B 0.35")
    'FLRYB035'
    """
    left = re.sub(r"[^A-Za-z0-9]", "", _plain(name))
    return (left if left[:1].isalpha() else f"W{left}")[:ANSYS_MOST]


def file_stem(name: str) -> str:
    """Name of a file without its ending, for every common file system.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it will do, else what is left of it with a check sum of the name.

    Examples
    --------
    >>> file_stem("A2")
    'A2'
    """
    kept = _reduced(name, allowed="A-Za-z0-9._ +-", first="A-Za-z0-9", most=FILE_MOST)
    is_device = re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", kept, flags=re.IGNORECASE)
    return _summed(name, kept, FILE_MOST) if is_device or kept != kept.rstrip(". ") else kept


def on_one_line(name: str, most: int) -> str:
    """A name for a comment: printable ASCII on one line, cut short with dots.

    Parameters
    ----------
    name : of the wire, any text
    most : characters, at least 4

    Examples
    --------
    >>> on_one_line("a name that goes on and on", 12)
    'a name th...'
    """
    line = re.sub(r"[^ -~]+", "?", _plain(" ".join(name.split())))
    return line if len(line) <= most else line[: most - 3] + "..."


def _reduced(name: str, *, allowed: str, first: str, most: int) -> str:
    kept = re.sub(rf"[^{allowed}]+", "_", _plain(name))
    if not re.match(f"[{first}]", kept):
        kept = f"W{kept}"
    return kept if kept == name and len(kept) <= most else _summed(name, kept, most)


def _summed(name: str, kept: str, most: int) -> str:
    total = f"{zlib.crc32(name.encode('utf-8', 'surrogatepass')):0{_SUM}x}"
    return f"{kept[: most - _SUM - 1].rstrip('. ')}_{total}"


def _plain(name: str) -> str:
    """Letters without their accents, as far as there are such."""
    parts = unicodedata.normalize("NFKD", name)
    return "".join(part for part in parts if not unicodedata.combining(part))
