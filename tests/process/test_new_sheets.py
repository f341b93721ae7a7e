"""Test sheets from tables, from what folders hold, and from the protocol that fits."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProtocolError, ReadError, StoreError, UsageError
from labpipe.process.export_metadata import (
    FOLDER,
    Fact,
    agreed,
    day_in,
    facts_of_export,
    facts_of_folder,
)
from labpipe.process.protocol_match import Fit, KnownFacts, all_protocols, fitting
from labpipe.process.raw_folder import InspectedExport, look_into
from labpipe.process.sheet_inference import InferredTest, infer_test, infer_tests
from labpipe.process.sheet_writing import new_from_sheet, new_seen, write_seen
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from tests.approved import Approve
from tests.builders.load_frames import mts_suite
from tests.builders.small_tests import Lab

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
    assert [dict(part.labels) for part in (one, two, three)] == [{"cured": "24 h"}, {}, {}]
    assert resolve(load_test_sheet(made.written[0]), made.written[0]).specimen.span == 0.1524


def test_rows_added_later_leave_earlier_tests_alone(table: Path, tmp_path: Path) -> None:
    path = tmp_path / "raw" / "A2-1" / "test.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("mine", encoding="utf-8")

    made = new_from_sheet(table, tmp_path / "raw")
    assert (made.kept, len(made.written)) == ((path,), 1)
    assert path.read_text(encoding="utf-8") == "mine"

    made = new_from_sheet(table, tmp_path / "raw", overwrite=True)
    assert (made.kept, len(made.written)) == ((), 2)


def test_what_is_to_be_filled_in_is_marked_and_found(tmp_path: Path) -> None:
    values = {"test": "t", "type": "A2", "span": "", "protocol": ""}
    open_ = ("protocol", "spool", "sample", "span", "frame")
    seen = InferredTest(
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


def test_a_folder_that_cannot_be_made(table: Path, tmp_path: Path) -> None:
    (tmp_path / "raw").write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match=r"test\.yaml: expected "):
        new_from_sheet(table, tmp_path / "raw")


FAULTS_OF_A_TABLE = {
    "lenght": (("Length (mm)", "lenght"),),
    "a column twice": (("type;spool", "spool;spool"),),
    "no sample": (("A2;s1;2", "A2;s1;"),),
    "a mass": (("8 cm", "8 kg"),),
    "a protocol": (("A2-2;wire-cantilever", "A2-2;wire-cantilver"),),
    "a test twice": (("A2-2", "a2-1"),),
    "no reason": (("Grip;renamed", "Grip;"),),
    "a date": (("2026-03-04;a.mat;t.csv;Grip", "4.3.26;a.mat;t.csv;Grip"),),
    "a name": (("A2-2", "../A2"),),
    "bundles": (("19 B1;;;", "19 B1;symmetric;;half-lap"), ("10 B1 +", "10 B1,")),
}


@pytest.mark.parametrize("name", FAULTS_OF_A_TABLE)
def test_a_fault_names_its_cell_and_nothing_is_written(
    name: str,
    tmp_path: Path,
    repository: Path,
    monkeypatch: pytest.MonkeyPatch,
    approved: Approve,
) -> None:
    own, table = tmp_path / "protocols", tmp_path / "campaign.csv"
    own.mkdir()
    for protocol in ("wire-cantilever", "force-displacement", "markers-only"):
        shutil.copy(repository / "protocols" / f"{protocol}.yaml", own)
    monkeypatch.setattr("labpipe.protocol.load.protocol_folders", lambda _: (own,))
    text = BUNDLES if name == "bundles" else TABLE
    for old, new in FAULTS_OF_A_TABLE[name]:
        text = text.replace(old, new)
    table.write_text(text, encoding="utf-8")
    with pytest.raises(ReadError) as refused:
        new_from_sheet(table, tmp_path / "raw", protocols=own)
    assert not (tmp_path / "raw").exists()
    approved(str(refused.value).replace(str(table), "campaign.csv"))


@pytest.fixture
def wire(lab: Lab) -> Path:
    """A wire in a folder that is named as the lab names them, without its test sheet."""
    folder = lab.raw.with_name("A2-085-3")
    shutil.copytree(lab.raw, folder)
    (folder / "test.yaml").unlink()
    shutil.rmtree(lab.raw)
    return folder


def has(seen: InferredTest, *parts: str) -> bool:
    return any(all(part in sentence for part in parts) for sentence in seen.said)


def test_all_that_can_be_seen(wire: Path) -> None:
    seen = infer_test(wire, {})

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
    seen = infer_test(wire, given)
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
    seen = infer_test(folder, {"protocol": "wire-cantilever"})
    assert "date" not in seen.values
    assert has(seen, "date: 2026-03-04 in force.mat, 2026-03-05 in take.csv; left out")
    assert has(seen, "look: take.csv is of 'A2-085-3', the folder is called 'A2-120-3'")
    assert has(seen, "look: the markers of take.csv show a length of about 86", "120 mm is stated")


def test_several_protocols_fit_alike(tmp_path: Path) -> None:
    (tmp_path / "pull").mkdir()
    (tmp_path / "pull" / "x.txt").write_bytes(mts_suite())
    seen = infer_test(tmp_path / "pull", {})
    assert seen.open == ("protocol", "type", "spool", "sample")
    (first,) = (sentence for sentence in seen.said if sentence.startswith("protocol: "))
    asked, *named, decides = first.splitlines()
    assert "fit alike; name one with --protocol" in asked
    assert {"stiff-bar", "tensile", "three-point-bend"} <= {
        line.split(":")[0].strip() for line in named
    }
    assert "what would decide: a folder" in decides
    assert seen.files == {"frame": ("x.txt",)}
    assert infer_test(tmp_path / "pull", {"protocol": "three-point-bend"}).open[-1] == "span"


def test_two_exports_of_one_role(tmp_path: Path) -> None:
    for name in ("x.txt", "y.txt"):
        (tmp_path / name).write_bytes(mts_suite())
    seen = infer_test(tmp_path, {"protocol": "tensile"})
    assert seen.files == {}
    assert "frame" in seen.open
    assert has(seen, "frame: x.txt, y.txt could each be it", "name one with --frame")
    assert infer_test(tmp_path, {"protocol": "tensile", "frame": "y.txt"}).files == {
        "frame": ("y.txt",)
    }


def test_an_empty_folder_and_one_without_exports(tmp_path: Path) -> None:
    assert has(infer_test(tmp_path, {}), "no exports lie here yet")
    (tmp_path / "x.bin").write_bytes(bytes(100))
    assert has(infer_test(tmp_path, {}), "no export that labpipe reads lies here")
    assert has(infer_test(tmp_path, {"frame": "a.txt"}), "not there yet: a.txt")


def test_a_name_of_a_folder_that_no_test_can_have(tmp_path: Path) -> None:
    folder = tmp_path / "Run 4, März (2)"
    folder.mkdir()
    assert infer_test(folder, {}).values["test"] == "Run-4-März-2"


def test_tests_of_one_campaign_settle_each_other(wire: Path) -> None:
    longer = wire.with_name("A1-100-1")
    shutil.copytree(wire, longer)
    shutil.copytree(wire, wire.with_name("A0-100-1"))
    alone = infer_test(longer, {})
    assert "protocol" in alone.values  # by the length that the markers show

    seen = {
        infer_test.folder.name: infer_test
        for infer_test in infer_tests(sorted(wire.parent.iterdir()), {})
    }

    assert {each.values["protocol"] for each in seen.values()} == {"wire-cantilever"}


def facts(metadata: Mapping[str, object], name: str = "x.csv") -> dict[str, str]:
    return {
        fact.key: fact.value for fact in facts_of_export(name, Recording("r", metadata=metadata))
    }


@pytest.mark.parametrize(
    ("written", "day"),
    {
        "2026-03-04 10.05.00.000 AM": "2026-03-04",
        "20.02.2008": "2008-02-20",
        "10/26/2022 1:02:25 PM": "2022-10-26",
        "26/10/2022 13:02": "2022-10-26",
        "7/3/2025 12:23:28 PM": "2025-07-03",
        "7/7/2025": "2025-07-07",
        "7/3/2025 12:23": "",
        "31/31/2025": "",
        "43173.4": "",
    }.items(),
)
def test_a_day_is_read_where_its_order_is_plain(written: str, day: str) -> None:
    assert day_in(written) == day


def test_the_day_of_the_export_counts_before_that_of_its_name() -> None:
    assert facts({"Date": "27.02.2015"}, "2026-01-01.csv") == {"date": "2015-02-27"}
    assert facts({}, "2026-01-01.csv") == {"date": "2026-01-01"}
    assert facts({"Date/heure": "43173.4"}, "2026-01-01.csv") == {"date": "2026-01-01"}
    assert facts({}, "take.csv") == {}


def test_what_programs_say_of_operator_and_specimen() -> None:
    control = {"Description": {"General": {"User": "jk", "DateTime": "x"}}, "date": "2026-03-04"}
    assert facts(control) == {"date": "2026-03-04", "operator": "jk"}
    bluehill = {
        "Specimen properties : Length": "50 mm",
        "Specimen properties : Width": "wide",
        "General : Specimen number (included)": "7",
    }
    assert facts(bluehill) == {"length": "50 mm", "specimen": "7"}
    assert facts({"Operator": "<None>", "Test Run": "A2-085-1"}) == {"take": "A2-085-1"}


@pytest.mark.parametrize(
    ("name", "said"),
    {
        "A2-085-1": {"type": "A2", "length": "85 mm", "sample": "1"},
        "TWB-B1-19-PVC-2": {"type": "TWB-B1-19-PVC", "sample": "2"},
        "twist-tube-1a": {"type": "twist-tube", "sample": "1a"},
        "CT_10_3": {"type": "CT_10", "sample": "3"},
        "2026-03-04": {},
        "Test Run 4 10-23-2023 6 43 09 PM": {},
        "specimen": {},
    }.items(),
)
def test_the_pattern_of_a_lab(name: str, said: dict[str, str]) -> None:
    assert {fact.key: fact.value for fact in facts_of_folder(name)} == said


def test_what_all_say_is_taken_and_what_is_said_twice_is_left_open() -> None:
    both = agreed(
        [
            Fact("date", "2026-03-04", "a.mat"),
            Fact("date", "", "b.csv", "3/4/2026"),
            Fact("date", "2026-03-04", "take.csv"),
            Fact("operator", "jk", "a.mat"),
            Fact("operator", "vl", "take.csv"),
            Fact("type", "A2", FOLDER),
        ]
    )

    assert both.facts["date"].where == "a.mat and take.csv"
    assert list(both.facts) == ["date", "type"]
    assert both.open == ("operator: jk in a.mat, vl in take.csv; left out, write the right one",)


def test_a_day_that_can_be_read_two_ways_is_left_open() -> None:
    found = agreed([Fact("date", "", "b.csv", "3/4/2026")])
    said = "date: '3/4/2026' in b.csv can be read day first or month first; left out"
    assert (dict(found.facts), found.open) == ({}, (said,))


TIME: Floats = np.linspace(0.0, 120.0, 1201)


@pytest.fixture(scope="module")
def protocols() -> list[Protocol]:
    return all_protocols()


def cell() -> InspectedExport:
    """The load cell in volts, as the benches record it."""
    channel = Channel("Out1", "Model Root/Load Cell/Out1", np.sin(TIME))
    return InspectedExport(
        Path("f.mat"), Recording("dspace-mat", "", "", (Clock("time", TIME),), (channel,))
    )


def take(*, body: str = "Clamp", length: float = 0.085, stroke: float = 0.053) -> InspectedExport:
    """A clamp that goes down, and markers along a wire."""
    down = np.zeros((len(TIME), 3))
    down[:, 1] = -stroke * np.clip(TIME / 60.0, 0.0, 1.0)
    none = np.full((len(TIME), 4), np.nan)
    bodies = (RigidBody(body, down, none, none[:, 0]),) if body else ()
    along = length + 0.006 - 0.004
    last = down + np.array([along, 0.0, 0.0])
    tracks = MarkerTracks(TIME, TIME, 10.0, ("Wire:Marker1",), last[:, None, :], bodies)
    return InspectedExport(Path("t.csv"), Recording("motive-csv", markers=tracks))


def frame(
    travel: float, speed: float, *, peak: float = 100.0, start: float = 0.0, name: str = "m.txt"
) -> InspectedExport:
    """A pull on a load frame at a steady speed."""
    time = np.linspace(start, start + travel / speed, 400)
    clock = Clock("time", time)
    moved = Channel("Crosshead", "Crosshead", (time - start) * speed * 1e3, unit_in_file="mm")
    force = Channel("Load", "Load", peak * np.linspace(0.0, 1.0, 400), unit_in_file="N")
    recording = Recording("load-frame", "", "", (clock,), (moved, force), metadata={"dialect": "x"})
    return InspectedExport(Path(name), recording)


def names(fits: Sequence[Fit]) -> list[str]:
    return [fit.protocol.name for fit in fits]


def test_a_wire_is_known_by_clamp_length_and_stroke(protocols: list[Protocol]) -> None:
    (fit,) = fitting([cell(), take()], protocols, KnownFacts(("A2-085-1", "A2"), 0.085))
    assert fit.protocol.name == "wire-cantilever"
    assert fit.files == {"force": ("f.mat",), "markers": ("t.csv",)}
    assert fit.faults == ()


def test_a_bundle_is_longer(protocols: list[Protocol]) -> None:
    assert names(fitting([cell(), take(length=0.1143)], protocols, KnownFacts())) == [
        "taped-bundle"
    ]


def test_without_a_clamp_it_lies_on_two_supports(protocols: list[Protocol]) -> None:
    assert names(fitting([cell(), take(body="")], protocols, KnownFacts())) == ["conduit-bundle"]


def test_a_take_alone(protocols: list[Protocol]) -> None:
    assert names(fitting([take()], protocols, KnownFacts())) == ["markers-only"]


@pytest.mark.parametrize(
    ("of_type", "of_campaign", "expected"),
    [
        ({}, {"wire-cantilever": 1}, "wire-cantilever"),
        ({}, {"wire-cantilever": 3, "taped-bundle": 2}, "wire-cantilever"),
        ({}, {"wire-cantilever": 2, "taped-bundle": 2}, ""),
        ({}, {"wire-cantilever": 2, "corrugated-tube": 3}, ""),
        ({}, {"wire-cantilever": 6, "": 15}, ""),
        ({}, {"corrugated-tube": 9}, ""),
        ({"taped-bundle": 1}, {"wire-cantilever": 9, "taped-bundle": 1}, "taped-bundle"),
        ({"taped-bundle": 1, "": 1}, {"wire-cantilever": 9, "taped-bundle": 1}, "wire-cantilever"),
    ],
)
def test_what_fits_alike_is_settled_by_most_of_the_others(
    protocols: list[Protocol],
    of_type: dict[str, int],
    of_campaign: dict[str, int],
    expected: str,
) -> None:
    known = KnownFacts(of_type=of_type, of_campaign=of_campaign)
    found = fitting([cell(), take(length=0.1)], protocols, known)
    assert names(found) == ([expected] if expected else ["taped-bundle", "wire-cantilever"])
    if expected:
        share = f"{(of_type or of_campaign)[expected]} of " if not of_type.get("") else "9 of 10"
        assert share in found[0].signs[-1].text


@pytest.mark.parametrize("called", ["22AWG tensile_3", "tensile-1", "A Tensile (2)"])
def test_facts_of_the_export_count_before_the_others(
    protocols: list[Protocol], called: str
) -> None:
    """A short pull among tubes that are stretched by 50 mm is none of them."""
    pull = frame(0.012, 0.1e-3)
    among = {"corrugated-tube": 20}
    undecided = names(fitting([pull], protocols, KnownFacts(of_campaign=among)))
    assert "tensile" in undecided
    assert "corrugated-tube" not in undecided
    assert names(fitting([pull], protocols, KnownFacts((called,), of_campaign=among))) == [
        "tensile"
    ]


def test_tubes_and_tapes_by_stroke_speed_and_name(protocols: list[Protocol]) -> None:
    tube = frame(0.05, 0.423e-3)
    assert names(fitting([tube], protocols, KnownFacts())) == ["corrugated-tube"]
    tape = frame(0.04, 0.5e-3, peak=400.0)
    assert "tensile" in names(
        fitting([tape], protocols, KnownFacts())
    )  # one weak sign is too little
    assert names(fitting([tape], protocols, KnownFacts(("pet-tape-1",)))) == ["pet-tape"]


def test_parts_of_one_recording_are_of_one_role(protocols: list[Protocol]) -> None:
    parts = [frame(0.01, 1e-3, name="1.txt"), frame(0.01, 1e-3, start=11.0, name="2.txt")]
    for fit in fitting(parts, protocols, KnownFacts()):
        assert fit.files == {"frame": ("1.txt", "2.txt")}
        assert not fit.unclear


def test_nothing_fits_what_lacks_a_role(protocols: list[Protocol]) -> None:
    wire = [protocol for protocol in protocols if protocol.name == "wire-cantilever"]
    assert fitting([cell()], wire, KnownFacts()) == []
    assert fitting([cell(), take()], wire, KnownFacts(roles={"frame": ("m.txt",)})) == []


def test_real_parts_of_a_load_frame(protocols: list[Protocol], realdata: Path) -> None:
    folder = next((realdata / "mts" / "MTS_data").glob("*/Test Run 4*"))
    fits = fitting(look_into(folder).exports, protocols, KnownFacts())
    assert {len(fit.files["frame"]) for fit in fits} == {6}  # one of them is empty


def test_a_sheet_that_is_there_is_not_seen_again(tmp_path: Path) -> None:
    path = tmp_path / "t" / "test.yaml"
    path.parent.mkdir()
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="found one that is there already"):
        list(new_seen(tmp_path / "t", {}))
    assert path.read_text(encoding="utf-8") == "mine"
