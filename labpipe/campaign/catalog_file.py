"""Open and make the file of a catalog; refuse newer ones and set damaged ones aside."""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from labpipe.campaign.catalog import (
    CATALOG,
    PROGRAM,
    SCHEMA,
    TABLES,
    Catalog,
    can_write,
    connect_autocommit,
    make_tables,
    open_connection,
    sqlite_errors,
)
from labpipe.campaign.machine import is_on_this_machine
from labpipe.errors import UsageError, error_text
from labpipe.store.replace import storing

_DAMAGED: Final = "it was damaged ({})"
_NOT_DAMAGED: Final = ("lock", "readonly", "unable to open", "busy")
"""Words in SQLite errors that do not mean a damaged file."""


class NoCatalog(Exception):  # noqa: N818  not an error: the catalog is rebuilt
    """There is no usable catalog.

    Parameters
    ----------
    why : there is none
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)


def open_catalog(folder: Path) -> Catalog:
    """Open the catalog of a campaign.

    Parameters
    ----------
    folder : of the results; if read-only, a copy in memory is opened

    Raises
    ------
    NoCatalog
        If there is none, or it is damaged.
    UsageError
        If it was made by a newer labpipe, or is not a catalog.
    """
    path = folder / CATALOG
    if not path.is_file():
        raise NoCatalog("no file" if path.exists() else "there was none")
    try:
        with closing(open_connection(path, "ro")) as connection:
            _check_tables(connection, path)
        if not can_write(path):
            return _copy_to_memory(path)
        connection = open_connection(path, "rw")
        _set_journal(connection, path)
        return Catalog(connection, path, in_memory=False)
    except sqlite3.DatabaseError as error:
        if any(word in str(error) for word in _NOT_DAMAGED):
            with sqlite_errors(path):
                raise
        raise NoCatalog(_DAMAGED.format(error)) from error


def new_catalog(folder: Path, *, keep_old: bool = True) -> Catalog:
    """Make an empty catalog.

    Parameters
    ----------
    folder : of the results, made if missing; if read-only, the catalog is made in memory
    keep_old : whether an existing file is kept as ``catalog.sqlite.damaged``

    Raises
    ------
    StoreError
        If the system refuses.
    """
    path = folder / CATALOG
    if not can_write(path):
        memory = connect_autocommit(":memory:")
        make_tables(memory)
        return Catalog(memory, path, in_memory=True)
    with storing(path):
        if path.exists() and keep_old:
            path.replace(path.with_name(f"{CATALOG}.damaged"))
        for ending in ("", "-wal", "-shm", "-journal"):
            path.with_name(CATALOG + ending).unlink(missing_ok=True)
    with sqlite_errors(path):
        connection = open_connection(path, "rwc")
        _set_journal(connection, path)
        make_tables(connection)
    return Catalog(connection, path, in_memory=False)


def _copy_to_memory(path: Path) -> Catalog:
    memory = connect_autocommit(":memory:")
    with closing(open_connection(path, "ro")) as connection:
        connection.backup(memory)
    return Catalog(memory, path, in_memory=True)


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Raise for newer, foreign and damaged files."""
    (program,) = connection.execute("pragma application_id").fetchone()
    (version,) = connection.execute("pragma user_version").fetchone()
    tables = {name for (name,) in connection.execute("select name from sqlite_schema")}
    if program != PROGRAM and tables:
        state = "a database of another program"
        raise UsageError(
            error_text(path, "", expected="a catalog of labpipe", found=state,
                      remedy="Move it away: the catalog is rebuilt from the files of the tests.")
        )  # fmt: skip
    if version > SCHEMA:
        remedy = (
            "A newer labpipe made it: use that version, or move the file away to rebuild it from"
            " the files of the tests."
        )
        expected = f"a catalog of version {SCHEMA}"
        raise UsageError(
            error_text(path, "", expected=expected, found=f"version {version}", remedy=remedy)
        )
    missing = {*TABLES} - tables
    if missing or version != SCHEMA:
        raise NoCatalog(_DAMAGED.format(f"without {', '.join(sorted(missing)) or 'a version'}"))
    (sound,) = connection.execute("pragma quick_check(1)").fetchone()
    if sound != "ok":
        raise NoCatalog(_DAMAGED.format(sound))


def _set_journal(connection: sqlite3.Connection, path: Path) -> None:
    """Allow concurrent readers and a writer, where the drive supports it."""
    mode = "wal" if is_on_this_machine(path) else "delete"
    with suppress(sqlite3.OperationalError):  # in use: the mode stays
        connection.execute(f"pragma journal_mode = {mode}")
    connection.execute(
        "pragma synchronous = normal" if mode == "wal" else "pragma synchronous = full"
    )
