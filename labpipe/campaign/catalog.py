"""Keep the catalog of a campaign: an SQLite file with the states and results of all tests.

The catalog makes the status of a campaign and queries fast. It can be rebuilt, because its tables
``tests`` and ``results`` are made from ``summary.json`` and ``failure.json`` of the tests, from the
test sheets and from the decisions. Two tables exist only here: ``seen``, the states of the files of
tests at the last update, and ``running``, the claims of processes.
"""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import fields
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import psutil

from labpipe.campaign.campaign_files import UNKNOWN_SOURCES, OutcomeFiles, SourceHashes
from labpipe.errors import StoreError, UsageError
from labpipe.messages import format_sentence
from labpipe.process.output_paths import RESULT_FILE
from labpipe.store.layout import ResultRow
from labpipe.store.replace import lock, map_errors
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_FILE, compute_entry_seal, read_summary

PENDING, RUNNING, OK, DOUBTFUL, FAILED, STALE, REJECTED = STATES = (
    *("pending", "running", "ok", "doubtful", "failed", "stale", "rejected"),
)
NEWER_RESULT: Final = "newer_result"
"""Code of a test whose results were made by a newer labpipe and are not replaced."""


class TestRow(NamedTuple):
    """A row of the table ``tests``.

    Parameters
    ----------
    folder : folder of the test relative to the campaign, with slashes; key of the row
    test : name of the test
    state : one of `STATES` except ``running``
    why : what changed, for a stale test; the reason of the decision, for a rejected test; the fault
        of the results, for a pending test
    code, reason : code and reason of a failure, or of the first result that is not ok
    protocol, type, spool, sample, date, operator : facts from summary.json, or from the test sheet
        if there are no results
    specimen : specimen of summary.json, as JSON
    labpipe : version of labpipe that made the last attempt
    run : key of the results; empty without results
    failed_run : key of the last attempt if it failed; empty if the failure has no key
    decided_by, decided : person who rejected the test, and time of the decision
    """

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
    decided_by: str = ""
    decided: str = ""

    @property
    def attempt_key(self) -> str:
        """Key of the last attempt, or of the results if the failure has no key."""
        return self.failed_run or self.run

    @property
    def is_due(self) -> bool:
        """Whether the test must be processed."""
        return self.state in {PENDING, STALE}


TestRow.__test__ = False  # type: ignore[attr-defined]  # pytest must not collect it
_REAL_COLUMNS: Final = ("value", "lower", "upper", "level", "estimate")


class FileState(NamedTuple):
    """State of the files of a test when its row was made.

    Parameters
    ----------
    inputs_json : inputs of the test, from `HashedInputs.to_json`; empty if not determined
    fingerprint : text that changes with outcome files, inputs and decisions of the test
    """

    inputs_json: str = ""
    fingerprint: str = ""


class Entry(NamedTuple):
    """Catalog entry of a test.

    Parameters
    ----------
    row : row of the table ``tests``
    file_state : state of the files of the test
    source_hashes : hashes of the exports, sheet and protocol of the last attempt
    results : results of the last successful attempt
    """

    row: TestRow
    file_state: FileState = FileState()
    source_hashes: SourceHashes = UNKNOWN_SOURCES
    results: tuple[ResultRow, ...] = ()


def escape_surrogates(value: object) -> str:
    """Convert a value to text with lone surrogates escaped, so that files and databases accept it.

    Parameters
    ----------
    value : text, or an object with a text, such as a path
    """
    return str(value).encode("utf-8", "backslashreplace").decode()


def write_json(content: Mapping[str, Any]) -> str:
    """Write an object as JSON with sorted keys, so that equal objects have equal text.

    Parameters
    ----------
    content : object with values of JSON
    """
    return json.dumps(content, ensure_ascii=False, sort_keys=True)


def read_outcome(folder: str, files: OutcomeFiles) -> Entry:
    """Read the outcome of a test.

    Parameters
    ----------
    folder : folder of the test relative to the campaign
    files : outcome files of the test

    Returns
    -------
    Entry of the test. Its state is ``ok``, ``doubtful`` or ``failed``, or ``pending`` if there is
    no outcome, or if the results have no key or cannot be read. Results of a newer labpipe count as
    ``failed``, and so does a failure that cannot be read, with the code ``unknown``. A failure with
    the same key as the results is ignored, because the process that wrote these results was killed
    before it deleted the older failure.
    """
    entry, file_names = Entry(TestRow(folder)), files.names
    if {SUMMARY_FILE, RESULT_FILE} <= file_names:
        entry = _read_summary(folder, files.folder / SUMMARY_FILE)
    elif SUMMARY_FILE in file_names:
        entry = Entry(TestRow(folder, why=f"{RESULT_FILE} is missing"))
    failure = _read_failure(files.folder / FAILURE_FILE) if FAILURE_FILE in file_names else {}
    run = failure.get("run") or ""
    if FAILURE_FILE not in file_names or (run and run == entry.row.run):
        return entry
    row = entry.row._replace(
        state=FAILED,
        failed_run=str(run),
        code=str(failure.get("code") or "unknown"),
        reason=str(failure.get("reason") or ""),
        labpipe=str(failure.get("labpipe") or entry.row.labpipe),
    )
    try:
        return entry._replace(row=row, source_hashes=_parse_source_hashes(failure))
    except (KeyError, TypeError, AttributeError):
        return entry._replace(row=row)


def _read_summary(folder: str, path: Path) -> Entry:
    """Read the results of a test; if they cannot be read, the entry states the reason."""
    try:
        return _parse_summary(folder, read_summary(path))
    except StoreError as error:
        if error.code == NEWER_RESULT:
            return Entry(TestRow(folder, state=FAILED, code=NEWER_RESULT, reason=str(error)))
        return Entry(TestRow(folder, why=f"{SUMMARY_FILE} cannot be read"))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        return Entry(TestRow(folder, why=f"{SUMMARY_FILE} is damaged ({error})"))


_SUMMARY_COLUMNS = (
    *("test", "protocol", "labpipe", "run", "date", "operator"),
    *("type", "spool", "sample"),
)
"""Columns of a test that are copied from summary.json."""


def _parse_summary(folder: str, content: Mapping[str, Any]) -> Entry:
    """Parse the content of summary.json as the entry of a test."""
    results = tuple(map(_parse_result, content["results"]))
    bad_result = next((result for result in results if result.status != OK), None)
    specimen = {"type": "", "spool": "", "sample": "", **content["specimen"]}
    facts = {**specimen, **content}
    row = TestRow(
        folder,
        state=PENDING if not content["run"] else OK if bad_result is None else DOUBTFUL,
        code="" if bad_result is None else bad_result.code,
        reason="" if bad_result is None else f"{bad_result.name}: {bad_result.reason}",
        specimen=write_json(specimen),
        **{key: str(facts.get(key) or "") for key in _SUMMARY_COLUMNS},
    )
    return Entry(row, source_hashes=_parse_source_hashes(content), results=results)


def _parse_source_hashes(content: Mapping[str, Any]) -> SourceHashes:
    """Parse the hashes of the exports, sheet and protocol from which an outcome was made."""
    files = tuple(
        (str(file["role"]), str(file["file"]), str(file["sha256"])) for file in content["inputs"]
    )
    hashes = content.get("made_of") or {}
    return SourceHashes(files, str(hashes.get("sheet", "")), str(hashes.get("protocol", "")))


def _parse_result(entry: Mapping[str, Any]) -> ResultRow:
    """Parse a result of summary.json; refuse numbers that were changed after the seal was made."""
    seal = str(entry.get("seal") or "")
    if seal and seal != compute_entry_seal(entry):
        message = f"the numbers of {entry['name']} were changed"
        raise ValueError(message)
    cells: dict[str, Any] = {name: str(entry[name]) for name in ("name", "unit", "status")}
    cells |= {key: None if entry[key] is None else float(str(entry[key])) for key in _REAL_COLUMNS}
    return ResultRow(
        **cells,
        code=", ".join(str(reason["code"]) for reason in entry["reasons"]),
        reason="; ".join(str(reason["message"]) for reason in entry["reasons"]),
    )


def _read_failure(path: Path) -> dict[str, Any]:
    """Read a failure; return an empty object if it cannot be read."""
    with suppress(OSError, ValueError, RecursionError):
        content = json.loads(path.read_text(encoding="utf-8"))
        return content if isinstance(content, dict) else {}
    return {}


CATALOG: Final = "catalog.sqlite"
SCHEMA: Final = 4
"""Version of the tables, in ``user_version``.

Tables of a newer version are refused; those of an older version are rebuilt.
"""
APPLICATION_ID: Final = 0x4C425043
"""``application_id`` of the file: the letters LBPC."""


RESULT_COLUMNS: Final = tuple(field.name for field in fields(ResultRow))
"""Columns of a result in the table ``results``."""
_get_result_cells = attrgetter(*RESULT_COLUMNS)


def _define_columns(names: Iterable[str]) -> str:
    """Write the column definitions of a table in SQL: text, or a number that may be null."""
    return ", ".join(
        f"{name} {'real' if name in _REAL_COLUMNS else 'text not null'}" for name in names
    )


_TABLES = f"""
create table tests ({_define_columns(TestRow._fields)}, primary key (folder)) without rowid;
create table results (
    folder text not null, place integer not null, {_define_columns(RESULT_COLUMNS)},
    primary key (folder, place)
) without rowid;
create table seen (folder text primary key, content text not null, marks text not null);
create table running (
    folder text primary key, host text not null, pid integer not null, process text not null,
    since real not null
);
"""
MAX_CLAIM_AGE = 24 * 3600.0
"""Largest age of a claim of another host, s; no test takes so long, so older claims are ignored."""


class Claim(NamedTuple):
    """The claim of a process on a test; other processes do not process a claimed test.

    Parameters
    ----------
    host : name of the machine, and the namespace of process ids if the system has namespaces
    pid : process id
    start_time : start time of the process as text, s since 1970; a later process may have the
        same id
    since : time of the claim, s since 1970
    """

    host: str
    pid: int
    start_time: str
    since: float

    @property
    def machine(self) -> str:
        """Name of the machine."""
        return self.host.split()[0]


def is_alive(claim: Claim) -> bool:
    """Return whether the process of a claim is alive.

    Parameters
    ----------
    claim : claim of a process on any host

    Returns
    -------
    For a process of this host, whether a process with this id and start time runs; a process that
    may not be inspected counts as alive. A process of another host counts as alive if its claim is
    younger than `MAX_CLAIM_AGE`.
    """
    if claim.host != _identify_host():
        return abs(time.time() - claim.since) < MAX_CLAIM_AGE
    max_clock_step = 2.0  # s; the start of a process shifts when the system clock is set
    try:
        process = psutil.Process(claim.pid)
        is_dead = process.status() in {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
        return not is_dead and abs(process.create_time() - float(claim.start_time)) < max_clock_step
    except psutil.AccessDenied:
        return True
    except (psutil.NoSuchProcess, ValueError):  # ValueError: claim of an earlier labpipe
        return False


@cache
def _identify_host() -> str:
    """Return the name of the machine and its namespace of process ids, separated by a space."""
    namespace = ""
    with suppress(OSError):
        namespace = str(Path("/proc/self/ns/pid").readlink())
    return f"{socket.gethostname()} {namespace}".strip()


class Catalog:
    """An open catalog; its methods raise SQLite errors as `StoreError`.

    Parameters
    ----------
    connection : connection to the file, or to a database in memory
    path : path of the file, for messages
    is_in_memory : whether the catalog is only in memory and is lost when the process ends
    """

    def __init__(
        self, connection: sqlite3.Connection, path: Path, *, is_in_memory: bool = False
    ) -> None:
        self._connection, self.path, self.is_in_memory = connection, path, is_in_memory

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _begin_transaction(self) -> Iterator[sqlite3.Connection]:
        """Make all changes of a block in one transaction, which an error rolls back."""
        with convert_sqlite_errors(self.path), self._connection:
            self._connection.execute("begin immediate")
            yield self._connection

    def _fetch_all(self, sql: str, *values: object) -> list[Any]:
        """Execute a query, and fetch all its rows."""
        with convert_sqlite_errors(self.path):
            return self._connection.execute(sql, values).fetchall()

    def _select(self, columns: str, table: str, folder: str | None) -> list[Any]:
        """Select columns of a table for one test, or for all tests if `folder` is None."""
        condition, values = ("", ()) if folder is None else (" where folder = ?", (folder,))
        return self._fetch_all(f"select {columns} from {table}{condition}", *values)

    def read_rows(self, folder: str | None = None) -> dict[str, TestRow]:
        """Read rows of ``tests``, keyed by folder.

        Parameters
        ----------
        folder : folder of one test; None for all tests
        """
        rows = self._select(", ".join(TestRow._fields), "tests", folder)
        return {row[0]: TestRow(*row) for row in rows}

    def read_file_states(self, folder: str | None = None) -> dict[str, FileState]:
        """Read the recorded states of the files of tests, keyed by folder.

        Parameters
        ----------
        folder : folder of one test; None for all tests
        """
        rows = self._select("folder, content, marks", "seen", folder)
        return {folder: FileState(*state) for folder, *state in rows}

    def read_group_values(self, folder: str) -> dict[str, list[float]]:
        """Read the values of each result that is ok in the other tests of the group of a test.

        Tests of a group have the same protocol, and specimens that differ at most in spool, sample
        and uncertainty.

        Parameters
        ----------
        folder : folder of the test

        Returns
        -------
        Values, keyed by result; those of rejected tests are left out.
        """
        specimen = "json_remove({}.specimen, '$.spool', '$.sample', '$.uncertainty')"
        sql = (
            "select results.name, results.value from tests as own"
            " join tests as other on other.protocol = own.protocol and other.folder <> own.folder"
            f" and {specimen.format('other')} = {specimen.format('own')}"
            " join results on results.folder = other.folder"
            " where own.folder = ? and other.run <> '' and other.state <> 'rejected'"
            " and results.status = 'ok' and results.value is not null"
            " order by other.folder, results.place"
        )
        values = defaultdict[str, list[float]](list)
        for name, value in self._fetch_all(sql, folder):
            values[name].append(value)
        return values

    def has_failed_results(self) -> bool:
        """Return whether any result failed in a test that is not rejected."""
        sql = (
            "select 1 from results join tests on tests.folder = results.folder"
            " where results.status = 'failed' and tests.state <> 'rejected' limit 1"
        )
        return bool(self._fetch_all(sql))

    def write_entries(
        self, entries: Iterable[Entry], states_at_start: Mapping[str, FileState] | None = None
    ) -> None:
        """Write entries of tests.

        Parameters
        ----------
        entries : entries of the tests
        states_at_start : recorded states of files when the update began, keyed by folder. A test
            whose recorded state has changed since was written by another process and is skipped.
            None to write all tests
        """
        with self._begin_transaction() as connection:
            states = self.read_file_states() if states_at_start is not None else {}
            for entry in entries:
                folder = entry.row.folder
                if states_at_start is None or states.get(folder) == states_at_start.get(folder):
                    _delete(connection, folder)
                    _insert(connection, "tests", [entry.row])
                    _insert(connection, "seen", [(folder, *entry.file_state)])
                    rows = [
                        (folder, place, *_get_result_cells(row))
                        for place, row in enumerate(entry.results)
                    ]
                    _insert(connection, "results", rows)

    def remove_tests(self, folders: Iterable[str]) -> None:
        """Remove tests from the catalog; claims on them are kept.

        Parameters
        ----------
        folders : folders of the tests
        """
        with self._begin_transaction() as connection:
            for folder in folders:
                _delete(connection, folder)

    def read_claims(self) -> dict[str, Claim]:
        """Read the claims of live processes, keyed by folder; delete those of dead processes."""
        rows = self._fetch_all("select * from running")
        claims = {folder: Claim(*cells) for folder, *cells in rows}
        live_claims = {folder: claim for folder, claim in claims.items() if is_alive(claim)}
        if dead_rows := [row for row in rows if row[0] not in live_claims]:
            sql = "delete from running where (folder, host, pid, process, since) = (?, ?, ?, ?, ?)"
            with self._begin_transaction() as connection:
                connection.executemany(sql, dead_rows)
        return live_claims

    def claim_test(self, folder: str) -> bool:
        """Claim a test for this process.

        Parameters
        ----------
        folder : folder of the test

        Returns
        -------
        True if the test was claimed; False if it has a claim of a live process, which may be this
        process.
        """
        with self._begin_transaction() as connection:
            rows = self._fetch_all("select * from running where folder = ?", folder)
            if any(is_alive(Claim(*row[1:])) for row in rows):
                return False
            start_time = str(psutil.Process().create_time())
            claim = Claim(_identify_host(), os.getpid(), start_time, time.time())
            _insert(connection, "running", [(folder, *claim)])
        return True

    def release_tests(self, *folders: str) -> None:
        """Delete the claims of all processes on tests.

        Parameters
        ----------
        folders : folders of the tests
        """
        with self._begin_transaction() as connection:
            sql = "delete from running where folder = ?"
            connection.executemany(sql, [(folder,) for folder in folders])

    @contextmanager
    def open_copy(self) -> Iterator[sqlite3.Connection]:
        """Open a copy in memory, so that a query does not block other processes."""
        with convert_sqlite_errors(self.path), closing(_connect(None)) as memory:
            self._connection.backup(memory)
            yield memory


@contextmanager
def convert_sqlite_errors(path: Path) -> Iterator[None]:
    """Convert SQLite errors inside a block to a `StoreError`.

    Parameters
    ----------
    path : path of the catalog
    """
    try:
        yield
    except sqlite3.Error as error:
        code = _get_primary_code(error)
        if code in _BUSY_CODES:
            raise StoreError.about("campaign.catalog_in_use", path, found=error) from error
        if code in _REFUSED_CODES:
            raise StoreError.about("campaign.catalog_refused", path, found=error) from error
        raise StoreError.about("campaign.bad_catalog", path, found=error) from error


_BUSY_CODES: Final = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
_REFUSED_CODES: Final = {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL}


def _get_primary_code(error: sqlite3.Error) -> int:
    """Return the primary result code of an SQLite error; 0 if it has none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _delete(connection: sqlite3.Connection, folder: str) -> None:
    """Delete the rows of a test from all tables except ``running``."""
    for table in ("tests", "results", "seen"):
        connection.execute(f"delete from {table} where folder = ?", (folder,))


def _insert(connection: sqlite3.Connection, table: str, rows: Sequence[Sequence[Any]]) -> None:
    """Insert rows with the columns of a table; rows with the same key are replaced."""
    for row in rows:
        values = [escape_surrogates(cell) if isinstance(cell, str) else cell for cell in row]
        placeholders = ", ".join("?" * len(values))
        connection.execute(f"insert or replace into {table} values ({placeholders})", values)


def _connect(path: Path | None) -> sqlite3.Connection:
    """Connect to a file, or to memory, in autocommit mode with explicit transactions."""
    lock_timeout = 60.0  # s to wait for another process that writes
    connection = sqlite3.connect(
        path or ":memory:", timeout=lock_timeout, isolation_level=None, check_same_thread=False
    )
    connection.execute("pragma synchronous = normal")  # a catalog can be rebuilt
    return connection


def open_catalog(folder: Path, notes: list[str]) -> Catalog:
    """Open the catalog of a campaign; make an empty catalog if there is none that is usable.

    Parameters
    ----------
    folder : folder of the results. It is made if it does not exist. If it is read-only, the catalog
        is a copy in memory; without a usable file, that copy is empty
    notes : list to which a message is added if the catalog is empty in memory, or if an unusable
        catalog was replaced; the replaced file is kept as ``catalog.sqlite.damaged``

    Raises
    ------
    LabpipeError
        If the catalog was made by a newer labpipe or another program, is in use, or cannot be
        opened or made.
    """
    path, lock_timeout = folder / CATALOG, 30.0  # s to wait for another process
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    is_file_writable = not path.exists() or os.access(path, os.W_OK)
    if not (is_file_writable and os.access(folder, os.W_OK | os.X_OK)):
        memory = _connect(None)
        with suppress(sqlite3.DatabaseError):  # then the copy is empty
            with closing(_open_file(path)) as connection:
                connection.backup(memory)
            return Catalog(memory, path, is_in_memory=True)
        notes.append(format_sentence("campaign.catalog_in_memory", path=path))
        return Catalog(_make_tables(memory), path, is_in_memory=True)
    with convert_sqlite_errors(path):
        opened = _open_usable_file(path)
        if isinstance(opened, sqlite3.Connection):
            return Catalog(opened, path)
        with lock(folder, timeout=lock_timeout), map_errors(path):
            opened = _open_usable_file(path)
            if isinstance(opened, sqlite3.Connection):  # another process has just made it
                return Catalog(opened, path)
            if path.exists():
                notes.append(format_sentence("campaign.catalog_rebuilt", path=path, why=opened))
                path.replace(path.with_name(f"{CATALOG}.damaged"))
            for suffix in ("-wal", "-shm", "-journal"):
                path.with_name(CATALOG + suffix).unlink(missing_ok=True)
            return Catalog(_make_tables(_connect(path)), path)


def _open_usable_file(path: Path) -> sqlite3.Connection | str:
    """Connect to a catalog, or return why it must be made again; raise an error if it is in use."""
    try:
        return _open_file(path)
    except sqlite3.DatabaseError as error:
        code = _get_primary_code(error)  # 0 if the error is not of SQLite itself
        if path.exists() and code in _BUSY_CODES | _REFUSED_CODES:
            raise
        return format_sentence("campaign.damaged_catalog", why=error) if code else str(error)


def _open_file(path: Path) -> sqlite3.Connection:
    """Connect to a catalog and check its tables; raise an SQLite error if it does not exist."""
    if not path.exists():
        raise sqlite3.DatabaseError
    connection = _connect(path)
    try:
        _check_tables(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def _make_tables(connection: sqlite3.Connection) -> sqlite3.Connection:
    """Make the empty tables of a new catalog, and return the connection."""
    connection.executescript(
        f"begin immediate; {_TABLES} pragma application_id = {APPLICATION_ID};"
        f" pragma user_version = {SCHEMA}; commit;"
    )
    return connection


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse files of a newer labpipe or another program; raise an SQLite error for other faults.

    Other faults are damage, and tables of an older labpipe.
    """
    (application_id,) = connection.execute("pragma application_id").fetchone()
    (version,) = connection.execute("pragma user_version").fetchone()
    (n_tables,) = connection.execute("select count(*) from sqlite_schema").fetchone()
    if application_id != APPLICATION_ID and n_tables:
        raise UsageError.about("campaign.foreign_catalog", path)
    if version > SCHEMA:
        raise UsageError.about("campaign.newer_catalog", path, known=SCHEMA, found=version)
    if 0 < version < SCHEMA:
        raise sqlite3.DatabaseError(format_sentence("campaign.older_catalog"))
    (integrity,) = connection.execute("pragma quick_check(1)").fetchone()
    if version != SCHEMA or integrity != "ok":
        why = integrity if version else "without a version"
        raise sqlite3.DatabaseError(format_sentence("campaign.damaged_catalog", why=why))
