"""Read the folder of a test: exports, each by its own reader, and other files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import LabpipeError, ReadError
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.values import has_control_characters
from labpipe.readers import Reader, recognise_export
from labpipe.readers.unknown_files import describe_unknown
from labpipe.records.recording import Recording

_IGNORED_SUFFIXES = frozenset({".yaml", ".yml", ".md", ".ini"})


@dataclass(frozen=True, slots=True, eq=False)
class InspectedExport:
    """An export in the folder of a test.

    Parameters
    ----------
    path : of the file
    recording : its content
    """

    path: Path
    recording: Recording

    @property
    def name(self) -> str:
        """Return the name of the file, as a test sheet writes it."""
        return self.path.name

    @property
    def reader(self) -> str:
        """Return the name of the reader of its format."""
        return self.recording.reader


@dataclass(frozen=True, slots=True, eq=False)
class FolderContents:
    """The files of a folder.

    Parameters
    ----------
    folder : without its subfolders
    exports : those that can be read, by name
    others : names of other files, and what each appears to be
    unread : names of exports that cannot be read, and the reason: damaged, truncated, locked
    """

    folder: Path
    exports: tuple[InspectedExport, ...]
    others: dict[str, str]
    unread: dict[str, str]


def read_folder(folder: Path) -> FolderContents:
    """Read the files in the folder of a test; formats are recognised by content.

    Parameters
    ----------
    folder : of the test; a missing folder is empty
    """
    exports, others, unread = list[InspectedExport](), dict[str, str](), dict[str, str]()
    for path in files_in(folder):
        if has_control_characters(path.name):
            others[path.name] = "its name has control characters; rename it"
            continue
        try:
            reader = _reader_of(path)
            if reader is None:
                others[path.name] = describe_unknown(path).what
            else:
                exports.append(InspectedExport(path, reader.read(path)))
        except (LabpipeError, OSError) as error:
            unread[path.name] = str(error).removeprefix(f"{path}").lstrip(":, ")
    return FolderContents(folder, tuple(exports), others, unread)


def _reader_of(path: Path) -> Reader | None:
    """Return the reader of an export; None if its format is unknown."""
    with path.open("rb") as stream:  # raises OSError before the format is recognised
        stream.read(1)
    try:
        return recognise_export(path)
    except ReadError:
        return None


def files_in(folder: Path) -> list[Path]:
    """List the files of a folder that may be exports, by name, without hidden ones.

    Parameters
    ----------
    folder : of a test
    """
    if not folder.is_dir():
        return []
    return [path for path in sorted(folder.iterdir()) if _may_be_export(path)]


def _may_be_export(path: Path) -> bool:
    is_other = (
        path.name == SHEET_NAME or path.suffix in _IGNORED_SUFFIXES or path.name.startswith(".")
    )
    return not is_other and path.is_file()


def folders_of_tests(folder: Path) -> list[Path]:
    """List the test folders of a campaign that hold files, by name.

    Parameters
    ----------
    folder : of a campaign

    Returns
    -------
    The folders; none if the folder is that of a test: it has a test sheet, or no folder with files.
    """
    if (folder / SHEET_NAME).exists() or not folder.is_dir():
        return []
    below = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return [path for path in below if not path.name.startswith(".") and files_in(path)]
