"""The grammar of a test sheet (test.yaml), and a new one written with comments."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Mapping
from datetime import date
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema

from labpipe.errors import Fault
from labpipe.protocol.bundle_grammar import SheetBundle
from labpipe.protocol.faults import did_you_mean, error_of, faults_of, shown
from labpipe.protocol.grammar import Block
from labpipe.protocol.source import Role
from labpipe.protocol.values import FileStem, Line, Remark, Text, file_inside, one_or_several
from labpipe.records.declarations import Length, Snake
from labpipe.records.result import Specimen
from labpipe.units import parse_quantity

SHEET_NAME = "test.yaml"
_NAME = r"[a-z][a-z0-9_]*"
_BARE = r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*"
"""A number without a unit."""


def _nothing_is_empty(value: object) -> object:
    return {} if value is None else value


class SheetSpecimen(Block):
    """What was tested: samples are cut from a spool, spools belong to a type."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Length]

    type: Line
    spool: Line
    sample: Line
    length: Length | None = Field(None, description="Free length; overrides the protocol's")
    bundle: SheetBundle | None = Field(None, description="What a harness bundle is made of")
    labels: Annotated[dict[Snake, Line], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="Any other words on the specimen, by name"
    )

    @property
    def dimensions(self) -> dict[str, float]:
        """Lengths by name, m."""
        length = {} if self.length is None else {"length": self.length}
        return length | dict(self.__pydantic_extra__)

    @property
    def record(self) -> Specimen:
        """The specimen in the words of the rest of labpipe; lengths in m."""
        bundle = None if self.bundle is None else self.bundle.record
        named = (self.type, self.spool, self.sample)
        return Specimen(*named, self.dimensions, bundle, self.labels)

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Refuse dimensions that look like a misspelt key, and labels that are called like keys."""
        if not isinstance(data, Mapping):
            return []
        known = [*cls.keys(), "span"]
        faults = [_misspelt(str(key), known) for key in data if _is_misspelt(str(key), known)]
        misspelt = {fault.path[0] for fault in faults}
        faults += [
            _no_dimension(str(key), value)
            for key, value in data.items()
            if key not in misspelt and key not in known and _is_no_length(value)
        ]
        labels = data.get("labels")
        taken = [key for key in labels if key in known] if isinstance(labels, Mapping) else []
        return faults + [_taken(key) for key in taken]


def _is_misspelt(key: str, known: list[str]) -> bool:
    if key in known:
        return False
    if re.fullmatch(_NAME, key) is None:
        return True
    return bool(difflib.get_close_matches(key, known, n=1, cutoff=0.8))


def _misspelt(key: str, known: list[str]) -> Fault:
    small = re.sub(r"\W+", "_", key.casefold())
    remedy = did_you_mean(key, known)
    if small != key and re.fullmatch(_NAME, small):
        remedy = f"Write it as {small!r}."
    expected = "a known key, or the name of a dimension in small letters"
    return Fault((key,), expected, repr(key), remedy, "key")


def _is_no_length(value: object) -> bool:
    """Tell a word, or a quantity that is no length: a label rather than a dimension."""
    try:
        parse_quantity(value, "m")
    except ValueError:
        return isinstance(value, str) and re.fullmatch(_BARE, value) is None
    return False


def _no_dimension(key: str, value: object) -> Fault:
    expected = "a dimension, which is a length with its unit such as '2 mm'"
    remedy = f"Write other words on the specimen as 'labels: {{{key}: {value}}}'."
    return Fault((key,), expected, shown(value), remedy, "key")


def _taken(key: str) -> Fault:
    expected = "a label that is not called like a key of 'specimen'"
    return Fault(
        ("labels", key), expected, repr(key), "Write it one level up, or rename it.", "key"
    )


COPY_IT = "Copy the export into the folder of the test and name it from there."


def _listed(value: object) -> object:
    return [value] if isinstance(value, str) else value


FileNames = Annotated[
    tuple[Annotated[str, file_inside("the folder of the test", COPY_IT)], ...],
    BeforeValidator(_listed),
    Field(min_length=1),
    one_or_several({"type": "string"}),
]


def _date(value: object) -> date | None:
    if value is None or type(value) is date:
        return value
    try:
        return date.fromisoformat(str(value))
    except ValueError as error:
        raise error_of(expected="a date such as 2026-03-04", found=value) from error


Day = Annotated[
    date | None,
    BeforeValidator(_date),
    WithJsonSchema({"type": ["string", "null"], "format": "date"}),
]


class Override(Block):
    """A value of the protocol that this test changes, and why."""

    value: Any
    because: Text


class TestSheet(Block):
    """One test: a specimen, a protocol and the exports."""

    __test__ = False  # not a test of this project, whatever its name suggests to pytest

    test: FileStem
    protocol: Text = Field(description="Name of a protocol, or a path to one")
    specimen: SheetSpecimen
    date: Day = None
    operator: Remark = ""
    files: dict[Role, FileNames] = Field(
        min_length=1, description="By role: a file, or the parts of one recording in order"
    )
    overrides: Annotated[dict[str, Override], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="By dotted key of the protocol"
    )


_HEAD = "# One test: what was tested, and which exports belong to it.\n"
_COMMENTS = {
    "protocol": "name of a protocol, or a path beside this file",
    "specimen": "samples are cut from a spool, spools belong to a type",
    "files": "role: file in this folder, or a list of the parts of one recording",
    "overrides": "values of the protocol that this test changes, and why",
}
_EXAMPLE = "# overrides:                # values of the protocol that this test changes, and why\n"
_EXAMPLES = {
    "force": "sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}",
    "frame": "sources.frame.channels.force.unit: {value: N, because: the export says none}",
}
"""An override that makes sense, by the role of an export."""


def test_sheet_faults(data: Mapping[str, object]) -> list[Fault]:
    """Find what is wrong with the values of a test sheet before it is written.

    Parameters
    ----------
    data : with the keys of ``test.yaml``

    Returns
    -------
    The faults, with their paths in `data`.
    """
    try:
        TestSheet.model_validate(data)
    except ValidationError as error:
        return faults_of(error, data=data, keys=())
    return []


def write_test_sheet(data: Mapping[str, object]) -> str:
    """Write a test sheet as commented YAML.

    Parameters
    ----------
    data : with the keys of ``test.yaml``, every value as text, list or block

    Returns
    -------
    The text; reading it gives the same values.
    """
    parts = [_HEAD, *(_entry(key, value) for key, value in data.items())]
    return "".join(parts if "overrides" in data else [*parts, _example(data)])


def _example(data: Mapping[str, object]) -> str:
    files = data.get("files")
    roles = [role for role in _EXAMPLES if isinstance(files, Mapping) and role in files]
    return f"{_EXAMPLE}#   {_EXAMPLES[roles[0] if roles else 'force']}\n"


def _entry(key: str, value: object) -> str:
    """Write one key of the sheet with its comment."""
    if key == "date" and isinstance(value, str):
        value = date.fromisoformat(value)  # else YAML would put it in quotes
    # PyYAML writes the rarer line breaks as they are, and reads them back as blanks.
    plain = json.dumps(value, ensure_ascii=False, default=str)
    escaped = any(mark in plain for mark in "\x85\u2028\u2029")
    text = yaml.safe_dump(
        {key: value}, sort_keys=False, allow_unicode=not escaped, width=float("inf"), indent=2
    )
    first, _, rest = text.partition("\n")
    if key not in _COMMENTS or (isinstance(value, str) and rest):
        return text  # a comment in the middle of a text would become part of it
    return f"{first:<27} # {_COMMENTS[key]}\n{rest}"
