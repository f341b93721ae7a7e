"""Paths and fields as people give them: one or several, of any kind, some of them impossible."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

from labpipe.errors import UsageError, error_text, refusal

PathLike: TypeAlias = str | os.PathLike[str]
Paths: TypeAlias = PathLike | Iterable[PathLike]


def path_of(given: PathLike) -> Path:
    """Take a path that the system can be asked about; there need not be anything.

    Parameters
    ----------
    given : of a file or a folder

    Raises
    ------
    UsageError
        If there can be no such path: too long, with a zero byte, in a folder that is closed.
    """
    path = Path(given)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return path  # what is missing is said by whoever needs it
    except OSError as error:
        raise UsageError(refusal(error)) from error
    except ValueError as error:
        text = error_text(
            repr(os.fspath(given)),
            "",
            expected="a path",
            found=str(error),
            remedy="Name a file or a folder.",
        )
        raise UsageError(text) from error
    return path


def paths_of(given: Paths) -> list[Path]:
    """Take one path, or several.

    Parameters
    ----------
    given : as `path_of`, or a list of them

    Raises
    ------
    UsageError
        If there is none, or one cannot be.
    """
    several = [given] if isinstance(given, str | os.PathLike) else list(given)
    if not several:
        text = error_text(
            "folder",
            "",
            expected="a folder with processed tests",
            found="an empty list",
            remedy="Name one.",
        )
        raise UsageError(text)
    return [path_of(each) for each in several]


def fields_of(by: str | Sequence[str]) -> tuple[str, ...]:
    """Take the name of one field, or of several."""
    return (by,) if isinstance(by, str) else tuple(by)
