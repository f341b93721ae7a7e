"""Patterns of the names of exports and folders, such as ``{type}-{length mm}-{sample}_force.mat``.

The grammar: ``{name}`` stands for a word, ``{length mm}`` for a number whose unit is not in the
name, ``{date}`` for a day with the year first, ``*`` for anything; all else for itself, in capitals
or not. A word takes as much as it can, from the left. A slash parts folders.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from labpipe.units import parse_quantity

WORDS = ("test", "type", "spool", "sample", "operator", "date")
"""Fields without a unit; besides them, every dimension with its unit, and ``labels.NAME``."""
_PART = re.compile(r"\{([^{}]*)\}|(\*)|([{}])")
_DIMENSION = re.compile(r"([a-z][a-z0-9_]*)\s+(\S+)")
_LABEL = re.compile(r"labels\.[a-z][a-z0-9_]*")
_WORD, _NUMBER, _DAY = r"[^/\\]+", r"\d+(?:[.,]\d+)?", r"\d{4}-\d{2}-\d{2}|\d{8}"
MAX_PATTERN_LENGTH = 300
"""Characters of a pattern, and of a name that is compared."""


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A pattern that was read.

    Parameters
    ----------
    text : as written
    fields : names of its fields in their order, each once
    units : unit of each field that is a number
    compiled : what a name is compared with
    """

    text: str
    fields: tuple[str, ...]
    units: Mapping[str, str]
    compiled: re.Pattern[str]

    def match(self, name: str) -> dict[str, str] | None:
        """Split a name into its fields.

        Parameters
        ----------
        name : of a file or folder, with slashes between folders

        Returns
        -------
        Text by field, a number with its unit; None if the name is not of this pattern.

        Examples
        --------
        >>> parse_name_pattern("{type}-{length mm}-{sample}_force.mat").match("A2-085-1_Force.MAT")
        {'type': 'A2', 'length': '85 mm', 'sample': '1'}
        """
        match = self.compiled.fullmatch(name) if len(name) <= MAX_PATTERN_LENGTH else None
        if match is None:
            return None
        texts = {field: match[f"f{place}"] for place, field in enumerate(self.fields)}
        return {field: self._value(field, text) for field, text in texts.items()}

    def stem(self, name: str) -> str:
        """Return the part of a name up to its last field, without its folders.

        Parameters
        ----------
        name : of this pattern

        Examples
        --------
        >>> parse_name_pattern("in/{type}-{sample}_force.mat").stem("in/A2-1_force.mat")
        'A2-1'
        """
        match = self.compiled.fullmatch(name)
        ends = [match.end(f"f{place}") for place in range(len(self.fields))] if match else []
        return name[: max(ends, default=len(name))].rpartition("/")[2]

    def _value(self, field: str, text: str) -> str:
        if field in self.units:
            number = float(text.replace(",", "."))
            return f"{number:g} {self.units[field]}"
        if field == "date" and "-" not in text:
            return f"{text[:4]}-{text[4:6]}-{text[6:]}"
        return text


def parse_name_pattern(text: str) -> NamePattern:
    """Read a pattern.

    Parameters
    ----------
    text : as a campaign YAML has it

    Raises
    ------
    ValueError
        If it is invalid; the message says what is expected.
    """
    if len(text) > MAX_PATTERN_LENGTH:
        message = f"a pattern of at most {MAX_PATTERN_LENGTH} letters"
        raise ValueError(message)
    units: dict[str, str] = {}
    fields: list[str] = []
    parts, end = [], 0
    for field_match in _PART.finditer(text):
        parts.append(re.escape(text[end : field_match.start()]))
        end = field_match.end()
        if field_match[2]:
            parts.append(r"[^/\\]*")
            continue
        name, unit = _field("{" if field_match[1] is None else field_match[1])
        if name in fields:
            parts.append(f"(?P=f{fields.index(name)})")
            continue
        pattern = _NUMBER if unit else _DAY if name == "date" else _WORD
        parts.append(f"(?P<f{len(fields)}>{pattern})")
        fields.append(name)
        units |= {name: unit} if unit else {}
    parts.append(re.escape(text[end:]))
    compiled = re.compile("".join(parts), re.IGNORECASE)
    return NamePattern(text, tuple(fields), MappingProxyType(units), compiled)


def _field(written: str) -> tuple[str, str]:
    """Return name and unit of the field between braces."""
    name = written.strip()
    if name in WORDS or _LABEL.fullmatch(name):
        return name, ""
    match = _DIMENSION.fullmatch(name)
    if match and match[1] not in WORDS:
        try:
            parse_quantity(f"1 {match[2]}", "m")
        except ValueError:
            message = f"a dimension with a unit of length, such as {{{match[1]} mm}}"
            raise ValueError(message) from None
        return match[1], match[2]
    fields = ", ".join(f"{{{word}}}" for word in WORDS)
    message = (
        f"one of {fields}, a dimension with its unit such as {{length mm}}, or {{labels.name}}"
    )
    raise ValueError(message)
