"""Fill the templates of decks, and describe range, errors and name of a wire for them."""

from __future__ import annotations

import re
import textwrap
import unicodedata
import zlib
from collections.abc import Iterable
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe import __version__
from labpipe.mechanics.decks.unloading import (
    Release,
    describe_unloading,
    make_unloading_entry,
)
from labpipe.mechanics.law.loss_card import make_table_card
from labpipe.mechanics.law.plays import require_positive
from labpipe.records.arrays import Floats, Ints
from labpipe.records.wire import WireTable

if TYPE_CHECKING:
    from jinja2 import Environment

FIRST_LOADING_TEXT = "The law is that of the first loading of a wire that was never bent before."


@cache
def _load_templates() -> Environment:
    """Return the environment of Jinja that loads the templates of decks, with their filters."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        auto_reload=False,
        autoescape=False,  # decks are not HTML; `quoteattr` quotes names
    )
    filters = {
        "attribute": quoteattr,
        "comments": _format_xml_comments,
        "g": _format_numbers,
        "header": list_header_sentences,
        "lines": lambda lines, prefix: "\n".join(f"{prefix}{line}" for line in lines),
        "rows": _format_rows,
        "shorten": shorten_name,
        "wrap": _wrap_sentences,
    }
    environment.filters.update(filters)
    return environment


def fill_template(name: str, /, **values: object) -> str:
    """Fill the template of a deck.

    Parameters
    ----------
    name : name of the file in ``templates``
    values : values of all variables of the template
    """
    return _load_templates().get_template(name).render(values)


def _format_numbers(values: Floats | float, digits: int = 7) -> str:
    """Format values of any shape with `digits` significant digits, separated by blanks."""
    if isinstance(values, float):
        return f"{values:.{digits}g}"
    return " ".join(f"{value:.{digits}g}" for value in np.ravel(values).tolist())


def _format_rows(rows: Floats | Ints, row_format: str) -> str:
    """Format a table; one formatting of all rows is several times as fast as value by value."""
    return "\n".join([row_format] * len(rows)) % tuple(np.ravel(rows).tolist())


def _format_xml_comments(lines: Iterable[str]) -> str:
    """Return lines as XML comments, in which two successive hyphens are not allowed."""
    return "\n".join(f"  <!-- {re.sub('-(?=-)', '- ', line)} -->" for line in lines)


def _wrap_sentences(sentences: Iterable[str], line_width: int) -> list[str]:
    """Wrap sentences into lines; a number and its per cent sign stay on one line."""
    return [
        line.replace("~%", " %")
        for sentence in sentences
        for line in textwrap.wrap(sentence.replace(" %", "~%"), line_width)
    ]


def list_header_sentences(table: WireTable, max_length: int = 100) -> tuple[str, ...]:
    """Return the sentences in the header of every deck: name, units, range and law.

    Parameters
    ----------
    table : table of the wire
    max_length : largest number of characters of the wire's name
    """
    max_curvature, doubtful_curvature = float(table.curvature[-1]), table.doubtful_curvature
    doubt_sentence = (
        f"Doubtful beyond {doubtful_curvature:.6g} 1/m: insulation strain above "
        f"{100.0 * table.spec.insulation_strain:.3g} %."
    )
    return (
        f"Wire {shorten_name(table.name, max_length)}, made by labpipe {__version__}.",
        "Units: m, N, kg, s, rad; curvature and twist 1/m, moment N m, stiffness N m^2.",
        f"Range: curvature from 0 to {max_curvature:.6g} 1/m (bend radius "
        f"{1.0 / max_curvature:.4g} m and more).",
        "The deck is not valid beyond this range.",
        *((doubt_sentence,) if doubtful_curvature < max_curvature else ()),
        FIRST_LOADING_TEXT,
    )


def get_mass_per_length(table: WireTable) -> float:
    """Return the mass per length of a wire, kg/m, for a deck that requires it.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        If the mass per length is not finite and positive.
    """
    require_positive("mass_per_length", table.mass_per_length)
    return table.mass_per_length


def compute_angular_frequency(stiffness: float, mass_per_length: float, length: float) -> float:
    """Return the first angular frequency of a wire that is clamped at one end, rad/s.

    Parameters
    ----------
    stiffness : bending stiffness, N m^2
    mass_per_length : mass per length of the wire, kg/m
    length : free length, m
    """
    # the first root of cos x cosh x = -1, for the first mode of a cantilever
    first_root = 1.8751040687119611
    return float(first_root**2 * np.sqrt(stiffness / mass_per_length) / length**2)


def find_linear_range(table: WireTable, stiffness: float) -> tuple[float, float] | None:
    """Find the range of curvature in which a constant stiffness represents the law.

    Parameters
    ----------
    table : table of the wire
    stiffness : constant bending stiffness, N m^2

    Returns
    -------
    Lower and upper end, 1/m, of the first interval in which the linear moment is within 5 % of the
    moment of the wire, found on a grid of 20 000 logarithmically spaced curvatures. None if the
    table has no such interval.
    """
    max_error = 0.05  # relative to the moment
    n_curvatures = 20_000
    low, high = np.log(table.curvature[[1, -1]]).tolist()
    curvature = np.exp(np.linspace(low, high, n_curvatures))  # several times as fast as geomspace
    moment = np.interp(curvature, table.curvature, table.moment)
    is_inside = np.abs(stiffness * curvature / moment - 1.0) <= max_error
    if not is_inside.any():
        return None
    start = int(np.argmax(is_inside))
    stop = start + int(np.argmin(np.append(is_inside[start:], False)))
    return float(curvature[start]) if start else 0.0, float(curvature[stop - 1])


def compute_skew_bending_error(table: WireTable) -> float:
    """Return the relative excess of the moment in skew bending if the two axes are uncoupled.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Largest value over the range of sqrt(2) M(kappa / sqrt(2)) / M(kappa) - 1, which compares two
    uncoupled laws in bending at 45 degrees to both axes with one law.
    """
    component_curvature = table.curvature[1:] / np.sqrt(2.0)
    component_moment = np.interp(component_curvature, table.curvature, table.moment)
    return float(np.max(np.sqrt(2.0) * component_moment / table.moment[1:] - 1.0))


def make_abaqus_label(name: str) -> str:
    """Make the label of an element set: a letter, then up to 79 letters, digits, ``_`` and ``-``.

    Parameters
    ----------
    name : name of the wire, any text

    Returns
    -------
    The name if it is a valid label. Otherwise its allowed characters, with ``_`` for the others,
    and a checksum of the name, so that different names have different labels.

    Notes
    -----
    Abaqus ignores the case of labels without quotes. The names of wires must therefore not differ
    in case only.

    Examples
    --------
    >>> make_abaqus_label("FLRY-B_0.35")
    'FLRY-B_0_35_f1a89d0a'
    """
    return _make_label(name, allowed="A-Za-z0-9_-", initial="A-Za-z", max_length=80)


def make_ansys_name(name: str) -> str:
    """Make the name of a section: at most eight letters and digits, the first a letter.

    Parameters
    ----------
    name : name of the wire, any text

    Returns
    -------
    The first eight allowed characters of the name, after a ``W`` if the first is not a letter.
    Ansys identifies sections by their number, so that the name need not be unique.

    Examples
    --------
    >>> make_ansys_name("FLRY-B 0.35")
    'FLRYB035'
    """
    characters = re.sub(r"[^A-Za-z0-9]", "", _remove_accents(name))
    return (characters if characters[:1].isalpha() else f"W{characters}")[:8]


def make_file_stem(name: str) -> str:
    """Make a file name without its ending that is valid in every common file system.

    Parameters
    ----------
    name : name of the wire, any text

    Returns
    -------
    The name if it is allowed. Otherwise its allowed characters, with ``_`` for the others, and a
    checksum of the name. Names that differ only in case may have the same file.

    Examples
    --------
    >>> make_file_stem("A2")
    'A2'
    """
    max_length = 100
    stem = _make_label(name, allowed="A-Za-z0-9._ +-", initial="A-Za-z0-9", max_length=max_length)
    if re.match(r"(con|prn|aux|nul|com\d|lpt\d) *(\.|$)", stem, flags=re.IGNORECASE):
        # Windows reserves these names for devices
        return _append_checksum(name, stem.replace(".", "_"), max_length)
    return _append_checksum(name, stem, max_length) if stem.endswith((".", " ")) else stem


def shorten_name(name: str, max_length: int = 100) -> str:
    """Convert a name to one line of printable ASCII for a comment, with ``...`` if it is too long.

    Parameters
    ----------
    name : name of the wire, any text
    max_length : largest number of characters, at least 4

    Examples
    --------
    >>> shorten_name("a name that goes on and on", 12)
    'a name th...'
    """
    line = re.sub(r"[^ -~]+", "?", _remove_accents(" ".join(name.split())))
    return line if len(line) <= max_length else line[: max_length - 3] + "..."


def _make_label(name: str, *, allowed: str, initial: str, max_length: int) -> str:
    """Return the allowed characters of a name, with a checksum if they differ from the name.

    `allowed` (for all characters) and `initial` (for the first one) are character sets of a regular
    expression.
    """
    label = re.sub(rf"[^{allowed}]+", "_", _remove_accents(name))
    if not re.match(f"[{initial}]", label):
        label = f"W{label}"
    if label == name and len(label) <= max_length:
        return label
    return _append_checksum(name, label, max_length)


def _append_checksum(name: str, label: str, max_length: int) -> str:
    """Append a checksum of the name to a label, which is shortened if necessary."""
    n_digits = 8  # hexadecimal
    checksum = f"{zlib.crc32(name.encode('utf-8', 'surrogatepass')):0{n_digits}x}"
    return f"{label[: max_length - n_digits - 1].rstrip('. ')}_{checksum}"


def _remove_accents(name: str) -> str:
    """Replace each letter with an accent by the letter without an accent, if there is one."""
    characters = unicodedata.normalize("NFKD", name)
    return "".join(char for char in characters if not unicodedata.combining(char))


def describe_law_errors(
    table: WireTable, unloading_rule: str = "Masing", deck_release: Release | None = None
) -> tuple[str, str]:
    """Describe unloading with a deck, and the errors of simpler laws that programs can represent.

    Parameters
    ----------
    table, unloading_rule, deck_release : as for `describe_unloading`

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    return describe_unloading(table, unloading_rule, deck_release), _describe_loss_card(table)


@lru_cache(maxsize=4)  # tables are hashed by identity
def _describe_loss_card(table: WireTable) -> str:
    """Return a sentence on the errors of simpler laws."""
    card = make_table_card(table)
    sliders = ", ".join(f"{n} sliders {format_percent(error)}" for n, error in card.slider_errors)
    return (
        f"Loss card, largest error of the moment from {table.curvature[1]:.3g} to "
        f"{table.curvature[-1]:.4g} 1/m, each form at its best: constant stiffness "
        f"{format_percent(card.stiffness_error)}, Dahl {format_percent(card.dahl_law.error)}, "
        f"{sliders}."
    )


def format_percent(ratio: float) -> str:
    """Format a ratio in per cent with two digits, or as a whole number from 100 %.

    Parameters
    ----------
    ratio : ratio, not negative; below 1e-6 it is formatted as 0 %
    """
    min_ratio = 1e-6
    min_whole_ratio = 0.995  # two digits would show 1e+02
    if ratio >= min_whole_ratio:
        return f"{round(100.0 * ratio):d} %"
    return f"{100.0 * ratio:.2g} %" if ratio > min_ratio else "0 %"


def describe_loading_error(error: float) -> str:
    """Return a sentence on the largest error of a deck on first loading, relative to the moment."""
    return f"This deck: error on first loading up to {format_percent(error)} of the moment."


def explain_missing_model(error: float) -> str:
    """Return why a deck with this error on first loading has no model; empty if it has one."""
    max_error = 0.5  # a deck with a larger error does not represent the wire
    if error <= max_error:
        return ""
    percent, max_percent = format_percent(error), format_percent(max_error)
    return (
        f"the law of the deck differs from that of the wire by {percent}, more than {max_percent}"
    )


def describe_deck_errors(
    table: WireTable, deck_error_sentence: str, unloading_rule: str, deck_release: Release
) -> tuple[str, ...]:
    """Return sentences on the error of a deck, on unloading, and on the errors of simpler laws.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the reason replaces unloading
        and simpler laws
    deck_error_sentence : sentence on the error of the deck
    unloading_rule, deck_release : as for `describe_unloading`
    """
    try:
        law_errors = describe_law_errors(table, unloading_rule, deck_release)
    except ValueError as error:
        return deck_error_sentence, f"No loss card of other forms: {error}."
    return deck_error_sentence, *law_errors


@lru_cache(maxsize=4)
def make_loss_card_entry(table: WireTable) -> dict[str, object]:
    """Return the entry ``loss_card`` of a JSON deck.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the entry states only the reason
    """
    try:
        card = make_table_card(table)
    except ValueError as error:
        return {"reason": f"{error}"}
    return {
        "curvature": table.curvature[[1, -1]].tolist(),
        "constant": {"stiffness": card.stiffness, "error": card.stiffness_error},
        "dahl": card.dahl_law.error,
        "sliders": {str(count): error for count, error in card.slider_errors},
        "directions": {str(count): error for count, error in card.direction_errors},
        "unloading": make_unloading_entry(table),
    }
