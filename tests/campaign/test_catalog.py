"""The catalog of a campaign, its file and folders, and the machine that it lies on."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath

import pytest

from labpipe.campaign import machine
from labpipe.campaign.campaign_folders import (
    CampaignFolders,
    find_campaign,
    list_processed,
    list_raw,
    look_at_outcome,
)
from labpipe.campaign.catalog import (
    OK,
    SCHEMA,
    STALE,
    Catalog,
    Entry,
    Seen,
    TestRow,
    speaking,
    uri_of,
)
from labpipe.campaign.catalog_file import new_catalog, open_catalog
from labpipe.campaign.machine import BYTES_PER_TEST, default_jobs
from labpipe.campaign.outcome_rows import ResultRow
from labpipe.campaign.remote_drives import is_on_this_machine, shared_kind
from labpipe.campaign.running import look
from labpipe.campaign.test_locks import LONGEST, is_alive, new_claim
from labpipe.errors import StoreError, UsageError
from tests.builders.kept_campaigns import KeptCampaign, content_of

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


def test_what_another_process_knows_better_stays(catalog: Catalog) -> None:
    catalog.put([ENTRY])
    before = catalog.seen()
    newer = replace(ENTRY, row=replace(ENTRY.row, run="newer"), seen=Seen("{}", "newer"))
    catalog.put([newer])
    catalog.put([replace(ENTRY, row=replace(ENTRY.row, state=STALE))], before)
    assert catalog.row_of("T1") == newer.row


def test_nothing_of_several_changes_is_kept_when_one_fails(catalog: Catalog) -> None:
    bad = replace(ENTRY, row=replace(ENTRY.row, folder="T2", state=None))  # type: ignore[arg-type]
    with pytest.raises(StoreError, match="NOT NULL constraint failed"):
        catalog.put([ENTRY, bad])
    assert catalog.rows() == {}


def test_a_test_is_claimed_once(catalog: Catalog) -> None:
    assert catalog.claim("T1")
    assert not catalog.claim("T1")
    assert set(catalog.claims()) == {"T1"}
    catalog.release("T1")
    assert catalog.claim("T1")


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


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    kept.run()
    return kept


def sql(kept: KeptCampaign, *statements: str) -> None:
    with closing(sqlite3.connect(kept.processed / "catalog.sqlite")) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()


def test_a_catalog_that_was_deleted_is_made_anew(kept: KeptCampaign) -> None:
    before = content_of(kept)
    for file in kept.processed.glob("catalog.sqlite*"):
        file.unlink()
    overview = look(kept.folders)
    assert (overview.notes, overview.counts) == ([], {OK: 1})
    assert content_of(kept) == before


DAMAGES = {
    "empty": b"",
    "text": b"this is no data base, but it is long enough to look like one" * 100,
    "cut": None,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_catalog_is_put_aside_and_made_anew(kept: KeptCampaign, damage: str) -> None:
    before = content_of(kept)
    path = kept.processed / "catalog.sqlite"
    content = DAMAGES[damage]
    path.write_bytes(path.read_bytes()[:9000] if content is None else content)
    overview = look(kept.folders)
    assert overview.counts == {OK: 1}
    assert overview.notes[0].startswith(
        f"{path}: made anew from the files of the tests: it was damaged ("
    )
    assert path.with_name("catalog.sqlite.damaged").exists()
    assert content_of(kept) == before
    kept.run()
    assert kept.stand_in.processed == []


def test_a_newer_catalog_is_refused(kept: KeptCampaign) -> None:
    sql(kept, f"pragma user_version = {SCHEMA + 1}")
    message = f"expected a catalog of the version {SCHEMA}, found version {SCHEMA + 1}. A newer"
    for _ in range(2):
        with pytest.raises(UsageError, match=message):
            kept.run()
    assert not (kept.processed / "catalog.sqlite.damaged").exists()


def test_a_data_base_of_another_program_is_refused(kept: KeptCampaign) -> None:
    sql(kept, "pragma application_id = 7")
    message = "expected a catalog of labpipe, found a data base of another program. Move it away"
    with pytest.raises(UsageError, match=message):
        look(kept.folders)


@pytest.mark.parametrize(("is_own", "mode"), [(True, "wal"), (False, "delete")])
def test_the_journal_fits_the_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_own: bool, mode: str
) -> None:
    monkeypatch.setattr("labpipe.campaign.catalog_file.is_on_this_machine", lambda _: is_own)
    new_catalog(tmp_path).close()
    catalog = open_catalog(tmp_path)
    ((found,),) = catalog._all("pragma journal_mode")
    catalog.close()
    assert found == mode


def test_a_catalog_that_another_process_is_writing(
    kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.catalog._WAIT", 0.05)
    with closing(sqlite3.connect(kept.processed / "catalog.sqlite")) as connection:
        connection.execute("begin immediate")
        catalog = open_catalog(kept.processed)
        with closing(catalog), pytest.raises(StoreError, match=r"found database is locked\. A"):
            catalog.claim("T1")


@pytest.fixture
def campaign(tmp_path: Path) -> CampaignFolders:
    for name in ("T1", "more/T2", "figures", ".hidden/T3"):
        folder = tmp_path / "raw" / "C" / name
        folder.mkdir(parents=True)
        (folder / "test.yaml").write_text("", "utf-8")
        (folder / "force.mat").write_text("", "utf-8")
    (tmp_path / "raw" / "C" / "notes.txt").write_text("", "utf-8")
    (tmp_path / "processed" / "C").mkdir(parents=True)
    return find_campaign(tmp_path / "raw" / "C")


def test_folders_that_are_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    for place, found in (("nowhere", "nothing of that name"), ("file", "a file")):
        with pytest.raises(UsageError, match=f"expected the folder of a campaign, found {found}"):
            find_campaign(tmp_path / place)
    with pytest.raises(UsageError, match="a folder below 'raw' or 'processed', found one that"):
        find_campaign(tmp_path)
    (tmp_path / "raw" / "T1").mkdir(parents=True)
    (tmp_path / "raw" / "T1" / "test.yaml").write_text("", "utf-8")
    with pytest.raises(UsageError, match=r"a campaign, found that of a single test\. Put the"):
        find_campaign(tmp_path / "raw" / "T1")


def test_tests_and_files_but_hidden_ones_and_links(campaign: CampaignFolders) -> None:
    (campaign.raw / "linked").symlink_to(campaign.raw / "T1")
    found = list_raw(campaign)
    assert found.sheets == {
        name: campaign.raw / name / "test.yaml" for name in ("T1", "figures", "more/T2")
    }
    assert sorted(found.files) == [
        "T1/force.mat", "T1/test.yaml", "figures/force.mat", "figures/test.yaml", "linked",
        "more/T2/force.mat", "more/T2/test.yaml", "notes.txt",
    ]  # fmt: skip
    assert found.refused == []


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_of_other_bytes_is_said(campaign: CampaignFolders) -> None:
    Path(os.fsdecode(os.fsencode(campaign.raw) + b"/\xff")).mkdir()
    found = list_raw(campaign)
    assert len(found.refused) == 1
    assert found.refused[0].endswith(
        "\\udcff: expected a name in UTF-8, found other bytes. Rename it; it was left out."
    )


def test_a_test_sheet_that_is_no_file_is_said(campaign: CampaignFolders) -> None:
    sheet = campaign.raw / "T1" / "test.yaml"
    sheet.unlink()
    sheet.symlink_to("nowhere")
    found = list_raw(campaign)
    assert "T1" not in found.sheets
    assert found.refused == [
        f"{sheet}: expected a file, found a pipe, or a link to nowhere. Put the test sheet there."
    ]


def test_outcomes_and_what_changes_their_marks(campaign: CampaignFolders) -> None:
    folder = campaign.processed / "T1"
    (folder / "figures").mkdir(parents=True)
    assert list_processed(campaign) == {}
    (folder / "summary.json").write_text("{}", "utf-8")
    half = list_processed(campaign)["T1"]
    assert (half.has_results, half.has_failure) == (False, False)
    (folder / "result.h5").write_text("", "utf-8")
    whole = list_processed(campaign)["T1"]
    assert whole == look_at_outcome(campaign, "T1")
    assert (whole.has_results, whole.has_failure) == (True, False)
    (folder / "failure.json").write_text("{}", "utf-8")
    assert list_processed(campaign)["T1"].has_failure
    (folder / "failure.json").unlink()
    assert list_processed(campaign)["T1"] == whole
    (folder / "summary.json").write_text("{ }", "utf-8")
    assert list_processed(campaign)["T1"] != whole


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX alone keeps what has ended")
def test_a_process_that_ended_does_not() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)  # it is a zombie from here on
    assert not is_alive(replace(new_claim(), pid=ended.pid, process=""))
    ended.wait()
    assert not is_alive(replace(new_claim(), pid=ended.pid, process=""))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when a process began")
def test_a_process_that_got_the_number_of_another_is_not_that_one() -> None:
    assert not is_alive(replace(new_claim(), process="another boot 1"))


def test_of_another_host_the_claim_must_be_young() -> None:
    other = replace(new_claim(), host="elsewhere", pid=1)
    assert is_alive(other)
    for age in (LONGEST + 1, -LONGEST - 1):  # the second: a clock that was set back
        assert not is_alive(replace(other, since=time.time() - age))


MOUNTS = """\
22 1 8:1 / / rw,relatime - ext4 /dev/sda1 rw
30 22 0:40 / /mnt/lab rw shared:1 - nfs4 server:/lab rw
31 30 0:41 / /mnt/lab/own\\040disk rw - xfs /dev/sdb rw
no mount at all
32 22 0:42 / /mnt/win rw - cifs //server/share rw
"""


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/processed/C", "ext4"),
        ("/mnt/lab/processed/C", "nfs4"),
        ("/mnt/lab", "nfs4"),
        ("/mnt/laboratory", "ext4"),
        ("/mnt/lab/own disk/C", "xfs"),
        ("/mnt/win/C", "cifs"),
    ],
)
def test_the_deepest_mount_counts(path: str, kind: str) -> None:
    assert shared_kind(MOUNTS, path) == kind


@pytest.mark.skipif(sys.platform != "linux", reason="the table of mounts is that of Linux")
def test_a_shared_drive_is_not_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_on_this_machine(Path("/proc").resolve())
    for kind, own in (("nfs4", False), ("fuse.sshfs", False), ("", False), ("ext4", True)):
        monkeypatch.setattr("labpipe.campaign.remote_drives.shared_kind", lambda *_, k=kind: k)
        assert is_on_this_machine(tmp_path) is own


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of eight cores, whose memory files state."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(machine, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(machine, "_CONTAINER", tmp_path)
    return tmp_path


def free(system: Path, tests: float) -> None:
    kilobytes = int(tests * BYTES_PER_TEST / 1024)
    (system / "meminfo").write_text(f"MemTotal: 99 kB\nMemAvailable: {kilobytes} kB\n")


@pytest.mark.parametrize(("tests", "jobs"), [(0.2, 1), (1.5, 1), (3.5, 3), (100.0, 8)])
def test_the_cores_but_no_more_than_the_memory_takes(system: Path, tests: float, jobs: int) -> None:
    free(system, tests)
    assert default_jobs() == jobs


@pytest.mark.parametrize(("most", "used", "jobs"), [("max", 0, 8), ("3000000000", 1e9, 2)])
def test_a_container_may_have_less(system: Path, most: str, used: float, jobs: int) -> None:
    free(system, 100.0)
    (system / "memory.max").write_text(f"{most}\n")
    (system / "memory.current").write_text(f"{used:.0f}\n")
    assert default_jobs() == jobs


def test_what_a_killed_process_left_half_replaced_is_finished(campaign: CampaignFolders) -> None:
    folder = campaign.processed / "T1"
    files = folder / ".labpipe.commit" / "files"
    files.mkdir(parents=True)
    (files.parent / "gone").write_text("", "utf-8")
    for name in ("summary.json", "result.h5"):
        (files / name).write_text("{}", "utf-8")
    assert list_processed(campaign)["T1"].has_results
    assert sorted(path.name for path in folder.iterdir()) == ["result.h5", "summary.json"]
