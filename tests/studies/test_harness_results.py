from __future__ import annotations

import csv
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.rod.bands import Band, StateBands
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine, prepare_line
from labpipe.mechanics.studies.harness_numbers import (
    PATH_RADIUS,
    RADIUS,
    Doubt,
    build_results,
    choose_bend_limit,
    collect_fields,
    compute_curvature,
    compute_numbers,
    compute_radius,
    evaluate_numbers,
    find_jump_doubt,
    find_reasons,
    find_sharpest_bend,
    find_unloading_doubt,
    list_releases,
    make_convergence_doubts,
    make_share_doubts,
)
from labpipe.mechanics.studies.harness_solution import HarnessSolution
from labpipe.mechanics.studies.harness_study import (
    build_drawn_harness,
    compute_columns,
    follow_harness,
    format_forces,
    format_shape,
    format_vtk,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Status
from tests.builders.harness_files import SLACK, STIFFNESS, arch, followed, pushed, written

ALONE = pushed(STIFFNESS).partition("  - kind: grip")[0] + "steps: 2\n"
"""A cantilever under its own weight."""
WEIGHTLESS = "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"
NAMED = arch().replace("left", """'le"ft, one'""")
STEPS = (4, 8)
MEMORY = {"energy_lost", "kept_curvature"}
SHAPE = {"smallest_bend_radius", "lowest_point"}


def remarks_of(path: RodPath) -> dict[str, str]:
    return {result.name: result.remark for result in build_results(path, (), {})}


def doubtful_of(path: RodPath, doubt: Doubt | None) -> set[str]:
    doubts = () if doubt is None else (doubt,)
    results = build_results(path, (), {}, doubts)
    return {result.name for result in results if result.status is Status.DOUBTFUL}


def test_a_heavy_cantilever() -> None:
    """w = 0.0686 N/m on 0.1 m of 150 N mm^2: w L^4 / 8 EI = 5.7 mm, w L^2 / 2 at the clip.

    The lowest point is along gravity: the same cantilever, pulled to the side, and without weight.
    """
    _, _, path = followed(ALONE)
    numbers = compute_numbers(path)
    weight = 0.007 * 9.80665
    moment = weight * 0.1**2 / 2.0
    assert numbers["force.bench"] == pytest.approx(weight * 0.1, rel=1e-6)
    assert numbers["moment.bench"] == pytest.approx(moment, rel=0.01)
    assert numbers["smallest_bend_radius"] == pytest.approx(150e-6 / moment, rel=2e-3)
    assert remarks_of(path)["smallest_bend_radius"] == "0 mm from the start"
    down = numbers["lowest_point"]
    assert down == pytest.approx(-weight * 0.1**4 / 8 / 150e-6, rel=0.02)
    assert remarks_of(path)["lowest_point"] == "100 mm from the start"
    assert numbers["kept_curvature"] == 0.0
    assert not any(name.startswith("springback") for name in numbers)
    assert find_unloading_doubt(path) is None, "a spring"
    _, _, path = followed(ALONE + "gravity: [0 m/s^2, 9.80665 m/s^2, 0 m/s^2]\n")
    assert compute_numbers(path)["lowest_point"] == pytest.approx(down, rel=1e-9)
    assert path.last.positions[-1, 1] == pytest.approx(-down, rel=1e-9)
    _, _, path = followed(ALONE + WEIGHTLESS)
    assert compute_numbers(path)["lowest_point"] == pytest.approx(0.0, abs=1e-12)
    radius, *_ = build_results(path, (), {})
    assert (radius.name, radius.value, radius.codes) == (
        "smallest_bend_radius",
        None,
        ("straight",),
    )
    assert compute_radius(np.array([0.0, 2.0])).tolist() == [np.inf, 0.5]


@pytest.mark.parametrize(
    ("stiffness", "elements", "is_coarse"),
    [(3, 12, False), (3, 8, False), (1, 20, False), (3, 5, True), (0.3, 12, True), (0.1, 20, True)],
)
def test_elements_that_turn_far_are_too_long(
    stiffness: float, elements: int, *, is_coarse: bool
) -> None:
    """A limp cantilever: where nothing is doubtful its bend radius is that of 100 elements."""
    text = ALONE.replace("bending_stiffness: 150", f"bending_stiffness: {stiffness}")
    harness, material, _ = followed(text)

    def at(count: int) -> PreparedLine:
        line = harness.line.model_copy(update={"elements": count})
        other = harness.model_copy(update={"line": line})
        return prepare_line(other, material.sections[0]({}), {})

    path, exact = follow(*at(elements), steps=2), follow(*at(100), steps=2)
    doubts = make_convergence_doubts(path, at(elements // 2), {})
    assert [doubt.reason.code for doubt in doubts] == ["coarse_elements"] * is_coarse
    if not is_coarse:
        radius, exact_radius = (compute_numbers(line)[RADIUS] for line in (path, exact))
        assert radius == pytest.approx(exact_radius, rel=0.01)


def test_what_was_lost_in_a_jump_is_doubtful() -> None:
    """1 of 4 J in a jump in step 2: what remembers is doubtful, and shape where it was let go."""
    _, _, path = followed(ALONE)
    lost, fallen = np.array([1.0, 3.0, 4.0]), np.array([0.0, 0.0, 1.0])
    jumped = replace(path, jump_steps=(0, 2), lost_energy=lost, jump_energy=fallen)
    doubt = find_jump_doubt(jumped)
    assert doubt is not None
    assert doubt.reason.code == "jumped"
    assert doubt.reason.message.startswith("step 2: the line jumped")
    assert "25 % of the energy" in doubt.reason.message
    assert doubtful_of(jumped, doubt) == MEMORY | {"moment.bench"}
    assert find_jump_doubt(replace(jumped, jump_energy=0.2 * fallen)) is None, "a twentieth"
    without_memory = replace(jumped, lost_energy=0.0 * lost, jump_energy=0.0 * lost)
    assert find_jump_doubt(without_memory) is None
    _, _, path = followed(pushed())
    shape = SHAPE | {"springback.gripper", "moment.bench"}
    assert doubtful_of(path, find_jump_doubt(path)) == MEMORY | shape


def test_masings_rule_is_an_assumption() -> None:
    """The last shape of a released line depends on it; the bench carries the weight in any case.

    So do forces of one that is held and was unbent: in the example of slack the wire is bent
    elsewhere and more sharply on the way.
    """
    _, _, path = followed(pushed(), isotropic_share=0.0)
    doubt = find_unloading_doubt(path)
    assert doubt is not None
    assert doubt.reason.code == "unloading_assumed"
    assert doubtful_of(path, doubt) == MEMORY | SHAPE | {"springback.gripper"}
    _, _, path = followed(SLACK, isotropic_share=0.0)
    names = {f"{kind}.{side}" for kind in ("force", "moment") for side in ("left", "right")}
    assert doubtful_of(path, find_unloading_doubt(path)) == MEMORY | names
    first = replace(path, states=path.states[:1] + 40 * path.states[1:2])
    assert doubtful_of(path, find_unloading_doubt(first)) == MEMORY, "not unbent yet"


def test_an_isotropic_share_leaves_a_bend_and_no_doubt() -> None:
    """With more isotropic hardening the line springs back less."""
    radii = []
    for share in (0.0, 0.35, 1.0):
        _, _, path = followed(pushed(), isotropic_share=share)
        radii.append(compute_numbers(path)["smallest_bend_radius"])
        assert (find_unloading_doubt(path) is None) == (share > 0.0)
    assert radii == sorted(radii, reverse=True)


@pytest.mark.parametrize(("upper", "wide"), [(1.9, False), (2.1, True)])
def test_a_wide_interval_over_the_share_is_doubtful(upper: float, *, wide: bool) -> None:
    intervals = {"kept_curvature": Interval(1.0, upper), "lowest_point": Interval(-1.0, 1.0)}
    intervals["smallest_bend_radius_on_the_way"] = Interval(0.01, 0.03)  # depends on loading
    names = "kept_curvature", "lowest_point", "smallest_bend_radius"
    doubts = list(make_share_doubts(intervals, names, (0.2, 0.9)))
    assert all("between 0.2 and 0.9" in doubt.reason.message for doubt in doubts)
    assert [doubt.names for doubt in doubts] == [("kept_curvature",)] * wide


def test_what_a_gripper_leaves() -> None:
    _, _, path = followed(pushed())
    numbers = compute_numbers(path)
    ((gripper, _),) = list_releases(path)
    node = gripper.node
    distance = np.linalg.norm(path.states[-1].positions[node] - path.states[8].positions[node])
    assert numbers["springback.gripper"] == pytest.approx(distance)
    assert "step 8" in remarks_of(path)["springback.gripper"]
    assert numbers["force.gripper"] == pytest.approx(0.0, abs=1e-9)
    assert numbers["energy_lost"] > 0.0
    bend_on_path, end = (numbers[f"smallest_bend_radius{word}"] for word in ("_on_the_way", ""))
    assert bend_on_path < 0.5 * end
    assert remarks_of(path)["smallest_bend_radius_on_the_way"].startswith("step ")
    assert "moment.gripper" not in numbers, "it may turn in the gripper"


def test_numbers_are_those_of_the_line() -> None:
    _, _, path = followed(pushed())
    fields = collect_fields(path)
    numbers = compute_numbers(path)
    responses = evaluate_numbers(fields.__getitem__, path)
    assert list(responses) == list(numbers)
    for name, value in numbers.items():
        response = float(responses[name])
        assert (1.0 / response if name in (RADIUS, PATH_RADIUS) else response) == pytest.approx(
            value
        )


def test_curvature_at_rest_counts_in_the_radius() -> None:
    """A curled line that nothing bends is as round as its spool."""
    curl = "line: {length: 100 mm, elements: 12, spool: {curvature: 8 1/m}, section: "
    text = ALONE.replace("line: {length: 100 mm, elements: 12, section: ", curl)
    _, _, path = followed(text + WEIGHTLESS)
    assert compute_curvature(path.last)[1:-1] == pytest.approx(np.full(11, 8.0), rel=1e-6)
    assert find_sharpest_bend(path, [2]).radius == pytest.approx(1.0 / 8.0, rel=1e-6)


def test_beyond_what_backs_the_law() -> None:
    _, material, path = followed(NAMED)
    assert find_reasons(path, material) == ()
    peak = max(float(state.bending_curvatures.max()) for state in path.states)
    half = replace(material, curvature_limit=0.5 * peak)
    (reason,) = find_reasons(path, half)
    assert reason.code == "beyond_backed"
    message = (
        f"the line is bent to {peak:.4g} 1/m, its law is supported up to {peak / 2:.4g} 1/m by "
    )
    assert message in reason.message
    assert reason.message.startswith("step ")
    beyond = replace(
        path,
        reasons=(Reason("beyond_law", "step 3"),),
    )
    assert [reason.code for reason in find_reasons(beyond, half)] == ["beyond_law"]


def test_a_wire_that_is_pulled_beyond_its_copper() -> None:
    """0.1 % of A2 is some 60 N: of seven strands 0.32 mm thick of 110 GPa."""
    load = "  - {kind: load, name: pull, at: end, force: [100 N, 0 N, 0 N]}\nsteps: 2"
    text = ALONE.replace("steps: 2", load).replace(STIFFNESS, "{wire: A2}")
    for pull, codes in (("100 N, ", ["beyond_stretch"]), ("20 N, ", [])):
        _, material, path = followed(text.replace("100 N, ", pull))
        assert [reason.code for reason in find_reasons(path, material)] == codes


def test_the_allowed_radius_is_stated_or_assumed() -> None:
    harness, material, _ = followed(NAMED)
    assumed = choose_bend_limit(harness, material)
    assert assumed.radius == pytest.approx(0.01)
    assert assumed.source == "assumed: 5 times the outer diameter of 2 mm"
    stated = choose_bend_limit(harness.model_copy(update={"allowed_bend_radius": 0.025}), material)
    assert (stated.radius, stated.source) == (0.025, "stated in the file")
    assert (assumed.is_assumed, stated.is_assumed) == (True, False)


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(text)))


def column(table: list[dict[str, str]], name: str) -> Floats:
    return np.array([float(row[name]) for row in table])


def flat_bands(lower: float, upper: float) -> StateBands:
    """Bands of the last step of `NAMED` with the same ends everywhere."""
    nodes, number, edges = (
        Band(*(np.full(shape, end) for end in (lower, lower, upper)))
        for shape in ((17, 3), (17,), (3, 3))
    )
    return StateBands(8, nodes, number, number, edges, edges, {})


def test_the_shape_has_a_row_for_each_node() -> None:
    _, _, path = followed(NAMED)
    table = rows(format_shape(path, STEPS, {8: flat_bands(1.0, 2.0)}))
    assert [int(row["step"]) for row in table] == [4] * 17 + [8] * 17
    last = table[17:]
    places = np.column_stack([column(last, f"{axis} [m]") for axis in "xyz"])
    assert places == pytest.approx(path.last.positions, rel=1e-8, abs=1e-12)
    radius = column(last, "bend_radius [m]")
    assert radius == pytest.approx(1.0 / column(last, "curvature [1/m]"), rel=1e-8)
    assert list(last[0])[:3] == ["step", "node", "along [m]"]
    assert {table[0]["z_lower [m]"], table[0]["curvature_upper [1/m]"]} == {""}
    assert [float(last[0][f"{name}_upper [m]"]) for name in "xyz"] == [2.0, 2.0, 2.0]
    assert float(last[-1]["curvature_lower [1/m]"]) == 1.0


def test_moments_and_tension_are_those_of_the_forces() -> None:
    """EI times the curvature is the bending moment; the pull of the clip is that in the line."""
    _, _, path = followed(NAMED)
    columns = compute_columns(path.last, path.line)
    stiffness = path.line.section.law.spring_stiffness
    moment, curvature = columns["bending_moment [N*m]"], columns["curvature [1/m]"]
    assert moment[1:-1] == pytest.approx(stiffness * curvature[1:-1], rel=0.01)
    pull = -path.last.reaction_forces[0]
    assert columns["tension [N]"][0] == pytest.approx(float(pull[0]), rel=0.05)
    assert columns["torque [N*m]"] == pytest.approx(np.zeros(17), abs=1e-9)


def test_forces_of_every_step_in_balance() -> None:
    _, _, path = followed(NAMED)
    table = rows(format_forces(path, {8: flat_bands(-9.0, 9.0)}))
    assert len(table) == 9 * 2
    last = table[-2:]
    assert [row["boundary"] for row in last] == ['le"ft, one', "right"]
    rest_turns = [float(np.sum(column(last, f"f{axis} [N]"))) for axis in "xyz"]
    assert rest_turns == pytest.approx([0.0, 0.0, 0.007 * 0.2 * 9.80665], abs=1e-6), "the weight"
    size = np.linalg.norm([float(last[0][f"f{axis} [N]"]) for axis in "xyz"])
    assert float(last[0]["force [N]"]) == pytest.approx(float(size))
    assert (last[-1]["fz_upper [N]"], table[0]["fz_upper [N]"]) == ("9", "")


def test_the_vtk_is_a_line_for_each_step() -> None:
    _, _, path = followed(NAMED)
    lines = format_vtk(path, STEPS, "a line, 2 µm").splitlines()
    head = ["# vtk DataFile Version 3.0", "a line, 2 ?m", "ASCII", "DATASET POLYDATA"]
    assert lines[:5] == [*head, "POINTS 34 double"]
    points = np.array([list(map(float, line.split())) for line in lines[5:39]])
    assert points[17:] == pytest.approx(path.last.positions, rel=1e-8, abs=1e-12)
    assert lines[39] == "LINES 2 36"
    assert lines[41].split() == ["17", *map(str, range(17, 34))]
    scalars = ["CELL_DATA 2", "SCALARS step double 1", "LOOKUP_TABLE default", "4", "8"]
    assert lines[42:48] == [*scalars, "POINT_DATA 34"]
    at = lines.index("SCALARS curvature double 1") + 2
    curvature = compute_columns(path.last, path.line)["curvature [1/m]"]
    assert list(map(float, lines[at + 17 : at + 34])) == pytest.approx(curvature.tolist(), rel=1e-8)
    assert not any(word in line for line in lines[48:] for word in ("inf", "nan"))


def done(folder: Path, text: str) -> HarnessSolution:
    return follow_harness(written(folder, text), out=folder / "out", figures=False)


@pytest.mark.slow
def test_signs_are_where_things_are_at_the_end(tmp_path: Path) -> None:
    boundaries = (
        "  - {kind: string, name: thread, at: 100 mm, anchor: [90 mm, 0 mm, 150 mm],\n    "
        "length: 155 mm}\n"
        "  - {kind: load, name: weight, at: 50 mm, force: [0 N, 0 N, -1 mN]}\n"
        "  - {kind: plane, name: table, point: [0 mm, 0 mm, -60 mm]}\nsteps: 10"
    )
    result = done(tmp_path, pushed(STIFFNESS).replace("steps: 10", boundaries))
    drawn = build_drawn_harness(result)
    by_name = {boundary.name: boundary for boundary in drawn.boundaries}
    assert list(by_name) == ["bench", "gripper", "thread", "weight"]
    ((gripper, _),) = list_releases(result.path)
    node = gripper.node
    assert by_name["gripper"].position == pytest.approx(result.path.last.positions[node])
    assert (by_name["gripper"].is_holding, by_name["bench"].is_holding) == (False, True)
    assert by_name["gripper"].path[-1] == pytest.approx([0.06, 0.0, 0.045])
    assert not by_name["bench"].path.size
    assert by_name["bench"].direction == pytest.approx([1.0, 0.0, 0.0])
    assert by_name["thread"].path[0] == pytest.approx(result.path.last.positions[-1])
    ((point, normal),) = drawn.planes
    assert (point[2], normal.tolist()) == (-0.06, [0.0, 0.0, 1.0])
    assert [shape.step for shape in drawn.shapes] == [8, 10]
    assert drawn.allowed_radius == pytest.approx(0.01)
    assert "Allowed bend radius 10 mm, assumed: 5 times the outer diameter of 2 mm." in drawn.note
