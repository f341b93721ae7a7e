"""Templates of decks, and facts, range and names of a wire for the head of every deck."""

from __future__ import annotations

import re
import textwrap
import unicodedata
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe import __version__
from labpipe.mechanics.decks.unloading import (
    Release,
    collect_unloading_numbers,
    describe_unloading,
)
from labpipe.mechanics.law.loss_card import LossCard, TurnLoss, compute_turn_loss, make_table_card
from labpipe.mechanics.law.plays import require_positive
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

if TYPE_CHECKING:
    from jinja2 import Environment

FIRST_LOADING_TEXT = "The law is that of the first loading of a wire that was never bent before."


@cache
def _load_templates() -> Environment:
    """Return the templates of decks with their filters."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # decks are no pages; names pass `quoteattr`
    )
    filters = {
        "attribute": quoteattr,
        "comments": _write_xml_comments,
        "g": _format_numbers,
        "lines": lambda lines, prefix: "\n".join(f"{prefix}{line}" for line in lines),
        "shorten": shorten_name,
    }
    environment.filters.update(filters)
    return environment


def fill_template(name: str, /, **facts: object) -> str:
    """Fill the template of a deck.

    Parameters
    ----------
    name : of the file in ``templates``
    facts : values of all names in the template
    """
    return _load_templates().get_template(name).render(facts)


def _format_numbers(values: Floats | float, digits: int = 7) -> str:
    """Return numbers of any shape with significant digits, separated by blanks."""
    return " ".join(f"{value:.{digits}g}" for value in np.ravel(values).tolist())


def _write_xml_comments(lines: Iterable[str]) -> str:
    """Return XML comments, in which two hyphens are not allowed."""
    return "\n".join(f"  <!-- {line.replace('--', '- -')} -->" for line in lines)


def list_facts(table: WireTable, max_length: int = 100) -> tuple[str, ...]:
    """Return the sentences at the head of every deck.

    Parameters
    ----------
    table : law of the wire
    max_length : characters of the name of the wire
    """
    end = float(table.curvature[-1])
    limit = table.doubtful_curvature
    strain = 100.0 * table.spec.insulation_strain
    doubt = f"Doubtful beyond {limit:.6g} 1/m: insulation strain above {strain:.3g} %."
    return (
        f"Wire {shorten_name(table.name, max_length)}, made by labpipe {__version__}.",
        "Units: m, N, kg, s, rad; curvature and twist 1/m, moment N m, stiffness N m^2.",
        f"Range: curvature from 0 to {end:.6g} 1/m (bend radius {1.0 / end:.4g} m and more).",
        "The deck is not valid beyond this range.",
        *((doubt,) if limit < end else ()),
        FIRST_LOADING_TEXT,
    )


def find_mass(table: WireTable) -> float:
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


def compute_first_frequency(stiffness: float, mass_per_length: float, length: float) -> float:
    """Return the first angular frequency of a clamped wire, rad/s.

    Parameters
    ----------
    stiffness : of bending, N m^2
    mass_per_length, length : kg/m, m
    """
    first_root = 1.8751040687119611  # of cos x cosh x = -1: first mode of a cantilever
    return float(first_root**2 * np.sqrt(stiffness / mass_per_length) / length**2)


def find_linear_range(table: WireTable, stiffness: float) -> tuple[float, float] | None:
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
    limits = (1.0 - max_moment_error, 1.0 + max_moment_error)
    crossings = [_crossings(table, stiffness, limit) for limit in limits]
    knots = np.unique(np.concatenate([table.curvature, *crossings]))
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


def compute_skew_bending_error(table: WireTable) -> float:
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


def compute_solid_area(table: WireTable) -> float:
    """Return the area of strands and insulation across the wire, m^2."""
    layout = table.layout
    tube = np.pi * (layout.wire_radius**2 - layout.bore_radius**2)
    return float(np.sum(np.pi / 4.0 * layout.diameter**2) + tube)


def compute_second_moment(table: WireTable) -> float:
    """Return the second moment of that area, m^4: the mean over all axes through the centre."""
    layout = table.layout
    tube = np.pi / 4.0 * (layout.wire_radius**4 - layout.bore_radius**4)
    area = np.pi / 4.0 * layout.diameter**2
    arms = 0.5 * (layout.x**2 + layout.y**2)
    return float(np.sum(np.pi / 64.0 * layout.diameter**4 + area * arms) + tube)


def make_abaqus_label(name: str) -> str:
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
    >>> make_abaqus_label("FLRY-B_0.35")
    'FLRY-B_0_35_f1a89d0a'
    """
    return _allowed_text(name, allowed="A-Za-z0-9_-", first="A-Za-z", max_length=80)


def make_ansys_name(name: str) -> str:
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
    >>> make_ansys_name("FLRY-B 0.35")
    'FLRYB035'
    """
    remainder = re.sub(r"[^A-Za-z0-9]", "", _without_accents(name))
    return (remainder if remainder[:1].isalpha() else f"W{remainder}")[:8]


def make_file_stem(name: str) -> str:
    """Return the name of a file without its ending, for every common file system.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is allowed, otherwise its allowed characters with a checksum of the name.

    Examples
    --------
    >>> make_file_stem("A2")
    'A2'
    """
    max_length = 100
    stem = _allowed_text(name, allowed="A-Za-z0-9._ +-", first="A-Za-z0-9", max_length=max_length)
    is_device = re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", stem, flags=re.IGNORECASE)
    return (
        _with_checksum(name, stem, max_length) if is_device or stem != stem.rstrip(". ") else stem
    )


def shorten_name(name: str, max_length: int = 100) -> str:
    """Convert a name for a comment: printable ASCII on one line, shortened with dots.

    Parameters
    ----------
    name : of the wire, any text
    max_length : characters, at least 4

    Examples
    --------
    >>> shorten_name("a name that goes on and on", 12)
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


def describe_losses(card: LossCard) -> str:
    """Describe in one line the errors of a law in forms that programs can represent.

    Parameters
    ----------
    card : of the law
    """
    sliders = ", ".join(f"{number} sliders {format_percent(lost)}" for number, lost in card.sliders)
    return (
        f"Loss card, largest error of the moment from {card.first:.3g} to {card.last:.4g} 1/m, "
        f"each form at its best: constant stiffness {format_percent(card.constant)}, Dahl "
        f"{format_percent(card.dahl.error)}, {sliders}."
    )


def describe_masing_losses(table: WireTable) -> tuple[str, str]:
    """Describe unloading by Masing's rule, and the errors of forms that programs can represent."""
    return describe_unloading(table, "Masing"), describe_losses(make_table_card(table))


def format_percent(share: float) -> str:
    """Format a share in per cent with two digits; 100 % and more with all digits."""
    min_share = 1e-6
    if share >= 0.995:
        return f"{round(100.0 * share):d} %"
    return f"{100.0 * share:.2g} %" if share > min_share else "0 %"


def describe_turn_loss(
    table: WireTable, first: float, form: Literal["curve", "isotropic"], why: str
) -> str:
    """Describe in one line the error of the form of law of a deck.

    Parameters
    ----------
    table : law of the wire
    first : largest error on first loading, as a share of the moment
    form : a curve without memory, or isotropic hardening
    why : what the program does on unloading
    """
    turn = asdict(compute_table_turn(table))
    return (
        f"This deck: error on first loading up to {format_percent(first)} of the moment; on "
        f"unloading from bends up to half of the range up to {format_percent(turn[form])} of the "
        f"moment by Masing's rule at the reversal (from {turn[f'{form}_at']:.2g} 1/m): {why}."
    )


def describe_deck_losses(
    table: WireTable, loss: str, rule: str, form: Release, *, wide: int = 120
) -> tuple[str, ...]:
    """Return the loss card for the head of a deck: its own error, then those of other forms.

    Parameters
    ----------
    table : law of the wire; without a fit by sliders, the reason instead
    loss : error of the deck itself
    rule, form : of the deck on unloading, see `describe_unloading`
    wide : characters of a line
    """
    try:
        other_forms: tuple[str, ...] = (
            describe_unloading(table, rule, form),
            describe_losses(make_table_card(table)),
        )
    except ValueError as error:
        other_forms = (f"No loss card of other forms: {error}.",)
    return tuple(
        line.replace("~%", " %")  # keeps a number and its per cent sign on one line
        for sentence in (loss, *other_forms)
        for line in textwrap.wrap(sentence.replace(" %", "~%"), wide)
    )


@lru_cache(maxsize=4)
def compute_table_turn(table: WireTable) -> TurnLoss:
    """Return the errors on unloading of forms without the memory of a wire, over its table."""
    return compute_turn_loss(table.curvature, table.moment)


def compute_constant_loss(table: WireTable, stiffness: float) -> float:
    """Return the largest error of the moment of a constant stiffness, N m^2, over a table."""
    return float(np.max(np.abs(stiffness * table.curvature[1:] / table.moment[1:] - 1.0)))


def collect_card_numbers(table: WireTable) -> dict[str, object]:
    """Return the loss card for a JSON deck.

    Parameters
    ----------
    table : law of the wire; without a fit by sliders, the reason and the errors on unloading
    """
    way_back = asdict(compute_table_turn(table))
    try:
        card = make_table_card(table)
    except ValueError as error:
        return {"reason": f"{error}", "way_back": way_back}
    return {
        "curvature": [card.first, card.last],
        "constant": {"stiffness": card.stiffness, "error": card.constant},
        "dahl": card.dahl.error,
        "sliders": {str(number): lost for number, lost in card.sliders},
        "directions": {str(number): lost for number, lost in card.directions},
        "way_back": way_back,
        "unloading": collect_unloading_numbers(table),
    }
