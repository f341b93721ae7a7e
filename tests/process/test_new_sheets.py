"""Test sheets from tables, from what folders hold, and from the protocol that fits."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProtocolError, ReadError, StoreError, UsageError
from labpipe.process.sheet_inference import (
    FOLDER_NAME_SOURCE,
    InferredTest,
    ProtocolMatch,
    collect_facts,
    infer_test,
    infer_tests,
    load_all_protocols,
    make_test_name,
    match_protocols,
    parse_date,
    parse_folder_name,
)
from labpipe.process.sheet_writing import (
    write_inferred_sheet,
    write_inferred_sheets,
    write_table_sheets,
)
from labpipe.protocol.grammar import is_test_name
from labpipe.protocol.load import load_test_sheet, resolve_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.yaml_text import parse_yaml
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


BUNDLES = """\
test;protocol;type;spool;sample;Span (mm);Bundle_wires;Arrangement;tape;taping;conduit;\
Conduit_bore (mm);labels.cured;force;markers
C-1;wire-cantilever;CWB;s1;1;152.4;19 B1;;;;corrugated-tube;10.7;24 h;a.mat;t.csv
C-2;wire-cantilever;CWB;s1;2;152.4;10 B1 + 9 B2;asymmetric;PVC;coarse;twist-tube;;;a.mat;t.csv
C-3;wire-cantilever;B1;s1;3;152.4;;;;;;;;a.mat;t.csv
"""


PULL = """\
test;protocol;type;spool;sample;gauge_length (mm);section.area (mm^2);frame
P-1;iso-6892;42CrMoS4;1;1;25;19.66;a.csv
"""


def sheets_of(table: str, folder: Path) -> list[TestSheet]:
    (folder / "campaign.csv").write_text(table, encoding="utf-8")
    sheets = write_table_sheets(folder / "campaign.csv", folder / "raw")
    assert not any(sheet.is_kept for sheet in sheets)
    return [load_test_sheet(sheet.path) for sheet in sheets]


def test_one_test_sheet_per_row(tmp_path: Path) -> None:
    first, second = sheets_of(TABLE, tmp_path)
    assert (first.test, second.test) == ("A2-1", "A2-2")
    assert (first.specimen.length, second.specimen.length) == (0.085, 0.080)
    assert (first.overrides, list(second.overrides)) == ({}, ["markers.clamp"])

    sheets = sheets_of(BUNDLES, tmp_path)
    specimens = [sheet.specimen.record for sheet in sheets]
    tube = Bundle((BundleWire("B1", 19),), conduit="corrugated-tube", conduit_bore=0.0107)
    mixed = Bundle(
        (BundleWire("B1", 10), BundleWire("B2", 9)),
        arrangement="asymmetric",
        tape="PVC",
        taping="coarse",
        conduit="twist-tube",
    )
    assert [specimen.bundle for specimen in specimens] == [tube, mixed, None]
    assert [dict(part.labels) for part in specimens] == [{"cured": "24 h"}, {}, {}]
    path = tmp_path / "raw" / "C-1" / "test.yaml"
    assert resolve_protocol(sheets[0], path).specimen.span == 0.1524

    (pull,) = sheets_of(PULL, tmp_path)
    specimen = resolve_protocol(pull, tmp_path / "raw" / "P-1" / "test.yaml").specimen
    assert specimen.section is not None
    assert (specimen.gauge_length, specimen.section.area) == pytest.approx((0.025, 19.66e-6))


def test_what_is_to_be_filled_in_is_marked_and_found(tmp_path: Path) -> None:
    open_ = ("protocol", "spool", "sample", "span", "frame")
    values = {"test": "t", "type": "A2"}
    sheet = write_inferred_sheet(InferredTest(tmp_path, values, {"force": ("a;b.mat",)}, open_))
    assert sheet.open_keys == open_
    lines = sheet.path.read_text(encoding="utf-8").splitlines()
    blank = [line.strip() for line in lines if line.endswith("# to be filled in")]
    assert blank == [f"{key}:   # to be filled in" for key in open_]
    assert "  force: a;b.mat" in lines  # a name, not two
    with pytest.raises(ProtocolError) as refused:
        load_test_sheet(sheet.path)
    assert len(str(refused.value).splitlines()) == len(open_)


WRONG_VALUES = (
    *({"length": "85"}, {"typ": "A"}, {"labels.Cured": "24 h"}, {"conduit": "twist-tube"}),
    *({"force": "../a.mat"}, {"markers.clamp": "Grip"}),
)


def test_a_wrong_value_is_refused_though_others_are_open(tmp_path: Path, approved: Approve) -> None:
    (tmp_path / "x").mkdir()
    messages = []
    for values in WRONG_VALUES:
        with pytest.raises(UsageError) as refused:
            list(write_inferred_sheets(tmp_path / "x", values))
        messages.append(str(refused.value))
        assert not (tmp_path / "x" / "test.yaml").exists()
    approved(messages)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "raw").write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match=r"test\.yaml: expected "):
        sheets_of(TABLE, tmp_path)


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
    monkeypatch.setattr("labpipe.protocol.load.list_protocol_folders", lambda _: (own,))
    text = BUNDLES if name == "bundles" else TABLE
    for old, new in FAULTS_OF_A_TABLE[name]:
        text = text.replace(old, new)
    table.write_text(text, encoding="utf-8")
    with pytest.raises(ReadError) as refused:
        write_table_sheets(table, tmp_path / "raw")
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


def page(seen: InferredTest) -> list[str]:
    """What was inferred of a test, and why."""
    files = {role: " ".join(files) for role, files in seen.files.items()}
    return [f"{seen.values} {files} open: {', '.join(seen.open_keys)}", *seen.remarks]


def test_all_that_can_be_seen(wire: Path, approved: Approve) -> None:
    """And contradictions: another date in the take, another name and length of the folder."""
    pages = page(infer_test(wire, {}))
    folder = wire.rename(wire.with_name("A2-120-3"))
    text = (folder / "take.csv").read_text(encoding="utf-8").replace("2026-03-04", "2026-03-05")
    text = text.replace("Take Name,T1", "Take Name,A2-085-3")
    (folder / "take.csv").write_text(text, encoding="utf-8")
    approved([*pages, *page(infer_test(folder, {"protocol": "wire-cantilever"}))])


def test_folders_that_leave_something_open(tmp_path: Path, approved: Approve) -> None:
    folder = tmp_path / "Run 4, März (2)"
    folder.mkdir()
    pages = page(infer_test(folder, {}))
    (folder / "x.bin").write_bytes(bytes(100))
    pages += page(infer_test(folder, {})) + page(infer_test(folder, {"frame": "a.txt"}))
    for name in ("x.txt", "y.txt"):
        (folder / name).write_bytes(mts_suite())
        pages += page(infer_test(folder, {"protocol": "tensile"}))
    pages += page(infer_test(folder, {"protocol": "tensile", "frame": "y.txt"}))
    pages += page(infer_test(folder, {"protocol": "no-such", "force": "x.txt; y.txt;"}))
    approved(pages)


def test_an_error_without_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path) -> None:
        raise OSError

    (tmp_path / "x.txt").touch()
    monkeypatch.setattr("labpipe.process.sheet_inference.recognise_export", refuse)
    assert "not used: x.txt ()" in infer_test(tmp_path, {}).remarks


def test_a_file_stated_for_the_later_role_is_not_of_the_earlier_one(
    protocols: list[Protocol],
) -> None:
    """Two exports that either role of one protocol may have."""
    (tensile,) = (protocol for protocol in protocols if protocol.name == "tensile")
    (source,) = tensile.sources.values()
    roles = dict.fromkeys(("force", "frame"), source)
    both = tensile.model_copy(update={"sources": roles})
    exports = dict([frame(0.01, 1e-3, name="1.txt"), frame(0.01, 1e-3, name="2.txt")])
    for name, other_name in (("1.txt", "2.txt"), ("2.txt", "1.txt")):
        (match,) = match_protocols(exports, [both], stated_files={"frame": (name,)})
        assert match.files == {"force": (other_name,), "frame": (name,)}


def test_names_of_protocols_are_found_whatever_separates_their_words(
    protocols: list[Protocol],
) -> None:
    """As in `pet_tape`, whose folder is `PET-tape 1`; a part of a word is no name."""
    (tensile,) = (protocol for protocol in protocols if protocol.name == "tensile")
    alike = [tensile.model_copy(update={"name": name}) for name in ("pet_tape.2", "tap")]
    for called, expected in (("PET-tape 2", "pet_tape.2"), ("tap_1", "tap")):
        (match,) = match_protocols(dict([frame(0.012, 1e-4)]), alike, names=(called,))
        assert match.protocol.name == expected


@pytest.mark.parametrize("name", ["con", "a.", "..", "é" * 80, "a" * 114 + ".b " * 9, "Run 4, (2)"])
def test_names_that_no_folder_can_have(name: str) -> None:
    assert is_test_name(make_test_name(name))


def test_several_protocols_fit_alike(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_bytes(mts_suite())
    test = infer_test(tmp_path, {})
    assert test.open_keys == ("protocol", "type", "spool", "sample")
    (first,) = (sentence for sentence in test.remarks if sentence.startswith("protocol: "))
    for part in ("--protocol", "stiff-bar", "tensile"):
        assert part in first
    assert infer_test(tmp_path, {"protocol": "three-point-bend"}).open_keys[-1] == "span"


@pytest.mark.parametrize(
    ("protocol", "stated", "asked"),
    [
        ("iso-6892", {}, ("gauge_length", "section.area")),
        ("iso-527-tape", {"length": "80 mm"}, ("gauge_length", "section.area")),
        ("iso-527-tape", {"gauge_length": "50 mm", "section.area": "10 mm^2"}, ()),
        ("iso-527-tape", {"gauge_length": "50 mm", "width": "10 mm", "thickness": "1 mm"}, ()),
        ("iso-6892", {"gauge_length": "25 mm", "section.outer_diameter": "5 mm"}, ()),
        ("tensile", {}, ()),
    ],
)
def test_tension_tests_ask_for_gauge_length_and_section(
    tmp_path: Path, protocol: str, stated: dict[str, str], asked: tuple[str, ...]
) -> None:
    (tmp_path / "x.csv").write_text(PULLED, encoding="utf-8")
    values = dict.fromkeys(("type", "spool", "sample"), "1") | stated
    test = infer_test(tmp_path, {"protocol": protocol} | values)
    assert test.open_keys == asked
    data = parse_yaml(write_inferred_sheet(test).path.read_text(encoding="utf-8"), "").data
    assert isinstance(data, Mapping)
    sizes = data["specimen"]
    assert sizes.get("section", {}) == {
        **({"area": None} if "section.area" in asked else {}),
        **({"area": "10 mm^2"} if "section.area" in stated else {}),
        **({"outer_diameter": "5 mm"} if "section.outer_diameter" in stated else {}),
        **({"width": "10 mm", "thickness": "1 mm"} if "width" in stated else {}),
    }


def test_what_a_person_says_counts_before_what_is_seen(wire: Path) -> None:
    options = {"operator": "jk", "spool": "s", "protocol": "taped-bundle", "date": "2026-01-01"}
    test = infer_test(wire, options)
    assert options.items() <= test.values.items()
    assert test.open_keys == ()
    assert "operator" not in str(test.remarks)


def test_tests_of_one_campaign_settle_each_other(wire: Path) -> None:
    longer = wire.with_name("A1-100-1")
    shutil.copytree(wire, longer)
    assert "protocol" in infer_test(longer, {}).open_keys

    campaign = infer_tests(sorted(wire.parent.iterdir()), {})
    assert {test.values["protocol"] for test in campaign} == {"wire-cantilever"}


DAYS = (
    *("2026-03-04 10.05.00.000 AM", "20.02.2008", "10/26/2022 1:02:25 PM", "26/10/2022 13:02"),
    *("7/3/2025 12:23:28 PM", "7/7/2025", "7/3/2025 12:23", "31/31/2025", "43173.4"),
    *("2025-13-45 26/10/2022", "31/31/2025 26/10/2022", "7/3/2025 26/10/2022"),
    "26/10/2022 1:02 PM",
)
CONTROLDESK = {"Description": {"General": {"User": "jk", "DateTime": "x"}}, "date": "2026-03-04"}
BLUEHILL = {
    "Specimen properties : Length": "50 mm",
    "Specimen properties : Width": "wide",
    "General : Specimen number (included)": "7",
}
EXPORTS: tuple[tuple[str, Mapping[str, object]], ...] = (
    ("2026-01-01.csv", {"Date": "27.02.2015"}),
    ("2026-01-01.csv", {}),
    ("2026-01-01.csv", {"Date/heure": "43173.4"}),
    ("take.csv", {}),
    ("x.csv", CONTROLDESK),
    ("x.csv", BLUEHILL),
    ("x.csv", {"Gauge length": "25 mm", "Original cross-section": "19.66 mm²"}),
    ("x.csv", {"Operator": "<None>", "Test Run": "A2-085-1"}),
)
FOLDERS = (
    *("A2-085-1", "TWB-B1-19-PVC-2", "twist-tube-1a", "CT_10_3", "2026-03-04", "specimen"),
    "A2-000-1",
    "Test Run 4 10-23-2023 6 43 09 PM",
)


def test_facts_of_days_exports_and_folders(approved: Approve) -> None:
    """Days whose order is plain; that of an export counts before that of its name."""
    recordings = [(name, Recording("r", metadata=more)) for name, more in EXPORTS]
    facts = [
        [(key, *values) for key, values in collect_facts("", dict([export])).items()]
        for export in recordings
    ]
    facts += [[*parse_folder_name(name).items()] for name in FOLDERS]
    names = [f"{name} {dict(more)}" for name, more in EXPORTS] + list(FOLDERS)
    approved(
        [f"{written}: {parse_date(written) or '-'}" for written in DAYS]
        + [
            f"{name}: " + ", ".join(f"{key} {value}" for key, value in values)
            for name, values in zip(names, facts, strict=True)
        ]
    )


def test_facts_are_combined_by_value() -> None:
    exports = {
        "a.mat": Recording("r", metadata={"date": "2026-03-04", "User": "jk"}),
        "take.csv": Recording("r", metadata={"date": "2026-03-04", "User": "vl", "Length": "9 mm"}),
    }
    facts = collect_facts("A2-085-1", exports)
    assert facts["length"] == {"85 mm": [FOLDER_NAME_SOURCE]}
    assert facts["date"] == {"2026-03-04": ["a.mat", "take.csv"]}
    assert facts["operator"] == {"jk": ["a.mat"], "vl": ["take.csv"]}


PULLED = "Time;Crosshead separation;Load;Extensometer\n(s);(mm);(kN);(%)\n" + "".join(
    f"{0.1 * i:.1f};{0.1 * i:.1f};{0.2 * i:.1f};{0.01 * i:.2f}\n" for i in range(20)
)
TIME: Floats = np.linspace(0.0, 120.0, 1201)


@pytest.fixture(scope="module")
def protocols() -> list[Protocol]:
    return load_all_protocols()


Export = tuple[Path, Recording]


def cell() -> Export:
    """The load cell in volts, as the benches record it."""
    channel = Channel("Out1", "Model Root/Load Cell/Out1", np.sin(TIME))
    return Path("f.mat"), Recording("dspace-mat", "", "", (Clock("time", TIME),), (channel,))


def take(*, body: str = "Clamp", length: float = 0.085, stroke: float = 0.053) -> Export:
    """A clamp that goes down, and markers along a wire."""
    down = np.zeros((len(TIME), 3))
    down[:, 1] = -stroke * np.clip(TIME / 60.0, 0.0, 1.0)
    none = np.full((len(TIME), 4), np.nan)
    bodies = (RigidBody(body, down, none, none[:, 0]),) if body else ()
    along = length + 0.006 - 0.004
    last = down + np.array([along, 0.0, 0.0])
    tracks = MarkerTracks(TIME, TIME, 10.0, ("Wire:Marker1",), last[:, None, :], bodies)
    return Path("t.csv"), Recording("motive-csv", markers=tracks)


def frame(
    travel: float, speed: float, *, peak: float = 100.0, start: float = 0.0, name: str = "m.txt"
) -> Export:
    """A pull on a load frame at a steady speed."""
    time = np.linspace(start, start + travel / speed, 400)
    clock = Clock("time", time)
    moved = Channel("Crosshead", "Crosshead", (time - start) * speed * 1e3, unit_in_file="mm")
    force = Channel("Load", "Load", peak * np.linspace(0.0, 1.0, 400), unit_in_file="N")
    recording = Recording("load-frame", "", "", (clock,), (moved, force), metadata={"dialect": "x"})
    return Path(name), recording


def names(matches: Sequence[ProtocolMatch]) -> list[str]:
    return [match.protocol.name for match in matches]


@pytest.mark.parametrize(
    ("exports", "called", "fitted"),
    [
        ([cell(), take()], ("A2-085-1", "A2"), "wire-cantilever"),
        ([cell(), take(body="")], (), "conduit-bundle"),
        ([take()], (), "markers-only"),
        ([frame(0.04, 0.5e-3)], ("pet-tape-1",), "pet-tape"),
        ([frame(0.012, 0.1e-3)], ("22AWG tensile_3",), "tensile"),
        ([frame(0.012, 0.1e-3)], (), "corrugated-tube"),
    ],
)
def test_the_protocol_that_fits(
    protocols: list[Protocol], exports: list[Export], called: tuple[str, ...], fitted: str
) -> None:
    """Facts of the exports count before names, and names before the other tests."""
    protocol_counts = [{"corrugated-tube": 20}]
    length = 0.085 if "A2" in called else None
    matching = partial(
        match_protocols, names=called, length=length, protocol_counts=protocol_counts
    )
    (match,) = matching(dict(exports), protocols)
    assert match.protocol.name == fitted
    assert match.score[0]
    assert sorted(sum(match.files.values(), ())) == sorted(path.name for path, _ in exports)


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
    exports = dict([cell(), take(length=0.1)])
    matches = match_protocols(exports, protocols, protocol_counts=[of_type, of_campaign])
    assert names(matches) == ([expected] if expected else ["taped-bundle", "wire-cantilever"])
    if expected:
        share = f"{(of_type or of_campaign)[expected]} of " if not of_type.get("") else "9 of 10"
        assert share in matches[0].reason


def test_parts_of_one_recording_are_of_one_role(protocols: list[Protocol]) -> None:
    parts = [frame(0.01, 1e-3, name="1.txt"), frame(0.01, 1e-3, start=11.0, name="2.txt")]
    for fit in match_protocols(dict(parts), protocols):
        assert fit.files == {"frame": ("1.txt", "2.txt")}
        assert not fit.choices


def test_nothing_fits_what_lacks_a_role(protocols: list[Protocol]) -> None:
    wire = [protocol for protocol in protocols if protocol.name == "wire-cantilever"]
    assert match_protocols(dict([cell()]), wire) == []
    exports, files = dict([cell(), take()]), {"frame": ("m.txt",)}
    assert match_protocols(exports, wire, stated_files=files) == []
