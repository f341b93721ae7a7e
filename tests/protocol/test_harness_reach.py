from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.harness_file import HarnessFile
from labpipe.protocol.harness_reach import start_of
from labpipe.protocol.load import load_harness

BETWEEN_CLIPS = """\
version: 1
line:
  length: 300 mm
  section:
    bending_stiffness: 150 N*mm^2
    torsional_stiffness: 90 N*mm^2
    largest_curvature: 80 1/m
    diameter: 2.2 mm
boundaries:
  - {kind: clip, name: left, at: start, position: [10 mm, 0 mm, 0 mm], direction: [0, 1, 0]}
  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}
"""


def load(tmp_path: Path, text: str) -> HarnessFile:
    path = tmp_path / "harness.yaml"
    path.write_text(text, encoding="utf-8")
    return load_harness(path)


def test_a_line_begins_where_its_first_clip_is(tmp_path: Path) -> None:
    assert start_of(load(tmp_path, BETWEEN_CLIPS)) == ((0.01, 0.0, 0.0), (0.0, 1.0, 0.0))
    own = BETWEEN_CLIPS.replace(
        "  section:", "  start: [1 mm, 0 mm, 0 mm]\n  direction: [0, 0, 1]\n  section:"
    )
    assert start_of(load(tmp_path, own)) == ((0.001, 0.0, 0.0), (0.0, 0.0, 1.0))
    at_the_end = BETWEEN_CLIPS.replace("at: start", "at: 1 mm")
    assert start_of(load(tmp_path, at_the_end)) == ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))


def test_a_line_may_be_straight_between_its_clips(tmp_path: Path) -> None:
    assert load(tmp_path, BETWEEN_CLIPS.replace("250 mm", "300 mm"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "250 mm",
            "301 mm",
            "line 11, column 5 (boundaries.1): expected at most the 300 mm that lie between 'left' "
            "and 'right', found 301 mm between them at step 40. Bring them nearer, or make",
        ),
        (
            "at: end",
            "at: 310 mm",
            "(boundaries.1.at): expected a place on the line, which is 300 mm long, found 310 mm.",
        ),
        (
            "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
            "  - {kind: grip, name: mid, at: 100 mm, path: [{step: 5, position: [0 mm, 90 mm, 0 mm]"
            "}, {step: 15, position: [0 mm, 30 mm, 99 mm]}], release: 20}\n"
            "  - {kind: clip, by: 10, name: right, at: end, position: [10 mm, 150 mm, 0 mm]}",
            "(boundaries.1): expected at most the 100 mm that lie between 'left' and 'mid', found "
            "103.928 mm between them at step 15.",
        ),
        (
            "    diameter",
            "    diameter: 2.2 mm\nsweep: {length: [400 mm, 240 mm, 200 mm]}\n#",
            "(sweep.length.2): expected at most the 200 mm that lie between 'left' and 'right', ",
        ),
        (
            "boundaries:\n",
            "boundaries:\n  - {kind: string, name: thread, at: 100 mm, length: 50 mm, "
            "anchor: [0 mm, 0 mm, 200 mm]}\n",
            "(boundaries.0): expected at most the 150 mm that lie between 'left' and 'thread', "
            "found 200.25 mm between them at step 40.",
        ),
        (
            "boundaries:\n",
            "boundaries:\n  - {kind: ring, name: guide, position: [0 mm, 100 mm, 120 mm], "
            "direction: [0, 1, 0]}\n",
            "(boundaries.0): expected a ring that the line comes to: 300 mm of it are there, "
            "found a way of 348.879 mm by 'guide'.",
        ),
        (
            "boundaries:\n",
            "boundaries:\n  - {kind: plane, name: table, point: [0 mm, 0 mm, -1 mm], "
            "normal: [0, 0, 5]}\n",
            "(boundaries.1): expected the axis of the line 1.1 mm above 'table', its radius, found "
            "1 mm at step 0. Hold it higher, or begin higher ('line.start').",
        ),
        (
            "position: [10 mm, 250 mm, 0 mm]}",
            "position: [10 mm, 250 mm, 0 mm], turn: 540 deg, by: 3}",
            "(boundaries.1.turn): expected less than 180 deg of turn in a step, which has one "
            "meaning, found 180 deg in each from step 0 to 3. Take more steps for it: ",
        ),
        (
            "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
            "  - {kind: grip, name: right, at: end, path: [{step: 4, turn: 90 deg}, {step: 6, "
            "position: [10 mm, 250 mm, 0 mm]}, {step: 7, turn: -100 deg}]}",
            "(boundaries.1.path.2.turn): expected less than 180 deg of turn in a step, which has "
            "one meaning, found 190 deg in each from step 6 to 7.",
        ),
        (
            "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
            "  - {kind: pin, name: right, at: end, position: [10 mm, 250 mm, 0 mm], by: 9, "
            "release: 9}",
            "(boundaries.1.release): expected a step after 9, at which 'right' is where it brings "
            "the line, found 9. Let it go later, or bring it there earlier.",
        ),
        (
            "  - {kind: clip, name: right, at: end, position: [10 mm, 250 mm, 0 mm]}",
            "  - {kind: grip, name: right, at: end, release: 4, path: [{step: 6, position: "
            "[10 mm, 250 mm, 0 mm]}, {step: 9, position: [10 mm, 240 mm, 0 mm]}]}",
            "(boundaries.1.release): expected a step after 6, at which 'right' is where it ",
        ),
        (
            "  section:",
            "  spool: {curvature: 500 1/m}\n  section:",
            "(line.spool.curvature): expected a curl of at most 90 deg over an element of 7.5 mm, "
            "found 214.859 deg. Check the unit of the curvature, or take more elements.",
        ),
        (
            "bending_stiffness: 150 N*mm^2",
            "sliders: none.sliders.json\n#",
            "(line.section.sliders): expected a file, found 'none.sliders.json'. There is none at ",
        ),
    ],
)
def test_what_cannot_be_reached(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = BETWEEN_CLIPS.replace(old, new, 1)
    if "sliders" in new:
        text = "\n".join(
            each for each in text.splitlines() if not each.startswith(("    tor", "    lar"))
        )
    with pytest.raises(ProtocolError) as raised:
        load(tmp_path, text)
    assert message in str(raised.value)


def test_what_lets_go_holds_no_more(tmp_path: Path) -> None:
    """From its release on, a grip may be as far from the line as it likes."""
    grip = (
        "  - {kind: grip, name: mid, at: 100 mm, release: RELEASE, path: ["
        "{step: 10, position: [10 mm, 95 mm, 0 mm]}, {step: 30, position: [10 mm, 0 mm, 500 mm]}]}"
        "\nsteps: 40\n"
    )
    assert load(tmp_path, BETWEEN_CLIPS + grip.replace("RELEASE", "11"))
    with pytest.raises(ProtocolError, match=r"'mid', found [0-9.]+ mm between them at step 30"):
        load(tmp_path, BETWEEN_CLIPS + grip.replace("RELEASE", "40"))


def test_a_line_may_be_held_on_a_table(tmp_path: Path) -> None:
    table = "  - {kind: plane, name: table, point: [0 mm, 0 mm, -1.1 mm]}\n"
    assert load(tmp_path, BETWEEN_CLIPS + table)


def test_many_turns_may_be_made_in_enough_steps(tmp_path: Path) -> None:
    assert load(tmp_path, BETWEEN_CLIPS.replace("250 mm, 0 mm]", "250 mm, 0 mm], turn: 1080 deg"))


def test_a_line_that_all_let_go_falls(tmp_path: Path) -> None:
    """One without weight, with a table, or with one that holds on, does not."""
    loose = BETWEEN_CLIPS.replace("direction: [0, 1, 0]}", "direction: [0, 1, 0], release: 9}")
    assert load(tmp_path, loose)
    loose = loose.replace("250 mm, 0 mm]}", "250 mm, 0 mm], release: 20}")
    assert load(tmp_path, loose), "it has no weight"
    heavy = loose.replace("    diameter", "    mass_per_length: 7 g/m\n    diameter")
    with pytest.raises(ProtocolError, match="holds the line from step 20 on, found nothing: it f"):
        load(tmp_path, heavy)
    assert load(tmp_path, heavy + "  - {kind: plane, name: p, point: [0 mm, 0 mm, -9 mm]}\n")
    assert load(tmp_path, heavy + "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")


def test_a_fault_of_the_grammar_comes_before_one_of_reach(tmp_path: Path) -> None:
    """A line too short is said once its numbers are readable, with the key as it is written."""
    path = tmp_path / "harness.yaml"
    path.write_text(BETWEEN_CLIPS.replace("300 mm", "200 mm"), encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"harness\.yaml, line 11, .*\(boundaries\.1\): "):
        load_harness(path)
    path.write_text(BETWEEN_CLIPS.replace("300 mm", "200 N"), encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"harness\.yaml, line 3, .*\(line\.length\): "):
        load_harness(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"none\.yaml"):
        load_harness(tmp_path / "none.yaml")
