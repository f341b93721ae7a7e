from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from labpipe.campaign.catalog import OK, SCHEMA
from labpipe.campaign.catalog_file import NoCatalog, new_catalog, open_catalog
from labpipe.campaign.running import look
from labpipe.errors import StoreError, UsageError
from tests.builders.kept_campaigns import KeptCampaign, content_of


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


def test_pages_that_were_overwritten(kept: KeptCampaign) -> None:
    before = content_of(kept)
    path = kept.processed / "catalog.sqlite"
    data = bytearray(path.read_bytes())
    data[4096 : 4096 * 6] = b"\xff" * (4096 * 5)
    path.write_bytes(data)
    assert look(kept.folders).counts == {OK: 1}
    assert content_of(kept) == before


def test_a_table_that_is_missing(kept: KeptCampaign) -> None:
    sql(kept, "drop table seen")
    (note,) = look(kept.folders).notes
    assert note.endswith("it was damaged (without seen)")


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


def test_a_folder_in_its_place(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    (kept.processed / "catalog.sqlite").mkdir(parents=True)
    assert kept.run().overview.notes[0].endswith("made anew from the files of the tests: no file")
    assert (kept.processed / "catalog.sqlite.damaged").is_dir()


def test_names_that_a_uri_could_take_for_something_else(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path / "a?b#c%20d;é '\"")
    kept.add("T1")
    kept.run()
    assert look(kept.folders).counts == {OK: 1}
    assert (kept.processed / "catalog.sqlite").is_file()


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


def test_there_is_none(tmp_path: Path) -> None:
    with pytest.raises(NoCatalog, match="there was none"):
        open_catalog(tmp_path)
