from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.checking import check_paths
from labpipe.readers import read_export
from labpipe.records.recording import Clock, Recording
from tests.approved import Approve
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.motive import Layout, marker, rigid_body, write_table

PROTOCOL = """\
version: 1
name: wire
sources:
  force: {reader: dspace-mat, channel: Model/Load/Out1, unit: N}
  markers: {reader: motive-csv}
markers: {clamp: Clamp, along: [M*]}
"""


SHEET = """\
test: A1
protocol: wire
specimen: {type: A, spool: s, sample: 1}
files: {force: force.mat, markers: take.csv}
"""


WIRE, TEST = "protocols/wire.yaml", "raw/campaign/A1/test.yaml"


FOLDER = Path("raw/campaign/A1")


Change = tuple[str, str, str]


def write_force(path: Path, count: int = 50, *, name: str = "Load") -> None:
    """Two channels of a bench, 1000 samples per second."""
    time = np.arange(count) * 0.001
    signals = [Signal("Model/Load", "Out1", time), Signal("Model/Laser", "Out1", time)]
    if name != "Load":
        signals = [Signal("", "Load", time, unit="mm"), Signal("", "Crosshead", time, unit="N")]
    write_mat_v5(path, [Axis(time)], signals)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab with one protocol and one test, both right."""
    test = tmp_path / FOLDER
    test.mkdir(parents=True)
    (tmp_path / "protocols").mkdir()
    (tmp_path / WIRE).write_text(PROTOCOL, encoding="utf-8")
    (tmp_path / TEST).write_text(SHEET, encoding="utf-8")
    write_force(test / "force.mat")
    positions = np.random.default_rng(1).normal(size=(20, 3))
    columns = rigid_body("Clamp", positions, np.tile([0.0, 0.0, 0.0, 1.0], (20, 1)))
    write_table(test / "take.csv", columns + marker("M1", positions), 20, Layout())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def messages(lab: Path, *changes: Change) -> list[str]:
    """Give the findings of the lab after some changes (file, old, new)."""
    for name, old, new in changes:
        text = (lab / name).read_text(encoding="utf-8")
        assert text.count(old) == 1
        (lab / name).write_text(text.replace(old, new), encoding="utf-8")
    return [fault.replace(os.sep, "/") for fault in check_paths().faults]


@pytest.mark.parametrize(
    ("path", "protocols", "tests"),
    [(WIRE, 1, 0), ("raw/campaign/A1", 0, 1), (TEST, 0, 1), ("raw", 0, 1), (".", 1, 1)],
)
def test_what_a_path_stands_for(lab: Path, path: str, protocols: int, tests: int) -> None:
    checked = check_paths([lab / path])
    assert (len(checked.protocols), len(checked.tests)) == (protocols, tests)
    assert checked.faults == []


def test_a_path_with_nothing_to_check(lab: Path, approved: Approve) -> None:
    (lab / "empty").mkdir()
    faults = check_paths([Path("nowhere"), Path("empty"), FOLDER / "force.mat"]).faults
    shutil.rmtree(lab / "protocols")
    shutil.rmtree(lab / "raw")
    faults += check_paths().faults
    approved(fault.replace(os.sep, "/") for fault in faults)


def nothing(_: Path) -> None:
    """The files stay."""


def no_take(folder: Path) -> None:
    (folder / "take.csv").unlink()


def no_recording(folder: Path) -> None:
    (folder / "force.mat").write_text("no recording", encoding="utf-8")


def the_take_twice(folder: Path) -> None:
    shutil.copy(folder / "take.csv", folder / "force.mat")


def the_force_twice(folder: Path) -> None:
    shutil.copy(folder / "force.mat", folder / "again.mat")


def no_body(folder: Path) -> None:
    write_table(folder / "take.csv", marker("X1", np.zeros((20, 3))), 20, Layout())


def twenty_samples(folder: Path) -> None:
    write_force(folder / "force.mat", 20)


def five_samples(folder: Path) -> None:
    write_force(folder / "force.mat", 5)


def swapped_columns(folder: Path) -> None:
    write_force(folder / "force.mat", name="swapped")


def copies_of_the_test(folder: Path) -> None:
    shutil.copytree(folder, folder.with_name("A2"))
    shutil.copytree(folder, folder.parent.with_name("other") / "A1")


ZEROS = (
    "steps:\n  - {step: zero, channel: force, over: 2 ms}\n"
    "  - {step: zero, channel: force, over: 3 ms, at: end}\nmarkers: {clamp"
)


SWAPPED = "channels: {force: {channel: Load}, displacement: {channel: Crosshead}}"


BENT = """\
protocol: three-point-bend
specimen: {type: A, spool: s, sample: 1}
files: {frame: bend.txt}
"""


FAULTS: dict[str, tuple[Callable[[Path], None], Change | None]] = {
    "name of the file": (nothing, (WIRE, "name: wire", "name: other")),
    "channels": (nothing, (WIRE, "Model/Load/Out1", "[Force, Model/Load/Out]")),
    "parts overlap": (the_force_twice, (TEST, "force.mat", "[force.mat, again.mat]")),
    "two short rests": (twenty_samples, (WIRE, "markers: {clamp", ZEROS)),
    "short recording": (five_samples, None),
    "swapped columns": (swapped_columns, (WIRE, "channel: Model/Load/Out1, unit: N", SWAPPED)),
    "no unit": (nothing, (WIRE, ", unit: N", "")),
    "no such body": (nothing, (WIRE, "clamp: Clamp, along: [M*]", "clamp: Klamp, along: [M*, N1]")),
    "no body at all": (no_body, None),
    "bad protocol and bad file": (no_recording, (WIRE, "name: wire", "name: wire\nabuot: x")),
    "no file": (no_take, None),
    "another format": (the_take_twice, None),
    "bad sheet": (nothing, (TEST, "test: A1", "tset: A1\ntest: A1")),
    "two tests of a name": (copies_of_the_test, None),
    "no span": (nothing, (TEST, SHEET.partition("\n")[2], BENT)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults(lab: Path, name: str, approved: Approve) -> None:
    spoil, change = FAULTS[name]
    spoil(lab / FOLDER)
    faults = messages(lab, *([change] if change else []))
    assert faults
    approved(faults)


def test_a_part_without_samples_is_no_fault(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A test of nothing else is."""
    shutil.copy(lab / FOLDER / "force.mat", lab / FOLDER / "empty.mat")

    def read(path: Path, *reader: object, **more: object) -> Recording:
        empty = Recording("dspace-mat", clocks=(Clock("time", np.empty(0)),))
        return empty if path.name == "empty.mat" else read_export(path, *reader, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("labpipe.process.reading.read_export", read)
    assert messages(lab, (TEST, "force: force.mat", "force: [force.mat, empty.mat]")) == []
    (message,) = messages(lab, (TEST, "[force.mat, empty.mat]", "empty.mat"))
    assert message.startswith(f"{FOLDER.as_posix()}/empty.mat: expected samples, found none")


def test_sizes_that_a_tension_test_needs(tmp_path: Path) -> None:
    """Unless gauge length and section are stated, `labpipe check` says for which results."""
    rows = "".join(f"{i / 10};{i / 10};{i / 5};{i / 100}\n" for i in range(20))
    head = "Time;Crosshead separation;Load;Extensometer\n(s);(mm);(kN);(%)\n"
    (tmp_path / "x.csv").write_text(head + rows, encoding="utf-8")
    sheet = tmp_path / "test.yaml"
    text = "test: P1\nprotocol: iso-527-tape\nfiles: {frame: x.csv}\nspecimen:\n"
    text += "  {type: PET, spool: s, sample: '1', labels: {}SIZES}\n"
    results = "elastic-modulus, tensile-strength, elongation-at-maximum-force, elongation-at-break"
    sheet.write_text(text.replace("SIZES", ""), encoding="utf-8")
    length, area = (x for x in check_paths([sheet]).faults if "specimen." in x)
    assert f"specimen.gauge_length: expected the gauge length (for {results})" in length
    assert f"specimen.section.area: expected the area of the cross-section (for {results})" in area
    sizes = ", gauge_length: 50 mm, section: {width: 10 mm, thickness: 1 mm}"
    sheet.write_text(text.replace("SIZES", sizes), encoding="utf-8")
    assert not [x for x in check_paths([sheet]).faults if "specimen." in x]


HARNESS = """\
version: 1
line:
  length: 300 mm
  section: {wire: A2}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm]}
steps: 10
"""


@pytest.mark.parametrize(
    ("name", "right", "wrong", "said"),
    [
        ("plan", "version: 1\nwire: A2\n", "version: 1\nwire: A2\nmethod: x\n", "method"),
        ("harness", HARNESS, HARNESS.replace("300 mm", "300"), "line 3, column 11 (line.length)"),
        (
            *("campaign", "version: 1\nprotocol: wire\n", "version: 1\nprotocl: wire\n"),
            "Did you mean 'protocol'?",
        ),
    ],
)
def test_plans_are_no_protocols(lab: Path, name: str, right: str, wrong: str, said: str) -> None:
    plan = Path("raw/campaign") / f"{name}.yaml"
    plan.write_text(right, encoding="utf-8")
    checked = check_paths()
    assert (checked.plans, checked.faults) == ([plan], [])
    plan.write_text(wrong, encoding="utf-8")
    (fault,) = check_paths().faults
    assert said in fault
