"""The catalog of a campaign: an SQLite file that can be rebuilt from the files of its tests.

Tables ``tests``, ``results``, ``inputs`` and ``decisions`` copy the content of files. ``seen``
(file stamps), ``running`` (claims of processes) and ``times`` (durations) exist only here and are
not compared.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path, PurePath
from typing import Any, Final

from labpipe.campaign.decisions import Decision
from labpipe.campaign.machine import Claim, is_alive, is_on_this_machine, new_claim
from labpipe.campaign.outcome_rows import ResultRow
from labpipe.errors import StoreError, UsageError, error_text
from labpipe.store.replace import storing

CATALOG: Final = "catalog.sqlite"
SCHEMA: Final = 2
"""Version of the tables, in ``user_version`` of the file; a newer one is refused."""
PROGRAM: Final = 0x4C425043
"""``application_id`` of the file: *LBPC*."""
PENDING, RUNNING, OK, DOUBTFUL, FAILED, STALE, REJECTED = STATES = (
    *("pending", "running", "ok", "doubtful", "failed", "stale", "rejected"),
)
COMPARED: Final = ("tests", "results", "inputs", "decisions")
"""Tables that a rebuild reproduces row for row."""
TABLES: Final = (*COMPARED, "seen", "running", "times")
_TABLES = """
create table tests (
    folder text primary key, test text not null, state text not null, why text not null,
    code text not null, reason text not null, protocol text not null, type text not null,
    spool text not null, sample text not null, date text not null, operator text not null,
    specimen text not null, labpipe text not null, run text not null, failed_run text not null,
    sheet text not null, resolved text not null, decided_by text not null, decided text not null
) without rowid;
create table results (
    folder text not null, place integer not null, name text not null, value real,
    unit text not null, lower real, upper real, level real, estimate real, status text not null,
    code text not null, reason text not null, seal text not null, primary key (folder, place)
) without rowid;
create table inputs (
    folder text not null, place integer not null, role text not null, file text not null,
    sha256 text not null, primary key (folder, place)
) without rowid;
create table decisions (
    place integer primary key, test text not null, run text not null, decision text not null,
    because text not null, "by" text not null, "when" text not null, note text not null,
    applied integer not null
);
create table seen (folder text primary key, content text not null, marks text not null);
create table running (
    folder text primary key, host text not null, pid integer not null, process text not null,
    since real not null
);
create table times (folder text primary key, finished text not null, seconds real not null);
"""


@dataclass(frozen=True, slots=True)
class TestRow:
    """A row of the table ``tests``.

    Parameters
    ----------
    folder : of the test below the campaign, with slashes; the key
    test : its name
    state : one of `STATES` except ``running``
    why : what changed for a stale test, the reason for a rejected one
    code, reason : of a failure, or of the first doubtful result
    protocol, type, spool, sample, date, operator : from summary.json, else the test sheet
    specimen : from summary.json, as JSON
    labpipe : version of the last attempt
    run : key of the results; empty without results
    failed_run : key of the last attempt if it failed
    sheet, resolved : SHA-256 of test sheet and resolved protocol of the last attempt
    decided_by, decided : person and time of a rejection
    """

    __test__ = False  # pytest must not collect it

    folder: str
    test: str = ""
    state: str = PENDING
    why: str = ""
    code: str = ""
    reason: str = ""
    protocol: str = ""
    type: str = ""
    spool: str = ""
    sample: str = ""
    date: str = ""
    operator: str = ""
    specimen: str = "{}"
    labpipe: str = ""
    run: str = ""
    failed_run: str = ""
    sheet: str = ""
    resolved: str = ""
    decided_by: str = ""
    decided: str = ""

    @property
    def attempt(self) -> str:
        """Return the key of the last attempt; empty without any."""
        return self.failed_run or self.run


TEST_COLUMNS: Final = tuple(field.name for field in fields(TestRow))
RESULT_COLUMNS: Final = tuple(field.name for field in fields(ResultRow))


@dataclass(frozen=True, slots=True)
class Seen:
    """State of the files of a test when its row was made.

    Parameters
    ----------
    content : inputs of the test, from `Content.as_text`; empty if not determined
    marks : of the files of its outcome
    """

    content: str = ""
    marks: str = ""


@dataclass(frozen=True, slots=True)
class Entry:
    """Catalog entry of a test.

    Parameters
    ----------
    row : of the table ``tests``
    seen : state of its files
    inputs : role, file and SHA-256 of the exports
    results : of the last successful attempt; both are None if row, inputs and results are
        unchanged
    """

    row: TestRow
    seen: Seen
    inputs: tuple[tuple[str, str, str], ...] | None = None
    results: tuple[ResultRow, ...] | None = None


class Catalog:
    """An open catalog. SQLite errors are raised as `StoreError`.

    Parameters
    ----------
    connection : to a file with the tables
    path : of the file, for messages
    in_memory : whether it is a private copy in memory
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, *, in_memory: bool) -> None:
        self._connection, self.path, self.in_memory = connection, path, in_memory

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Run several changes in one transaction."""
        with sqlite_errors(self.path):
            self._connection.execute("begin immediate")
            try:
                yield self._connection
            except BaseException:
                self._connection.rollback()
                raise
            self._connection.commit()

    def _all(self, sql: str, *values: object) -> list[Any]:
        with sqlite_errors(self.path):
            return self._connection.execute(sql, values).fetchall()

    def rows(self) -> dict[str, TestRow]:
        """Return all rows of ``tests`` by folder."""
        rows = self._all(f"select {', '.join(TEST_COLUMNS)} from tests")
        return {row[0]: TestRow(*row) for row in rows}

    def seen(self) -> dict[str, Seen]:
        """Return the recorded state of files by folder."""
        rows = self._all("select folder, content, marks from seen")
        return {folder: Seen(content, marks) for folder, content, marks in rows}

    def row_of(self, folder: str) -> TestRow | None:
        """Return the row of a test, or None.

        Parameters
        ----------
        folder : of the test
        """
        rows = self._all(f"select {', '.join(TEST_COLUMNS)} from tests where folder = ?", folder)
        return TestRow(*rows[0]) if rows else None

    def seen_of(self, folder: str) -> Seen | None:
        """Return the recorded state of the files of a test, or None.

        Parameters
        ----------
        folder : of the test
        """
        rows = self._all("select content, marks from seen where folder = ?", folder)
        return Seen(*rows[0]) if rows else None

    def put_seen(self, folder: str, seen: Seen) -> None:
        """Record the state of the files of a test.

        Parameters
        ----------
        folder : of the test
        seen : the state
        """
        with self._writing() as connection:
            values = (folder, seen.content, seen.marks)
            connection.execute("insert or replace into seen values (?, ?, ?)", values)

    def results_of(self, folder: str) -> tuple[ResultRow, ...]:
        """Return the results of a test, in order.

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

    def inputs_of(self, folder: str) -> tuple[tuple[str, str, str], ...]:
        """Return role, file and SHA-256 of the exports of a test, in order.

        Parameters
        ----------
        folder : of the test
        """
        sql = "select role, file, sha256 from inputs where folder = ? order by place"
        return tuple(self._all(sql, folder))

    def put(self, entries: Iterable[Entry], before: Mapping[str, Seen] | None = None) -> None:
        """Write entries of tests.

        Parameters
        ----------
        entries : of the tests
        before : recorded states when the entries were begun; a test whose recorded state has
            changed since was written by another process and is skipped. None to write all
        """
        with self._writing() as connection:
            stored = self.seen() if before is not None else {}
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
                for table in ("tests", "results", "inputs", "seen", "times"):
                    connection.execute(f"delete from {table} where folder = ?", (folder,))

    def decisions(self) -> list[tuple[Decision, bool]]:
        """Return all decisions in order, and whether each is applied."""
        sql = 'select test, run, decision, because, "by", "when", note, applied from decisions'
        rows = self._all(f"{sql} order by place")
        return [(Decision(*row[:-1]), bool(row[-1])) for row in rows]

    def put_decisions(self, decisions: Sequence[tuple[Decision, bool]]) -> None:
        """Replace all decisions.

        Parameters
        ----------
        decisions : in order, and whether each is applied
        """
        if decisions == self.decisions():
            return
        sql = "insert into decisions values (?, ?, ?, ?, ?, ?, ?, ?, ?)"
        rows = [(n, *astuple(decision), on) for n, (decision, on) in enumerate(decisions)]
        with self._writing() as connection:
            connection.execute("delete from decisions")
            connection.executemany(sql, rows)

    def claims(self) -> dict[str, Claim]:
        """Return claims of live processes by folder of the test."""
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
            sql = "select host, pid, process, since from running where folder = ?"
            if any(is_alive(Claim(*row)) for row in self._all(sql, folder)):
                return False
            values = (folder, *astuple(new_claim()))
            connection.execute("insert or replace into running values (?, ?, ?, ?, ?)", values)
        return True

    def release(self, folder: str) -> None:
        """Release a claim.

        Parameters
        ----------
        folder : of a test claimed by this process
        """
        with self._writing() as connection:
            connection.execute("delete from running where folder = ?", (folder,))

    def release_dead(self) -> None:
        """Delete the claims of processes that have ended."""
        alive = self.claims()
        dead = {folder for (folder,) in self._all("select folder from running")} - alive.keys()
        if dead:
            with self._writing() as connection:
                sql = "delete from running where folder = ?"
                connection.executemany(sql, [(folder,) for folder in dead])

    def put_time(self, folder: str, finished: str, seconds: float) -> None:
        """Record when a test was processed, and its duration.

        Parameters
        ----------
        folder : of the test
        finished : time, ISO 8601
        seconds : duration
        """
        with self._writing() as connection:
            values = (folder, finished, seconds)
            connection.execute("insert or replace into times values (?, ?, ?)", values)

    def content(self) -> dict[str, list[Any]]:
        """Return all rows of the compared tables, sorted."""
        return {table: sorted(self._all(f"select * from {table}"), key=repr) for table in COMPARED}

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Open a read-only connection for a query."""
        if self.in_memory:
            self._connection.execute("pragma query_only = on")
            yield self._connection
            self._connection.execute("pragma query_only = off")
            return
        with sqlite_errors(self.path):
            connection = open_connection(self.path, "ro")
        with closing(connection):
            yield connection


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
        message = str(error)
        remedy = "`labpipe campaign rebuild` rebuilds it from the files of the tests."
        if "lock" in message or "busy" in message:
            remedy = "Another labpipe is writing: wait until it is done, and try again."
        elif "readonly" in message or "unable to open" in message or "full" in message:
            remedy = "Check the disk and its permissions."
        expected = "a readable and writable catalog"
        raise StoreError(
            error_text(path, "", expected=expected, found=message, remedy=remedy)
        ) from error


def _put(connection: sqlite3.Connection, entry: Entry) -> None:
    folder = entry.row.folder
    seen = (folder, entry.seen.content, entry.seen.marks)
    connection.execute("insert or replace into seen values (?, ?, ?)", seen)
    if entry.inputs is None or entry.results is None:
        return
    for table in ("tests", "results", "inputs"):
        connection.execute(f"delete from {table} where folder = ?", (folder,))
    holes = ", ".join("?" * len(TEST_COLUMNS))
    connection.execute(f"insert into tests values ({holes})", astuple(entry.row))
    holes = ", ".join("?" * (len(RESULT_COLUMNS) + 2))
    results = [(folder, place, *astuple(result)) for place, result in enumerate(entry.results)]
    connection.executemany(f"insert into results values ({holes})", results)
    inputs = [(folder, place, *export) for place, export in enumerate(entry.inputs)]
    connection.executemany("insert into inputs values (?, ?, ?, ?, ?)", inputs)


def make_tables(connection: sqlite3.Connection) -> None:
    """Create the tables of an empty catalog.

    Parameters
    ----------
    connection : to an empty file, or to memory
    """
    connection.executescript(
        f"begin immediate; {_TABLES} pragma application_id = {PROGRAM};"
        f" pragma user_version = {SCHEMA}; commit;"
    )


def open_connection(path: Path, mode: str) -> sqlite3.Connection:
    """Open the file of a catalog.

    Parameters
    ----------
    path : of the file
    mode : ``ro``, ``rw``, or ``rwc`` to create it. With ``ro``, a file in a folder without write
        access is opened as immutable
    """
    uri = file_uri(path.absolute())
    try:
        connection = connect_autocommit(f"{uri}?mode={mode}")
        connection.execute("select count(*) from sqlite_schema")
    except sqlite3.OperationalError:
        if mode != "ro" or can_write(path):
            raise
        connection = connect_autocommit(f"{uri}?mode=ro&immutable=1")
    return connection


def file_uri(path: PurePath) -> str:
    """Return the URI of a file for SQLite, for any characters in its name.

    Parameters
    ----------
    path : absolute; may be on a Windows network drive, whose server SQLite takes as a folder
    """
    uri = path.as_uri()
    return uri if uri.startswith("file:///") else uri.replace("file://", "file:////", 1)


def connect_autocommit(uri: str) -> sqlite3.Connection:
    """Connect in autocommit mode, with explicit transactions.

    Parameters
    ----------
    uri : of a file, or ``:memory:``
    """
    # s to wait for another process that writes
    lock_timeout = 60.0
    return sqlite3.connect(
        uri, uri=True, timeout=lock_timeout, isolation_level=None, check_same_thread=False
    )


def can_write(path: Path) -> bool:
    """Return whether a catalog, and files beside it, can be written.

    Parameters
    ----------
    path : of the catalog
    """
    return os.access(path.parent, os.W_OK | os.X_OK) and (
        not path.exists() or os.access(path, os.W_OK)
    )


def as_json(content: Mapping[str, Any]) -> str:
    """Write an object as JSON with sorted keys, so that equal objects have equal text.

    Parameters
    ----------
    content : the object
    """
    return json.dumps(content, ensure_ascii=False, sort_keys=True)


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
