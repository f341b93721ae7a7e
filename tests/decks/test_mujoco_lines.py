from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from labpipe.mechanics.decks.deck_law import find_linear_range
from labpipe.mechanics.decks.mujoco import format_cable_deck
from labpipe.mechanics.decks.mujoco_line import format_line_deck
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine, prepare_line, read_material
from labpipe.protocol.load import load_harness
from labpipe.records.arrays import Floats
from tests.builders.harness_files import STIFFNESS, arch, pushed, written
from tests.builders.wire_tables import LENGTH, wire_table


def settle_tip(deck: str, load: float) -> tuple[Floats, Any]:
    """Hang a load on the tip, wait, and give back where the tip is."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(deck)
    data = mujoco.MjData(model)
    tip = int(model.sensor("tip").objid[0])
    data.xfrc_applied[tip, 1] = load
    steps = re.search(r"at rest after (\d+) steps", deck)
    assert steps is not None
    for _ in range(int(steps[1])):
        mujoco.mj_step(model, data)
    assert not any(warning.number for warning in data.warning)
    assert float(np.max(np.abs(data.qvel))) < 1e-6
    return np.array(data.sensor("tip").data), data


@pytest.mark.parametrize(("name", "length", "edges"), [("A1", LENGTH, 40), ("C5", 0.3, 20)])
def test_a_small_load_bends_the_cable_as_the_wire_model_says(
    name: str, length: float, edges: int
) -> None:
    table = wire_table(name)
    stiffness = table.stick_stiffness
    close = find_linear_range(table, stiffness)
    assert close is not None
    load = 0.5 * close[1] * stiffness / length
    tip, _ = settle_tip(format_cable_deck(table, length=length, edges=edges), load)
    assert tip[1] == pytest.approx(load * length**3 / (3.0 * stiffness), rel=0.005)
    # up to there, it is the wire itself that bends so
    assert load * length < np.interp(close[1], table.curvature, table.moment)


@pytest.mark.parametrize("edges", [20, pytest.param(120, marks=pytest.mark.slow)])
def test_a_large_load_bends_it_along_the_elastica(edges: int) -> None:
    """By the table of the elastica; the mass does not count, and the cable keeps its length."""
    table, tips = wire_table("A2"), []
    for alpha, deflection, mass in (
        (5.0, 0.713792, 2e-3),
        (5.0, 0.713792, 50e-3),
        (2.0, 0.493457, 2e-3),
    ):
        load = alpha * 1.2e-3 / LENGTH**2
        deck = format_cable_deck(
            replace(table, mass_per_length=mass), stiffness=1.2e-3, edges=edges
        )
        tip, data = settle_tip(deck, load)
        assert tip[1] / LENGTH == pytest.approx(deflection, rel=0.005)
        assert tip[2] == pytest.approx(0.0, abs=1e-9)
        length = np.sum(np.linalg.norm(np.diff(np.array(data.flexvert_xpos), axis=0), axis=1))
        assert length * (edges - 0.5) / edges == pytest.approx(LENGTH, rel=2e-3)
        tips.append(tip[1])
    assert tips[0] == pytest.approx(tips[1], rel=1e-6)


def test_numbers_of_the_model() -> None:
    table = replace(wire_table("A2"), name="A---2")  # XML comments have no two hyphens
    root = Xml.fromstring(format_cable_deck(table))  # our own text
    flex = root.find("worldbody/flexcomp")
    assert flex is not None
    elasticity = flex.find("elasticity")
    assert elasticity is not None
    circle = np.pi / 4.0 * float(flex.attrib["radius"]) ** 4
    assert float(elasticity.attrib["young"]) * circle == pytest.approx(table.stick_stiffness)
    twist = float(elasticity.attrib["shear"]) * 2.0 * circle
    assert twist == pytest.approx(table.torsional_stiffness)
    points = np.array(flex.attrib["point"].split(), dtype=np.float64).reshape(-1, 3)
    mass_per_length = float(flex.attrib["mass"]) / len(points) / (points[1, 0] - points[0, 0])
    assert mass_per_length == pytest.approx(table.mass_per_length, rel=1e-6)


def test_the_stiffness_is_stated_or_the_slope_of_the_law_at_zero() -> None:
    table = wire_table("A2")
    secants = table.secant_stiffness / 5.0
    slipping = replace(table, slip_onsets=np.zeros(1), moment=table.moment / 5.0)
    text = format_cable_deck(replace(slipping, secant_stiffness=secants))
    assert f"bending stiffness {secants[1]:.6g} N m2 (the slope of the law at zero" in text
    soft = format_cable_deck(table, stiffness=1e-4)
    assert "0.0001 N m2 (as given), at no curvature within 5 % of the wire's law" in soft


@pytest.mark.parametrize("name", ["A2", "<A & B>", 'say "A2" -- twice', "two\nlines", "-->"])
def test_a_name_breaks_nothing_and_the_clamp_is_where_the_deck_says(name: str) -> None:
    import mujoco

    deck = format_cable_deck(replace(wire_table(), name=name), edges=10)
    model = mujoco.MjModel.from_xml_string(deck)
    assert (model.nflex, model.nflexvert, len(model.flex_vert0)) == (1, 11, 11)
    assert model.flex_radius[0] == pytest.approx(0.8e-3)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    x = np.array(data.flexvert_xpos)[:, 0]
    assert x[0] + x[1] == pytest.approx(0.0, abs=1e-12)
    assert x[-1] == pytest.approx(LENGTH)


def test_refused() -> None:
    for changes, message in (
        ({"stiffness": 0.0}, r"stiffness=0\.0: must be finite and > 0"),
        ({"stiffness": float("nan")}, r"stiffness=nan: must be finite"),
        ({"length": -1.0}, r"length=-1\.0: must be finite and > 0"),
        ({"edges": 2}, r"edges=2: must be a whole number >= 3"),
    ):
        with pytest.raises(ValueError, match=message):
            format_cable_deck(wire_table(), **changes)


def prepare(folder: Path, text: str) -> PreparedLine:
    file = written(folder, text)
    harness = load_harness(file)
    return prepare_line(harness, read_material(harness, file).sections[0]({}), {})


def settle_chain(deck: str, steps: int, places: int, *, moves: int = 50, rest: int = 600) -> Floats:
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


def sample_rod(prepared: PreparedLine, steps: int, places: int) -> Floats:
    """The same places of the rod: bodies begin at (i - 1/2) / 30 of the length."""
    path = follow(*prepared, steps=steps)
    nodes = np.round(np.linspace(1, 30, places)).astype(int)
    body_stations = (nodes - 0.5) / 30.0 * prepared.line.length
    return np.column_stack(
        [np.interp(body_stations, prepared.line.stations, x) for x in path.last.positions.T]
    )


@pytest.mark.slow
@pytest.mark.parametrize("section", [STIFFNESS, "{wire: A2}"])
def test_mujoco_has_the_shape_of_the_rod(tmp_path: Path, section: str) -> None:
    """An arch in its plane: within 1.5 % of the length."""
    prepared = prepare(tmp_path, arch(section).replace("elements: 16", "elements: 30"))
    deck = format_line_deck(prepared.line, prepared.boundaries, title="arch")
    assert settle_chain(deck, 8, 7) == pytest.approx(sample_rod(prepared, 8, 7), abs=3e-3)


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
    prepared = prepare(tmp_path, text.replace("position: [60 mm, 0 mm, 45 mm]}]", down))
    if weight == "none":
        prepared = prepared._replace(boundaries=prepared.boundaries[:-1])
    deck = format_line_deck(prepared.line, prepared.boundaries, title="pushed")
    assert settle_chain(deck, 16, 7) == pytest.approx(sample_rod(prepared, 16, 7), abs=2e-4)


def test_the_model_begins_as_the_line_lies(tmp_path: Path) -> None:
    """A curled line, by the places of the bodies before anything moves."""
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco-core, of the development extras")
    curl = "  spool: {curvature: 5 1/m, towards: [0, 1, 0]}\n"
    prepared = prepare(tmp_path, arch(line=curl).replace("elements: 16", "elements: 30"))
    model = mujoco.MjModel.from_xml_string(
        format_line_deck(prepared.line, prepared.boundaries, title="curl")
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    last = data.body("node_30")
    end = last.xpos + last.xmat.reshape(3, 3)[:, 0] * 0.5 * 0.2 / 30
    assert end == pytest.approx(prepared.line.positions[-1], abs=2e-3)


def test_names_of_the_file_are_those_of_the_model(tmp_path: Path) -> None:
    """A clip may be called as the chain calls its bodies."""
    contacts = (
        "  - {kind: string, name: thread, at: 50 mm, anchor: [50 mm, 0 mm, 90 mm], "
        "length: 95 mm}\n"
        "  - {kind: load, name: node_3, at: 77 mm, force: [0 N, 0 N, -1 N]}\n"
        "  - {kind: ring, name: guide, position: [50 mm, 0 mm, 0 mm], direction: [1, 0, 0]}\n"
        "  - {kind: plane, name: table, point: [0 mm, 0 mm, -50 mm], friction: 0.3}\nsteps:"
    )
    text = arch().replace("left", "'a \"b\" <c>'").replace("right", "'g,h é'")
    prepared = prepare(tmp_path, text.replace("steps:", contacts))
    deck = format_line_deck(prepared.line, prepared.boundaries, title="all -- kinds")
    root = ET.fromstring(deck)
    names = {part.get("name") for part in root.iter() if part.get("name")}
    assert names >= {
        *('a "b" <c>', "g,h é", 'path_a "b" <c>', "release_g,h é", "hold_g,h é"),
        *("thread", "anchor_thread", "node_3_x", "node_3_z", "at_node_3"),
    }
    assert "Omitted, as the chain has no contacts: guide, table." in deck
    spatial = root.find(".//spatial")
    assert spatial is not None
    assert spatial.get("range") == "0 0.095"
    clip = prepare(tmp_path, arch().replace("right", "node_3"))
    root = ET.fromstring(format_line_deck(clip.line, clip.boundaries, title="a line"))
    bodies = [body.get("name") for body in root.iter("body")]
    assert "node_3" in bodies
    assert len(set(bodies)) == len(bodies)


def test_a_line_that_may_fall_is_free_in_space(tmp_path: Path) -> None:
    prepared = prepare(tmp_path, arch())
    supports = [boundary for boundary in prepared.boundaries if isinstance(boundary, rod.Held)]
    loose = format_line_deck(prepared.line, supports[1:], title="loose")
    fixed = format_line_deck(prepared.line, supports, title="fixed")
    assert loose.count("<freejoint />") == 1
    assert "freejoint" not in fixed
