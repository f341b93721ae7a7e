"""Cards: descriptions of vendors' export formats, as data."""

from __future__ import annotations

import codecs
import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)

from labpipe.errors import ReadError, error_text, nearest
from labpipe.readers.raw_files import reading, unreadable

LAB_FOLDER = "dialects"
"""Folder of a lab's own cards, in the working folder beside ``protocols``."""
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_EXPECTED = {
    "string_type": "text",
    "string_pattern_mismatch": "text",
    "bool_type": "true or false",
    "float_type": "a number",
    "finite_number": "a number",
    "tuple_type": "a list in square brackets",
    "dict_type": "a table of names",
    "extra_forbidden": "a key of a card",
    "missing": "this key",
}
"""What a value should be, by the type of error of pydantic."""


def _require(is_right: bool, expected: str) -> None:
    if not is_right:
        raise ValueError(expected)


def _compiled(value: object, *, flags: re.RegexFlag) -> re.Pattern[str]:
    try:
        return re.compile(str(value), flags)
    except (re.error, OverflowError, RecursionError) as error:
        message = "a pattern"
        raise ValueError(message) from error


def _one_group(pattern: re.Pattern[str]) -> re.Pattern[str]:
    _require(pattern.groups == 1, "a pattern with one group in round brackets")
    return pattern


def _encoding(name: str) -> str:
    is_known = name == "detect"
    with suppress(LookupError):
        is_known = is_known or bool(codecs.lookup(name))
    _require(is_known, "the name of an encoding")
    return name


def _separator(sign: str) -> str:
    _require(sign == "blanks" or (len(sign) == 1 and sign.isascii()), 'one sign, or "blanks"')
    return " " if sign == "blanks" else sign


_Text = Annotated[str, Field(pattern=r"\S")]
_Flag = Annotated[bool, Field(strict=True)]
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Pattern = Annotated[re.Pattern[str], BeforeValidator(partial(_compiled, flags=re.MULTILINE))]
_NamePattern = Annotated[re.Pattern[str], BeforeValidator(partial(_compiled, flags=re.IGNORECASE))]
_Group = Annotated[_Pattern, AfterValidator(_one_group)]
_Encoding = Annotated[_Text, AfterValidator(_encoding)]
_Separator = Annotated[str, AfterValidator(_separator)]


class Card(BaseModel):
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

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    about: _Text
    recognise: tuple[_Pattern, ...]
    time: tuple[_NamePattern, ...]
    names: Literal["above units", "with units", "alone", "listed", "any"]
    program: _Text = ""
    kind: Literal["text", "workbook"] = "text"
    fallback: _Flag = False
    blank: _Flag = False
    version: _Group | None = None
    model: _Group | None = None
    encodings: tuple[_Encoding, ...] = ("utf-8", "cp1252")
    separators: tuple[_Separator, ...] = ("\t", ";", ",")
    decimal: Literal[".", ",", "auto"] = "auto"
    decimal_pattern: _Group | None = None
    brackets: Literal["", "()", "[]"] = ""
    name_starts: _Pattern | None = None
    header_words: tuple[_Text, ...] = ()
    listed: _Group | None = None
    start: _Pattern | None = None
    units: Mapping[str, _Text] = {}
    time_unit: _Text = ""
    variable_rate: _Flag = False
    words: tuple[_Text, ...] = ()
    missing: tuple[_Number, ...] = ()
    last_zeros: tuple[_Text, ...] = ()
    last_code: Mapping[str, _Number] = {}
    stated_rows: _Text = ""
    stated_columns: _Text = ""
    layout: Literal["one", "side by side", "blocks", "specimen above"] = "one"
    source: str = ""

    def fits(self, text: str) -> bool:
        """Return whether all patterns of the card are found in a text."""
        return bool(self.recognise) and all(pattern.search(text) for pattern in self.recognise)


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
        expected, remedy = "a name of small letters, digits and hyphens", "Rename the file."
        raise unreadable(source, "", expected, f"'{name}'", remedy)
    try:
        keys = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and huge numbers
        found, remedy = f"text that is none ({error})", "Correct the line named there."
        raise unreadable(source, "", "a card in TOML", found, remedy) from error
    try:
        card = Card.model_validate({"name": name, "source": str(source), **keys})
    except ValidationError as error:
        faults = error.errors(include_url=False)
        raise ReadError("\n".join(_fault_text(fault, source) for fault in faults)) from error
    _require_keys(card)
    return card


def _fault_text(fault: Any, source: object) -> str:
    key = ".".join(part for part in fault["loc"] if isinstance(part, str))
    expected = _EXPECTED.get(fault["type"], "")
    found, remedy = repr(fault["input"])[:60], "Correct the card."
    if fault["type"] == "missing":
        found, remedy = "none", "Add it to the card."
    elif fault["type"] == "extra_forbidden":
        close = nearest(key, [*Card.model_fields], limit=3)
        found, remedy = "another one", f"Nearest: {', '.join(close)}."
    elif fault["type"] == "literal_error":
        expected = f"one of {', '.join(map(repr, get_args(Card.model_fields[key].annotation)))}"
    elif not expected:
        why = fault["ctx"]["error"]
        expected = str(why)
        found += f" ({why.__cause__})" if why.__cause__ else ""
    return error_text(source, f"key {key}", expected=expected, found=found, remedy=remedy)


def _require_keys(card: Card) -> None:
    """Refuse a card that lacks what its kind of names needs."""
    needs = {
        "alone": ("header_words", bool(card.header_words)),
        "listed": ("listed", card.listed is not None and card.start is not None),
        "with units": ("brackets", bool(card.brackets)),
    }
    key, has_key = needs.get(card.names, ("", True))
    if not has_key:
        also = " (and `start`)" if key == "listed" else ""
        expected = f"this key{also}, as names = '{card.names}'"
        raise unreadable(card.source, f"key {key}", expected, "none", "Add it to the card.")
    if not card.recognise and not card.blank:
        remedy = "Give text that every export of the program contains."
        raise unreadable(card.source, "key recognise", "at least one pattern", "none", remedy)


@cache
def shipped_cards() -> Mapping[str, Card]:
    """Load the cards of labpipe, by name."""
    folder = resources.files("labpipe.readers.load_frame") / "dialects"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    texts = {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}
    return {
        name: parse_card(text, name=name, source=f"{name}.toml") for name, text in texts.items()
    }


def lab_card_files(folder: Path | None = None) -> list[Path]:
    """List the files of a lab's own cards.

    Parameters
    ----------
    folder : their folder; ``dialects`` in the working folder if None
    """
    cards_folder = Path(LAB_FOLDER) if folder is None else folder
    return sorted(cards_folder.glob("*.toml")) if cards_folder.is_dir() else []


def lab_cards(folder: Path | None = None) -> Mapping[str, Card]:
    """Load a lab's own cards, by name.

    Parameters
    ----------
    folder : as for `lab_card_files`

    Raises
    ------
    ReadError
        If a card is wrong, or has the name of a card of labpipe.
    """
    cards = {}
    for file in lab_card_files(folder):
        if file.stem in shipped_cards():
            found = f"'{file.stem}', which is a card of labpipe"
            remedy = "Rename the file, and name the new dialect in the protocol."
            raise unreadable(file, "", "a name of its own", found, remedy)
        with reading(file, "a card in UTF-8", remedy="Save it as UTF-8."):
            text = file.read_text(encoding="utf-8")
        cards[file.stem] = parse_card(text, name=file.stem, source=file)
    return cards
