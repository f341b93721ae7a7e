"""Descriptions of files that no reader recognises, with a remedy."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from labpipe.readers.raw_files import as_content, is_binary, read_head, split_lines
from labpipe.readers.text_cells import is_sample, split_line
from labpipe.readers.workbooks import is_locked

_EXPORT_KNOWN = "Export the recording in one of these formats."
_WRITE_CARD = (
    "If a testing machine's program wrote it, a card of a dozen lines makes labpipe read it: see"
    " docs/how-to/new-dialect.md."
)


class UnknownFile(NamedTuple):
    """A file of an unknown format.

    Parameters
    ----------
    kind : such as ``a C3D file (motion capture)``
    remedy : what the operator can do
    """

    kind: str
    remedy: str


def describe_unknown(path: Path) -> UnknownFile:
    """Describe a file of an unknown format.

    Parameters
    ----------
    path : the file
    """
    head = read_head(path)
    if len(head) >= 512 and head[1] == 0x50 and 0 < head[0] < 64:
        return UnknownFile(
            "a C3D file (motion capture), which is recognised but not read", _EXPORT_KNOWN
        )
    if is_locked(path):
        return UnknownFile("a workbook with a password", "Save a copy of it without a password.")
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip().decode("latin-1")
    text = (files("labpipe.readers") / "unknown_files.toml").read_text(encoding="utf-8")
    for known in tomllib.loads(text)["file"]:
        if start.startswith(known["starts"]):
            return UnknownFile(known["what"], known["remedy"])
    content = as_content(head)
    if is_binary(content):
        return UnknownFile("binary data of an unknown kind", _EXPORT_KNOWN)
    lines = split_lines(content.data.decode("utf-8", errors="replace"))
    first_line = next((line.strip()[:40] for line in lines if line.strip()), "")
    if any(_has_table(lines, separator) for separator in "\t;, "):
        return UnknownFile(f"a table that begins with '{first_line}'", _WRITE_CARD)
    return UnknownFile(f"text that begins with '{first_line}'", _EXPORT_KNOWN)


def _has_table(lines: Sequence[str], separator: str) -> bool:
    """Return whether two successive lines hold several numbers each."""
    rows = ([cell for cell in split_line(line, separator) if cell.strip()] for line in lines)
    are_samples = (len(row) > 1 and is_sample(row) for row in rows)
    return any(one and two for one, two in pairwise(are_samples))
