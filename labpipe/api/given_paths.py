"""Check and convert path and field arguments: one or several, of any kind."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

from labpipe.errors import UsageError, error_text, refusal

PathLike: TypeAlias = str | os.PathLike[str]
Paths: TypeAlias = PathLike | Iterable[PathLike]


def path_of(location: PathLike) -> Path:
    """Convert to a path, and check that the system accepts it; it need not exist.

    Parameters
    ----------
    location : of a file or a folder

    Raises
    ------
    UsageError
        If the path is impossible: too long, with a zero byte, in a folder without access.
    """
    path = Path(location)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return path  # the caller reports missing files
    except OSError as error:
        raise UsageError(refusal(error)) from error
    except ValueError as error:
        text = error_text(
            repr(os.fspath(location)),
            "",
            expected="a path",
            found=str(error),
            remedy="Name a file or a folder.",
        )
        raise UsageError(text) from error
    return path


def paths_of(locations: Paths) -> list[Path]:
    """Convert one path, or several.

    Parameters
    ----------
    locations : as `path_of`, or a list of them

    Raises
    ------
    UsageError
        If the list is empty, or a path is impossible.
    """
    several = [locations] if isinstance(locations, str | os.PathLike) else list(locations)
    if not several:
        text = error_text(
            "folder",
            "",
            expected="a folder with processed tests",
            found="an empty list",
            remedy="Name one.",
        )
        raise UsageError(text)
    return [path_of(location) for location in several]


def fields_of(by: str | Sequence[str]) -> tuple[str, ...]:
    """Convert the name of one field, or of several, to a tuple."""
    return (by,) if isinstance(by, str) else tuple(by)
