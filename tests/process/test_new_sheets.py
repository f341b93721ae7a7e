from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError, ReadError, StoreError, UsageError
from labpipe.process.new_sheets import new_from_sheet, new_seen, write_seen
from labpipe.process.seen_tests import SeenTest
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.records.harness_bundle import Bundle, BundleWire

TABLE = """\
Test;protocol;type;spool;sample;Length (mm);date;force;markers;markers.clamp;because
A2-1;wire-cantilever;A2;s1;1;85;2026-03-04;a.mat;t.csv;;
A2-2;wire-cantilever;A2;s1;2;8 cm;2026-03-04;a.mat;t.csv;Grip;renamed
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "campaign.csv"
    path.write_text(TABLE, encoding="utf-8")
    return path


def test_one_test_sheet_per_row(table: Path, tmp_path: Path) -> None:
    made = new_from_sheet(table, tmp_path / "raw")

    first, second = (load_test_sheet(path) for path in made.written)
    assert made.kept == ()
    assert [path.parent.name for path in made.written] == ["A2-1", "A2-2"]
    assert (first.specimen.length, second.specimen.length) == (0.085, 0.080)
    assert (first.overrides, list(second.overrides)) == ({}, ["markers.clamp"])


BUNDLES = """\
test;protocol;type;spool;sample;Span (mm);Bundle_wires;Arrangement;tape;taping;conduit;\
Conduit_bore (mm);labels.cured;force;markers
C-1;wire-cantilever;CWB;s1;1;152.4;19 B1;;;;corrugated-tube;10.7;24 h;a.mat;t.csv
C-2;wire-cantilever;CWB;s1;2;152.4;10 B1 + 9 B2;asymmetric;PVC;coarse;twist-tube;;;a.mat;t.csv
C-3;wire-cantilever;B1;s1;3;152.4;;;;;;;;a.mat;t.csv
"""


def test_bundles_from_a_table(tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    path.write_text(BUNDLES, encoding="utf-8")

    made = new_from_sheet(path, tmp_path / "raw")

    one, two, three = (load_test_sheet(each).specimen.record for each in made.written)
    assert one.bundle == Bundle(
        (BundleWire("B1", 19),), conduit="corrugated-tube", conduit_bore=0.0107
    )
    assert two.bundle == Bundle(
        (BundleWire("B1", 10), BundleWire("B2", 9)),
        arrangement="asymmetric",
        tape="PVC",
        taping="coarse",
        conduit="twist-tube",
    )
    assert three.bundle is None
    assert [dict(each.labels) for each in (one, two, three)] == [{"cured": "24 h"}, {}, {}]
    assert resolve(load_test_sheet(made.written[0]), made.written[0]).specimen.span == 0.1524


def test_faults_of_bundles_name_their_cells(tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    wrong = BUNDLES.replace("19 B1;;;", "19 B1;symmetric;;half-lap").replace("10 B1 +", "10 B1,")
    path.write_text(wrong, encoding="utf-8")

    with pytest.raises(ReadError) as info:
        new_from_sheet(path, tmp_path / "raw")
    assert str(info.value).splitlines() == [
        f"{path}, line 2, column 8 (arrangement): expected 'packed' for wires of one type, found"
        " 'symmetric'. Only wires of different types can be spread one way or another: leave it"
        " out.",
        f"{path}, line 2, column 10 (taping): expected 'none' where there is no tape, found"
        " 'half-lap'. Write what tape it is, such as 'tape: PVC', or 'tape: unknown'.",
        f"{path}, line 3, column 7 (bundle_wires): expected wires by type, such as"
        " {B1: 10, B2: 9} or '10 B1 + 9 B2', found '10 B1, 9 B2'.",
    ]
    assert not (tmp_path / "raw").exists()


def test_rows_added_later_leave_earlier_tests_alone(table: Path, tmp_path: Path) -> None:
    path = tmp_path / "raw" / "A2-1" / "test.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("mine", encoding="utf-8")

    made = new_from_sheet(table, tmp_path / "raw")
    assert (made.kept, len(made.written)) == ((path,), 1)
    assert path.read_text(encoding="utf-8") == "mine"

    made = new_from_sheet(table, tmp_path / "raw", overwrite=True)
    assert (made.kept, len(made.written)) == ((), 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "Length (mm)",
            "lenght",
            "line 1, column 6: expected one of 'length', 'test', 'arrangement', 'sample', 'taping',"
            " ..., or a dotted key, found 'lenght'. Did you mean 'length'?",
        ),
        (
            "type;spool",
            "spool;spool",
            "line 1, column 4: expected each column once, found 'spool' again."
            " Remove or rename one of them.",
        ),
        (
            "type;spool",
            "spool;spool",
            "line 1, column 1: expected a column 'type', found none. Add it.",
        ),
        (
            "A2;s1;2",
            "A2;s1;",
            "line 3, column 5 (sample): expected a value for 'sample', found none. Fill it in.",
        ),
        (
            "8 cm",
            "8 kg",
            "line 3, column 6 (length): expected a quantity with a unit such as mm, found '8 kg'."
            " kg is a unit of mass. Write it with its unit, such as '53 mm'.",
        ),
        (
            "A2-2;wire-cantilever",
            "A2-2;wire-cantilver",
            "line 3, column 2 (protocol): expected one of the protocols 'wire-cantilever',"
            " 'force-displacement', 'markers-only', found 'wire-cantilver'."
            " Did you mean 'wire-cantilever'?",
        ),
        (
            "A2-2",
            "a2-1",
            "line 3, column 1: expected each test once, found 'a2-1' again."
            " Give each test a name of its own.",
        ),
        (
            "Grip;renamed",
            "Grip;",
            "line 3, column 11 (because): expected a value for 'because', found none. Fill it in.",
        ),
        (
            "2026-03-04;a.mat;t.csv;Grip",
            "4.3.26;a.mat;t.csv;Grip",
            "line 3, column 7 (date): expected a date such as 2026-03-04, found '4.3.26'.",
        ),
        (
            "A2-2",
            "../A2",
            "line 3, column 1 (test): expected a name of letters, digits, '-', '_', '.' and '+',"
            " found '../A2'.",
        ),
    ],
)
def test_a_fault_names_its_cell_and_nothing_is_written(
    old: str,
    new: str,
    message: str,
    table: Path,
    tmp_path: Path,
    repository: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shipped = ("wire-cantilever", "force-displacement", "markers-only")
    own = tmp_path / "protocols"
    own.mkdir()
    for name in shipped:
        shutil.copy(repository / "protocols" / f"{name}.yaml", own)
    monkeypatch.setattr("labpipe.protocol.load.protocol_folders", lambda _: (own,))
    table.write_text(TABLE.replace(old, new), encoding="utf-8")

    with pytest.raises(ReadError) as info:
        new_from_sheet(table, tmp_path / "raw", protocols=own)

    assert f"{table}, {message}" in str(info.value).splitlines()
    assert not (tmp_path / "raw").exists()


def test_what_is_to_be_filled_in_is_marked_and_found(tmp_path: Path) -> None:
    values = {"test": "t", "type": "A2", "span": "", "protocol": ""}
    open_ = ("protocol", "spool", "sample", "span", "frame")
    seen = SeenTest(
        tmp_path, {k: v for k, v in values.items() if v}, {"force": ("a;b.mat",)}, open_
    )

    sheet = write_seen(seen)

    assert sheet.open == open_
    lines = sheet.path.read_text(encoding="utf-8").splitlines()
    blank = [line.strip() for line in lines if line.endswith("# to be filled in")]
    assert blank == [
        f"{key}:   # to be filled in" for key in ("protocol", "spool", "sample", "span", "frame")
    ]
    assert "  force: a;b.mat" in lines  # a name, not two
    with pytest.raises(ProtocolError) as info:
        load_test_sheet(sheet.path)
    assert len(str(info.value).splitlines()) == len(open_)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"length": "85"}, "length: expected a quantity with a unit"),
        ({"typ": "A"}, "expected one of .*found 'typ'"),
        ({"labels.Cured": "24 h"}, "labels.Cured: expected a name of small letters"),
        ({"conduit": "twist-tube"}, "bundle_wires: expected a value for 'bundle_wires'"),
        ({"force": "../a.mat"}, "force: expected a file inside the folder of the test"),
        ({"markers.clamp": "Grip"}, "because: expected a value for 'because', found none"),
    ],
)
def test_a_wrong_value_is_refused_though_others_are_open(
    values: dict[str, str], message: str, tmp_path: Path
) -> None:
    (tmp_path / "x").mkdir()
    with pytest.raises(UsageError, match=message):
        list(new_seen(tmp_path / "x", values))
    assert not (tmp_path / "x" / "test.yaml").exists()


def test_a_sheet_that_is_there_is_not_seen_again(tmp_path: Path) -> None:
    path = tmp_path / "t" / "test.yaml"
    path.parent.mkdir()
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="found one that is there already"):
        list(new_seen(tmp_path / "t", {}))
    assert path.read_text(encoding="utf-8") == "mine"


def test_a_folder_that_cannot_be_made(table: Path, tmp_path: Path) -> None:
    (tmp_path / "raw").write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match=r"test\.yaml: expected "):
        new_from_sheet(table, tmp_path / "raw")


def test_exports_that_a_table_names_and_that_are_not_there(tmp_path: Path) -> None:
    table = tmp_path / "c.csv"
    rows = (
        "test,protocol,type,spool,sample,force,markers\nt,wire-cantilever,A,s,1,a.mat;b.mat,c.csv\n"
    )
    table.write_text(rows, encoding="utf-8")
    (tmp_path / "raw" / "t").mkdir(parents=True)
    (tmp_path / "raw" / "t" / "a.mat").write_bytes(b"x")
    made = new_from_sheet(table, tmp_path / "raw")
    assert dict(made.absent) == {tmp_path / "raw" / "t" / "test.yaml": ("b.mat", "c.csv")}
