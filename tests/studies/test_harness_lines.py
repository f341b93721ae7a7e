from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from labpipe.errors import LabpipeError
from labpipe.mechanics.decks.lookup import format_sliders_json
from labpipe.mechanics.decks.unloading import compute_release
from labpipe.mechanics.law.sliders import (
    SliderLaw,
    compute_first_loading,
    make_linear_law,
    make_unbent_history,
    slide_vector,
)
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Section
from labpipe.mechanics.rod.rotations import to_matrices
from labpipe.mechanics.studies.harness_line import (
    Material,
    PreparedLine,
    prepare_line,
    read_material,
)
from labpipe.mechanics.studies.harness_numbers import (
    bound_residual_curvature,
    compute_released_curvature,
    compute_residual_curvature,
    compute_unbending,
    find_unloading_doubt,
)
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.wire_table import replace_parameters, tabulate_wire
from labpipe.protocol.load import load_harness
from labpipe.protocol.model_files import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.wire import PARAMETERS
from tests.approved import Approve
from tests.builders.harness_files import (
    SHEET,
    SLACK,
    STIFFNESS,
    arch,
    followed,
    pushed,
    written,
)

SECTION = Section(make_linear_law(1e-4, 100.0), 1e-4, mass_per_length=0.01, diameter=2e-3)


def harness(tmp_path: Path, text: str) -> HarnessFile:
    return load_harness(written(tmp_path, text))


def line_of(tmp_path: Path, text: str, **inputs: float) -> PreparedLine:
    return prepare_line(harness(tmp_path, text), SECTION, inputs)


def held(line: PreparedLine, name: str) -> rod.Held:
    (support,) = (boundary for boundary in line.boundaries if boundary.name == name)
    assert isinstance(support, rod.Held)
    return support


def test_a_clip_is_reached_in_a_straight_line(tmp_path: Path) -> None:
    prepared = line_of(tmp_path, arch(steps=4))
    right = held(prepared, "right")
    assert [held(prepared, name).node for name in ("left", "right")] == [0, 16]
    share = np.linspace(0.0, 1.0, 5)[:, None]
    expected = (1.0 - share) * [0.2, 0.0, 0.0] + share * [0.18, 0.0, 0.03]
    assert right.position == pytest.approx(expected, abs=1e-15)
    assert right.frame is not None
    assert to_matrices(right.frame)[:, :, 2] == pytest.approx(
        np.tile([1.0, 0, 0], (5, 1)), abs=1e-12
    )
    assert held(prepared, "left").position == pytest.approx(np.zeros((5, 3)))


def test_every_named_place_is_a_node(tmp_path: Path) -> None:
    load = "  - {kind: load, name: weight, at: 77 mm, force: [0 N, 0 N, -1 N], by: 4}\nsteps:"
    prepared = line_of(tmp_path, arch().replace("steps:", load))
    line = prepared.line
    (weight,) = (edge for edge in prepared.boundaries if isinstance(edge, rod.Load))
    node, force = weight.node, weight.force
    assert line.stations[node] == pytest.approx(0.077, abs=1e-12)
    assert line.stations[-1] == pytest.approx(0.2, abs=1e-12)
    assert line.lengths[:node] == pytest.approx(np.full(node, 0.077 / node))
    assert line.lengths.max() < 1.3 * line.lengths.min()
    assert force[:, 2] == pytest.approx([0, -0.25, -0.5, -0.75, -1, -1, -1, -1, -1])


def test_a_grip_turns_and_twists_as_its_path_says(tmp_path: Path) -> None:
    """Direction from x to z over two steps, then 540 degrees about itself over four more."""
    free = line_of(tmp_path, pushed())
    assert held(free, "gripper").frame is None, "by its position it may turn"
    assert held(free, "gripper").position[5] == pytest.approx([0.0695, 0.0, 0.0275])
    text = pushed().replace("    holds: position\n", "")
    path = text[text.index("path: [") : text.index("]}]") + 3]
    turns = "path: [{step: 2, direction: [0, 0, 1]}, {step: 6, turn: 540 deg}]"
    grip = held(line_of(tmp_path, text.replace(path, turns)), "gripper")
    assert grip.release == 9
    assert grip.frame is not None
    axes = to_matrices(grip.frame)
    root = np.sqrt(0.5)
    directions = [[1, 0, 0], [root, 0, root], *[[0, 0, 1]] * 9]
    assert axes[:, :, 2] == pytest.approx(np.array(directions), abs=1e-12)
    cosines = axes[2:7, :, 0] @ axes[2, :, 0]
    assert cosines == pytest.approx(np.cos(np.deg2rad([0, 135, 270, 405, 540])), abs=1e-12)


def test_weight_grows_only_where_the_line_begins_taut(tmp_path: Path) -> None:
    def weights(text: str) -> list[Floats]:
        boundaries = line_of(tmp_path, text).boundaries
        return [edge.vector for edge in boundaries if isinstance(edge, rod.Gravity)]

    (taut,) = weights(arch(steps=10))
    assert taut[:, 2] / -9.80665 == pytest.approx([0, 0.5, *[1] * 9])
    (weight,) = weights(pushed().partition("  - kind: grip")[0] + "steps: 10\n")
    assert weight.tolist() == [[0.0, 0.0, -9.80665]]
    assert weights(arch(more="gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")) == []


def test_a_spool_leaves_an_arc_that_is_at_rest(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [0, 1, -1]}\n"
    line = line_of(tmp_path, arch(line=curl)).line
    angle = 5.0 * 0.2
    chord = np.sin(angle) / 5.0, (1.0 - np.cos(angle)) / 5.0
    end = np.array([chord[0], chord[1] * np.sqrt(0.5), -chord[1] * np.sqrt(0.5)])
    assert line.positions[-1] == pytest.approx(end, rel=1e-3)
    assert np.linalg.norm(line.rest_curvature[:, :2], axis=1) == pytest.approx(np.full(15, 5.0))
    assert line.rest_curvature[:, 2] == pytest.approx(np.zeros(15), abs=1e-9)
    curlier = line_of(tmp_path, arch(line=curl), free_curvature_1=1.0).line
    assert np.linalg.norm(curlier.rest_curvature[:, :2], axis=1) == pytest.approx(
        np.full(15, 6.0)
    ), "the first free curvature is to the side of the spool"
    with pytest.raises(ValueError, match="must be a side of the line, not its direction"):
        line_of(tmp_path, arch(line=curl.replace("[0, 1, -1]", "[2, 0, 0]")))


def test_inputs_change_length_and_rest(tmp_path: Path) -> None:
    prepared = line_of(tmp_path, arch(), length_factor=np.log(1.01))
    assert prepared.line.length == pytest.approx(0.202)
    assert held(prepared, "right").position[-1] == pytest.approx([0.18, 0.0, 0.03])
    longer = arch().replace("length: 200 mm", "length: 250 mm")
    assert line_of(tmp_path, longer).line.length == pytest.approx(0.25)


def test_rings_strings_and_planes(tmp_path: Path) -> None:
    """At the start the line lies straight, from the origin along x, and nothing may pull it."""
    contacts = (
        "  - {kind: pin, name: stud, at: 100 mm, position: [95 mm, 0 mm, 10 mm]}\n"
        "  - {kind: ring, name: guide, position: [52 mm, 9 mm, 0 m], direction: [1, 0, 0], by: 4}\n"
        "  - {kind: ring, name: eye, position: [60 mm, 0 mm, 0 mm], direction: [1, 0, 0]}\n"
        "  - {kind: string, name: tie, at: 50 mm, anchor: [50 mm, 0 mm, 60 mm], length: 3 cm}\n"
        "  - {kind: string, name: long, at: 50 mm, anchor: [50 mm, 0 mm, 90 mm], length: 95 mm}\n"
        "  - {kind: plane, name: table, point: [0 mm, 0 mm, -50 mm], friction: 0.3}\nsteps:"
    )
    boundaries = line_of(tmp_path, arch().replace("steps:", contacts)).boundaries
    *_, guide, eye, tie, long, table, weight = boundaries
    assert isinstance(guide, rod.Ring)
    assert isinstance(eye, rod.Ring)
    assert isinstance(tie, rod.String)
    assert isinstance(long, rod.String)
    assert isinstance(table, rod.Plane)
    assert isinstance(weight, rod.Gravity)
    sideways = [[0.052, 0.0, 0.0], [0.052, 0.0045, 0.0], [0.052, 0.009, 0.0], [0.052, 0.009, 0]]
    assert guide.position[[0, 2, 4, -1]] == pytest.approx(np.array(sideways))
    assert np.ptp(eye.position, axis=0).max() < 1e-15
    assert eye.position[0] == pytest.approx([0.06, 0.0, 0.0])
    assert tie.anchor[[0, -1]] == pytest.approx(np.array([[0.05, 0, 0.03], [0.05, 0, 0.06]]))
    assert long.anchor[[0, -1]] == pytest.approx(np.array([[0.05, 0, 0.09], [0.05, 0, 0.09]]))
    assert table.friction == 0.3


def material(folder: Path, section: str, *, wires: Path | None = None, line: str = "") -> Material:
    file = written(folder, arch(section, line=line))
    return read_material(load_harness(file), file, wires)


def test_a_wire_has_the_law_of_its_sheet(tmp_path: Path) -> None:
    """The sheet of the file, or another in its place; and a deck of the wire."""
    wire = material(tmp_path, "{wire: A2}")
    table = tabulate_wire(next(spec for spec in read_wire_sheet(SHEET).specs if spec.name == "A2"))
    section = wire.sections[0]({})
    moments = compute_first_loading(section.law, table.curvature[1:])
    assert moments == pytest.approx(table.moment[1:], rel=0.01)
    assert section.mass_per_length == pytest.approx(table.mass_per_length)
    assert section.torsional_stiffness == pytest.approx(table.torsional_stiffness)
    assert wire.diameter == pytest.approx(1.6e-3)
    assert wire.curvature_limit == pytest.approx(table.doubtful_curvature)
    assert wire.limit_source == "the linear range of the insulation"
    assert wire.best_inputs == {"isotropic_share": 0.675}
    assert wire.varies_only_share
    assert [file.role for file in wire.files] == ["wires"]
    sheet = tmp_path / "other.csv"
    sheet.write_text(
        "wire,wire_diameter_mm,strands,strand_diameter_mm,insulation_thickness_mm,lay_angles_deg\n"
        "X,1.6,7,0.32,0.3,12\n"
    )
    assert material(tmp_path, "{wire: X}", wires=sheet).name == "X"
    (tmp_path / "A2.sliders.json").write_text(format_sliders_json(table), encoding="utf-8")
    deck = material(tmp_path, "{sliders: A2.sliders.json, diameter: 1.6 mm}")
    of_deck = deck.sections[0]({})
    assert of_deck.law.slider_stiffnesses == pytest.approx(section.law.slider_stiffnesses, rel=1e-6)
    assert of_deck.mass_per_length == pytest.approx(section.mass_per_length)
    assert (deck.name, deck.limit_source) == ("A2", wire.limit_source)
    assert deck.curvature_limit == pytest.approx(wire.curvature_limit)
    assert deck.share_range == (0.35, 1.0)
    assert deck.best_inputs == wire.best_inputs
    for share in (0.35, 0.675, 1.0):
        laws = [line.sections[0]({"isotropic_share": share}).law for line in (deck, wire)]
        computed, expected = (
            compute_release(law, np.array([5.0, 12.0, 23.5])).residual_curvature for law in laws
        )
        assert computed == pytest.approx(expected, rel=1e-6)
    stated = replace(table, spec=replace(table.spec, isotropic_share=0.5))
    (tmp_path / "known.json").write_text(format_sliders_json(stated), encoding="utf-8")
    of_known = material(tmp_path, "{sliders: known.json, diameter: 1.6 mm}")
    assert not of_known.distributions
    assert of_known.sections[0]({}).law.growing_sliders[0].stiffness == pytest.approx(
        deck.sections[0]({"isotropic_share": 0.5}).law.growing_sliders[0].stiffness
    )
    stiffer = deck.sections[0]({"law_factor": np.log(2.0), "mass_factor": np.log(3.0)})
    assert stiffer.law.slider_stiffnesses == pytest.approx(2.0 * of_deck.law.slider_stiffnesses)
    assert stiffer.law.spring_stiffness == pytest.approx(2.0 * of_deck.law.spring_stiffness)
    assert stiffer.mass_per_length == pytest.approx(3.0 * of_deck.mass_per_length)
    assert stiffer.torsional_stiffness == of_deck.torsional_stiffness


def test_a_calibrated_wire_has_the_strength_of_its_copper_once(tmp_path: Path) -> None:
    values = dict(zip(PARAMETERS, (0.06, 0.8e9, 1.3), strict=True))
    none = np.zeros((4, 4)).tolist()
    mixture = {"chance": [1.0], "scatter": [0.0], "shift": [[0.0] * 4], "covariance": [none]}
    solution = {**values, "rise": 0.0, "rmse": 1e-3, "limit": 4.0, "covariance": none}
    solution["mixture"] = {**mixture, "freedom": 90.0}
    content = {"wire": "A2", "solutions": [solution], "widening": 1.0, "tested_curvature": 20.0}
    (tmp_path / "fit.json").write_text(json.dumps(content), encoding="utf-8")
    wire = material(tmp_path, "{wire: A2, calibration: fit.json}")
    spec = next(spec for spec in read_wire_sheet(SHEET).specs if spec.name == "A2")
    table = tabulate_wire(replace_parameters(spec, values))
    is_bent = table.curvature > 1.0
    law = wire.sections[0]({**wire.best_inputs, "isotropic_share": 0.0}).law
    moments = compute_first_loading(law, table.curvature[is_bent])
    assert moments == pytest.approx(table.moment[is_bent], rel=0.01)


def test_what_the_file_states_is_believed(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 2 1/m, spread: 0.4 1/m}\n"
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    stated = material(tmp_path, section, line=curl)
    assert stated.sections[0]({}).law.spring_stiffness == pytest.approx(150e-6)
    assert np.isinf(stated.sections[0]({}).axial_stiffness)
    assert stated.curvature_limit == 80.0
    assert stated.limit_source == "'largest_curvature' of the file"
    (belief,) = stated.distributions
    assert belief.names == ("law_factor", "free_curvature_1", "free_curvature_2")
    assert np.diag(belief.steps) == pytest.approx([0.1, 0.4, 0.4])
    assert dict.fromkeys(belief.causes) == {"stiffness as stated": None, "curl of the spool": None}
    assert belief.to_inputs() == dict.fromkeys(belief.names, 0.0)


def test_files_without_a_law(tmp_path: Path, approved: Approve) -> None:
    deck = {"stiffness": 1e-4, "stiffnesses": [-1.0], "slip_curvatures": [1.0]}
    ranged = deck | {"range": {"curvature": [0.1, 9.0]}, "torsional_stiffness": 1e-4}
    none = {"reason": "it stiffens"}
    grown = {"stiffness": 1e-4, "slid": [0.0, 1.0], "limits": [1e-4, 2e-4], "isotropic_share": 0.5}
    shared = ranged | {"stiffnesses": [1.0], "growing": grown | {"share_interval": [0.5, 2.0]}}
    decks = {"list": [], "none": none, "open": deck, "low": ranged, "shared": shared}
    for name, content in decks.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    (tmp_path / "damaged.json").write_bytes(b"\xff")
    sections = ["{wire: A22}", "{wire: A2, calibration: damaged.json}"]
    for name in ("damaged.json", "list.json", "none.json", "open.json", "low.json", "shared.json"):
        sections.append(f"{{sliders: {name}, diameter: 2 mm}}")
    messages = []
    for section in sections:
        with pytest.raises(LabpipeError) as raised:
            material(tmp_path, section)
        messages.append(str(raised.value))
    approved(messages)


ONE = SliderLaw(2.0, np.array([6.0]), np.array([1.0]), 0.0, 10.0)
"""A spring of 2 and a slider of 6 that slides at 1."""
SOME = SliderLaw(0.5, np.array([9.0, 3.0, 1.0]), np.array([0.5, 2.0, 5.0]), 0.0, 20.0)


def bent(law: SliderLaw, path: list[tuple[float, float]]) -> Floats:
    """Where the sliders of one station rest after some curvatures."""
    rests = make_unbent_history(law, 1, is_vector=True)
    for curvature in path:
        rests = slide_vector(law, np.array([curvature]), rests).history
    return rests


def test_one_slider() -> None:
    """It slides back by twice what it slid at, or as far as the spring pulls it."""
    for law, to, residual in (
        (ONE, 0.9, 0.0),  # nothing slid
        (ONE, 1.5, 1.5 - (2.0 * 1.5 + 6.0) / 8.0),  # 0.375: back without sliding
        (ONE, 2.5, 2.5 - (2.0 * 2.5 + 6.0) / 8.0),  # 1.125: back by 1.375
        (ONE, 5.0, 3.0),  # back by 2, then it slides the other way until 2 k = 6
        (replace(ONE, spring_stiffness=0.0), 3.0, 2.0),  # without a spring back by 1
    ):
        released = compute_released_curvature(law, bent(law, [(to, 0.0)]))[0]
        assert released == pytest.approx([residual, 0.0], abs=1e-8)
    spring = SliderLaw(1.0, np.zeros(0), np.zeros(0), 0.0, 1.0)
    assert not compute_released_curvature(spring, np.zeros((4, 0, 2))).any()


def test_a_way_that_turned_ends_where_the_energy_is_least() -> None:
    rests = bent(SOME, [(3.0, 0.0), (4.0, 4.0), (-1.0, 6.0)])

    def energy(curvature: Floats) -> float:
        size, slips = np.linalg.norm(curvature - rests[0], axis=1), SOME.slip_curvatures
        work = np.where(size < slips, 0.5 * size**2, slips * size - 0.5 * slips**2)
        energy = 0.5 * SOME.spring_stiffness * float(curvature @ curvature)
        return energy + float(SOME.slider_stiffnesses @ work)

    optimum = minimize(
        energy, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14}
    )
    assert compute_released_curvature(SOME, rests)[0] == pytest.approx(optimum.x, abs=1e-5)


def test_a_laid_line_keeps_what_its_own_law_says() -> None:
    """The example of slack by Masing's rule, bent more sharply on the way than when laid.

    A tenth of its bend by the rule, nearly all of it if nothing slid back.
    """
    _, _, path = followed(SLACK, isotropic_share=0.0)
    law = path.line.section.law
    doubt = find_unloading_doubt(path)
    assert doubt is not None
    message = "85 mm from the start the residual curvature is 1.49 1/m by the rule"
    assert message in doubt.reason.message
    residual = compute_residual_curvature(path.last, law)
    largest = bound_residual_curvature(path, law)
    bends = np.array([state.bending_curvatures for state in path.states])
    node = int(np.argmax(largest))
    assert residual[node] == pytest.approx(1.49, abs=0.01)
    assert residual[node] < largest[node] < bends[:, node].max()
    # by hand: from the sharpest bend, back by the moment there over the first stiffness
    sharp = path.states[int(np.argmax(bends[:, node]))]
    curvature = sharp.curvatures[node, 0, :2]
    moment = law.spring_stiffness * curvature
    moment = moment + law.slider_stiffnesses @ (curvature - sharp.slider_rests[node, 0])
    released = np.linalg.norm(curvature - moment / law.first_stiffness)
    assert largest[node] == pytest.approx(float(released), rel=1e-9)
    assert compute_unbending(path) == pytest.approx(
        (bends.max(axis=0) - bends[-1]).max() / bends.max()
    )
    assert 0.7 < compute_unbending(path) < 0.8
    assert compute_unbending(replace(path, states=41 * path.states[-1:])) == 0.0
