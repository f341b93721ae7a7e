"""The catalog of a campaign, its file and folders, and the machine that it lies on."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from labpipe.campaign import executors
from labpipe.campaign.campaign_files import (
    CampaignFolders,
    find_campaign,
    list_processed,
    list_raw,
)
from labpipe.campaign.catalog import (
    MAX_CLAIM_AGE,
    OK,
    SCHEMA,
    STALE,
    Catalog,
    Claim,
    Entry,
    FileState,
    TestRow,
    convert_sqlite_errors,
    is_alive,
    open_catalog,
)
from labpipe.campaign.executors import BYTES_PER_TEST, choose_default_jobs
from labpipe.campaign.running import read_overview
from labpipe.errors import StoreError, UsageError
from labpipe.store.layout import ResultRow
from tests.builders.lab_campaigns import LabCampaign, content_of

RESULT = ResultRow("peak", 1.5, None, 1.0, 2.0, "N", 0.95, "ok", "", "")
ENTRY = Entry(
    TestRow("T1", test="T1", state=OK, run="r"),
    FileState("{}", "m"),
    results=(RESULT,),
)


@pytest.fixture
def catalog(tmp_path: Path) -> Iterator[Catalog]:
    catalog = open_catalog(tmp_path, [])
    yield catalog
    catalog.close()


def test_put_skips_tests_written_by_another_process(catalog: Catalog) -> None:
    """And of several changes none is kept where one fails."""
    catalog.write_entries([ENTRY])
    assert catalog.read_rows() == catalog.read_rows("T1") == {"T1": ENTRY.row}
    assert (catalog.read_rows("T2"), catalog.read_file_states("T2")) == ({}, {})
    assert catalog._fetch_all("select name, value from results") == [("peak", 1.5)]
    states = catalog.read_file_states()
    assert states == {"T1": ENTRY.file_state}
    newer = Entry(ENTRY.row._replace(run="newer"), FileState("{}", "newer"))
    catalog.write_entries([newer])
    catalog.write_entries([ENTRY._replace(row=ENTRY.row._replace(state=STALE))], states)
    bad = ENTRY._replace(row=ENTRY.row._replace(folder="T2", state=None))  # type: ignore[arg-type]
    with pytest.raises(StoreError, match="NOT NULL constraint failed"):
        catalog.write_entries([ENTRY, bad])
    assert catalog.read_rows() == {"T1": newer.row}


def test_a_test_is_claimed_once(catalog: Catalog, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catalog.claim_test("T1")
    assert not catalog.claim_test("T1")
    assert set(catalog.read_claims()) == {"T1"}
    catalog.release_tests("T1")
    assert catalog.claim_test("T1")
    monkeypatch.setattr("labpipe.campaign.catalog.is_alive", lambda _: False)
    assert catalog.claim_test("T1")
    assert catalog.read_claims() == {}
    assert catalog._fetch_all("select * from running") == []


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (sqlite3.SQLITE_BUSY, "Another labpipe is writing"),
        (sqlite3.SQLITE_READONLY, "Check the disk"),
        (sqlite3.SQLITE_CORRUPT, "`labpipe campaign rebuild` rebuilds it"),
    ],
)
def test_sqlite_errors_name_a_remedy(code: int, remedy: str) -> None:
    error = sqlite3.OperationalError("a message")
    error.sqlite_errorcode = code
    with (
        pytest.raises(StoreError, match=f"found a message. {remedy}"),
        convert_sqlite_errors(Path("c.sqlite")),
    ):
        raise error


@pytest.fixture
def campaign(tmp_path: Path) -> LabCampaign:
    campaign = LabCampaign(tmp_path)
    campaign.add("T1")
    campaign.run()
    return campaign


@pytest.mark.parametrize("length", [None, 0, 100, 9000])
def test_damaged_or_missing_catalog_is_rebuilt(campaign: LabCampaign, length: int | None) -> None:
    content = content_of(campaign)
    path = campaign.processed / "catalog.sqlite"
    if length is None:
        path.unlink()
    else:
        path.write_bytes(b"no data base " * 500 if length == 100 else path.read_bytes()[:length])
    overview = read_overview(campaign.folders)
    assert overview.counts == {OK: 1}
    message = f"{path}: rebuilt from the files of the tests: it was damaged ("
    assert [note.startswith(message) for note in overview.notes] == [True] * (length is not None)
    assert path.with_name("catalog.sqlite.damaged").exists() == (length is not None)
    assert content_of(campaign) == content
    campaign.run()
    assert campaign.stand_in.processed == []


def test_a_catalog_of_an_earlier_labpipe_is_rebuilt(campaign: LabCampaign) -> None:
    path = campaign.processed / "catalog.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"pragma user_version = {SCHEMA - 1}")
    notes = read_overview(campaign.folders).notes
    message = "rebuilt from the files of the tests: it was made by an earlier labpipe"
    assert [*notes] == [f"{path}: {message}"]


def test_a_usable_catalog_is_opened_without_the_lock(
    campaign: LabCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report that is being written holds the lock for minutes, and a status must not wait."""
    monkeypatch.setattr("labpipe.campaign.catalog.lock", None)
    assert read_overview(campaign.folders).counts == {OK: 1}
    monkeypatch.setattr(os, "access", lambda *_: False)
    notes = list[str]()
    copy = open_catalog(campaign.processed, notes)
    assert (copy.is_in_memory, notes, [*copy.read_rows()]) == (True, [], ["T1"])
    copy.close()


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        (f"pragma user_version = {SCHEMA + 1}", f"{SCHEMA}, found version {SCHEMA + 1}. A newer"),
        ("pragma application_id = 7", "found a database of another program. Move it away"),
    ],
)
def test_foreign_and_newer_catalogs_are_refused(
    campaign: LabCampaign, statement: str, message: str
) -> None:
    with closing(sqlite3.connect(campaign.processed / "catalog.sqlite")) as connection:
        connection.execute(statement)
        connection.commit()
    for _ in range(2):
        with pytest.raises(UsageError, match=f"expected a catalog of .*{message}"):
            campaign.run()
    assert not (campaign.processed / "catalog.sqlite.damaged").exists()


@pytest.fixture
def campaign_folders(tmp_path: Path) -> CampaignFolders:
    for name in ("T1", "more/T2", "figures", ".hidden/T3"):
        folder = tmp_path / "raw" / "C" / name
        folder.mkdir(parents=True)
        (folder / "test.yaml").write_text("", "utf-8")
        (folder / "force.mat").write_text("", "utf-8")
    (tmp_path / "raw" / "C" / "notes.txt").write_text("", "utf-8")
    (tmp_path / "processed" / "C").mkdir(parents=True)
    return find_campaign(tmp_path / "raw" / "C")


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("nowhere", "expected the folder of a campaign, found nothing of that name"),
        ("file", "expected the folder of a campaign, found a file"),
        (".", "a folder below 'raw' or 'processed', found a folder below"),
        ("raw/T1", r"a campaign, found the folder of a single test\. Put each"),
    ],
)
def test_other_folders_are_refused(tmp_path: Path, place: str, message: str) -> None:
    LabCampaign(tmp_path).add("../T1")
    (tmp_path / "file").write_text("", "utf-8")
    with pytest.raises(UsageError, match=message):
        find_campaign(tmp_path / place)


def test_list_raw_skips_hidden_folders_and_links(campaign_folders: CampaignFolders) -> None:
    (campaign_folders.raw / "linked").symlink_to(campaign_folders.raw / "T1")
    (campaign_folders.raw / "figures" / "test.yaml").unlink()
    (campaign_folders.raw / "figures" / "test.yaml").symlink_to("nowhere")
    content = list_raw(campaign_folders)
    names = ("T1", "more/T2")
    assert content.sheets == {name: campaign_folders.raw / name / "test.yaml" for name in names}
    files = {f"{name}/{file}" for name in names for file in ("force.mat", "test.yaml")}
    assert files <= set(content.files)
    assert {name.partition("/")[0] for name in content.files} == {
        *("T1", "figures", "linked", "more", "notes.txt")
    }
    assert content.problems == [
        f"{campaign_folders.raw / 'figures' / 'test.yaml'}: expected a file, found a pipe or a"
        " broken link. Put the test sheet there."
    ]


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_name_that_is_not_utf8_is_reported(campaign_folders: CampaignFolders) -> None:
    Path(os.fsdecode(os.fsencode(campaign_folders.raw) + b"/\xff")).mkdir()
    content = list_raw(campaign_folders)
    assert len(content.problems) == 1
    assert content.problems[0].endswith(
        "\\udcff: expected a name in UTF-8, found a name with other bytes. Rename it; until then"
        " it is left out."
    )


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when a process began")
def test_claim_ends_with_its_process(catalog: Catalog) -> None:
    catalog.claim_test("T1")
    own_claim = catalog.read_claims()["T1"]
    ended = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)  # it is a zombie from here on
    claim = own_claim._replace(pid=ended.pid, start_time="")
    assert not is_alive(claim)
    ended.wait()
    assert not is_alive(claim)
    assert is_alive(own_claim)
    assert not is_alive(own_claim._replace(start_time="another boot 1"))


def test_old_claims_of_other_hosts_are_ignored() -> None:
    claim = Claim("elsewhere", 1, "", time.time())
    assert is_alive(claim)
    for age in (MAX_CLAIM_AGE + 1, -MAX_CLAIM_AGE - 1):  # the second: a clock that was set back
        assert not is_alive(claim._replace(since=time.time() - age))


@pytest.mark.parametrize(
    ("tests", "limit", "jobs"),
    [(0.2, 0, 1), (1.5, 0, 1), (3.5, 0, 3), (99.0, 0, 8), (99.0, "max", 8), (99.0, 3 * 10**9, 2)],
)
def test_default_jobs_from_cores_and_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tests: float, limit: int | str, jobs: int
) -> None:
    """A machine of eight cores, and a container of which 1 GB is used."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    free = SimpleNamespace(available=int(tests * BYTES_PER_TEST))
    monkeypatch.setattr(psutil, "virtual_memory", lambda: free)
    monkeypatch.setattr(executors, "_CONTROL_GROUP", tmp_path)
    if limit:
        (tmp_path / "memory.max").write_text(f"{limit}\n")
        (tmp_path / "memory.current").write_text("1000000000\n")
    assert choose_default_jobs() == jobs


def test_interrupted_replacement_is_completed(campaign_folders: CampaignFolders) -> None:
    folder = campaign_folders.processed / "T1"
    files = folder / ".labpipe.commit" / "files"
    files.mkdir(parents=True)
    (files.parent / "gone").write_text("", "utf-8")
    for name in ("summary.json", "result.h5"):
        (files / name).write_text("{}", "utf-8")
    assert list_processed(campaign_folders)["T1"].names == {"summary.json", "result.h5"}
    assert sorted(path.name for path in folder.iterdir()) == ["result.h5", "summary.json"]
