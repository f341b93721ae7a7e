"""What every deck has of its wire: facts and range, names."""

from __future__ import annotations

import re
import unicodedata
import zlib

import numpy as np

from labpipe import __version__
from labpipe.law.plays import require_positive
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

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
    limit = table.doubtful_curvature
    strain = 100.0 * table.spec.insulation_strain
    doubt = f"Doubtful beyond {limit:.6g} 1/m: the insulation is strained by over {strain:.3g} %."
    return (
        f"Wire {name}, made by labpipe {__version__}.",
        UNITS,
        f"Range: curvature from 0 to {end:.6g} 1/m (bending radius {1.0 / end:.4g} m and more).",
        "Beyond this range the deck is not valid.",
        *((doubt,) if limit < end else ()),
        FIRST_LOADING,
    )


def mass_of(table: WireTable) -> float:
    """Mass per length of a wire, kg/m, for a deck that needs one.

    Parameters
    ----------
    table : of the wire

    Raises
    ------
    ValueError
        If it is not a positive number.
    """
    require_positive("mass_per_length", table.mass_per_length)
    return table.mass_per_length


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
