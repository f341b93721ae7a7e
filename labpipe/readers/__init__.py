"""From exports to recordings: one reader per format, recognised by content, never by suffix."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, cast

from labpipe.errors import ReadError
from labpipe.readers.files import unreadable
from labpipe.readers.workbooks import is_workbook, open_sheets

if TYPE_CHECKING:
    from labpipe.readers.channels import Wanted
    from labpipe.records.recording import Recording

__all__ = ["READERS", "Reader", "read_export", "recognise_export"]


class _Format(Protocol):
    """What the module of a format has."""

    def recognise(self, path: Path) -> bool: ...

    def read(self, path: Path, *, channels: Sequence[Wanted] | None = None) -> Recording: ...


class Reader(NamedTuple):
    """One format; its module is imported when it is asked.

    Parameters
    ----------
    name : as protocols write it
    module : in this package
    of_texts, of_workbooks : whether its files can be texts or binary files of their own, and
        whether they can be workbooks
    """

    name: str
    module: str
    of_texts: bool = True
    of_workbooks: bool = False

    def recognise(self, path: Path) -> bool:
        """Tell from the content whether a file is of this format."""
        is_of_kind = self.of_workbooks if is_workbook(path) else self.of_texts
        return is_of_kind and self._format.recognise(path)

    def read(self, path: Path, *, channels: Sequence[Wanted] | None = None) -> Recording:
        """Make a recording of a file, faults of the time axis as notes of severity error."""
        return self._format.read(path, channels=channels)

    @property
    def _format(self) -> _Format:
        return cast("_Format", import_module(f"labpipe.readers.{self.module}"))


READERS: dict[str, Reader] = {
    "dspace-mat": Reader("dspace-mat", "dspace_mat"),
    "dspace-csv": Reader("dspace-csv", "dspace_csv"),
    "dspace-mf4": Reader("dspace-mf4", "dspace_mf4"),
    "motive-csv": Reader("motive-csv", "motive_csv"),
    "motive-xlsx": Reader("motive-xlsx", "motive_csv", of_texts=False, of_workbooks=True),
    "load-frame": Reader("load-frame", "load_frame", of_workbooks=True),
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
        If the file cannot be opened, is empty, or is of no format that is read here.
    """
    for reader in READERS.values():
        if reader.recognise(path):
            return reader
    if is_workbook(path):
        open_sheets(path)  # where it cannot be opened at all, that is what is wrong
    from labpipe.readers.strangers import recognise_stranger

    stranger = recognise_stranger(path)
    raise unreadable(
        path,
        "",
        f"an export of a known format ({', '.join(READERS)})",
        stranger.what,
        stranger.remedy,
    )


def read_export(
    path: Path,
    reader: str | Sequence[str] | None = None,
    channels: Sequence[Wanted] | None = None,
    *,
    dialect: Sequence[str] | None = None,
    part: str | None = None,
) -> Recording:
    """Read an export that is to be processed.

    Parameters
    ----------
    path : the export
    reader : the format, or formats, that it must have; None to take what the content says
    channels : names or paths of the channels wanted, None for all; only these are loaded, with
        their time axes
    dialect : of a load frame's export, the card or cards that it must fit
    part : of a load frame's export, the specimen or sheet wanted of one that holds several

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
    found = _recognised_or_named(path, allowed, dialect)
    if found.name not in allowed:
        raise unreadable(
            path,
            "",
            f"a file of the format {' or '.join(allowed)}",
            f"one of the format {found.name}",
            "Name the right file, or change `reader` in the protocol.",
        )
    if found.name == "load-frame":
        from labpipe.readers import load_frame

        recording = load_frame.read(path, channels=channels, dialect=dialect, part=part)
    else:
        recording = found.read(path, channels=channels)
    _refuse_broken_time(recording, path)
    return recording


def _recognised_or_named(
    path: Path, allowed: Sequence[str], dialect: Sequence[str] | None
) -> Reader:
    """The reader by content; where none fits, the load frame's if one of its cards was named."""
    for name in allowed:  # a file is of one format only: spares asking, and loading, the others
        if READERS[name].recognise(path):
            return READERS[name]
    try:
        return recognise_export(path)
    except ReadError:
        if dialect and list(allowed) == ["load-frame"] and path.is_file():
            return READERS["load-frame"]
        raise


def _refuse_broken_time(recording: Recording, path: Path) -> None:
    from labpipe.records.quality import Severity

    for note in recording.notes:
        if note.severity is Severity.ERROR:
            raise unreadable(
                path,
                note.where,
                "time that increases from sample to sample",
                note.message,
                "Export the recording again; it cannot be processed as it is.",
            )
