"""Cards: descriptions of vendors' export formats, as data."""

from __future__ import annotations

import codecs
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, get_origin, get_type_hints

from labpipe.errors import ReadError, nearest
from labpipe.readers.raw_files import reading, unreadable

Pattern = re.Pattern[str]

KINDS: Final = ("text", "workbook")
NAMES: Final = ("above units", "with units", "alone", "listed", "any")
LAYOUTS: Final = ("one", "side by side", "blocks", "specimen above")
BRACKETS: Final = ("", "()", "[]")
DECIMALS: Final = (".", ",", "auto")
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_FIX = "Correct the card."
_Check = Callable[[object, str, object], object]
LAB_FOLDER = "dialects"
"""Folder of a lab's own cards, in the working folder beside ``protocols``."""


def _error(source: object, key: str, expected: str, found: str, remedy: str) -> ReadError:
    place = f"key {key}" if key else ""
    return unreadable(source, place, expected, found, remedy)


def _shown(value: object) -> str:
    return repr(value)[:60]


def _text(value: object, key: str, source: object) -> str:
    if isinstance(value, str) and value.strip():
        return value
    raise _error(source, key, "text", _shown(value), _FIX)


def _flag(value: object, key: str, source: object) -> bool:
    if isinstance(value, bool):
        return value
    raise _error(source, key, "true or false", _shown(value), _FIX)


def _number(value: object, key: str, source: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 10**300:
        return float(value)
    raise _error(source, key, "a number", _shown(value), _FIX)


def _pattern(value: object, key: str, source: object) -> Pattern:
    try:
        return re.compile(_text(value, key, source), re.MULTILINE)
    except (re.error, OverflowError, RecursionError) as error:
        raise _error(source, key, "a pattern", f"{_shown(value)} ({error})", _FIX) from error


def _group(value: object, key: str, source: object) -> Pattern:
    pattern = _pattern(value, key, source)
    if pattern.groups == 1:
        return pattern
    found = f"{pattern.groups} in {_shown(value)}"
    raise _error(source, key, "a pattern with one group in round brackets", found, _FIX)


def _name_pattern(value: object, key: str, source: object) -> Pattern:
    return re.compile(_pattern(value, key, source).pattern, re.IGNORECASE)


def _encoding(value: object, key: str, source: object) -> str:
    name = _text(value, key, source)
    try:
        codecs.lookup("ascii" if name == "detect" else name)
    except LookupError as error:
        raise _error(source, key, "the name of an encoding", _shown(value), _FIX) from error
    return name


def _separator(value: object, key: str, source: object) -> str:
    if value == "blanks" or (isinstance(value, str) and len(value) == 1 and value.isascii()):
        return " " if value == "blanks" else value
    raise _error(source, key, 'one sign, or "blanks"', _shown(value), _FIX)


def _one_of(choices: tuple[str, ...]) -> _Check:
    def check(value: object, key: str, source: object) -> object:
        if value in choices:
            return value
        expected = f"one of {', '.join(map(repr, choices))}"
        close = nearest(str(value), list(choices), limit=1)[0]
        raise _error(source, key, expected, _shown(value), f"Nearest: '{close}'.")

    return check


def _list_of(check: _Check) -> _Check:
    def check_items(value: object, key: str, source: object) -> object:
        if not isinstance(value, list):
            raise _error(source, key, "a list in square brackets", _shown(value), _FIX)
        return tuple(check(item, key, source) for item in value)

    return check_items


def _table_of(check: _Check) -> _Check:
    def check_items(value: object, key: str, source: object) -> object:
        if not isinstance(value, dict):
            raise _error(source, key, "a table of names", _shown(value), _FIX)
        checked = {str(name): check(item, f"{key}.{name}", source) for name, item in value.items()}
        return MappingProxyType(checked)

    return check_items


@dataclass(frozen=True, slots=True)
class Card:
    """A dialect: rules to recognise and read the export of one program.

    Parameters
    ----------
    name : as in protocols; the name of the card's file
    about : one-sentence description
    program : program that wrote the export, empty in a fallback card
    kind : ``text`` or ``workbook`` (xlsx, xls)
    recognise : patterns that must all be found in the head of the text, or of one sheet whose
        cells are separated by tabs
    fallback : whether it is tried only if no other card recognises the export
    blank : whether a file with only a byte order mark is an export without samples
    version, model : patterns whose group is the version, or follows the program's name
    encodings : tried in order without a byte order mark; ``detect`` detects the encoding
    separators : between cells, the first one that fits; ``blanks`` for any number of blanks
    decimal : decimal sign, or ``auto``
    decimal_pattern : pattern whose group is the decimal sign; replaces `decimal`
    names : location of the names of the columns; see docs/how-to/new-dialect.md
    brackets : around units
    name_starts : pattern at which a name begins, if blanks separate names that contain blanks
    header_words : first cells of the row of names, if there is no row of units
    listed : pattern of the line of one column, whose group is the name with the unit
    start : pattern of the line after which the samples begin
    units : units by name, where the export does not state them
    time : patterns of the name of the time column, preferred first
    time_unit : unit of time if the export does not state it
    variable_rate : whether the program samples at a variable rate: long steps are no losses
    words : names of columns of text
    missing : numbers for a missing value
    last_zeros : columns that are zero in a last row that is not a sample
    last_code : columns and their values in such a row
    stated_rows, stated_columns : keys of the preamble that state the numbers of samples and columns
    layout : arrangement of specimens and blocks
    source : file of the card, for messages
    """

    name: str
    about: Annotated[str, _text]
    recognise: Annotated[tuple[Pattern, ...], _list_of(_pattern)]
    time: Annotated[tuple[Pattern, ...], _list_of(_name_pattern)]
    names: Annotated[str, _one_of(NAMES)]
    program: Annotated[str, _text] = ""
    kind: Annotated[str, _one_of(KINDS)] = "text"
    fallback: Annotated[bool, _flag] = False
    blank: Annotated[bool, _flag] = False
    version: Annotated[Pattern | None, _group] = None
    model: Annotated[Pattern | None, _group] = None
    encodings: Annotated[tuple[str, ...], _list_of(_encoding)] = ("utf-8", "cp1252")
    separators: Annotated[tuple[str, ...], _list_of(_separator)] = ("\t", ";", ",")
    decimal: Annotated[str, _one_of(DECIMALS)] = "auto"
    decimal_pattern: Annotated[Pattern | None, _group] = None
    brackets: Annotated[str, _one_of(BRACKETS)] = ""
    name_starts: Annotated[Pattern | None, _pattern] = None
    header_words: Annotated[tuple[str, ...], _list_of(_text)] = ()
    listed: Annotated[Pattern | None, _group] = None
    start: Annotated[Pattern | None, _pattern] = None
    units: Annotated[Mapping[str, str], _table_of(_text)] = field(
        default_factory=lambda: MappingProxyType({})
    )
    time_unit: Annotated[str, _text] = ""
    variable_rate: Annotated[bool, _flag] = False
    words: Annotated[tuple[str, ...], _list_of(_text)] = ()
    missing: Annotated[tuple[float, ...], _list_of(_number)] = ()
    last_zeros: Annotated[tuple[str, ...], _list_of(_text)] = ()
    last_code: Annotated[Mapping[str, float], _table_of(_number)] = field(
        default_factory=lambda: MappingProxyType({})
    )
    stated_rows: Annotated[str, _text] = ""
    stated_columns: Annotated[str, _text] = ""
    layout: Annotated[str, _one_of(LAYOUTS)] = "one"
    source: str = ""


_CHECKS: Final[Mapping[str, _Check]] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(Card, include_extras=True).items()
    if get_origin(hint) is Annotated
}
"""Check of each key of a card."""


def parse_card(text: str, *, name: str, source: object) -> Card:
    """Read the text of a card.

    Parameters
    ----------
    text : TOML
    name : of the dialect: small letters, digits and hyphens
    source : file of the card, for messages

    Returns
    -------
    The card.

    Raises
    ------
    ReadError
        If the text is not TOML, keys are unknown, missing or of the wrong type (all are
        reported at once), or keys contradict each other.
    """
    if not _NAME.fullmatch(name):
        expected = "a name of small letters, digits and hyphens"
        raise _error(source, "", expected, f"'{name}'", "Rename the file of the card.")
    try:
        keys = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and huge numbers
        remedy = "Correct the line named there."
        raise _error(
            source, "", "a card in TOML", f"text that is none ({error})", remedy
        ) from error
    return _card(keys, name, source)


def _card(keys: Mapping[str, object], name: str, source: object) -> Card:
    values, messages = _check_keys(keys, source)
    if messages:
        raise ReadError("\n".join(messages))
    card = Card(name=name, source=str(source), **values)
    _check_combinations(card, source)
    return card


def _check_keys(keys: Mapping[str, object], source: object) -> tuple[dict[str, Any], list[str]]:
    """Return the values of the keys, and messages on wrong ones."""
    values: dict[str, Any] = {}
    messages = []
    for key, value in keys.items():
        try:
            values[key] = _CHECKS.get(key, _unknown)(value, key, source)
        except ReadError as fault:
            messages.append(str(fault))
    for needed in fields(Card):
        must = needed.default is MISSING and needed.default_factory is MISSING
        if must and needed.name not in keys and needed.name != "name":
            messages.append(
                str(_error(source, needed.name, "this key", "none", "Add it to the card."))
            )
    return values, messages


def _unknown(value: object, key: str, source: object) -> object:  # noqa: ARG001
    close = ", ".join(nearest(key, list(_CHECKS), limit=3))
    raise _error(source, key, "a key of a card", "none", f"Nearest: {close}.")


def _check_combinations(card: Card, source: object) -> None:
    needs = {
        "alone": ("header_words", bool(card.header_words)),
        "listed": ("listed", card.listed is not None and card.start is not None),
        "with units": ("brackets", bool(card.brackets)),
    }
    key, has = needs.get(card.names, ("", True))
    if not has:
        also = " (and `start`)" if key == "listed" else ""
        expected = f"this key{also}, as names = '{card.names}'"
        raise _error(source, key, expected, "none", "Add it to the card.")
    if not card.recognise and not card.blank:
        remedy = "Give text that every export of the program contains."
        raise _error(source, "recognise", "at least one pattern", "none", remedy)


@cache
def shipped_cards(kind: str | None = None) -> Mapping[str, Card]:
    """Load the cards of labpipe, by name.

    Parameters
    ----------
    kind : of the exports, ``text`` or ``workbook``; None for all
    """
    return {
        name: _card(keys, name, f"{name}.toml")
        for name, keys in _shipped_keys().items()
        if kind is None or keys.get("kind", "text") == kind
    }


def shipped_names() -> tuple[str, ...]:
    """Return the names of the cards of labpipe, in order."""
    return tuple(_shipped_keys())


@cache
def _shipped_keys() -> Mapping[str, Mapping[str, object]]:
    folder = resources.files("labpipe.readers.load_frame") / "dialects"
    cards = [file for file in folder.iterdir() if file.name.endswith(".toml")]
    files = {file.name.removesuffix(".toml"): file for file in cards}
    return {name: tomllib.loads(files[name].read_text(encoding="utf-8")) for name in sorted(files)}


def lab_cards(folder: Path | None = None) -> Mapping[str, Card]:
    """Load a lab's own cards, by name.

    Parameters
    ----------
    folder : their folder; ``dialects`` in the working folder if None

    Raises
    ------
    ReadError
        If a card is wrong, or has the name of a card of labpipe.
    """
    return {file.stem: _lab_card(file) for file in lab_card_files(folder)}


def lab_card_files(folder: Path | None = None) -> list[Path]:
    """List the files of a lab's own cards.

    Parameters
    ----------
    folder : as for `lab_cards`
    """
    cards_folder = Path(LAB_FOLDER) if folder is None else folder
    return sorted(cards_folder.glob("*.toml")) if cards_folder.is_dir() else []


def _lab_card(file: Path) -> Card:
    if file.stem in shipped_names():
        raise unreadable(
            file,
            "",
            "a name of its own",
            f"'{file.stem}', which is a card of labpipe",
            "Rename the file, and name the new dialect in the protocol.",
        )
    with reading(file, "a card in UTF-8", remedy="Save it as UTF-8."):
        text = file.read_text(encoding="utf-8")
    return parse_card(text, name=file.stem, source=file)
