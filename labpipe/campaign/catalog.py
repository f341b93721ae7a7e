"""The catalog of a campaign: an SQLite file that can be made anew from the files of its tests.

Tables ``tests``, ``results``, ``inputs`` and ``decisions`` hold what the files say, and nothing
else. ``seen`` holds how files looked, ``running`` who is at work where, ``times`` how long tests
took: these stand in no other file, and are not compared.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, fields
from pathlib import Path, PurePath
from typing import Any, Final

from labpipe.campaign.decisions import Decision
from labpipe.campaign.outcome_rows import ResultRow
from labpipe.campaign.test_locks import Claim, is_alive, new_claim
from labpipe.errors import StoreError, error_text

CATALOG: Final = "catalog.sqlite"
SCHEMA: Final = 2
"""Version of the tables, in ``user_version`` of the file; a newer one is refused."""
PROGRAM: Final = 0x4C425043
"""``application_id`` of the file: *LBPC*."""
PENDING, RUNNING, OK, DOUBTFUL, FAILED, STALE, REJECTED = STATES = (
    *("pending", "running", "ok", "doubtful", "failed", "stale", "rejected"),
)
COMPARED: Final = ("tests", "results", "inputs", "decisions")
"""Tables that a rebuild gives row for row."""
TABLES: Final = (*COMPARED, "seen", "running", "times")
_WAIT = 60.0
"""s: how long another process may be writing."""
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
    folder : of the test below the campaign, with slashes; names it
    test : its name
    state : one of `STATES`, but ``running``
    why : of a stale test what changed, of a rejected one the reason
    code, reason : of a failure, or of the first result that is doubtful
    protocol, type, spool, sample, date, operator : of summary.json, else of the test sheet
    specimen : all that summary.json says of it, as JSON
    labpipe : version that made the results, or failed to
    run : key of the results; empty where there are none
    failed_run : key of the last attempt, where that failed
    sheet, resolved : SHA-256 of test sheet and resolved protocol of the last attempt
    decided_by, decided : who rejected it, and when
    """

    __test__ = False  # not a test of this project, whatever its name suggests to pytest

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
        """Key of the last attempt; empty where there was none."""
        return self.failed_run or self.run


TEST_COLUMNS: Final = tuple(field.name for field in fields(TestRow))
RESULT_COLUMNS: Final = tuple(field.name for field in fields(ResultRow))


@dataclass(frozen=True, slots=True)
class Seen:
    """How a test looked when its row was made.

    Parameters
    ----------
    content : what it was made of, as `Content.as_text` gives it; empty where that was not asked
    marks : how the files of its outcome looked
    """

    content: str = ""
    marks: str = ""


@dataclass(frozen=True, slots=True)
class Entry:
    """All that the catalog keeps of a test.

    Parameters
    ----------
    row : of the table ``tests``
    seen : how it looked
    inputs : role, file and SHA-256 of the exports
    results : of the last attempt that did not fail; both are None where they and the row are as
        the catalog has them
    """

    row: TestRow
    seen: Seen
    inputs: tuple[tuple[str, str, str], ...] | None = None
    results: tuple[ResultRow, ...] | None = None


class Catalog:
    """An open catalog. What SQLite refuses is said as a `StoreError`.

    Parameters
    ----------
    connection : to a file that has the tables
    path : of the file, for messages
    in_memory : whether it is a copy that nobody else sees
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, *, in_memory: bool) -> None:
        self._connection, self.path, self.in_memory = connection, path, in_memory

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Change several things, or none."""
        with speaking(self.path):
            self._connection.execute("begin immediate")
            try:
                yield self._connection
            except BaseException:
                self._connection.rollback()
                raise
            self._connection.commit()

    def _all(self, sql: str, *values: object) -> list[Any]:
        with speaking(self.path):
            return self._connection.execute(sql, values).fetchall()

    def rows(self) -> dict[str, TestRow]:
        """All rows of ``tests``, by folder."""
        found = self._all(f"select {', '.join(TEST_COLUMNS)} from tests")
        return {row[0]: TestRow(*row) for row in found}

    def seen(self) -> dict[str, Seen]:
        """How tests looked, by folder."""
        found = self._all("select folder, content, marks from seen")
        return {folder: Seen(content, marks) for folder, content, marks in found}

    def row_of(self, folder: str) -> TestRow | None:
        """The row of a test; None where there is none.

        Parameters
        ----------
        folder : of the test
        """
        found = self._all(f"select {', '.join(TEST_COLUMNS)} from tests where folder = ?", folder)
        return TestRow(*found[0]) if found else None

    def seen_of(self, folder: str) -> Seen | None:
        """How a test looked; None where it was not seen yet.

        Parameters
        ----------
        folder : of the test
        """
        found = self._all("select content, marks from seen where folder = ?", folder)
        return Seen(*found[0]) if found else None

    def put_seen(self, folder: str, seen: Seen) -> None:
        """Write how a test looks.

        Parameters
        ----------
        folder : of the test
        seen : how it looks
        """
        with self._writing() as connection:
            values = (folder, seen.content, seen.marks)
            connection.execute("insert or replace into seen values (?, ?, ?)", values)

    def results_of(self, folder: str) -> tuple[ResultRow, ...]:
        """Results of a test, in order.

        Parameters
        ----------
        folder : of the test
        """
        columns = ", ".join(RESULT_COLUMNS)
        sql = f"select {columns} from results where folder = ? order by place"
        return tuple(ResultRow(*row) for row in self._all(sql, folder))

    def has_failed_results(self) -> bool:
        """Whether any result of a test that is not rejected failed."""
        sql = (
            "select 1 from results join tests on tests.folder = results.folder"
            " where results.status = 'failed' and tests.state <> 'rejected' limit 1"
        )
        return bool(self._all(sql))

    def inputs_of(self, folder: str) -> tuple[tuple[str, str, str], ...]:
        """Role, file and SHA-256 of the exports of a test, in order.

        Parameters
        ----------
        folder : of the test
        """
        sql = "select role, file, sha256 from inputs where folder = ? order by place"
        return tuple(self._all(sql, folder))

    def put(self, entries: Iterable[Entry], before: Mapping[str, Seen] | None = None) -> None:
        """Write what is kept of tests.

        Parameters
        ----------
        entries : of the tests
        before : how they looked when the entries were begun; a test that looks otherwise in the
            catalog by now was written by another process, which knows more. None to write all
        """
        with self._writing() as connection:
            known = self.seen() if before is not None else {}
            for entry in entries:
                folder = entry.row.folder
                if before is None or known.get(folder) == before.get(folder):
                    _put(connection, entry)

    def forget(self, folders: Iterable[str]) -> None:
        """Take tests out.

        Parameters
        ----------
        folders : that are there no more
        """
        with self._writing() as connection:
            for folder in folders:
                for table in ("tests", "results", "inputs", "seen", "times"):
                    connection.execute(f"delete from {table} where folder = ?", (folder,))

    def decisions(self) -> list[tuple[Decision, bool]]:
        """All decisions in order, and whether each counts."""
        sql = 'select test, run, decision, because, "by", "when", note, applied from decisions'
        found = self._all(f"{sql} order by place")
        return [(Decision(*row[:-1]), bool(row[-1])) for row in found]

    def put_decisions(self, decisions: Sequence[tuple[Decision, bool]]) -> None:
        """Replace all decisions.

        Parameters
        ----------
        decisions : in order, and whether each counts
        """
        if decisions == self.decisions():
            return
        sql = "insert into decisions values (?, ?, ?, ?, ?, ?, ?, ?, ?)"
        rows = [(n, *astuple(each), on) for n, (each, on) in enumerate(decisions)]
        with self._writing() as connection:
            connection.execute("delete from decisions")
            connection.executemany(sql, rows)

    def claims(self) -> dict[str, Claim]:
        """Who is at work on which test, by folder; dead ones are left out."""
        found = self._all("select folder, host, pid, process, since from running")
        claims = {folder: Claim(*rest) for folder, *rest in found}
        return {folder: claim for folder, claim in claims.items() if is_alive(claim)}

    def claim(self, folder: str) -> bool:
        """Claim a test for this process.

        Parameters
        ----------
        folder : of the test

        Returns
        -------
        False where another process that lives has it.
        """
        with self._writing() as connection:
            sql = "select host, pid, process, since from running where folder = ?"
            if any(is_alive(Claim(*row)) for row in self._all(sql, folder)):
                return False
            values = (folder, *astuple(new_claim()))
            connection.execute("insert or replace into running values (?, ?, ?, ?, ?)", values)
        return True

    def release(self, folder: str) -> None:
        """Give a claim back.

        Parameters
        ----------
        folder : of a test that this process has claimed
        """
        with self._writing() as connection:
            connection.execute("delete from running where folder = ?", (folder,))

    def release_dead(self) -> None:
        """Take away claims of processes that ended before they gave them back."""
        alive = self.claims()
        dead = {folder for (folder,) in self._all("select folder from running")} - alive.keys()
        if dead:
            with self._writing() as connection:
                sql = "delete from running where folder = ?"
                connection.executemany(sql, [(folder,) for folder in dead])

    def put_time(self, folder: str, finished: str, seconds: float) -> None:
        """Write when a test was processed, and how long it took.

        Parameters
        ----------
        folder : of the test
        finished : time, ISO 8601
        seconds : that it took
        """
        with self._writing() as connection:
            values = (folder, finished, seconds)
            connection.execute("insert or replace into times values (?, ?, ?)", values)

    def content(self) -> dict[str, list[Any]]:
        """All rows of the tables that a rebuild gives, in order: for comparing."""
        return {table: sorted(self._all(f"select * from {table}"), key=repr) for table in COMPARED}

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Hand out a connection that cannot change anything, for a query."""
        if self.in_memory:
            self._connection.execute("pragma query_only = on")
            yield self._connection
            self._connection.execute("pragma query_only = off")
            return
        with speaking(self.path):
            connection = connected(self.path, "ro")
        with closing(connection):
            yield connection


@contextmanager
def speaking(path: Path) -> Iterator[None]:
    """Say what SQLite refuses as a `StoreError`.

    Parameters
    ----------
    path : of the catalog
    """
    try:
        yield
    except sqlite3.Error as error:
        said = str(error)
        remedy = "`labpipe campaign rebuild` makes it anew from the files of the tests."
        if "lock" in said or "busy" in said:
            remedy = "Another labpipe is writing: wait until it is done, and try again."
        elif "readonly" in said or "unable to open" in said or "full" in said:
            remedy = "Look at the disk and its permissions."
        expected = "a catalog that can be read and written"
        raise StoreError(
            error_text(path, "", expected=expected, found=said, remedy=remedy)
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
    inputs = [(folder, place, *each) for place, each in enumerate(entry.inputs)]
    connection.executemany("insert into inputs values (?, ?, ?, ?, ?)", inputs)


def make_tables(connection: sqlite3.Connection) -> None:
    """Make the tables of an empty catalog.

    Parameters
    ----------
    connection : to an empty file, or to memory
    """
    connection.executescript(
        f"begin immediate; {_TABLES} pragma application_id = {PROGRAM};"
        f" pragma user_version = {SCHEMA}; commit;"
    )


def connected(path: Path, mode: str) -> sqlite3.Connection:
    """Open the file of a catalog.

    Parameters
    ----------
    path : of the file
    mode : ``ro``, ``rw`` or ``rwc``, which makes it. With ``ro`` a file in a folder where SQLite
        cannot write its own files is opened as one that does not change
    """
    uri = uri_of(path.absolute())
    try:
        connection = in_autocommit(f"{uri}?mode={mode}")
        connection.execute("select count(*) from sqlite_schema")
    except sqlite3.OperationalError:
        if mode != "ro" or can_write(path):
            raise
        connection = in_autocommit(f"{uri}?mode=ro&immutable=1")
    return connection


def uri_of(path: PurePath) -> str:
    """Name a file as SQLite takes it, whatever characters its name has.

    Parameters
    ----------
    path : absolute; of a network drive of Windows, too, whose server SQLite wants as a folder
    """
    uri = path.as_uri()
    return uri if uri.startswith("file:///") else uri.replace("file://", "file:////", 1)


def in_autocommit(uri: str) -> sqlite3.Connection:
    """Connect; every statement counts at once, but between ``begin`` and ``commit``.

    Parameters
    ----------
    uri : of a file, or ``:memory:``
    """
    return sqlite3.connect(
        uri, uri=True, timeout=_WAIT, isolation_level=None, check_same_thread=False
    )


def can_write(path: Path) -> bool:
    """Whether a catalog can be written, and files beside it.

    Parameters
    ----------
    path : of the catalog
    """
    return os.access(path.parent, os.W_OK | os.X_OK) and (
        not path.exists() or os.access(path, os.W_OK)
    )


def as_json(said: Mapping[str, Any]) -> str:
    """Text of an object that is the same for the same object.

    Parameters
    ----------
    said : the object
    """
    return json.dumps(said, ensure_ascii=False, sort_keys=True)
