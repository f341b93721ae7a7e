"""Writing a test sheet with the comments that a person who edits it needs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date

import yaml
from pydantic import ValidationError

from labpipe.errors import Fault
from labpipe.protocol.faults import faults_of
from labpipe.protocol.sheet import TestSheet

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
