from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.process.checking import check_paths
from labpipe.readers import read_export
from labpipe.records.recording import Clock, Recording
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
Say = Callable[..., list[str]]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab with one protocol and one test, both right."""
    test = tmp_path / "raw" / "campaign" / "A1"
    test.mkdir(parents=True)
    (tmp_path / "protocols").mkdir()
    (tmp_path / "protocols" / "wire.yaml").write_text(PROTOCOL, encoding="utf-8")
    (test / "test.yaml").write_text(SHEET, encoding="utf-8")
    time = np.arange(50) * 0.001
    signals = [Signal("Model/Load", "Out1", time), Signal("Model/Laser", "Out1", time)]
    write_mat_v5(test / "force.mat", [Axis(time)], signals)
    positions = np.random.default_rng(1).normal(size=(20, 3))
    columns = rigid_body("Clamp", positions, np.tile([0.0, 0.0, 0.0, 1.0], (20, 1)))
    write_table(test / "take.csv", columns + marker("M1", positions), 20, Layout())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def say(lab: Path) -> Say:
    """Give the findings of the lab after some changes (file, old, new)."""

    def say(*changes: tuple[str, str, str]) -> list[str]:
        for name, old, new in changes:
            path = lab / name
            text = path.read_text(encoding="utf-8")
            assert text.count(old) == 1
            path.write_text(text.replace(old, new), encoding="utf-8")
        return [finding.message for finding in check_paths().findings]

    return say


WIRE, TEST = "protocols/wire.yaml", "raw/campaign/A1/test.yaml"
FOLDER = Path("raw/campaign/A1")


def test_a_lab_in_order(lab: Path) -> None:
    checked = check_paths()

    assert checked.findings == ()
    assert checked.protocols == (Path("protocols/wire.yaml"),)
    assert checked.tests == (FOLDER / "test.yaml",)


@pytest.mark.parametrize(
    ("path", "protocols", "tests"),
    [
        ("protocols/wire.yaml", 1, 0),
        ("raw/campaign/A1", 0, 1),
        ("raw/campaign/A1/test.yaml", 0, 1),
        ("raw", 0, 1),
        (".", 1, 1),
    ],
)
def test_what_a_path_stands_for(lab: Path, path: str, protocols: int, tests: int) -> None:
    checked = check_paths([lab / path])

    assert (len(checked.protocols), len(checked.tests)) == (protocols, tests)
    assert checked.findings == ()


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("nowhere", "nothing of that name"),
        ("empty", "a folder without any"),
        ("raw/campaign/A1/force.mat", "another file"),
    ],
)
def test_a_path_with_nothing_to_check(lab: Path, path: str, found: str) -> None:
    (lab / "empty").mkdir()

    (finding,) = check_paths([Path(path)]).findings

    assert finding.message == (
        f"{Path(path)}: expected a protocol, a test.yaml, or a folder with some, found {found}."
        " `labpipe new` writes a test.yaml."
    )


def test_nothing_to_check_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    (finding,) = check_paths().findings

    assert "protocols: expected a protocol, a test.yaml" in finding.message


def test_a_protocol_that_is_not_called_like_its_file(say: Say) -> None:
    assert say((WIRE, "name: wire", "name: other")) == [
        f"{Path(WIRE)}, (name): expected the name of the file, 'wire', found 'other'."
        " Change one of them."
    ]


def test_a_channel_that_the_export_does_not_have(say: Say) -> None:
    (message,) = say((WIRE, "Model/Load/Out1", "Model/Load/Out"))

    assert message.startswith(
        f"{FOLDER / 'force.mat'}, channel 'Model/Load/Out': expected one of the 2 channels"
    )
    assert "Nearest: 'Model/Load/Out1'" in message


def test_the_first_of_several_names_is_enough(say: Say) -> None:
    assert say((WIRE, "channel: Model/Load/Out1", "channel: [Force, Model/Load/Out1]")) == []


def test_none_of_several_names_is_there(say: Say) -> None:
    (message,) = say((WIRE, "channel: Model/Load/Out1", "channel: [Force, Model/Load/Out]"))

    assert message.startswith(
        f"{FOLDER / 'force.mat'}, channel 'Force' or 'Model/Load/Out': expected one of the 2"
        " channels of the file, found no such channel. Nearest: 'Model/Load/Out1'"
    )


def test_a_test_without_samples_is_told(say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = Recording("dspace-mat", clocks=(Clock("time", np.empty(0)),))
    monkeypatch.setattr("labpipe.process.checking.read_export", lambda *_, **__: nothing)

    assert say() == [
        f"{FOLDER / 'force.mat'}: expected samples, found none in this file. The test was aborted"
        " before its first sample; leave it out."
    ]


def test_a_part_without_samples_is_no_fault(
    lab: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = lab / FOLDER / "empty.mat"
    shutil.copy(lab / FOLDER / "force.mat", empty)

    def read(path: Path, *reader: Any, **more: Any) -> Recording:
        nothing = Recording("dspace-mat", clocks=(Clock("time", np.empty(0)),))
        return nothing if path.name == "empty.mat" else read_export(path, *reader, **more)

    monkeypatch.setattr("labpipe.process.checking.read_export", read)
    assert say((TEST, "force: force.mat", "force: [force.mat, empty.mat]")) == []


def test_parts_that_overlap_are_told(lab: Path, say: Say) -> None:
    shutil.copy(lab / FOLDER / "force.mat", lab / FOLDER / "again.mat")

    (message,) = say((TEST, "force: force.mat", "force: [force.mat, again.mat]"))
    place = f"{FOLDER / 'again.mat'}, time"
    assert message.startswith(f"{place}: expected a start after 0.049000 s, where force.mat")


ZERO = "steps:\n  - {step: zero, channel: force, over: 2 ms}\n"


def test_a_step_that_the_data_cannot_go_through_is_told(lab: Path, say: Say) -> None:
    """At once for each step, as `labpipe process` says it for the first one."""
    time = np.arange(20) * 0.001
    write_mat_v5(lab / FOLDER / "force.mat", [Axis(time)], [Signal("Model/Load", "Out1", time)])
    steps = f"{ZERO}  - {{step: zero, channel: force, over: 3 ms, at: end}}\nmarkers:"

    messages = say((WIRE, "markers: {clamp", f"{steps} {{clamp"))

    assert messages == [
        f"{FOLDER / 'test.yaml'}, steps.{number} (zero): force: {samples} samples in the {over} s"
        f" to zero on, 8 are needed, and there are 1000 per second. Write 'steps.{number}.over:"
        " {value: 0.0085 s, because: ...}' under 'overrides' in test.yaml."
        for number, samples, over in ((0, 3, 0.002), (1, 4, 0.003))
    ]


def test_a_recording_that_cannot_be_processed_is_told(lab: Path, say: Say) -> None:
    time = np.arange(5) * 0.001
    path = lab / FOLDER / "force.mat"
    write_mat_v5(path, [Axis(time)], [Signal("Model/Load", "Out1", time)])

    assert say() == [
        f"{FOLDER / 'test.yaml'}, force, time: expected at least 8 samples, found 5. The recording"
        " was aborted; leave this test out."
    ]


def test_dialect_and_part_go_to_the_reader(say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, object]] = []

    def read(*_: object, **more: object) -> Recording:
        asked.append(more)
        return Recording("load-frame")

    monkeypatch.setattr("labpipe.process.checking.read_export", read)
    new = "{reader: load-frame, dialect: own, part: Specimen 2, channel: Load}"
    say((WIRE, "{reader: dspace-mat, channel: Model/Load/Out1, unit: N}", new))

    assert {"dialect": ("own",), "part": "Specimen 2"} in asked


def test_swapped_columns(lab: Path, say: Say) -> None:
    time = np.arange(50) * 0.001
    signals = [Signal("", "Load", time, unit="mm"), Signal("", "Crosshead", time, unit="N")]
    write_mat_v5(lab / FOLDER / "force.mat", [Axis(time)], signals)

    channels = "channels: {force: {channel: Load}, displacement: {channel: Crosshead}}"
    messages = say((WIRE, "channel: Model/Load/Out1, unit: N", channels))

    assert [message.split(": expected ")[1] for message in messages] == [
        f"a unit of the dimension of {unit}, found '{found}'. Name another channel with"
        f" 'sources.force.channels.{name}.channel: {{value: ..., because: ...}}' under 'overrides'"
        f" in test.yaml, or give 'sources.force.channels.{name}.calibration'."
        for name, unit, found in (("force", "N", "mm"), ("displacement", "m", "N"))
    ]


def test_a_unit_that_nobody_says(say: Say) -> None:
    assert say((WIRE, ", unit: N", "")) == [
        f"{FOLDER / 'force.mat'}, channel 'Model/Load/Out1': expected a unit, found none in the"
        " file and none in the protocol. Write the unit of its numbers, such as"
        " 'sources.force.unit: {value: N, because: ...}' under 'overrides' in test.yaml."
    ]


@pytest.mark.parametrize("unit", ["mm", "kN"])
def test_a_unit_of_the_export_that_contradicts_the_protocol(lab: Path, say: Say, unit: str) -> None:
    time = np.arange(50) * 0.001
    path = FOLDER / "force.mat"
    write_mat_v5(lab / path, [Axis(time)], [Signal("Model/Load", "Out1", time, unit=unit)])

    (message,) = say()
    assert message.startswith(
        f"{path}, channel 'Model/Load/Out1': expected the unit that the export states, '{unit}',"
        " found 'sources.force.unit: N'. "
    )


def test_the_key_of_a_channel_that_is_not_there_is_named(say: Say) -> None:
    (message,) = say((WIRE, "Model/Load/Out1", "Model/Load/Out"))
    assert message.endswith(
        "Name the right one with 'sources.force.channel: {value: ..., because: ...}' under"
        " 'overrides' in test.yaml."
    )


def test_a_rigid_body_and_markers_that_the_take_does_not_have(say: Say) -> None:
    assert say((WIRE, "clamp: Clamp, along: [M*]", "clamp: Klamp, along: [M*, N1]")) == [
        f"{FOLDER / 'take.csv'}, rigid body 'Klamp': expected the rigid body that 'markers.clamp'"
        " names, found no such body. The take has 'Clamp'.",
        f"{FOLDER / 'take.csv'}, markers 'N1': expected markers that 'markers.along' names,"
        " found none. Nearest: 'M1'.",
    ]


def test_a_take_without_any_body_or_marker(lab: Path, say: Say) -> None:
    positions = np.zeros((20, 3))
    write_table(lab / FOLDER / "take.csv", marker("X1", positions), 20, Layout())

    (message, _) = say()

    assert message == (
        f"{FOLDER / 'take.csv'}, rigid body 'Clamp': expected the rigid body that 'markers.clamp'"
        " names, found no rigid bodies at all. `labpipe inspect` shows what the file holds."
    )


def test_no_clamp_and_all_markers_ask_nothing_of_the_take(lab: Path, say: Say) -> None:
    write_table(lab / FOLDER / "take.csv", marker("X1", np.zeros((20, 3))), 20, Layout())

    assert say((WIRE, "clamp: Clamp, along: [M*]", "clamp: null")) == []


def test_a_take_of_a_protocol_that_says_nothing_of_markers(say: Say) -> None:
    assert say((WIRE, "markers: {clamp: Clamp, along: [M*]}\n", "")) == []


def test_files_are_looked_at_even_where_the_protocol_is_wrong(lab: Path, say: Say) -> None:
    (lab / FOLDER / "force.mat").write_text("no recording", encoding="utf-8")

    messages = say((WIRE, "name: wire", "name: wire\nabuot: x"))

    assert [message.split(":")[0] for message in messages] == [
        f"{Path(WIRE)}, line 3, column 1 (abuot)",
        str(FOLDER / "force.mat"),
    ]


def test_a_file_that_is_not_there(lab: Path, say: Say) -> None:
    (lab / FOLDER / "take.csv").unlink()

    (message,) = say()

    place, _, rest = message.partition(": expected ")
    assert place.startswith(f"{FOLDER / 'test.yaml'}, line ")
    assert place.endswith("(files.markers)")
    assert rest.startswith("a file, found none of that name ('take.csv')")
    assert "'force.mat'" in rest


def test_a_file_of_another_format_than_the_protocol_says(lab: Path, say: Say) -> None:
    shutil.copy(lab / FOLDER / "take.csv", lab / FOLDER / "force.mat")

    assert say() == [
        f"{FOLDER / 'force.mat'}: expected a file of the format dspace-mat, found one of the format"
        " motive-csv. Name the right file, or change `reader` in the protocol."
    ]


def test_a_test_sheet_that_is_wrong(say: Say) -> None:
    (message,) = say((TEST, "test: A1", "tset: A1\ntest: A1"))

    assert message.startswith(f"{Path(TEST)}, line 1, column 1 (tset): expected one of the keys ")


def test_two_tests_of_one_name(lab: Path, say: Say) -> None:
    shutil.copytree(lab / FOLDER, lab / "raw" / "campaign" / "A2")
    shutil.copytree(lab / FOLDER, lab / "raw" / "other" / "A1")

    second = Path("raw/campaign/A2/test.yaml")
    assert say() == [
        f"{second}, (test): expected a name that no other test of the campaign has, found 'A1'."
        f" {Path(TEST)} has it too: rename one of them."
    ]


@pytest.mark.realdata
def test_a_real_recording_of_ten_channels_of_one_name(lab: Path, realdata: Path) -> None:
    test = lab / "raw" / "real"
    test.mkdir()
    shutil.copy(realdata / "dspace" / "0103_3_3.mat", test / "force.mat")
    (test / "test.yaml").write_text(
        """\
test: real
protocol: force-displacement
specimen: {type: finger, spool: s, sample: 1}
files: {force: force.mat}
overrides:
  sources.force.channels.force.channel: {value: load raw/In1, because: another bench}
""",
        encoding="utf-8",
    )

    messages = [finding.message for finding in check_paths([test]).findings]

    assert len(messages) == 2
    assert all("expected one of the 10 channels of the file" in message for message in messages)
    assert "Nearest: 'Model Root/Harware/Subsystem1/load raw/In1'" in messages[0]


@pytest.mark.parametrize(("span", "is_said"), [("", False), (", span: 40 mm", True)])
def test_a_test_on_two_supports_whose_distance_nobody_says(
    lab: Path, span: str, is_said: bool
) -> None:
    folder = lab / "raw" / "campaign" / "B1"
    folder.mkdir()
    sheet = SHEET.replace("test: A1\nprotocol: wire", "test: B1\nprotocol: three-point-bend")
    sheet = sheet.replace("sample: 1}", f"sample: 1{span}}}")
    sheet = sheet.replace("force: force.mat, markers: take.csv", "frame: bend.txt")
    (folder / "test.yaml").write_text(sheet, encoding="utf-8")
    said = [each.message for each in check_paths([folder]).findings if "span" in each.message]
    assert said == (
        []
        if is_said
        else [
            f"{folder / 'test.yaml'}, specimen.span: expected the distance of the supports (for "
            "bending-stiffness), found nothing. Write it into the specimen, such as "
            "'span: 152.4 mm'."
        ]
    )


PLAN = """\
version: 1
wire: A2
"""


def test_a_calibration_plan_is_no_protocol(lab: Path, tmp_path: Path) -> None:
    plan = tmp_path / "raw" / "campaign" / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")

    checked = check_paths()

    assert (checked.plans, checked.findings) == ((plan.relative_to(tmp_path),), ())
    plan.write_text(PLAN.replace("A2", "A2\nmethod: likelihood"), encoding="utf-8")
    (finding,) = check_paths().findings
    assert "method" in finding.message
    plan.write_text("version: 1\nname: plan\nsource: {}\n", encoding="utf-8")
    assert check_paths().protocols[-1] == plan.relative_to(tmp_path)  # a protocol, misspelt


HARNESS = """\
version: 1
line:
  length: 300 mm
  section: {wire: A2}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm]}
steps: 10
"""


def test_a_harness_is_no_protocol(lab: Path, tmp_path: Path) -> None:
    file = tmp_path / "raw" / "campaign" / "harness.yaml"
    file.write_text(HARNESS, encoding="utf-8")
    checked = check_paths()
    assert (checked.plans, checked.findings) == ((file.relative_to(tmp_path),), ())
    file.write_text(HARNESS.replace("300 mm", "300"), encoding="utf-8")
    (finding,) = check_paths().findings
    assert "line 3, column 11 (line.length): expected a quantity with a unit" in finding.message


def test_a_campaign_plan_is_known_by_its_name(lab: Path, tmp_path: Path) -> None:
    plan = tmp_path / "raw" / "campaign" / "campaign.yaml"
    plan.write_text("version: 1\nprotocol: wire\n", encoding="utf-8")
    checked = check_paths()
    assert (checked.plans, checked.findings) == ((plan.relative_to(tmp_path),), ())
    plan.write_text("version: 1\nprotocl: wire\n", encoding="utf-8")
    (finding,) = check_paths().findings
    assert "Did you mean 'protocol'?" in finding.message
