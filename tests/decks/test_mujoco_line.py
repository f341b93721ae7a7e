"""The line of a harness in MuJoCo, moved as the deck says, against the rod."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from labpipe.decks.mujoco_line import line_deck
from labpipe.protocol.load import load_harness
from labpipe.records.arrays import Floats
from labpipe.rod import boundaries as rod
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import Laid, laid
from labpipe.studies.harness_section import material_of
from tests.builders.harness_files import STIFFNESS, arch, pushed, written


def ready(folder: Path, text: str) -> Laid:
    file = written(folder, text)
    harness = load_harness(file)
    return laid(harness, material_of(harness, file).sections[0]({}), {})


def moved(deck: str, steps: int, places: int, *, moves: int = 50, rest: int = 600) -> Floats:
    """Where MuJoCo has the chain in the end, shape (places, 3), evenly along it."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco-core, of the development extras")
    model = mujoco.MjModel.from_xml_string(deck)
    data = mujoco.MjData(model)
    weight = model.opt.gravity.copy()
    paths: dict[str, Floats] = {}
    releases: dict[str, Floats] = {}
    for number in range(model.nnumeric):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_NUMERIC, number)
        begin, size = model.numeric_adr[number], model.numeric_size[number]
        kind, _, of = name.partition("_")
        values = model.numeric_data[begin : begin + size]
        (paths if kind == "path" else releases)[of] = values
    for step in range(steps):
        for move in range(moves):
            share = (move + 1) / moves
            model.opt.gravity[:] = weight * min(1.0, step + share)
            for name, path in paths.items():
                rows = path.reshape(-1, 7)
                row = (1.0 - share) * rows[step] + share * rows[step + 1]
                body = model.body(name).mocapid[0]
                data.mocap_pos[body], data.mocap_quat[body] = row[:3], row[3:]
                if releases[name][0] == step + 1:
                    data.eq_active[model.equality(f"hold_{name}").id] = 0
            mujoco.mj_step(model, data)
    for _ in range(rest):
        mujoco.mj_step(model, data)
    nodes = np.round(np.linspace(1, 30, places)).astype(int)
    return np.array([data.body(f"node_{node}").xpos for node in nodes])


def along_rod(found: Laid, steps: int, places: int) -> Floats:
    """The same places of the rod: bodies begin at (i - 1/2) / 30 of the length."""
    path = follow(found.line, found.boundaries, steps=steps)
    nodes = np.round(np.linspace(1, 30, places)).astype(int)
    at = (nodes - 0.5) / 30.0 * found.line.length
    return np.column_stack([np.interp(at, found.line.stations, x) for x in path.last.positions.T])


@pytest.mark.slow
@pytest.mark.parametrize("section", [STIFFNESS, "{wire: A2}"])
def test_mujoco_has_the_shape_of_the_rod(tmp_path: Path, section: str) -> None:
    """An arch in its plane: within 1.5 % of the length."""
    found = ready(tmp_path, arch(section).replace("elements: 16", "elements: 30"))
    deck = line_deck(found.line, found.boundaries, title="arch")
    assert moved(deck, 8, 7) == pytest.approx(along_rod(found, 8, 7), abs=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "place"),
    [
        ("", "79.9 mm, 0 mm, 1.5 mm"),
        ("", "79.7 mm, 0 mm, 3 mm"),
        ("", "79.4 mm, 0 mm, 6 mm"),
        ("none", "77 mm, 0 mm, 15 mm"),
        ("", "60 mm, 0 mm, 45 mm"),
    ],
)
def test_what_is_let_go_springs_back_in_mujoco_too(tmp_path: Path, weight: str, place: str) -> None:
    """Brought down before it is let go, or from on high: within 0.2 % of the length.

    Some come free at once (3 mm), others fall (6 mm).
    """
    down = f"position: [60 mm, 0 mm, 45 mm]}}, {{step: 14, position: [{place}]}}]"
    text = pushed().replace("elements: 12", "elements: 30").replace("steps: 10", "steps: 16")
    text = text.replace("release: 9", "release: 15")
    found = ready(tmp_path, text.replace("position: [60 mm, 0 mm, 45 mm]}]", down))
    if weight == "none":
        found = replace(found, boundaries=found.boundaries[:-1])
    deck = line_deck(found.line, found.boundaries, title="pushed")
    assert moved(deck, 16, 7) == pytest.approx(along_rod(found, 16, 7), abs=2e-4)


def test_the_model_begins_as_the_line_lies(tmp_path: Path) -> None:
    """A curled line, by the places of the bodies before anything moves."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco-core, of the development extras")
    curl = "  spool: {curvature: 5 1/m, towards: [0, 1, 0]}\n"
    found = ready(tmp_path, arch(line=curl).replace("elements: 16", "elements: 30"))
    model = mujoco.MjModel.from_xml_string(line_deck(found.line, found.boundaries, title="curl"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    last = data.body("node_30")
    end = last.xpos + last.xmat.reshape(3, 3)[:, 0] * 0.5 * 0.2 / 30
    assert end == pytest.approx(found.line.positions[-1], abs=2e-3)


def test_names_of_the_file_are_those_of_the_model(tmp_path: Path) -> None:
    text = (
        arch()
        .replace("left", "'a \"b\" <c>'")
        .replace("right", "'g,h é'")
        .replace(
            "steps:",
            "  - {kind: string, name: thread, at: 50 mm, anchor: [50 mm, 0 mm, 90 mm], "
            "length: 95 mm}\n"
            "  - {kind: load, name: weight, at: 77 mm, force: [0 N, 0 N, -1 N]}\n"
            "  - {kind: ring, name: guide, position: [50 mm, 0 mm, 0 mm], direction: [1, 0, 0]}\n"
            "  - {kind: plane, name: table, point: [0 mm, 0 mm, -50 mm], friction: 0.3}\nsteps:",
        )
    )
    found = ready(tmp_path, text)
    deck = line_deck(found.line, found.boundaries, title="all -- kinds")
    root = ET.fromstring(deck)
    names = {each.get("name") for each in root.iter() if each.get("name")}
    assert names >= {
        *('a "b" <c>', "g,h é", 'path_a "b" <c>', "release_g,h é", "hold_g,h é"),
        *("thread", "anchor_thread", "weight_x", "weight_z", "at_weight"),
    }
    assert "Left out, as this chain touches nothing: guide, table." in deck
    spatial = root.find(".//spatial")
    assert spatial is not None
    assert spatial.get("range") == "0 0.095"


def test_a_clip_may_be_called_as_the_chain_calls_its_bodies(tmp_path: Path) -> None:
    found = ready(tmp_path, arch().replace("right", "node_3"))
    bodies = [each.get("name") for each in ET.fromstring(deck_of(found)).iter("body")]
    assert "node_3" in bodies
    assert len(set(bodies)) == len(bodies)


def deck_of(found: Laid) -> str:
    return line_deck(found.line, found.boundaries, title="a line")


def test_a_line_that_may_fall_is_free_in_space(tmp_path: Path) -> None:
    found = ready(tmp_path, arch())
    held = [each for each in found.boundaries if isinstance(each, rod.Held)]
    loose = line_deck(found.line, held[1:], title="loose")
    fixed = line_deck(found.line, held, title="fixed")
    assert loose.count("<freejoint />") == 1
    assert "freejoint" not in fixed
