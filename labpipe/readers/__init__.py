"""Find the reader of an export by its content, and describe files of unknown formats."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from labpipe.errors import ReadError
from labpipe.readers.number_table import split_head
from labpipe.readers.raw_files import is_binary, normalise_content, read_head, split_lines
from labpipe.readers.workbooks import is_locked, is_workbook, open_sheets
from labpipe.records.quality import Severity
from labpipe.records.recording import EXPORT_FORMATS, ExportFormat

if TYPE_CHECKING:
    from labpipe.readers.channels import ChannelChoice
    from labpipe.records.recording import Recording

__all__ = ["READERS", "Reader", "describe_unknown", "read_export", "recognise_export"]
_EXPORT_REMEDY = "Export the recording in one of these formats."
_CARD_REMEDY = (
    "If a testing machine wrote it, describe its layout in a dialect card of about 12 lines: see"
    " docs/how-to/new-dialect.md."
)


class Reader(ExportFormat):
    """The reader of a format, whose module is imported on first use."""

    def recognise(self, path: Path) -> bool:
        """Return whether a file has this format, by its content."""
        is_possible = self.is_workbook if is_workbook(path) else self.is_text
        return is_possible and bool(import_module(self.module).recognise(path))

    def read(self, path: Path, **choices: object) -> Recording:
        """Read a file; an unusable time axis causes a note of severity error, not an exception."""
        recording: Recording = import_module(self.module).read(path, **choices)
        return recording


READERS: dict[str, Reader] = {x.name: Reader(*x) for x in EXPORT_FORMATS}
"""Reader of each format, keyed by name of the format."""


def recognise_export(path: Path) -> Reader:
    """Find the reader of an export by its content.

    Parameters
    ----------
    path : the export

    Returns
    -------
    The reader.

    Raises
    ------
    ReadError
        If the file cannot be opened, is empty, or is of an unknown format.
    """
    for reader in READERS.values():
        if reader.recognise(path):
            return reader
    if is_workbook(path):
        open_sheets(path)  # raises an error if the workbook cannot be opened
    kind, remedy = describe_unknown(path)
    formats = ", ".join(READERS)
    raise ReadError.about("readers.unknown_format", path, formats=formats, kind=kind, remedy=remedy)


def read_export(
    path: Path,
    reader: str | Sequence[str] | None = None,
    channels: Sequence[ChannelChoice] | None = None,
    *,
    dialect: Sequence[str] | None = None,
    part: str | None = None,
) -> Recording:
    """Read an export for processing.

    Parameters
    ----------
    path : the export
    reader : name of the allowed format, or names of several; None for any
    channels : names or paths of the wanted channels, None for all; the recording contains only
        these and their time axes
    dialect : names of dialect cards, one of which must fit a load-frame export
    part : name of the wanted specimen or sheet of a load-frame export with several

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If the content is of another format, is damaged, lacks a wanted channel, or has a time axis
        that runs backwards or is not finite.
    """
    reader_names = [reader] if isinstance(reader, str) else list(reader or READERS)
    allowed_readers = [READERS[name] for name in reader_names]  # tried before others are imported
    export_reader = next((x for x in allowed_readers if x.recognise(path)), None)
    if export_reader is None:
        try:
            export_reader = recognise_export(path)
        except ReadError:
            if not (dialect and reader_names == ["load-frame"] and path.is_file()):
                raise
            export_reader = READERS["load-frame"]  # a named card may fit although none recognises
    if export_reader.name not in reader_names:
        names, name = " or ".join(reader_names), export_reader.name
        raise ReadError.about("readers.other_format", path, allowed=names, name=name)
    choices = {"dialect": dialect, "part": part} if export_reader.name == "load-frame" else {}
    recording = export_reader.read(path, channels=channels, **choices)
    for note in recording.notes:
        if note.severity is Severity.ERROR:
            raise ReadError.about("readers.unusable_time", path, note.where, note=note.message)
    return recording


class UnknownFile(NamedTuple):
    """A file of an unknown format.

    Parameters
    ----------
    kind : description of the content, such as ``a C3D file (motion capture)``
    remedy : what the operator can do
    """

    kind: str
    remedy: str


def describe_unknown(path: Path) -> UnknownFile:
    """Describe the content of a file of an unknown format, with a remedy.

    Parameters
    ----------
    path : the file
    """
    head = read_head(path)
    if is_locked(path):
        return UnknownFile("a workbook with a password", "Save a copy of it without a password.")
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip().decode("latin-1")
    text = (files("labpipe.readers") / "unknown_files.toml").read_text(encoding="utf-8")
    for known_kind in tomllib.loads(text)["file"]:
        if start.startswith(known_kind["starts"]):
            return UnknownFile(known_kind["what"], known_kind["remedy"])
    content = normalise_content(head)
    if is_binary(content):
        return UnknownFile("binary data of an unknown kind", _EXPORT_REMEDY)
    lines = split_lines(content.data.decode("utf-8", errors="replace"))
    first_line = next((line.strip()[:40] for line in lines if line.strip()), "")
    if split_head(lines, "\t;, ") is not None:
        return UnknownFile(f"a table that begins with '{first_line}'", _CARD_REMEDY)
    return UnknownFile(f"text that begins with '{first_line}'", _EXPORT_REMEDY)
