from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.stats import rice

from labpipe.errors import LabpipeError, ProcessingError
from labpipe.protocol.load import load_harness
from labpipe.records.result import Status
from labpipe.rod.statics import follow
from labpipe.studies.harness_bands import HarnessBands, harness_bands
from labpipe.studies.harness_line import Inputs, laid
from labpipe.studies.harness_section import material_of
from labpipe.studies.harness_solution import FollowedHarness, followed, shown_steps, swept
from labpipe.studies.harness_study import as_json, follow_harness
from tests.builders.harness_files import STIFFNESS, arch, pushed, written

FILES = {"shape.csv", "forces.csv", "shape.vtk", "line.mujoco.xml", "summary.json"}


SWEEP = "sweep: {length: [190 mm, 200 mm, 240 mm]}\n"


TORN = """\
  - kind: grip
    name: puller
    at: 100 mm
    holds: position
    path: [{step: 2, position: [98 mm, 0 mm, 10 mm]}, {step: 6, position: [98 mm, 0 mm, -10 mm]}]
"""


def names(folder: Path) -> set[str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix() for path in files}


@pytest.mark.slow
def test_all_files_are_written_and_say_the_same(tmp_path: Path) -> None:
    out = tmp_path / "out"
    file = written(tmp_path, pushed())
    done = follow_harness(file, out=out, png=True)
    assert done.status is Status.OK
    assert names(out) == FILES | {"figures/harness.svg", "figures/harness.png"}
    assert {path.relative_to(out).as_posix() for path in done.files} == names(out)
    said = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert said == json.loads(json.dumps(as_json(done)))
    assert (said["schema"], said["harness"], said["status"]) == (1, "line", "ok")
    assert [sentence["role"] for sentence in said["inputs"]] == ["harness", "wires"]
    values = {sentence["name"]: sentence["value"] for sentence in said["results"]}
    assert values["springback.gripper"] > 0.01
    assert said["line"]["of"] == "A2"
    assert said["bend_radius"]["assumed"]
    assert said["bend_radius"]["kept"]
    assert len((out / "shape.csv").read_text().splitlines()) == 1 + 2 * len(done.laid.line.stations)
    assert ET.fromstring((out / "line.mujoco.xml").read_text(encoding="utf-8")).tag == "mujoco"


@pytest.mark.slow
def test_the_same_file_gives_the_same_bytes(tmp_path: Path) -> None:
    file = written(tmp_path, arch())
    for name in ("one", "other"):
        follow_harness(file, out=tmp_path / name)
    one, other = (
        {name: (tmp_path / folder / name).read_bytes() for name in names(tmp_path / folder)}
        for folder in ("one", "other")
    )
    assert one == other


@pytest.mark.slow
def test_a_sweep_shows_each_length(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = follow_harness(written(tmp_path, arch(more=SWEEP)), out=out, png=True)
    assert names(out) >= {"sweep.csv", "figures/harness-sweep.svg", "figures/harness-sweep.png"}
    radii = [run.bend.radius for run in done.sweep]
    assert radii[0] > radii[1] > radii[2], "more slack, a sharper bend"
    assert radii[1] == pytest.approx(done.results[0].value)
    lines = (out / "sweep.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["0.19", "0.2", "0.24"]
    without = follow_harness(written(tmp_path, arch()), out=out, figures=True)
    assert without.sweep == ()
    assert names(out) == FILES | {"figures/harness.svg"}, "what would speak for another run is gone"


@pytest.mark.slow
def test_bands_go_to_the_files(tmp_path: Path) -> None:
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    done = follow_harness(written(tmp_path, arch(section, more=SWEEP)), out=tmp_path / "out")
    assert done.bands is not None
    said = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    force = next(sentence for sentence in said["results"] if sentence["name"] == "force.left")
    assert force["lower"] < force["value"] < force["upper"]
    head, *rows = (tmp_path / "out" / "shape.csv").read_text().splitlines()
    assert head.endswith("curvature_lower [1/m],curvature_upper [1/m]")
    cells = dict(zip(head.split(","), rows[8].split(","), strict=True))
    assert float(cells["z_lower [m]"]) < float(cells["z [m]"]) < float(cells["z_upper [m]"])
    head, *rows = (tmp_path / "out" / "forces.csv").read_text().splitlines()
    cells = dict(zip(head.split(","), rows[-2].split(","), strict=True))
    assert float(cells["fx_lower [N]"]) < float(cells["fx [N]"]) < float(cells["fx_upper [N]"])
    assert said["bands"]["shares"]["reaction_forces"] == {"stiffness as stated": 1.0}
    assert all(sentence["upper"] > sentence["lower"] for sentence in said["sweep"])


@pytest.mark.slow
def test_a_failed_run_leaves_earlier_results(tmp_path: Path) -> None:
    """Two clips at the line's whole length, and a grip that pulls it aside: nothing gives."""
    out = tmp_path / "out"
    follow_harness(written(tmp_path, arch()), out=out)
    before = {name: (out / name).read_bytes() for name in names(out)}
    torn = arch().replace("steps: 8", f"{TORN}steps: 8")
    torn = torn.replace("[180 mm, 0 mm, 30 mm]", "[198 mm, 0 mm, 0 mm]")
    torn = torn.replace("{step: 2, position: [98 mm, 0 mm, 10 mm]}, ", "")
    torn = torn.replace("at: 100 mm", "at: 1 mm").replace("98 mm, 0 mm, -10", "0.99 mm, 0 mm, -0.1")
    torn = torn.replace("holds: position", "holds: pose")
    torn = torn.replace("-0.1 mm]}", "-0.1 mm], direction: [-1, 0, 0]}")
    failed = follow_harness(written(tmp_path, torn), out=out)
    assert failed.status is Status.FAILED
    assert (failed.results, failed.files) == ((), ())
    assert {name: (out / name).read_bytes() for name in before} == before
    assert names(out) - set(before) == {"failure.json"}
    said = json.loads((out / "failure.json").read_text(encoding="utf-8"))
    assert said["code"] == failed.reasons[0].code
    assert said["reason"].startswith("step ")
    assert said["reached"]["step"] == len(failed.path.states) - 1
    follow_harness(written(tmp_path, arch()), out=out)
    assert "failure.json" not in names(out)


@pytest.mark.slow
def test_a_faulty_file_leaves_earlier_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    follow_harness(written(tmp_path, arch()), out=out)
    before = {name: (out / name).read_bytes() for name in names(out)}
    for wrong in (
        arch().replace("180 mm", "280 mm"),
        arch().replace("200 mm", "200"),
        arch("{wire: A22}"),
        arch("{sliders: none.json, diameter: 2 mm}"),
    ):
        with pytest.raises(LabpipeError):
            follow_harness(written(tmp_path, wrong), out=out)
    assert {name: (out / name).read_bytes() for name in names(out)} == before


def test_results_go_beside_other_results_unless_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = follow_harness(written(tmp_path, arch()), figures=False)
    assert done.folder == Path("processed/harness/line")
    assert names(tmp_path / done.folder) == FILES


@pytest.mark.slow
def test_too_sharp_is_said(tmp_path: Path) -> None:
    done = follow_harness(
        written(tmp_path, arch(more="allowed_bend_radius: 200 mm\n")), out=tmp_path / "out"
    )
    said = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert not said["bend_radius"]["kept"]
    assert said["bend_radius"]["smallest"] == pytest.approx(done.sharpest.radius)
    assert (said["bend_radius"]["allowed"], said["bend_radius"]["assumed"]) == (0.2, False)


def run(folder: Path, text: str, limit: float | None = None) -> FollowedHarness:
    file = written(folder, text)
    harness = load_harness(file)
    material = material_of(harness, file)
    material = material if limit is None else replace(material, limit=limit)
    return followed(harness, file, material, folder / "out")


@pytest.mark.slow
def test_a_line_within_its_law_is_ok(tmp_path: Path) -> None:
    found = run(tmp_path, arch())
    assert (found.status, found.reasons, found.bands) == (Status.OK, (), None)
    assert found.steps == (8,)
    assert {result.status for result in found.results if result.value is not None} == {Status.OK}
    assert found.sharpest.radius <= found.results[0].value  # type: ignore[operator]
    assert not (tmp_path / "out").exists(), "nothing is written here"


@pytest.mark.slow
def test_one_beyond_it_is_doubtful_with_all_its_numbers(tmp_path: Path) -> None:
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    for text in (arch(), arch(section)):
        found = run(tmp_path, text, limit=2.0)
        assert found.status is Status.DOUBTFUL
        assert [reason.code for reason in found.reasons] == ["beyond_backed"], "said once"
        assert {result.status for result in found.results} == {Status.DOUBTFUL}
    assert found.bands is not None


@pytest.mark.slow
def test_one_beyond_the_range_of_its_law_says_so(tmp_path: Path) -> None:
    found = run(tmp_path, arch(STIFFNESS.replace("80 1/m", "5 1/m")))
    assert found.status is Status.DOUBTFUL
    assert [reason.code for reason in found.reasons] == ["beyond_law"]
    assert "step" in found.reasons[0].message


@pytest.mark.slow
def test_steps_and_lengths(tmp_path: Path) -> None:
    file = written(tmp_path, arch(more="show: [6, 2, 8]\n"))
    harness = load_harness(file)
    assert shown_steps(harness) == (2, 6, 8)
    material = material_of(harness, file)
    longer = swept(followed(harness, file, material, tmp_path), 0.25)
    assert longer.laid.line.length == pytest.approx(0.25)
    assert (longer.length, longer.bands) == (0.25, None)
    assert longer.way.radius <= longer.bend.radius
    assert longer.bend.step == 8


def test_what_is_nothing_but_rounding_is_no_doubt(tmp_path: Path) -> None:
    """A curl without weight, held at one end: its moment is what the solver leaves."""
    text = pushed(STIFFNESS).partition("  - kind: grip")[0]
    text = text.replace(f"{STIFFNESS}}}", f"{STIFFNESS}, spool: {{curvature: 1 1/m}}}}")
    found = run(tmp_path, f"{text}steps: 2\ngravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    (moment,) = (result for result in found.results if result.name == "moment.bench")
    assert moment.value == pytest.approx(0.0, abs=1e-9)
    assert moment.value != 0.0
    assert {result.status for result in found.results} == {Status.OK}


@pytest.mark.slow
def test_a_length_of_a_sweep_has_all_doubts_of_its_numbers(tmp_path: Path) -> None:
    """Six elements are too few for a line that is brought far round."""
    text = arch().replace("elements: 16", "elements: 6").replace("180 mm, 0 mm", "90 mm, 30 mm")
    file = written(tmp_path, text)
    harness = load_harness(file)
    material = material_of(harness, file)
    radius = run(tmp_path, text).results[0]
    one = swept(followed(harness, file, material, tmp_path), harness.line.length)
    assert radius.status is Status.DOUBTFUL
    assert one.status == "doubtful"
    assert {reason.code for reason in radius.reasons} <= {reason.code for reason in one.reasons}


@pytest.mark.slow
def test_loads_are_told_in_every_step(tmp_path: Path) -> None:
    """All that acts on a line, its weight included, is in balance."""
    push = "  - {kind: load, name: push, at: 55 mm, force: [0 N, 10 mN, -20 mN], by: 4}\nsteps:"
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    found = run(tmp_path, arch(section).replace("steps:", push))
    weight = 0.007 * 0.2 * 9.80665
    for step, state in enumerate(found.path.states):
        share = min(1.0, step / 4)
        assert state.reaction_forces[2] == pytest.approx(share * np.array([0.0, 0.01, -0.02]))
    assert found.path.last.reaction_forces.sum(axis=0) == pytest.approx((0, 0, weight), abs=1e-9)
    assert found.bands is not None
    band = found.bands.line.states[-1].reaction_forces
    assert band.lower[2] == pytest.approx([0.0, 0.01, -0.02])
    assert band.upper[2] == pytest.approx([0.0, 0.01, -0.02])


@pytest.mark.slow
def test_a_length_that_failed_has_no_numbers(tmp_path: Path) -> None:
    file = written(tmp_path, arch())
    harness = load_harness(file)
    one = swept(followed(harness, file, material_of(harness, file), tmp_path), 0.25)
    failed = replace(one, path=replace(one.path, status="failed"))
    assert math.isnan(failed.bend.radius)
    assert math.isnan(failed.way.radius)


def test_a_line_that_cannot_be_laid_is_bad_input(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [2, 0, 0]}\n"
    message = "line: expected a line that can be laid as its boundaries say, found this: towards="
    with pytest.raises(ProcessingError, match=re.escape(message)):
        run(tmp_path, arch(line=curl))


def test_a_line_limp_beyond_numbers_fails_without_a_warning(tmp_path: Path) -> None:
    """Warnings are errors here."""
    assert run(tmp_path, LIMP).status is Status.FAILED


LIMP = """\
version: 1
about: limp
line:
  length: 300 mm
  elements: 40
  section: {bending_stiffness: 1e-300 N*mm^2, torsional_stiffness: 8000 N*mm^2,
      largest_curvature: 200 1/m, diameter: 5.8 mm, mass_per_length: 55 g/m}
boundaries:
- kind: clip
  name: left
  at: start
  position: [0 mm, 0 mm, 0 mm]
  direction: [1, 0, 0]
steps: 20
"""


TEN_PERCENT = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")


NO_WEIGHT = "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"


def bands(
    folder: Path, section: str, more: str = "", *, text: str = ""
) -> tuple[HarnessBands | None, int]:
    file = written(folder, text or arch(section, more=more))
    harness = load_harness(file)
    material = material_of(harness, file)
    count = 0

    def follow_line(number: int, inputs: Inputs):  # type: ignore[no-untyped-def]
        nonlocal count
        count += 1
        ready = laid(harness, material.sections[number](inputs), inputs)
        return follow(ready.line, ready.boundaries, steps=harness.steps), ready

    return harness_bands(follow_line, material, (4, 8)), count


@pytest.mark.slow
def test_without_weight_forces_go_with_the_stiffness_and_shapes_do_not(tmp_path: Path) -> None:
    """A line of one stiffness between clips: forces are 10 % off, the shape next to nothing.

    What is left is the twist of an arch that leaves its plane: it goes by EI / GJ.
    """
    found, count = bands(tmp_path, TEN_PERCENT, NO_WEIGHT)
    assert found is not None
    assert count == 3, "at its best and to both sides, each once"
    assert [state.step for state in found.line.states] == [4, 8]
    radius = found.intervals["smallest_bend_radius"]
    assert radius.upper == pytest.approx(radius.lower, rel=0.01)
    force = found.intervals["force.left"]
    assert force.upper / force.lower == pytest.approx(1.22 / 0.82, rel=0.03)
    assert force.lower > 0.0
    places = found.line.states[1].positions
    assert places.upper == pytest.approx(places.lower, abs=5e-4)


@pytest.mark.slow
def test_numbers_lie_in_their_own_intervals(tmp_path: Path) -> None:
    found, _ = bands(tmp_path, TEN_PERCENT)
    assert found is not None
    assert set(found.intervals) >= {
        *("smallest_bend_radius", "smallest_bend_radius_on_the_way", "lowest_point"),
        *("force.left", "moment.right", "kept_curvature"),
    }
    way = found.intervals["smallest_bend_radius_on_the_way"]
    assert 0.0 < way.lower <= way.upper
    lowest = found.intervals["lowest_point"]
    assert lowest.lower < lowest.upper


BARE = """\
version: 1
line:
  length: 300 mm
  elements: 12
  section: {bending_stiffness: 12000 N*mm^2, torsional_stiffness: 8000 N*mm^2,
    largest_curvature: 200 1/m, diameter: 5.8 mm, mass_per_length: 55 g/m}
  spool: {curvature: 0.02 1/m, spread: 1 1/m}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
"""


"""A line that is nearly straight, as it comes from its spool."""


SWUNG = """\
  - kind: grip
    name: right
    at: end
    holds: position
    path:
      - {step: 4, position: [285 mm, 0 mm, 60 mm]}
      - {step: 8, position: [290 mm, 0 mm, 0 mm]}
"""


"""A grip that lets a bow swing out of its plane."""


def test_a_curl_in_two_directions_has_the_band_of_its_size(tmp_path: Path) -> None:
    """Without weight the curvature is |(k + a, b)|, a and b normal: Rice's distribution."""
    found, _ = bands(tmp_path, "", text=f"{BARE}steps: 8\n{NO_WEIGHT}")
    assert found is not None
    low, high = (float(rice.ppf(share, 0.02)) for share in (0.025, 0.975))
    for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way"):
        interval = found.intervals[name]
        assert 1.0 / interval.lower == pytest.approx(high, rel=0.03)
        assert 1.0 / interval.upper == pytest.approx(min(low, 0.02), rel=0.05)
    assert found.intervals["lowest_point"].upper <= 0.0, "its begin is held there"
    assert found.doubt is None


@pytest.mark.slow
def test_causes_that_do_not_add_up_are_said(tmp_path: Path) -> None:
    found, count = bands(tmp_path, "", text=f"{BARE}{SWUNG}steps: 8\n")
    assert found is not None
    assert count == 5 + 6, "six draws are solved whole"
    assert found.doubt is not None
    assert found.doubt.code == "causes_do_not_add"
    last, way = (
        found.intervals[name]
        for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way")
    )
    assert way.lower <= last.lower
    assert way.upper <= last.upper


def test_nothing_believed_no_bands(tmp_path: Path) -> None:
    assert bands(tmp_path, STIFFNESS) == (None, 0)
