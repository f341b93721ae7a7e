"""Load and check cards, which describe the export formats of vendors' programs as data."""

from __future__ import annotations

import codecs
import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from labpipe.errors import ReadError
from labpipe.readers.raw_files import map_read_errors, require

LAB_FOLDER = "dialects"
"""Folder of a lab's own cards, in the working folder."""
_CARD_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


def _compile_pattern(value: object, *, flags: re.RegexFlag) -> re.Pattern[str]:
    """Compile a pattern, or raise ValueError if it is invalid or too complex."""
    try:
        return re.compile(str(value), flags)
    except (re.error, OverflowError, RecursionError) as error:
        message = f"a wrong pattern: {error}"
        raise ValueError(message) from error


def _check_group(pattern: re.Pattern[str]) -> re.Pattern[str]:
    """Refuse a pattern that does not have exactly one group."""
    require(pattern.groups == 1, "a pattern needs one group in round brackets")
    return pattern


def _check_encoding(name: str) -> str:
    """Refuse a name that is neither that of an encoding nor ``detect``."""
    is_known = name == "detect"
    with suppress(LookupError):
        is_known = is_known or bool(codecs.lookup(name))
    require(is_known, "not the name of an encoding")
    return name


def _parse_separator(separator: str) -> str:
    """Parse a separator, which is one ASCII character or the word ``blanks``."""
    is_valid = separator == "blanks" or (len(separator) == 1 and separator.isascii())
    require(is_valid, 'should be one sign, or "blanks"')
    return " " if separator == "blanks" else separator


_Text = Annotated[str, Field(pattern=r"\S")]
_Flag = Annotated[bool, Field(strict=True)]
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Pattern = Annotated[
    re.Pattern[str], BeforeValidator(partial(_compile_pattern, flags=re.MULTILINE))
]
_NamePattern = Annotated[
    re.Pattern[str], BeforeValidator(partial(_compile_pattern, flags=re.IGNORECASE))
]
_GroupPattern = Annotated[_Pattern, AfterValidator(_check_group)]
_Encoding = Annotated[_Text, AfterValidator(_check_encoding)]
_Separator = Annotated[str, AfterValidator(_parse_separator)]


class Card(BaseModel):
    """Description of a dialect: how the exports of one program are recognised and read.

    Parameters
    ----------
    name : name of the dialect in protocols, and of the file of the card
    about : description in one sentence
    program : program that writes the exports; empty in a fallback card
    kind : ``text`` or ``workbook`` (xlsx, xls)
    recognise : patterns that must all be found in the head of the text, or in that of one sheet, in
        which tabs separate the cells
    fallback : whether the card is tried only if no other card recognises the export
    blank : whether a file with only a byte order mark is an export without samples
    version : pattern whose group is the version of the program
    model : pattern whose group is added to the name of the program
    encodings : encodings that are tried in this order if there is no byte order mark; ``detect``
        detects the encoding
    separators : characters that may separate cells, of which the first one that fits is used;
        ``blanks`` for any number of blanks
    decimal : decimal sign, or ``auto``
    decimal_pattern : pattern whose group is the decimal sign, which replaces `decimal`
    names : location of the names of the columns; see docs/how-to/new-dialect.md
    brackets : brackets around units
    name_starts : pattern at which a name begins, if blanks separate names that contain blanks
    header_words : first cells of the row of names, if there is no row of units
    listed : pattern of the line of one column, whose group is the name with the unit
    start : pattern of the line after which the samples begin
    units : units that the export does not state, keyed by name of the column
    time : patterns of the name of the time column, in order of preference
    time_unit : unit of time if the export does not state it
    variable_rate : whether the program samples at a variable rate, so that no samples are lost in
        long steps
    words : names of columns of text
    missing : numbers that stand for a missing value
    last_zeros : names of the columns that are zero in a last row that is not a sample
    last_code : other values in such a row, keyed by name of the column
    stated_rows, stated_columns : keys of the preamble that state the numbers of samples and columns
    layout : arrangement of specimens and blocks
    source : file of the card, for messages
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    name: str
    about: _Text
    recognise: tuple[_Pattern, ...]
    time: tuple[_NamePattern, ...]
    names: Literal["above units", "with units", "alone", "listed", "any"]
    program: _Text = ""
    kind: Literal["text", "workbook"] = "text"
    fallback: _Flag = False
    blank: _Flag = False
    version: _GroupPattern | None = None
    model: _GroupPattern | None = None
    encodings: tuple[_Encoding, ...] = ("utf-8", "cp1252")
    separators: tuple[_Separator, ...] = ("\t", ";", ",")
    decimal: Literal[".", ",", "auto"] = "auto"
    decimal_pattern: _GroupPattern | None = None
    brackets: Literal["", "()", "[]"] = ""
    name_starts: _Pattern | None = None
    header_words: tuple[_Text, ...] = ()
    listed: _GroupPattern | None = None
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

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        """Refuse a card without a pattern, or without keys that its location of names requires."""
        requirements = {
            "alone": ("header_words", self.header_words),
            "listed": ("listed and start", self.listed and self.start),
            "with units": ("brackets", self.brackets),
        }
        keys, values = requirements.get(self.names, ("", True))
        require(bool(values), f"names = '{self.names}' needs {keys}")
        require(bool(self.recognise or self.blank), "recognise needs at least one pattern")
        return self

    def fits(self, text: str) -> bool:
        """Return whether all patterns of the card are found in a text."""
        return bool(self.recognise) and all(pattern.search(text) for pattern in self.recognise)


def parse_card(text: str, *, name: str, source: object) -> Card:
    """Parse the text of a card.

    Parameters
    ----------
    text : TOML text of the card
    name : name of the dialect, of small letters, digits and hyphens
    source : file of the card, for messages

    Returns
    -------
    The card.

    Raises
    ------
    ReadError
        If the name is invalid, the text is not TOML, keys contradict each other, or keys are
        unknown, missing or of the wrong type. All faults of the keys are reported together.
    """
    if not _CARD_NAME.fullmatch(name):
        raise ReadError.about("readers.name_of_card", source, name=name)
    try:
        keys = tomllib.loads(text)
        return Card.model_validate({"name": name, "source": str(source), **keys})
    except ValidationError as error:
        faults = error.errors(include_url=False)
        raise ReadError("\n".join(_format_fault(fault, source) for fault in faults)) from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and huge numbers
        raise ReadError.about("readers.no_toml", source, reason=error) from error


def _format_fault(fault: Any, source: object) -> str:
    """Format a fault that pydantic found in a card."""
    key = ".".join(part for part in fault["loc"] if isinstance(part, str))
    place, reason = f"key {key}" if key else "", fault["msg"].removeprefix("Value error, ")
    value = "nothing" if isinstance(fault["input"], dict) else repr(fault["input"])[:60]
    return str(ReadError.about("readers.key_of_card", source, place, value=value, why=reason))


@cache
def load_shipped_cards() -> Mapping[str, Card]:
    """Load the cards of labpipe, keyed by name."""
    folder = resources.files("labpipe.readers.load_frame") / "dialects"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    texts = {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}
    return {
        name: parse_card(text, name=name, source=f"{name}.toml") for name, text in texts.items()
    }


def list_lab_card_files() -> list[Path]:
    """List the files of a lab's own cards, in `LAB_FOLDER`."""
    return sorted(Path(LAB_FOLDER).glob("*.toml"))


def load_lab_cards() -> Mapping[str, Card]:
    """Load a lab's own cards, keyed by name.

    Raises
    ------
    ReadError
        If a card is invalid, or has the name of a card of labpipe.
    """
    cards = {}
    for file in list_lab_card_files():
        if file.stem in load_shipped_cards():
            raise ReadError.about("readers.taken_name_of_card", file, name=file.stem)
        with map_read_errors(file, "a card in UTF-8", remedy="Save it as UTF-8."):
            text = file.read_text(encoding="utf-8")
        cards[file.stem] = parse_card(text, name=file.stem, source=file)
    return cards
