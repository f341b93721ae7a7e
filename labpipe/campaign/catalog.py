"""The catalog of a campaign: an SQLite file with states and results, for fast status and queries.

It can be rebuilt: tables ``tests``, ``results`` and ``inputs`` copy the content of the files of
tests. Only two tables have no other source: ``seen`` (state of these files at the last update) and
``running`` (claims of processes that work on tests).
"""

from __future__ import annotations

import os
import socket
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import astuple, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Final

import psutil

from labpipe.campaign.catalog_rows import (
    RESULT_COLUMNS,
    TEST_COLUMNS,
    Entry,
    FileState,
    Inputs,
    ResultRow,
    TestRow,
)
from labpipe.errors import StoreError, UsageError
from labpipe.messages import format_sentence
from labpipe.store.replace import storing

CATALOG: Final = "catalog.sqlite"
SCHEMA: Final = 2
"""Version of the tables, in ``user_version`` of the file; a newer one is refused."""
PROGRAM: Final = 0x4C425043
"""``application_id`` of the file: the letters LBPC."""
TABLES: Final = ("tests", "results", "inputs", "seen", "running")


def _columns(row: type[TestRow | ResultRow]) -> str:
    """Return the columns of a table in SQL: text, or a number that may be missing."""
    kinds = {"str": "text not null", "float | None": "real"}
    return ", ".join(f"{field.name} {kinds[str(field.type)]}" for field in fields(row))


_TABLES = f"""
create table tests ({_columns(TestRow)}, primary key (folder)) without rowid;
create table results (
    folder text not null, place integer not null, {_columns(ResultRow)},
    primary key (folder, place)
) without rowid;
create table inputs (
    folder text not null, place integer not null, role text not null, file text not null,
    sha256 text not null, primary key (folder, place)
) without rowid;
create table seen (folder text primary key, content text not null, marks text not null);
create table running (
    folder text primary key, host text not null, pid integer not null, process text not null,
    since real not null
);
"""
MAX_CLAIM_AGE = 24 * 3600.0
"""Age of a claim of another host, s, above which it is ignored; no test takes as long."""


@dataclass(frozen=True, slots=True)
class Claim:
    """The claim of a process on a test, which other processes then leave alone.

    Parameters
    ----------
    host : name of its machine, and of its container if it has one
    pid : process id
    process : start of the process, s since 1970; a later process may have the same id
    since : time of the claim, s since 1970
    """

    host: str
    pid: int
    process: str
    since: float

    @property
    def machine(self) -> str:
        """Return the name of the machine."""
        return self.host.split()[0]


def new_claim() -> Claim:
    """Make a claim of this process."""
    return Claim(_host(), os.getpid(), str(psutil.Process().create_time()), time.time())


def is_alive(claim: Claim) -> bool:
    """Return whether the process of a claim still works.

    Parameters
    ----------
    claim : of any process

    Returns
    -------
    For a process of this host, whether it is alive; for one of another host, whether its claim is
    younger than `MAX_CLAIM_AGE`.
    """
    if claim.host != _host():
        return abs(time.time() - claim.since) < MAX_CLAIM_AGE
    # s by which the start of a process moves when the clock of the machine is set
    max_clock_step = 2.0
    try:
        process = psutil.Process(claim.pid)
        is_dead = process.status() in {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
        return not is_dead and abs(process.create_time() - float(claim.process)) < max_clock_step
    except psutil.AccessDenied:
        return True
    except (psutil.NoSuchProcess, ValueError):  # ValueError: a claim of an earlier labpipe
        return False


@cache
def _host() -> str:
    """Return the name of the machine with its namespace of process ids."""
    namespace = ""
    with suppress(OSError):
        namespace = str(Path("/proc/self/ns/pid").readlink())
    return f"{socket.gethostname()} {namespace}".strip()


class Catalog:
    """An open catalog. SQLite errors are raised as `StoreError`.

    Parameters
    ----------
    connection : to the file, or to memory
    path : of the file, for messages
    in_memory : whether it is a private copy in memory, which is lost at the end
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, *, in_memory: bool) -> None:
        self._connection, self.path, self.in_memory = connection, path, in_memory

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Run several changes in one transaction."""
        with sqlite_errors(self.path), self._connection:  # commits, or rolls back
            self._connection.execute("begin immediate")
            yield self._connection

    def _all(self, sql: str, *values: object) -> list[Any]:
        with sqlite_errors(self.path):
            return self._connection.execute(sql, values).fetchall()

    def read_rows(self, folder: str | None = None) -> dict[str, TestRow]:
        """Read rows of ``tests`` by folder.

        Parameters
        ----------
        folder : of one test; None for all tests
        """
        rows = self._select("tests", TEST_COLUMNS, folder)
        return {row[0]: TestRow(*row) for row in rows}

    def read_file_states(self, folder: str | None = None) -> dict[str, FileState]:
        """Read the recorded states of the files of tests by folder.

        Parameters
        ----------
        folder : of one test; None for all tests
        """
        rows = self._select("seen", ("folder", "content", "marks"), folder)
        return {folder: FileState(*state) for folder, *state in rows}

    def _select(self, table: str, columns: Sequence[str], folder: str | None) -> list[Any]:
        sql = f"select {', '.join(columns)} from {table}"
        return self._all(sql) if folder is None else self._all(f"{sql} where folder = ?", folder)

    def read_results(self, folder: str) -> tuple[ResultRow, ...]:
        """Read the results of a test, in order.

        Parameters
        ----------
        folder : of the test
        """
        columns = ", ".join(RESULT_COLUMNS)
        sql = f"select {columns} from results where folder = ? order by place"
        return tuple(ResultRow(*row) for row in self._all(sql, folder))

    def has_failed_results(self) -> bool:
        """Return whether any result failed in a test that is not rejected."""
        sql = (
            "select 1 from results join tests on tests.folder = results.folder"
            " where results.status = 'failed' and tests.state <> 'rejected' limit 1"
        )
        return bool(self._all(sql))

    def read_inputs(self, folder: str) -> Inputs:
        """Read role, file and SHA-256 of the exports of a test, in order.

        Parameters
        ----------
        folder : of the test
        """
        sql = "select role, file, sha256 from inputs where folder = ? order by place"
        return tuple(self._all(sql, folder))

    def put(self, entries: Iterable[Entry], before: Mapping[str, FileState] | None = None) -> None:
        """Write entries of tests.

        Parameters
        ----------
        entries : of the tests
        before : recorded states when the update began; a test with another recorded state by now
            was written by another process and is skipped. None to write all
        """
        with self._writing() as connection:
            stored = self.read_file_states() if before is not None else {}
            for entry in entries:
                folder = entry.row.folder
                if before is None or stored.get(folder) == before.get(folder):
                    _put(connection, entry)

    def remove(self, folders: Iterable[str]) -> None:
        """Remove tests.

        Parameters
        ----------
        folders : of the tests
        """
        with self._writing() as connection:
            for folder in folders:
                for table in ("tests", "results", "inputs", "seen"):
                    connection.execute(f"delete from {table} where folder = ?", (folder,))

    def read_claims(self) -> dict[str, Claim]:
        """Read claims of live processes by folder of the test."""
        rows = self._all("select folder, host, pid, process, since from running")
        claims = {folder: Claim(*rest) for folder, *rest in rows}
        return {folder: claim for folder, claim in claims.items() if is_alive(claim)}

    def claim(self, folder: str) -> bool:
        """Claim a test for this process.

        Parameters
        ----------
        folder : of the test

        Returns
        -------
        False if another live process has claimed it.
        """
        with self._writing() as connection:
            if folder in self.read_claims():
                return False
            values = (folder, *astuple(new_claim()))
            connection.execute("insert or replace into running values (?, ?, ?, ?, ?)", values)
        return True

    def release(self, *folders: str) -> None:
        """Release claims.

        Parameters
        ----------
        folders : of tests claimed by this process, or by dead ones
        """
        with self._writing() as connection:
            sql = "delete from running where folder = ?"
            connection.executemany(sql, [(folder,) for folder in folders])

    def release_dead(self) -> None:
        """Delete the claims of processes that have ended."""
        claimed = {folder for (folder,) in self._all("select folder from running")}
        if dead := claimed - self.read_claims().keys():
            self.release(*dead)

    @contextmanager
    def copy(self) -> Iterator[sqlite3.Connection]:
        """Open a copy in memory for a query, which locks no other process out."""
        with sqlite_errors(self.path), closing(_connect(None)) as memory:
            self._connection.backup(memory)
            yield memory


@contextmanager
def sqlite_errors(path: Path) -> Iterator[None]:
    """Raise SQLite errors as `StoreError`.

    Parameters
    ----------
    path : of the catalog
    """
    try:
        yield
    except sqlite3.Error as error:
        code = _error_code(error)
        raise StoreError.about(
            "campaign.catalog_in_use" if code in _BUSY
            else "campaign.catalog_refused" if code in _REFUSED else "campaign.bad_catalog",
            path, found=error,
        ) from error  # fmt: skip


_BUSY: Final = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
_REFUSED: Final = {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL}


def _error_code(error: sqlite3.Error) -> int:
    """Return the primary result code of an SQLite error; 0 if it has none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _put(connection: sqlite3.Connection, entry: Entry) -> None:
    folder = entry.row.folder
    state = (folder, *astuple(entry.file_state))
    connection.execute("insert or replace into seen values (?, ?, ?)", state)
    if entry.is_row_unchanged:
        return
    for table in ("tests", "results", "inputs"):
        connection.execute(f"delete from {table} where folder = ?", (folder,))
    placeholders = ", ".join("?" * len(TEST_COLUMNS))
    connection.execute(f"insert into tests values ({placeholders})", astuple(entry.row))
    placeholders = ", ".join("?" * (len(RESULT_COLUMNS) + 2))
    results = [(folder, place, *astuple(result)) for place, result in enumerate(entry.results)]
    connection.executemany(f"insert into results values ({placeholders})", results)
    inputs = [(folder, place, *export) for place, export in enumerate(entry.inputs)]
    connection.executemany("insert into inputs values (?, ?, ?, ?, ?)", inputs)


def _connect(path: Path | None) -> sqlite3.Connection:
    """Connect to a file, or to memory, in autocommit mode with explicit transactions."""
    lock_timeout = 60.0  # s to wait for another process that writes
    connection = sqlite3.connect(
        path or ":memory:", timeout=lock_timeout, isolation_level=None, check_same_thread=False
    )
    connection.execute("pragma synchronous = normal")  # a catalog can be rebuilt
    return connection


def can_write(path: Path) -> bool:
    """Return whether a catalog, and files beside it, can be written.

    Parameters
    ----------
    path : of the catalog
    """
    return os.access(path.parent, os.W_OK | os.X_OK) and (
        not path.exists() or os.access(path, os.W_OK)
    )


class NoCatalog(Exception):  # noqa: N818  not an error: the catalog is rebuilt
    """There is no usable catalog; the message says why."""


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
        raise NoCatalog(format_sentence("campaign.missing_catalog"))
    is_writable = can_write(path)
    try:
        with ExitStack() as opened:
            connection = opened.enter_context(closing(_connect(path)))
            _check_tables(connection, path)
            if is_writable:
                opened.pop_all()
                return Catalog(connection, path, in_memory=False)
            memory = _connect(None)
            connection.backup(memory)
            return Catalog(memory, path, in_memory=True)
    except sqlite3.DatabaseError as error:
        if is_writable and _error_code(error) in _BUSY | _REFUSED:
            with sqlite_errors(path):
                raise
        raise _damaged(error) from error


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
    is_writable = can_write(path)
    if is_writable:
        with storing(path):
            if path.exists() and keep_old:
                path.replace(path.with_name(f"{CATALOG}.damaged"))
            for ending in ("", "-wal", "-shm", "-journal"):
                path.with_name(CATALOG + ending).unlink(missing_ok=True)
    with sqlite_errors(path):
        connection = _connect(path if is_writable else None)
        connection.executescript(
            f"begin immediate; {_TABLES} pragma application_id = {PROGRAM};"
            f" pragma user_version = {SCHEMA}; commit;"
        )
    return Catalog(connection, path, in_memory=not is_writable)


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Raise for newer, foreign and damaged files."""
    (program,) = connection.execute("pragma application_id").fetchone()
    (version,) = connection.execute("pragma user_version").fetchone()
    tables = {name for (name,) in connection.execute("select name from sqlite_schema")}
    if program != PROGRAM and tables:
        raise UsageError.about("campaign.foreign_catalog", path)
    if version > SCHEMA:
        raise UsageError.about("campaign.newer_catalog", path, known=SCHEMA, found=version)
    missing = {*TABLES} - tables
    if missing or version != SCHEMA:
        raise _damaged("without " + (", ".join(sorted(missing)) or "a version"))
    (sound,) = connection.execute("pragma quick_check(1)").fetchone()
    if sound != "ok":
        raise _damaged(sound)


def _damaged(why: object) -> NoCatalog:
    return NoCatalog(format_sentence("campaign.damaged_catalog", why=why))
