"""Readers of exports: one per format, recognised by content, never by suffix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from labpipe.errors import ReadError
from labpipe.readers.raw_files import unreadable
from labpipe.readers.workbooks import is_workbook, open_sheets
from labpipe.records.quality import Severity
from labpipe.records.recording import EXPORT_FORMATS, ExportFormat

if TYPE_CHECKING:
    from labpipe.readers.channels import ReportOptions
    from labpipe.records.recording import Recording

__all__ = ["READERS", "Reader", "read_export", "recognise_export"]


class _Module(Protocol):
    """Interface of the module of a format."""

    def recognise(self, path: Path) -> bool: ...

    def read(self, path: Path, *, channels: Sequence[ReportOptions] | None = None) -> Recording: ...


@dataclass(frozen=True, slots=True)
class Reader:
    """The reader of a format; its module is imported on first use."""

    format: ExportFormat

    @property
    def name(self) -> str:
        """Return the name of the format, as in protocols."""
        return self.format.name

    def recognise(self, path: Path) -> bool:
        """Return whether the content of a file is of this format."""
        is_of_kind = self.format.is_workbook if is_workbook(path) else self.format.is_text
        return is_of_kind and self._module.recognise(path)

    def read(self, path: Path, *, channels: Sequence[ReportOptions] | None = None) -> Recording:
        """Read a file; faults of the time axis become notes of severity error."""
        return self._module.read(path, channels=channels)

    @property
    def _module(self) -> _Module:
        return cast("_Module", import_module(self.format.module))


READERS: dict[str, Reader] = {
    export_format.name: Reader(export_format) for export_format in EXPORT_FORMATS
}


def recognise_export(path: Path) -> Reader:
    """Find the reader of an export from its content.

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

    unknown = describe_unknown(path)
    expected = f"an export of a known format ({', '.join(READERS)})"
    raise unreadable(path, "", expected, unknown.what, unknown.remedy)


def read_export(
    path: Path,
    reader: str | Sequence[str] | None = None,
    channels: Sequence[ReportOptions] | None = None,
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
        axis that runs backwards (`Reader.read` leaves that as a note, for `labpipe inspect`).
    """
    allowed = [reader] if isinstance(reader, str) else list(reader or READERS)
    export_reader = _find_reader(path, allowed, dialect)
    if export_reader.name not in allowed:
        expected = f"a file of the format {' or '.join(allowed)}"
        remedy = "Name the right file, or change `reader` in the protocol."
        raise unreadable(path, "", expected, f"one of the format {export_reader.name}", remedy)
    if export_reader.name == "load-frame":
        from labpipe.readers import load_frame

        recording = load_frame.read(path, channels=channels, dialect=dialect, part=part)
    else:
        recording = export_reader.read(path, channels=channels)
    for note in recording.notes:
        if note.severity is Severity.ERROR:
            expected = "time that increases from sample to sample"
            remedy = "Export the recording again; it cannot be processed as it is."
            raise unreadable(path, note.where, expected, note.message, remedy)
    return recording


def _find_reader(path: Path, allowed: Sequence[str], dialect: Sequence[str] | None) -> Reader:
    """Return the reader by content; if none fits, that of load frames if a card is named."""
    for name in allowed:  # avoids loading the other readers
        if READERS[name].recognise(path):
            return READERS[name]
    try:
        return recognise_export(path)
    except ReadError:
        if dialect and list(allowed) == ["load-frame"] and path.is_file():
            return READERS["load-frame"]
        raise
