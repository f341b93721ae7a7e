"""Harness files: what they hold, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from labpipe.errors import ProtocolError
from labpipe.protocol.load import load_harness
from labpipe.protocol.model_files import (
    END,
    START,
    Clip,
    Grip,
    HarnessFile,
    Plane,
    get_line_start,
)

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
    assert [point.step for point in grip.path] == [10, 20]
    assert grip.path[1].position is None
    assert grip.path[1].turn == pytest.approx(12.566370614)
    assert (left.at, grip.at, getattr(pin, "at", None)) == (START, 0.2, END)
    assert isinstance(table, Plane)
    assert (table.normal, table.friction) == ((0.0, 0.0, 1.0), 0.3)
    assert harness.sweep is not None
    assert harness.sweep.length == (0.31, 0.32)
    assert load(tmp_path, yaml.safe_dump(harness.model_dump(mode="json", by_alias=True))) == harness


def test_something_must_hold_the_line(tmp_path: Path) -> None:
    head, _, _ = WHOLE.partition("boundaries:\n")
    plane = "boundaries:\n  - {kind: plane, name: table, point: [0 mm, 0 mm, 0 mm]}\n"
    with pytest.raises(ProtocolError, match="expected a boundary that holds the line: clip, pin,"):
        load(tmp_path, head + plane + "steps: 30\n")


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


def test_a_line_begins_where_its_first_clip_is(tmp_path: Path) -> None:
    assert get_line_start(load(tmp_path, BETWEEN_CLIPS)) == ((0.01, 0.0, 0.0), (0.0, 1.0, 0.0))
    own = BETWEEN_CLIPS.replace(
        "  section:", "  start: [1 mm, 0 mm, 0 mm]\n  direction: [0, 0, 1]\n  section:"
    )
    assert get_line_start(load(tmp_path, own)) == ((0.001, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert load(tmp_path, BETWEEN_CLIPS.replace("250 mm", "300 mm")), "straight between clips"
    at_the_end = BETWEEN_CLIPS.replace("at: start", "at: 1 mm")
    assert get_line_start(load(tmp_path, at_the_end)) == ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))


def test_what_lets_go_holds_no_more(tmp_path: Path) -> None:
    """From its release on, a grip may be as far from the line as it likes."""
    grip = (
        "  - {kind: grip, name: mid, at: 100 mm, release: RELEASE, path: ["
        "{step: 10, position: [10 mm, 95 mm, 0 mm]}, {step: 30, position: [10 mm, 0 mm, 500 mm]}]}"
        "\nsteps: 40\n"
    )
    assert load(tmp_path, BETWEEN_CLIPS + grip.replace("RELEASE", "11"))
    with pytest.raises(ProtocolError, match=r"'mid', found [0-9.]+ mm at step 30"):
        load(tmp_path, BETWEEN_CLIPS + grip.replace("RELEASE", "40"))


@pytest.mark.parametrize(
    ("text", "place", "facts"),
    [
        ("{kind: pin, name: mid, at: 9 mm, position: [10 mm, 9 mm, 0 mm], by: 5, release: 5}",
         "2.release", ["'mid'", "after 5"]),
        ("{kind: pin, name: mid, at: 9 mm, position: [12 mm, 9 mm, 0 mm], release: 5}",
         "2.release", ["'mid'", "after 40"]),
    ],
)  # fmt: skip
def test_early_releases(tmp_path: Path, text: str, place: str, facts: list[str]) -> None:
    with pytest.raises(ProtocolError) as refused:
        load(tmp_path, f"{BETWEEN_CLIPS}  - {text}\n")
    assert all(fact in str(refused.value) for fact in (f"boundaries.{place}", *facts))


def test_a_heavy_line_without_holds_falls(tmp_path: Path) -> None:
    heavy = BETWEEN_CLIPS.replace("2.2 mm", "2.2 mm\n    mass_per_length: 7 g/m")
    heavy = heavy.replace("1, 0]}", "1, 0], release: 20}")
    heavy = heavy.replace("250 mm, 0 mm]}", "250 mm, 0 mm], by: 9, release: 30}")
    with pytest.raises(ProtocolError, match="from step 30 on, found none"):
        load(tmp_path, heavy)
    assert load(tmp_path, heavy + "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
