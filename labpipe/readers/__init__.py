"""Readers of exports: one per format, recognised by content, never by suffix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labpipe.errors import ReadError
from labpipe.readers.workbooks import is_workbook, open_sheets
from labpipe.records.quality import Severity
from labpipe.records.recording import EXPORT_FORMATS, ExportFormat

if TYPE_CHECKING:
    from labpipe.readers.channels import ChannelChoice
    from labpipe.records.recording import Recording

__all__ = ["READERS", "Reader", "read_export", "recognise_export"]


@dataclass(frozen=True, slots=True)
class Reader:
    """The reader of a format; its module is imported on first use."""

    format: ExportFormat

    @property
    def name(self) -> str:
        """Return the name of the format, as in protocols."""
        return self.format.name

    @property
    def module(self) -> Any:
        """Return its module, which has the functions `recognise` and `read`."""
        return import_module(self.format.module)

    def recognise(self, path: Path) -> bool:
        """Return whether the content of a file is of this format."""
        is_of_kind = self.format.is_workbook if is_workbook(path) else self.format.is_text
        return is_of_kind and bool(self.module.recognise(path))

    def read(self, path: Path, **choices: object) -> Recording:
        """Read a file; an unusable time axis gives a note of severity error."""
        recording: Recording = self.module.read(path, **choices)
        return recording


READERS: dict[str, Reader] = {
    export_format.name: Reader(export_format) for export_format in EXPORT_FORMATS
}


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
        open_sheets(path)  # raises if it cannot be opened
    from labpipe.readers.unknown_files import describe_unknown

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
    reader : allowed format or formats; None for any
    channels : names or paths of the wanted channels, None for all; only these and their time axes
        are loaded
    dialect : for load-frame exports, the card or cards that must fit
    part : for load-frame exports with several specimens or sheets, the wanted one

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If the content is of another format, is damaged, lacks a wanted channel, or has a time
        axis that runs backwards (for `labpipe inspect`, `Reader.read` gives a note instead).
    """
    allowed = [reader] if isinstance(reader, str) else list(reader or READERS)
    export_reader = _find_reader(path, allowed, dialect)
    if export_reader.name not in allowed:
        names, name = " or ".join(allowed), export_reader.name
        raise ReadError.about("readers.other_format", path, allowed=names, name=name)
    choices = {"dialect": dialect, "part": part} if export_reader.name == "load-frame" else {}
    recording = export_reader.read(path, channels=channels, **choices)
    for note in recording.notes:
        if note.severity is Severity.ERROR:
            raise ReadError.about("readers.unusable_time", path, note.where, note=note.message)
    return recording


def _find_reader(path: Path, allowed: Sequence[str], dialect: Sequence[str] | None) -> Reader:
    """Find the reader by content; if none fits and a card is named, that of load frames."""
    for name in allowed:  # avoids loading the other readers
        if READERS[name].recognise(path):
            return READERS[name]
    try:
        return recognise_export(path)
    except ReadError:
        if dialect and list(allowed) == ["load-frame"] and path.is_file():
            return READERS["load-frame"]
        raise
