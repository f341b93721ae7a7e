"""The file of a catalog: opened, made, refused where it is newer, put aside where it is damaged."""

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
    connected,
    in_autocommit,
    make_tables,
    speaking,
)
from labpipe.campaign.remote_drives import is_on_this_machine
from labpipe.errors import UsageError, error_text
from labpipe.store.replace import storing

_DAMAGED: Final = "it was damaged ({})"
_NOT_DAMAGED: Final = ("lock", "readonly", "unable to open", "busy")
"""Words of SQLite for what says nothing about the file."""


class NoCatalog(Exception):  # noqa: N818  no error: it is made anew then
    """There is no sound catalog.

    Parameters
    ----------
    why : what there is
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)


def open_catalog(folder: Path) -> Catalog:
    """Open the catalog of a campaign.

    Parameters
    ----------
    folder : of the results; where it cannot be written, a copy in memory is opened

    Raises
    ------
    NoCatalog
        If there is none, or a damaged one.
    UsageError
        If it is of a newer labpipe, or no catalog at all.
    """
    path = folder / CATALOG
    if not path.is_file():
        raise NoCatalog("no file" if path.exists() else "there was none")
    try:
        with closing(connected(path, "ro")) as connection:
            _check(connection, path)
        if not can_write(path):
            return _copied(path)
        connection = connected(path, "rw")
        _set_journal(connection, path)
        return Catalog(connection, path, in_memory=False)
    except sqlite3.DatabaseError as error:
        if any(word in str(error) for word in _NOT_DAMAGED):
            with speaking(path):
                raise
        raise NoCatalog(_DAMAGED.format(error)) from error


def new_catalog(folder: Path, *, keep_old: bool = True) -> Catalog:
    """Make an empty catalog.

    Parameters
    ----------
    folder : of the results, made if it is not there; where it cannot be written, the catalog is
        made in memory
    keep_old : whether what stood there is put aside, as ``catalog.sqlite.damaged``

    Raises
    ------
    StoreError
        If the system refuses.
    """
    path = folder / CATALOG
    if not can_write(path):
        memory = in_autocommit(":memory:")
        make_tables(memory)
        return Catalog(memory, path, in_memory=True)
    with storing(path):
        if path.exists() and keep_old:
            path.replace(path.with_name(f"{CATALOG}.damaged"))
        for ending in ("", "-wal", "-shm", "-journal"):
            path.with_name(CATALOG + ending).unlink(missing_ok=True)
    with speaking(path):
        connection = connected(path, "rwc")
        _set_journal(connection, path)
        make_tables(connection)
    return Catalog(connection, path, in_memory=False)


def _copied(path: Path) -> Catalog:
    memory = in_autocommit(":memory:")
    with closing(connected(path, "ro")) as connection:
        connection.backup(memory)
    return Catalog(memory, path, in_memory=True)


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse what is newer, or no catalog; tell what is damaged."""
    (program,) = connection.execute("pragma application_id").fetchone()
    (version,) = connection.execute("pragma user_version").fetchone()
    tables = {name for (name,) in connection.execute("select name from sqlite_schema")}
    if program != PROGRAM and tables:
        found = "a data base of another program"
        raise UsageError(
            error_text(path, "", expected="a catalog of labpipe", found=found,
                      remedy="Move it away: the catalog is made from the files of the tests.")
        )  # fmt: skip
    if version > SCHEMA:
        remedy = (
            "A newer labpipe made it: use that one, or move it away, and it is made anew from the"
            " files of the tests."
        )
        expected = f"a catalog of the version {SCHEMA}"
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
    """Let readers and a writer work at a time, where the drive keeps the promises this needs."""
    mode = "wal" if is_on_this_machine(path) else "delete"
    with suppress(sqlite3.OperationalError):  # in use: it stays as it is
        connection.execute(f"pragma journal_mode = {mode}")
    connection.execute(
        "pragma synchronous = normal" if mode == "wal" else "pragma synchronous = full"
    )
