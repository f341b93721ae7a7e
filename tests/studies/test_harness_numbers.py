"""Numbers of a followed harness, against what is known of simple lines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.law.sliders import slider_moment
from labpipe.protocol.load import load_harness
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Status
from labpipe.rod.path import Reason as RodReason
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import Laid, laid
from labpipe.studies.harness_memory import kept_curvature
from labpipe.studies.harness_numbers import (
    Doubt,
    Number,
    bend_limit,
    curvature_of,
    element_doubt,
    jump_doubt,
    numbers_of,
    radius_of,
    reasons_of,
    results_of,
    sharpest,
    unloading_doubt,
)
from labpipe.studies.harness_section import Material, material_of
from tests.builders.harness_files import EXAMPLES, STIFFNESS, arch, pushed, written

RELEASED = pushed()
ALONE = pushed(STIFFNESS).partition("  - kind: grip")[0] + "steps: 2\n"
"""A cantilever under its own weight."""
ENERGIES = ("work", "stored", "lost", "rubbed", "jumped", "lost_in_jumps")


def followed(folder: Path, text: str) -> tuple[Material, Laid, RodPath]:
    file = written(folder, text)
    harness = load_harness(file)
    material = material_of(harness, file)
    ready = laid(harness, material.sections[0]({}), {})
    return material, ready, follow(ready.line, ready.boundaries, steps=harness.steps)


def by_name(path: RodPath, ready: Laid) -> dict[str, Number]:
    return {each.name: each for each in numbers_of(path, ready)}


def doubtful_of(path: RodPath, ready: Laid, doubt: Doubt | None) -> set[str]:
    doubts = () if doubt is None else (doubt,)
    found = results_of(numbers_of(path, ready), (), {}, doubts)
    return {each.name for each in found if each.status is Status.DOUBTFUL}


def test_a_heavy_cantilever(tmp_path: Path) -> None:
    """w = 0.0686 N/m on 0.1 m of 150 N mm^2: w L^4 / 8 EI = 5.7 mm, w L^2 / 2 at the clip."""
    _, ready, path = followed(tmp_path, ALONE)
    numbers = by_name(path, ready)
    weight = 0.007 * 9.80665
    moment = weight * 0.1**2 / 2.0
    assert numbers["force.bench"].value == pytest.approx(weight * 0.1, rel=1e-6)
    assert numbers["moment.bench"].value == pytest.approx(moment, rel=0.01)
    assert numbers["smallest_bend_radius"].value == pytest.approx(150e-6 / moment, rel=2e-3)
    assert numbers["smallest_bend_radius"].remark == "0 mm from the start"
    assert numbers["lowest_point"].value == pytest.approx(-weight * 0.1**4 / 8 / 150e-6, rel=0.02)
    assert numbers["lowest_point"].remark == "100 mm from the start"
    assert numbers["kept_curvature"].value == 0.0
    assert not any(name.startswith("springback") for name in numbers)


def test_the_lowest_point_is_along_gravity(tmp_path: Path) -> None:
    """The same cantilever, pulled to the side, and without weight."""
    _, ready, path = followed(tmp_path, ALONE)
    down = by_name(path, ready)["lowest_point"].value
    aside = ALONE + "gravity: [0 m/s^2, 9.80665 m/s^2, 0 m/s^2]\n"
    _, ready, path = followed(tmp_path, aside)
    assert by_name(path, ready)["lowest_point"].value == pytest.approx(down, rel=1e-9)
    assert path.last.positions[-1, 1] == pytest.approx(-down, rel=1e-9)
    _, ready, path = followed(tmp_path, ALONE + "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    assert by_name(path, ready)["lowest_point"].value == pytest.approx(0.0, abs=1e-12)


def test_reasons_say_places_and_not_nodes(tmp_path: Path) -> None:
    material, ready, path = followed(tmp_path, ALONE)
    said = [
        "between nodes 0 and 6 the line is 0.05 m long",
        "it gives way most at node 12",
        "the line slid out of r with its node 0",
    ]
    path = replace(path, reasons=tuple(RodReason("taut", each, 1, 6) for each in said))
    assert [each.message for each in reasons_of(path, ready.line, material)] == [
        "between 0 mm and 50 mm from the start the line is 0.05 m long",
        "it gives way most at 100 mm from the start",
        "the line slid out of r with its end 0 mm from the start: put it further in, or move less",
    ]


@pytest.mark.parametrize(
    ("stiffness", "elements", "touched"), [(3, 12, ""), (3, 5, "bends"), (0.3, 5, "all")]
)
def test_elements_that_turn_far_are_too_long(
    tmp_path: Path, stiffness: float, elements: int, touched: str
) -> None:
    """A limp cantilever: where nothing is doubtful its bend radius is that of 200 elements."""
    text = ALONE.replace("bending_stiffness: 150", f"bending_stiffness: {stiffness}")

    def at(count: int) -> tuple[Laid, RodPath, float]:
        _, ready, path = followed(tmp_path, text.replace("elements: 12", f"elements: {count}"))
        return ready, path, by_name(path, ready)["smallest_bend_radius"].value

    ready, path, radius = at(elements)
    fine = at(200)[2]
    doubt = element_doubt(path, ready.line)
    assert (doubt is not None) is bool(touched)
    if doubt is None:
        assert radius == pytest.approx(fine, rel=0.01)
        return
    assert doubt.reason.code == "coarse_elements"
    assert doubtful_of(path, ready, doubt) >= {"smallest_bend_radius", "moment.bench"}
    assert ("lowest_point" in doubtful_of(path, ready, doubt)) is (touched == "all")
    while doubt is not None:
        elements = int(doubt.reason.message.split(": take ")[1].split()[0]) + 1
        ready, path, radius = at(elements)
        doubt = element_doubt(path, ready.line)
    assert elements < 60
    assert radius == pytest.approx(fine, rel=0.01)


def test_what_was_lost_in_a_jump_is_doubtful(tmp_path: Path) -> None:
    """1 of 4 J in a jump in step 2: what remembers is doubtful, and shape where it was let go."""
    _, ready, path = followed(tmp_path, ALONE)
    lost, fallen = np.array([1.0, 3.0, 4.0]), np.array([0.0, 0.0, 1.0])
    jumped = replace(path, snapped=(0, 2), lost=lost, lost_in_jumps=fallen)
    doubt = jump_doubt(jumped, ready)
    assert doubt is not None
    assert doubt.reason.code == "jumped"
    assert doubt.reason.message.startswith("step 2: the line jumped")
    assert "25 % of the energy" in doubt.reason.message
    memory = {"energy_lost", "kept_curvature", "moment.bench"}
    assert doubtful_of(jumped, ready, doubt) == memory
    assert jump_doubt(replace(jumped, lost_in_jumps=0.2 * fallen), ready) is None, "a twentieth"
    assert jump_doubt(replace(jumped, lost=0.0 * lost, lost_in_jumps=0.0 * lost), ready) is None, (
        "a law without memory"
    )
    _, ready, path = followed(tmp_path, RELEASED)
    let_go = jump_doubt(path, ready)
    shape = {"springback.gripper", "smallest_bend_radius", "lowest_point"}
    assert doubtful_of(path, ready, let_go) == memory | shape


@pytest.mark.slow
def test_a_line_that_buckles_loses_no_more_in_coarse_steps() -> None:
    """The example of slack: the end is pressed towards the start, so that it buckles at once."""
    file = EXAMPLES / "harness-slack.yaml"
    harness = load_harness(file)
    material = material_of(harness, file)
    found = []
    for steps in (10, 40, 160):
        finer = harness.model_copy(update={"steps": steps})
        ready = laid(finer, material.sections[0](material.best), material.best)
        path = follow(ready.line, ready.boundaries, steps=steps)
        assert path.status == "ok"
        assert jump_doubt(path, ready) is None
        numbers = by_name(path, ready)
        names = ("energy_lost", "moment.left", "moment.right", "kept_curvature")
        found.append([numbers[name].value for name in names])
    assert found[0] == pytest.approx(found[2], rel=0.02)
    assert found[1] == pytest.approx(found[2], rel=0.005)


def test_how_a_wire_unloads_is_an_assumption(tmp_path: Path) -> None:
    """Of a line let go its last shape hangs on it; the bench carries the weight in any case."""
    _, ready, path = followed(tmp_path, RELEASED)
    doubt = unloading_doubt(path, ready)
    assert doubt is not None
    assert doubt.reason.code == "unloading_assumed"
    memory = {"energy_lost", "kept_curvature", "springback.gripper"}
    shape = {"smallest_bend_radius", "lowest_point"}
    assert doubtful_of(path, ready, doubt) == memory | shape
    _, ready, path = followed(tmp_path, ALONE)
    assert unloading_doubt(path, ready) is None, "a spring"


def test_forces_hang_on_it_where_a_line_that_is_held_was_unbent() -> None:
    """In the example of slack the wire is bent elsewhere and more sharply on the way."""
    file = EXAMPLES / "harness-slack.yaml"
    harness = load_harness(file)
    material = material_of(harness, file)
    ready = laid(harness, material.sections[0](material.best), material.best)
    path = follow(ready.line, ready.boundaries, steps=harness.steps)
    held = {f"{what}.{side}" for what in ("force", "moment") for side in ("left", "right")}
    memory = {"energy_lost", "kept_curvature"}
    assert doubtful_of(path, ready, unloading_doubt(path, ready)) == memory | held
    first = replace(path, states=path.states[:1] + 40 * path.states[1:2])
    assert doubtful_of(path, ready, unloading_doubt(first, ready)) == memory, "not unbent yet"


def test_what_a_gripper_leaves(tmp_path: Path) -> None:
    _, ready, path = followed(tmp_path, RELEASED)
    numbers = by_name(path, ready)
    node = ready.nodes["gripper"]
    moved = np.linalg.norm(path.states[-1].positions[node] - path.states[8].positions[node])
    assert numbers["springback.gripper"].value == pytest.approx(moved)
    assert "from step 8, the last in which it was held" in numbers["springback.gripper"].remark
    assert numbers["force.gripper"].value == pytest.approx(0.0, abs=1e-9)
    assert numbers["energy_lost"].value > 0.0
    way, end = (numbers[f"smallest_bend_radius{word}"].value for word in ("_on_the_way", ""))
    assert way < 0.5 * end
    assert numbers["smallest_bend_radius_on_the_way"].remark.startswith("step ")
    assert "moment.gripper" not in numbers, "it may turn in the gripper"


def test_a_bend_that_is_let_go_is_kept_by_masings_rule(tmp_path: Path) -> None:
    """Without weight the line comes back to what the law says of where it was bent.

    On its way down it may bend behind the gripper, too, and remember that.
    """
    free = RELEASED + "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"
    _, ready, path = followed(tmp_path, free)
    law, held = ready.line.section.law, path.states[8]
    predicted = kept_curvature(held, law)
    bent = curvature_of(held, ready.line)
    was_bent = bent > 1.0
    left = curvature_of(path.last, ready.line)
    assert left[was_bent] == pytest.approx(predicted[was_bent], abs=0.02 * predicted.max())
    node = int(np.argmax(bent))
    first = np.geomspace(1e-4, 1.0, 20_000) * bent[node]
    moment = slider_moment(law, first)
    half = float(np.interp(0.5 * moment[-1], moment, first))
    assert predicted[node] == pytest.approx(bent[node] - 2.0 * half, abs=0.01 * bent[node])


def test_curvature_at_rest_counts_in_the_radius(tmp_path: Path) -> None:
    """A curled line that nothing bends is as round as its spool."""
    curl = "line: {length: 100 mm, elements: 12, spool: {curvature: 8 1/m}, section: "
    text = ALONE.replace("line: {length: 100 mm, elements: 12, section: ", curl)
    text += "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"
    _, ready, path = followed(tmp_path, text)
    assert curvature_of(path.last, ready.line)[1:-1] == pytest.approx(np.full(11, 8.0), rel=1e-6)
    assert sharpest(path, ready.line, [2]).radius == pytest.approx(1.0 / 8.0, rel=1e-6)


def test_a_straight_line_has_no_radius(tmp_path: Path) -> None:
    _, ready, path = followed(tmp_path, ALONE + "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    first, *_ = results_of(numbers_of(path, ready), (), {})
    assert (first.name, first.value, first.status) == (
        "smallest_bend_radius",
        None,
        Status.FAILED,
    )
    assert first.codes == ("straight",)
    assert radius_of(np.array([0.0, 2.0])).tolist() == [np.inf, 0.5]


def test_intervals_and_doubts_go_to_the_results() -> None:
    numbers = [Number("a", 1.0, "m"), Number("b", 2.0, "N", "there")]
    reason = Reason("why", "so")
    one, other = results_of(numbers, (reason,), {"b": Interval(1.0, 3.0, 0.95)})
    assert (one.interval, one.status, one.reasons) == (None, Status.DOUBTFUL, (reason,))
    assert (other.interval, other.remark) == (Interval(1.0, 3.0, 0.95), "there")


def test_beyond_what_backs_the_law(tmp_path: Path) -> None:
    material, ready, path = followed(tmp_path, arch())
    assert reasons_of(path, ready.line, material) == ()
    most = max(float(state.bendings.max()) for state in path.states)
    (reason,) = reasons_of(path, ready.line, replace(material, limit=0.5 * most))
    assert reason.code == "beyond_backed"
    words = f"the line is bent to {most:.4g} 1/m, its law is backed up to {most / 2:.4g} 1/m by "
    assert words in reason.message
    assert reason.message.startswith("step ")
    said = replace(path, reasons=(RodReason("beyond_law", "step 3: too far", 3),))
    (reason,) = reasons_of(said, ready.line, replace(material, limit=0.5 * most))
    assert (reason.code, reason.message) == ("beyond_law", "step 3: too far"), "said once"


def test_a_wire_that_is_pulled_beyond_its_copper(tmp_path: Path) -> None:
    """0.1 % of A2 is some 60 N: of seven strands 0.32 mm thick of 110 GPa."""
    loaded = ALONE.replace(
        "steps: 2",
        "  - {kind: load, name: pull, at: end, force: [100 N, 0 N, 0 N]}\nsteps: 2",
    )
    for text, codes in (
        (loaded.replace(STIFFNESS, "{wire: A2}"), ["beyond_stretch"]),
        (loaded.replace("100 N, ", "20 N, ").replace(STIFFNESS, "{wire: A2}"), []),
    ):
        material, ready, path = followed(tmp_path, text)
        assert [each.code for each in reasons_of(path, ready.line, material)] == codes


def test_nothing_was_reached(tmp_path: Path) -> None:
    material, ready, path = followed(tmp_path, ALONE)
    why = RodReason("no_equilibrium", "step 0: none", 0)
    nothing = replace(
        path,
        states=(),
        status="failed",
        reasons=(why,),
        snapped=(),
        **{name: np.zeros(0) for name in ENERGIES},
    )
    (reason,) = reasons_of(nothing, ready.line, material)
    assert reason.code == "no_equilibrium"


def test_the_allowed_radius_is_stated_or_assumed(tmp_path: Path) -> None:
    for more, radius, words in (
        ("", 0.01, "assumed: 5 times the outer diameter of 2 mm"),
        ("allowed_bend_radius: 25 mm\n", 0.025, "stated in the file"),
    ):
        file = written(tmp_path, arch(more=more))
        harness = load_harness(file)
        limit = bend_limit(harness, material_of(harness, file))
        assert limit.radius == pytest.approx(radius)
        assert (limit.words, limit.is_assumed) == (words, not more)
