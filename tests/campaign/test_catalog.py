from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath

import pytest

from labpipe.campaign.catalog import OK, STALE, Catalog, Entry, Seen, TestRow, speaking, uri_of
from labpipe.campaign.catalog_file import new_catalog
from labpipe.campaign.decisions import Decision
from labpipe.campaign.outcome_rows import ResultRow
from labpipe.errors import StoreError

RESULT = ResultRow("peak", 1.5, "N", 1.0, 2.0, 0.95, None, "ok", "", "")
ENTRY = Entry(
    TestRow("T1", test="T1", state=OK, run="r"), Seen("{}", "m"), (("force", "a", "1"),), (RESULT,)
)


@pytest.fixture
def catalog(tmp_path: Path) -> Iterator[Catalog]:
    made = new_catalog(tmp_path)
    yield made
    made.close()


def test_what_is_put_comes_back(catalog: Catalog) -> None:
    catalog.put([ENTRY])
    assert catalog.rows() == {"T1": ENTRY.row}
    assert catalog.row_of("T1") == ENTRY.row
    assert catalog.seen() == {"T1": ENTRY.seen}
    assert catalog.results_of("T1") == (RESULT,)
    assert catalog.inputs_of("T1") == (("force", "a", "1"),)
    assert (catalog.row_of("T2"), catalog.seen_of("T2")) == (None, None)


def test_looks_alone_leave_the_rows(catalog: Catalog) -> None:
    catalog.put([ENTRY])
    catalog.put([Entry(ENTRY.row, Seen("{}", "other"))])
    assert catalog.results_of("T1") == (RESULT,)
    assert catalog.seen_of("T1") == Seen("{}", "other")


def test_what_another_process_knows_better_stays(catalog: Catalog) -> None:
    catalog.put([ENTRY])
    before = catalog.seen()
    newer = replace(ENTRY, row=replace(ENTRY.row, run="newer"), seen=Seen("{}", "newer"))
    catalog.put([newer])
    catalog.put([replace(ENTRY, row=replace(ENTRY.row, state=STALE))], before)
    assert catalog.row_of("T1") == newer.row


def test_what_is_forgotten_is_gone(catalog: Catalog) -> None:
    catalog.put([ENTRY])
    catalog.put_time("T1", "now", 1.0)
    catalog.forget(["T1"])
    assert catalog.content() == {"tests": [], "results": [], "inputs": [], "decisions": []}


def test_nothing_of_several_changes_is_kept_when_one_fails(catalog: Catalog) -> None:
    bad = replace(ENTRY, row=replace(ENTRY.row, folder="T2", state=None))  # type: ignore[arg-type]
    with pytest.raises(StoreError, match="NOT NULL constraint failed"):
        catalog.put([ENTRY, bad])
    assert catalog.rows() == {}


def test_decisions_in_order(catalog: Catalog) -> None:
    first, second = (Decision("T1", "r", "reject", why, "me", "now", "") for why in "ab")
    catalog.put_decisions([(first, False), (second, True)])
    assert catalog.decisions() == [(first, False), (second, True)]
    catalog.put_decisions([])
    assert catalog.decisions() == []


def test_a_test_is_claimed_once(catalog: Catalog) -> None:
    assert catalog.claim("T1")
    assert not catalog.claim("T1")
    assert set(catalog.claims()) == {"T1"}
    catalog.release("T1")
    assert catalog.claim("T1")


def test_a_claim_does_not_look_at_all_others(
    catalog: Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(5):
        catalog.claim(f"T{number}")

    def asked(_: object) -> bool:
        raise AssertionError

    monkeypatch.setattr("labpipe.campaign.catalog.is_alive", asked)
    assert catalog.claim("T5")


def test_claims_of_the_dead_go(catalog: Catalog, monkeypatch: pytest.MonkeyPatch) -> None:
    catalog.claim("T1")
    monkeypatch.setattr("labpipe.campaign.catalog.is_alive", lambda _: False)
    catalog.release_dead()
    assert catalog._all("select * from running") == []
    catalog.claim("T1")
    assert catalog.claim("T1")


@pytest.mark.parametrize(
    ("path", "uri"),
    [
        (PurePosixPath("/a b/c?d#e%"), "file:///a%20b/c%3Fd%23e%25"),
        (PureWindowsPath("C:/lab/ü.sqlite"), "file:///C:/lab/%C3%BC.sqlite"),
        (PureWindowsPath("//server/share/c.sqlite"), "file:////server/share/c.sqlite"),
    ],
)
def test_paths_as_sqlite_takes_them(path: PurePath, uri: str) -> None:
    assert uri_of(path) == uri


def test_a_reader_cannot_write(catalog: Catalog) -> None:
    with catalog.reading() as connection:
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            connection.execute("delete from tests")
        assert connection.execute("select count(*) from tests").fetchone() == (0,)


@pytest.mark.parametrize(
    ("said", "remedy"),
    [
        ("database is locked", "Another labpipe is writing"),
        ("attempt to write a readonly database", "Look at the disk"),
        ("database disk image is malformed", "`labpipe campaign rebuild` makes it anew"),
    ],
)
def test_what_sqlite_says_is_said_with_what_to_do(said: str, remedy: str) -> None:
    with pytest.raises(StoreError, match=f"found {said}. {remedy}"), speaking(Path("c.sqlite")):
        raise sqlite3.OperationalError(said)
