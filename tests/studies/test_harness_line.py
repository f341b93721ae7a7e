"""From a harness YAML to nodes, rest shape and paths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.law.sliders import linear_moment_law
from labpipe.protocol.harness_file import HarnessFile
from labpipe.protocol.load import load_harness
from labpipe.rod import boundaries as rod
from labpipe.rod.line import Section
from labpipe.rod.rotations import matrices
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import Laid, laid
from tests.builders.harness_files import arch, pushed, written

SECTION = Section(linear_moment_law(1e-4, 100.0), 1e-4, mass_per_length=0.01, diameter=2e-3)


def harness(tmp_path: Path, text: str) -> HarnessFile:
    return load_harness(written(tmp_path, text))


def ready(tmp_path: Path, text: str, **inputs: float) -> Laid:
    return laid(harness(tmp_path, text), SECTION, inputs)


def held(found: Laid, name: str) -> rod.Held:
    (one,) = (each for each in found.boundaries if each.name == name)
    assert isinstance(one, rod.Held)
    return one


def test_a_clip_is_reached_in_a_straight_line(tmp_path: Path) -> None:
    found = ready(tmp_path, arch(steps=4))
    right = held(found, "right")
    assert found.nodes == {"left": 0, "right": 16}
    share = np.linspace(0.0, 1.0, 5)[:, None]
    wanted = (1.0 - share) * [0.2, 0.0, 0.0] + share * [0.18, 0.0, 0.03]
    assert right.position == pytest.approx(wanted, abs=1e-15)
    assert right.frame is not None
    assert matrices(right.frame)[:, :, 2] == pytest.approx(np.tile([1.0, 0, 0], (5, 1)), abs=1e-12)
    assert held(found, "left").position == pytest.approx(np.zeros((5, 3)))


def test_every_named_place_is_a_node(tmp_path: Path) -> None:
    text = arch(more="").replace(
        "steps:",
        "  - {kind: load, name: weight, at: 77 mm, force: [0 N, 0 N, -1 N], by: 4}\nsteps:",
    )
    found = ready(tmp_path, text)
    node = found.nodes["weight"]
    assert found.line.stations[node] == pytest.approx(0.077, abs=1e-12)
    assert found.line.stations[-1] == pytest.approx(0.2, abs=1e-12)
    lengths = found.line.lengths
    assert lengths[:node] == pytest.approx(np.full(node, 0.077 / node))
    assert lengths.max() < 1.3 * lengths.min()
    (load,) = (each for each in found.boundaries if isinstance(each, rod.Load))
    assert load.force[:, 2] == pytest.approx([0, -0.25, -0.5, -0.75, -1, -1, -1, -1, -1])


def test_a_grip_turns_and_twists_as_its_path_says(tmp_path: Path) -> None:
    """Direction from x to z over two steps, then 540 degrees about itself over four more."""
    text = pushed().replace("    holds: position\n", "")
    text = text.replace(
        text[text.index("path: [") : text.index("]}]") + 3],
        "path: [{step: 2, direction: [0, 0, 1]}, {step: 6, turn: 540 deg}]",
    )
    found = ready(tmp_path, text)
    frame = held(found, "gripper").frame
    assert frame is not None
    axes = matrices(frame)
    root = np.sqrt(0.5)
    directions = [[1, 0, 0], [root, 0, root], *[[0, 0, 1]] * 9]
    assert axes[:, :, 2] == pytest.approx(np.array(directions), abs=1e-12)
    turned = np.einsum("sk,sk->s", axes[2:7, :, 0], np.tile(axes[2, :, 0], (5, 1)))
    assert turned == pytest.approx(np.cos(np.deg2rad([0, 135, 270, 405, 540])), abs=1e-12)
    assert held(found, "gripper").release == 9


def test_a_pin_and_a_grip_by_position_may_turn(tmp_path: Path) -> None:
    found = ready(tmp_path, pushed())
    assert held(found, "gripper").frame is None
    assert held(found, "gripper").position[5] == pytest.approx([0.0695, 0.0, 0.0275])


def test_weight_grows_only_where_the_line_begins_taut(tmp_path: Path) -> None:
    (weight,) = (
        each for each in ready(tmp_path, arch(steps=10)).boundaries if isinstance(each, rod.Gravity)
    )
    assert weight.vector[:, 2] / -9.80665 == pytest.approx([0, 0.5, *[1] * 9])
    alone = pushed().partition("  - kind: grip")[0] + "steps: 10\n"
    (weight,) = (
        each for each in ready(tmp_path, alone).boundaries if isinstance(each, rod.Gravity)
    )
    assert weight.vector.tolist() == [[0.0, 0.0, -9.80665]]
    none = arch(more="gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    assert not any(isinstance(each, rod.Gravity) for each in ready(tmp_path, none).boundaries)


def test_a_spool_leaves_an_arc_that_is_at_rest(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [0, 1, -1]}\n"
    found = ready(tmp_path, arch(line=curl))
    angle = 5.0 * 0.2
    chord = np.sin(angle) / 5.0, (1.0 - np.cos(angle)) / 5.0
    end = np.array([chord[0], chord[1] * np.sqrt(0.5), -chord[1] * np.sqrt(0.5)])
    assert found.line.positions[-1] == pytest.approx(end, rel=1e-3)
    assert np.linalg.norm(found.line.natural[:, :2], axis=1) == pytest.approx(
        np.full(15, 5.0), rel=1e-9
    )
    assert found.line.natural[:, 2] == pytest.approx(np.zeros(15), abs=1e-9)
    more = ready(tmp_path, arch(line=curl), free_curvature_1=1.0)
    assert np.linalg.norm(more.line.natural[:, :2], axis=1) == pytest.approx(
        np.full(15, 6.0), rel=1e-9
    ), "the first free curvature is to the side of the spool"


def test_a_spool_beside_the_line(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [2, 0, 0]}\n"
    with pytest.raises(ValueError, match="allowed is a side of the line, not its direction"):
        ready(tmp_path, arch(line=curl))


def test_inputs_change_length_and_rest(tmp_path: Path) -> None:
    found = ready(tmp_path, arch(), length_factor=np.log(1.01))
    assert found.line.length == pytest.approx(0.202)
    assert held(found, "right").position[-1] == pytest.approx([0.18, 0.0, 0.03])
    other = laid(harness(tmp_path, arch()), SECTION, {}, length=0.25)
    assert other.line.length == pytest.approx(0.25)


def test_rings_and_strings_come_from_the_line(tmp_path: Path) -> None:
    """At the start the line lies straight, from the origin along x, and nothing may pull it."""
    text = arch().replace(
        "steps:",
        "  - {kind: ring, name: guide, position: [52 mm, 9 mm, 0 m], direction: [1, 0, 0], by: 4}\n"
        "  - {kind: ring, name: eye, position: [60 mm, 0 mm, 0 mm], direction: [1, 0, 0]}\n"
        "  - {kind: string, name: tie, at: 50 mm, anchor: [50 mm, 0 mm, 60 mm], length: 3 cm}\n"
        "  - {kind: string, name: long, at: 50 mm, anchor: [50 mm, 0 mm, 90 mm], length: 95 mm}\n"
        "steps:",
    )
    found = {each.name: each for each in ready(tmp_path, text).boundaries}
    guide, eye, short, long = (found[name] for name in ("guide", "eye", "tie", "long"))
    assert isinstance(guide, rod.Ring)
    assert isinstance(eye, rod.Ring)
    assert isinstance(short, rod.String)
    assert isinstance(long, rod.String)
    assert guide.position[[0, 2, 4, -1]] == pytest.approx(
        np.array([[0.052, 0.0, 0.0], [0.052, 0.0045, 0.0], [0.052, 0.009, 0.0], [0.052, 0.009, 0]])
    )
    assert eye.position.tolist() == [[0.06, 0.0, 0.0]]
    assert short.anchor[[0, -1]] == pytest.approx(np.array([[0.05, 0, 0.03], [0.05, 0, 0.06]]))
    assert long.anchor.tolist() == [[0.05, 0.0, 0.09]]


@pytest.mark.slow
def test_a_line_comes_to_a_ring_between_its_clips(tmp_path: Path) -> None:
    """Of one that does not stretch: in its place from the start, the ring would tear it."""
    text = arch(steps=4).replace(
        "steps:",
        "  - {kind: ring, name: eye, position: [80 mm, 12 mm, 0 mm], direction: [1, 0, 0]}\nsteps:",
    )
    found = ready(tmp_path, text)
    path = follow(found.line, found.boundaries, steps=4)
    assert path.status == "ok"
    apart = np.linalg.norm(path.last.positions - [0.08, 0.012, 0.0], axis=1)
    assert np.min(apart) < 0.2 / 16 / 2
    assert max(np.max(np.abs(each.reaction_forces)) for each in path.states) < 2.0


def test_all_kinds_of_boundaries(tmp_path: Path) -> None:
    text = arch().replace(
        "steps:",
        "  - {kind: pin, name: stud, at: 100 mm, position: [95 mm, 0 mm, -10 mm]}\n"
        "  - {kind: ring, name: guide, position: [50 mm, 0 mm, 0 mm], direction: [0, 0, 2]}\n"
        "  - {kind: string, name: thread, at: 50 mm, anchor: [50 mm, 0 mm, 90 mm], length: 95 mm}\n"
        "  - {kind: plane, name: table, point: [0 mm, 0 mm, -50 mm], friction: 0.3}\nsteps:",
    )
    kinds = [type(each).__name__ for each in ready(tmp_path, text).boundaries]
    assert kinds == ["Held", "Held", "Held", "Ring", "String", "Plane", "Gravity"]
