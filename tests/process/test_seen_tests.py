from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from labpipe.process.seen_tests import SeenTest, see_test, see_tests
from tests.builders.load_frames import mts_suite, zwick_tra
from tests.builders.small_tests import Lab


@pytest.fixture
def wire(lab: Lab) -> Path:
    """A wire in a folder that is named as the lab names them, without its test sheet."""
    folder = lab.raw.with_name("A2-085-3")
    shutil.copytree(lab.raw, folder)
    (folder / "test.yaml").unlink()
    shutil.rmtree(lab.raw)
    return folder


def has(seen: SeenTest, *parts: str) -> bool:
    return any(all(part in each for part in parts) for each in seen.said)


def test_all_that_can_be_seen(wire: Path) -> None:
    seen = see_test(wire, {})

    assert seen.values == {
        "test": "A2-085-3",
        "protocol": "wire-cantilever",
        "date": "2026-03-04",
        "operator": "labpipe virtual lab",
        "type": "A2",
        "sample": "3",
        "length": "85 mm",
    }
    assert seen.files == {"force": ("force.mat",), "markers": ("take.csv",)}
    assert seen.open == ("spool",)
    assert has(seen, "date 2026-03-04: from force.mat and take.csv")
    assert has(seen, "not used: truth.json: JSON")


def test_what_a_person_says_counts_before_what_is_seen(wire: Path) -> None:
    given = {"operator": "jk", "spool": "s", "protocol": "taped-bundle", "date": "2026-01-01"}
    seen = see_test(wire, given)
    assert given.items() <= seen.values.items()
    assert seen.open == ()
    assert not has(seen, "operator")


def test_contradictions_are_said(wire: Path) -> None:
    folder = wire.rename(wire.with_name("A2-120-3"))
    take = folder / "take.csv"
    text = take.read_text(encoding="utf-8")
    take.write_text(
        text.replace("2026-03-04", "2026-03-05").replace("Take Name,T1", "Take Name,A2-085-3"),
        encoding="utf-8",
    )
    seen = see_test(folder, {"protocol": "wire-cantilever"})
    assert "date" not in seen.values
    assert has(seen, "date: 2026-03-04 in force.mat, 2026-03-05 in take.csv; left out")
    assert has(seen, "look: take.csv is of 'A2-085-3', the folder is called 'A2-120-3'")
    assert has(seen, "look: the markers of take.csv show a length of about 86", "120 mm is stated")


def test_several_protocols_fit_alike(tmp_path: Path) -> None:
    (tmp_path / "pull").mkdir()
    (tmp_path / "pull" / "x.txt").write_bytes(mts_suite())
    seen = see_test(tmp_path / "pull", {})
    assert seen.open == ("protocol", "type", "spool", "sample")
    (first,) = (each for each in seen.said if each.startswith("protocol: "))
    asked, *named, decides = first.splitlines()
    assert "fit alike; name one with --protocol" in asked
    assert {"stiff-bar", "tensile", "three-point-bend"} <= {
        line.split(":")[0].strip() for line in named
    }
    assert "what would decide: a folder" in decides
    assert seen.files == {"frame": ("x.txt",)}
    assert see_test(tmp_path / "pull", {"protocol": "three-point-bend"}).open[-1] == "span"


def test_the_program_counts_the_specimens_where_the_folder_does_not(tmp_path: Path) -> None:
    for name in ("pull", "CT-10-2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "x.csv").write_bytes(b'"aktuelle Probe","16"\r\n' + zwick_tra())
    assert see_test(tmp_path / "pull", {}).values.get("sample") == "16"
    assert see_test(tmp_path / "CT-10-2", {}).values["sample"] == "2"


def test_two_exports_of_one_role(tmp_path: Path) -> None:
    for name in ("x.txt", "y.txt"):
        (tmp_path / name).write_bytes(mts_suite())
    seen = see_test(tmp_path, {"protocol": "tensile"})
    assert seen.files == {}
    assert "frame" in seen.open
    assert has(seen, "frame: x.txt, y.txt could each be it", "name one with --frame")
    assert see_test(tmp_path, {"protocol": "tensile", "frame": "y.txt"}).files == {
        "frame": ("y.txt",)
    }


def test_an_empty_folder_and_one_without_exports(tmp_path: Path) -> None:
    assert has(see_test(tmp_path, {}), "no exports lie here yet")
    (tmp_path / "x.bin").write_bytes(bytes(100))
    assert has(see_test(tmp_path, {}), "no export that labpipe reads lies here")
    assert has(see_test(tmp_path, {"frame": "a.txt"}), "not there yet: a.txt")


def test_a_name_of_a_folder_that_no_test_can_have(tmp_path: Path) -> None:
    folder = tmp_path / "Run 4, März (2)"
    folder.mkdir()
    assert see_test(folder, {}).values["test"] == "Run-4-März-2"


def test_tests_of_one_campaign_settle_each_other(wire: Path) -> None:
    longer = wire.with_name("A1-100-1")
    shutil.copytree(wire, longer)
    shutil.copytree(wire, wire.with_name("A0-100-1"))
    alone = see_test(longer, {})
    assert "protocol" in alone.values  # by the length that the markers show

    seen = {each.folder.name: each for each in see_tests(sorted(wire.parent.iterdir()), {})}

    assert {each.values["protocol"] for each in seen.values()} == {"wire-cantilever"}
