"""Facts, range and names of a wire for the head of every deck."""

from __future__ import annotations

import re
import unicodedata
import zlib

import numpy as np

from labpipe import __version__
from labpipe.law.plays import require_positive
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

FIRST_LOADING = "The law is that of the first loading of a wire that was never bent before."


def facts(table: WireTable, name: str) -> tuple[str, ...]:
    """Return the sentences at the head of every deck.

    Parameters
    ----------
    table : law of the wire
    name : of the wire, as the deck may write it
    """
    end = float(table.curvature[-1])
    limit = table.doubtful_curvature
    strain = 100.0 * table.spec.insulation_strain
    doubt = f"Doubtful beyond {limit:.6g} 1/m: insulation strain above {strain:.3g} %."
    return (
        f"Wire {name}, made by labpipe {__version__}.",
        "Units: m, N, kg, s, rad; curvature and twist 1/m, moment N m, stiffness N m^2.",
        f"Range: curvature from 0 to {end:.6g} 1/m (bend radius {1.0 / end:.4g} m and more).",
        "The deck is not valid beyond this range.",
        *((doubt,) if limit < end else ()),
        FIRST_LOADING,
    )


def mass_of(table: WireTable) -> float:
    """Return the mass per length of a wire, kg/m, for a deck that needs one.

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
    """Find the range of curvature in which a constant stiffness represents the law.

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
    max_moment_error = 0.05  # relative
    knots = np.union1d(
        table.curvature,
        np.concatenate(
            [
                _crossings(table, stiffness, 1.0 + off)
                for off in (-max_moment_error, max_moment_error)
            ]
        ),
    )
    middle = 0.5 * (knots[1:] + knots[:-1])
    moment = np.interp(middle, table.curvature, table.moment)
    inside = np.abs(stiffness * middle / moment - 1.0) <= max_moment_error
    if not inside.any():
        return None
    first = int(np.argmax(inside))
    leaves = np.flatnonzero(~inside[first:])
    last = first + int(leaves[0]) if len(leaves) else len(inside)
    return float(knots[first]), float(knots[last])


def _crossings(table: WireTable, stiffness: float, ratio: float) -> Floats:
    """Find curvatures between the points where linear moment over law moment is `ratio`."""
    first, second = table.curvature[:-1], table.curvature[1:]
    slope = np.diff(table.moment) / np.diff(table.curvature)
    slope_difference = stiffness - ratio * slope
    start = ratio * (table.moment[:-1] - slope * first)
    crossing = start / np.where(slope_difference == 0.0, np.inf, slope_difference)
    return crossing[(crossing > first) & (crossing < second)]


def skew_bending_error(table: WireTable) -> float:
    """Return how much too stiff skew bending is where the two axes are uncoupled.

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
    """Return the area of strands and insulation across the wire, m^2."""
    layout = table.layout
    tube = np.pi * (layout.wire_radius**2 - layout.bore_radius**2)
    return float(np.sum(np.pi / 4.0 * layout.diameter**2) + tube)


def second_moment(table: WireTable) -> float:
    """Return the second moment of that area, m^4: the mean over all axes through the centre."""
    layout = table.layout
    tube = np.pi / 4.0 * (layout.wire_radius**4 - layout.bore_radius**4)
    area = np.pi / 4.0 * layout.diameter**2
    arms = 0.5 * (layout.x**2 + layout.y**2)
    return float(np.sum(np.pi / 64.0 * layout.diameter**4 + area * arms) + tube)


def abaqus_label(name: str) -> str:
    """Return the label of an element set: begins with a letter, then letters, digits, ``_``, ``-``.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is a label already. Otherwise its allowed characters with a checksum of the name,
    so that different names have different labels.

    Notes
    -----
    Abaqus ignores the case of labels without quotes: names of wires must differ in more than case.

    Examples
    --------
    >>> abaqus_label("FLRY-B_0.35")
    'FLRY-B_0_35_f1a89d0a'
    """
    return _allowed_text(name, allowed="A-Za-z0-9_-", first="A-Za-z", max_length=80)


def ansys_name(name: str) -> str:
    """Return the name of a section: at most eight letters and digits, the first a letter.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is allowed, otherwise its allowed characters. Sections are identified by their
    number, so that the name need not be unique.

    Examples
    --------
    >>> ansys_name("FLRY-B 0.35")
    'FLRYB035'
    """
    remainder = re.sub(r"[^A-Za-z0-9]", "", _without_accents(name))
    return (remainder if remainder[:1].isalpha() else f"W{remainder}")[:8]


def file_stem(name: str) -> str:
    """Return the name of a file without its ending, for every common file system.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is allowed, otherwise its allowed characters with a checksum of the name.

    Examples
    --------
    >>> file_stem("A2")
    'A2'
    """
    max_length = 100
    stem = _allowed_text(name, allowed="A-Za-z0-9._ +-", first="A-Za-z0-9", max_length=max_length)
    is_device = re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", stem, flags=re.IGNORECASE)
    return (
        _with_checksum(name, stem, max_length) if is_device or stem != stem.rstrip(". ") else stem
    )


def on_one_line(name: str, max_length: int = 100) -> str:
    """Convert a name for a comment: printable ASCII on one line, shortened with dots.

    Parameters
    ----------
    name : of the wire, any text
    max_length : characters, at least 4

    Examples
    --------
    >>> on_one_line("a name that goes on and on", 12)
    'a name th...'
    """
    line = re.sub(r"[^ -~]+", "?", _without_accents(" ".join(name.split())))
    return line if len(line) <= max_length else line[: max_length - 3] + "..."


def _allowed_text(name: str, *, allowed: str, first: str, max_length: int) -> str:
    label = re.sub(rf"[^{allowed}]+", "_", _without_accents(name))
    if not re.match(f"[{first}]", label):
        label = f"W{label}"
    return (
        label
        if label == name and len(label) <= max_length
        else _with_checksum(name, label, max_length)
    )


def _with_checksum(name: str, label: str, max_length: int) -> str:
    digits = 8  # hexadecimal
    checksum = f"{zlib.crc32(name.encode('utf-8', 'surrogatepass')):0{digits}x}"
    return f"{label[: max_length - digits - 1].rstrip('. ')}_{checksum}"


def _without_accents(name: str) -> str:
    """Replace letters with accents by those without, where there are such."""
    parts = unicodedata.normalize("NFKD", name)
    return "".join(part for part in parts if not unicodedata.combining(part))
