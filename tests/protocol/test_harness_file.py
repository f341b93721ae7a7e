from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from labpipe.errors import ProtocolError
from labpipe.protocol.harness_file import END, START, Clip, Grip, HarnessFile, Plane
from labpipe.protocol.load import load_harness
from labpipe.protocol.reference import json_schema

WHOLE = """\
version: 1
about: pushed and let go
line:
  length: 0.3 m
  elements: 30
  section:
    bending_stiffness: 150 N*mm^2
    torsional_stiffness: 90 N*mm^2
    largest_curvature: 80 1/m
    diameter: 2.2 mm
    mass_per_length: 7 g/m
    stiffness_uncertainty: 5 %
  spool: {curvature: 2 1/m, towards: [0, 0, -2], spread: 0.5 1/m}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [3, 0, 4]}
  - kind: grip
    name: gripper
    at: 200 mm
    path:
      - {step: 10, position: [150 mm, 40 mm, 0 mm]}
      - {step: 20, direction: [0, 1, 0], turn: 720 deg}
    release: 25
  - {kind: pin, name: stud, at: end, position: [200 mm, 0 mm, 50 mm], by: 5}
  - {kind: ring, name: guide, position: [100 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
  - {kind: string, name: thread, at: 50 mm, anchor: [0 mm, 0 mm, 200 mm], length: 250 mm}
  - {kind: load, name: weight, at: 100 mm, force: [0 N, 0 N, -20 mN]}
  - {kind: plane, name: table, point: [0 mm, 0 mm, -10 mm], friction: 0.3}
steps: 30
allowed_bend_radius: 12 mm
show: [10, 20]
sweep: {length: [310 mm, 320 mm]}
"""


def load(tmp_path: Path, text: str) -> HarnessFile:
    path = tmp_path / "harness.yaml"
    path.write_text(text, encoding="utf-8")
    return load_harness(path)


def test_a_whole_file(tmp_path: Path) -> None:
    harness = load(tmp_path, WHOLE)
    line, section = harness.line, harness.line.section
    assert (line.length, line.elements) == (0.3, 30)
    assert section.kind == "bending_stiffness"
    assert section.bending_stiffness == pytest.approx(150e-6, rel=1e-12)
    assert section.mass_per_length == pytest.approx(0.007, rel=1e-12)
    assert line.spool is not None
    assert line.spool.towards == (0.0, 0.0, -1.0), "a direction has the length one"
    left, grip, pin, *_, table = harness.boundaries
    assert isinstance(left, Clip)
    assert left.direction == pytest.approx((0.6, 0.0, 0.8))
    assert isinstance(grip, Grip)
    assert [each.step for each in grip.path] == [10, 20]
    assert grip.path[1].position is None
    assert grip.path[1].turn == pytest.approx(12.566370614)
    assert (left.at, grip.at, getattr(pin, "at", None)) == (START, 0.2, END)
    assert isinstance(table, Plane)
    assert (table.normal, table.friction) == ((0.0, 0.0, 1.0), 0.3)
    assert harness.sweep is not None
    assert harness.sweep.length == (0.31, 0.32)


def test_what_is_written_reads_as_the_same(tmp_path: Path) -> None:
    harness = load(tmp_path, WHOLE)
    written = yaml.safe_dump(harness.model_dump(mode="json", by_alias=True))
    assert load(tmp_path, written) == harness


def test_the_schema_takes_and_refuses_as_labpipe_does() -> None:
    checker = jsonschema.Draft202012Validator(json.loads(json_schema(HarnessFile)))
    data = yaml.safe_load(WHOLE)
    assert checker.is_valid(data)
    changes: tuple[dict[str, object], ...] = (
        {"line": data["line"] | {"length": 300}},
        {"boundaries": []},
        {"boundaries": [data["boundaries"][0] | {"kind": "clib"}]},
        {"boundaries": [data["boundaries"][0] | {"position": ["0 mm", "0 mm"]}]},
        {"gravity": "down"},
        {"sweep": {"length": ["310 mm"]}},
        {"branches": []},
    )
    for wrong in changes:
        assert not checker.is_valid(data | wrong)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length: 0.3 m", "length: 0.3", "line 4, column 11 (line.length): expected a quantity"),
        ("length: 0.3 m", "length: 0.3 N", "(line.length): expected a quantity with a unit such"),
        ("elements: 30", "elements: 3", "expected a whole number from 4 to 2000, found '3'."),
        ("    diameter: 2.2 mm\n", "", "(line.section): expected the key 'diameter' beside 'ben"),
        (
            "    largest_curvature: 80 1/m\n",
            "",
            "expected the key 'largest_curvature' beside 'bending_stiffness', found no such key. A "
            "law needs a range",
        ),
        (
            "    bending_stiffness: 150 N*mm^2",
            "    wire: A2\n    bending_stiffness: 150 N*mm^2",
            "expected one of the keys 'wire', 'sliders' and 'bending_stiffness', found 'wire' and "
            "'bending_stiffness'. Say once what the line is made of.",
        ),
        ("    bending_stiffness: 150 N*mm^2\n", "", "found none of them"),
        (
            "    mass_per_length: 7 g/m",
            "    sheet: wires.xlsx",
            "(line.section.sheet): expected only keys that go with 'bending_stiffness'",
        ),
        ("at: start", "at: begin", "expected 'start', 'end', or a length from the start such as"),
        ("[3, 0, 4]", "[0, 0, 0]", "expected a direction, found 'one without length'"),
        ("[3, 0, 4]", "[3, 0]", "expected a list of three quantities, found 'a list of 2'. Write"),
        ("[3, 0, 4]", "right", "expected a list of three quantities, found 'right'. Write x, y"),
        ("kind: grip", "kind: gripp", "(boundaries.1.kind): expected one of 'grip',"),
        ("name: stud", "name: left", "expected a name of its own, found 'left', as boundary 1."),
        ("at: 200 mm", "at: start", "(boundaries.1.at): expected a place that nothing else holds"),
        ("at: end", "at: 0.2 m", "expected a place that nothing else holds, found '0.2 m', which "),
        ("step: 20", "step: 10", "(boundaries.1.path.1.step): expected a step after 10, found 10"),
        ("step: 20", "step: 31", "expected a step from 1 to 30, the last, found '31'. Or raise"),
        ("release: 25", "release: 31", "(boundaries.1.release): expected a step from 1 to 30"),
        ("by: 5", "by: 50", "(boundaries.2.by): expected a step from 1 to 30, the last"),
        ("[10, 20]", "[10, 40]", "(show.1): expected a step from 1 to 30, the last, found '40'."),
        ("at: 200 mm\n", "at: 200 mm\n    holds: position\n", "(boundaries.1.path.1.direction): "),
        ("friction: 0.3", "friction: -1", "(boundaries.6.friction): expected a pure number"),
        ("steps: 30", "stpes: 30", "expected one of the keys 'steps'"),
        ("[310 mm, 320 mm]", "[310 mm]", "(sweep.length): expected two lengths or more, found 1. "),
    ],
)
def test_what_is_wrong_is_said_with_its_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in WHOLE
    with pytest.raises(ProtocolError) as raised:
        load(tmp_path, WHOLE.replace(old, new))
    assert message in str(raised.value)


def test_something_must_hold_the_line(tmp_path: Path) -> None:
    head, _, rest = WHOLE.partition("boundaries:\n")
    plane = "boundaries:\n  - {kind: plane, name: table, point: [0 mm, 0 mm, 0 mm]}\n"
    with pytest.raises(ProtocolError, match="expected a boundary that holds the line: clip, pin,"):
        load(tmp_path, head + plane + "steps: 30\n")
    assert rest


def test_a_fault_of_the_only_boundary_is_the_only_fault(tmp_path: Path) -> None:
    head, _, _ = WHOLE.partition("boundaries:\n")
    clip = "boundaries:\n  - {kind: clip, name: left, at: 0 mm, position: [0 mm, 0 mm, 0 mm]}\n"
    with pytest.raises(ProtocolError) as raised:
        load(tmp_path, head + clip)
    assert len(str(raised.value).splitlines()) == 1
    with pytest.raises(ProtocolError, match="expected a boundary that holds the line"):
        load(tmp_path, head + "boundaries: []\n")


def test_neither_weight_nor_stiffness(tmp_path: Path) -> None:
    slack = WHOLE.replace("150 N*mm^2", "0 N*mm^2")
    with pytest.raises(
        ProtocolError, match=r"\(line.section.bending_stiffness\): .* above 0 N\*mm"
    ):
        load(tmp_path, slack.replace("    mass_per_length: 7 g/m\n", ""))


def test_all_faults_are_in_one_message(tmp_path: Path) -> None:
    wrong = WHOLE.replace("0.3 m\n", "0.3\n").replace("by: 5", "by: 50").replace("2.2 mm", "2.2")
    with pytest.raises(ProtocolError) as raised:
        load(tmp_path, wrong)
    assert len(str(raised.value).splitlines()) == 3
