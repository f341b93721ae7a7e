from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from scipy.stats import rice

from labpipe.errors import LabpipeError, ProcessingError
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import Inputs, prepare_line, read_material
from labpipe.mechanics.studies.harness_solution import (
    HarnessBands,
    HarnessSolution,
    predict_bands,
    solve_harness,
    solve_sweep,
)
from labpipe.mechanics.studies.harness_study import (
    build_drawn_harness,
    build_drawn_sweep,
    build_json,
    follow_harness,
)
from labpipe.protocol.load import load_harness
from labpipe.records.result import Status
from tests.builders.harness_files import STIFFNESS, arch, pushed, written

FILES = {"shape.csv", "forces.csv", "shape.vtk", "line.mujoco.xml", "summary.json"}


SWEEP = "sweep: {length: [190 mm, 200 mm, 240 mm]}\n"


TORN = """\
  - kind: grip
    name: puller
    at: 1 mm
    holds: pose
    path: [{step: 6, position: [0.99 mm, 0 mm, -0.1 mm], direction: [-1, 0, 0]}]
"""


TEN_PERCENT = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")


def names(folder: Path) -> set[str]:
    return set(contents(folder))


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.slow
def test_all_files_are_written_and_say_the_same(tmp_path: Path) -> None:
    """The same file gives the same bytes."""
    out, second = tmp_path / "out", tmp_path / "again"
    file = written(tmp_path, pushed())
    run = follow_harness(file, out=out, png=True)
    assert run.status is Status.OK
    assert names(out) == FILES | {"figures/harness.svg", "figures/harness.png"}
    assert {path.relative_to(out).as_posix() for path in run.files} == names(out)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary == json.loads(json.dumps(build_json(run)))
    assert (summary["schema"], summary["harness"], summary["status"]) == (1, "line", "ok")
    assert [source["role"] for source in summary["inputs"]] == ["harness", "wires"]
    values = {result["name"]: result["value"] for result in summary["results"]}
    assert values["springback.gripper"] > 0.01
    assert summary["line"]["of"] == "A2"
    assert summary["bend_radius"]["assumed"]
    assert summary["bend_radius"]["kept"]
    assert len((out / "shape.csv").read_text().splitlines()) == 1 + 2 * len(run.path.line.stations)
    assert ET.fromstring((out / "line.mujoco.xml").read_text(encoding="utf-8")).tag == "mujoco"
    follow_harness(file, out=second, png=True)
    assert contents(second) == contents(out)


@pytest.mark.slow
def test_a_sweep_shows_each_length(tmp_path: Path) -> None:
    out = tmp_path / "out"
    base = follow_harness(written(tmp_path, arch(more=SWEEP)), out=out, png=True)
    assert names(out) >= {"sweep.csv", "figures/harness-sweep.svg", "figures/harness-sweep.png"}
    radii = [run.final_sharpest_bend.radius for run in base.sweep]
    assert radii[0] > radii[1] > radii[2], "more slack, a sharper bend"
    assert radii[1] == pytest.approx(base.results[0].value)
    lines = (out / "sweep.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["0.19", "0.2", "0.24"]
    without = follow_harness(written(tmp_path, arch()), out=out, figures=True)
    assert without.sweep == ()
    assert names(out) == FILES | {"figures/harness.svg"}, "what would speak for another run is gone"


@pytest.mark.slow
def test_bands_go_to_the_files(tmp_path: Path) -> None:
    out, more = tmp_path / "out", SWEEP + "allowed_bend_radius: 200 mm\n"
    done = follow_harness(written(tmp_path, arch(TEN_PERCENT, more=more)), out=out)
    assert done.bands is not None
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    force = next(result for result in summary["results"] if result["name"] == "force.left")
    assert force["lower"] < force["value"] < force["upper"]
    assert summary["bands"]["shares"]["reaction_forces"] == {"stiffness as stated": 1.0}
    assert all(length["upper"] > length["lower"] for length in summary["sweep"])
    for file, row, name, unit in (("shape", 8, "z", "m"), ("forces", -2, "fx", "N")):
        table = list(csv.DictReader(StringIO((out / f"{file}.csv").read_text())))
        low, value, high = (
            float(table[row][f"{name}{side} [{unit}]"]) for side in ("_lower", "", "_upper")
        )
        assert low < value < high
    bend = summary["bend_radius"]
    assert (bend["allowed"], bend["assumed"], bend["kept"]) == (0.2, False, False)
    assert bend["smallest"] == pytest.approx(done.sharpest_bend.radius)


@pytest.mark.slow
def test_a_failed_run_leaves_earlier_results(tmp_path: Path) -> None:
    """Two clips at the line's whole length, and a grip that pulls it aside: nothing gives."""
    out = tmp_path / "out"
    follow_harness(written(tmp_path, arch()), out=out)
    before = contents(out)
    for wrong in (
        arch().replace("180 mm", "280 mm"),
        arch().replace("200 mm", "200"),
        arch("{wire: A22}"),
        arch("{sliders: none.json, diameter: 2 mm}"),
    ):
        with pytest.raises(LabpipeError):
            follow_harness(written(tmp_path, wrong), out=out)
    assert contents(out) == before
    torn = arch().replace("steps: 8", f"{TORN}steps: 8")
    torn = torn.replace("[180 mm, 0 mm, 30 mm]", "[198 mm, 0 mm, 0 mm]")
    failed = follow_harness(written(tmp_path, torn), out=out)
    assert failed.status is Status.FAILED
    assert (failed.results, failed.files) == ((), ())
    after = contents(out)
    failure = json.loads(after.pop("failure.json"))
    assert after == before
    assert failure["code"] == failed.reasons[0].code
    assert failure["reason"].startswith("step ")
    assert failure["reached"]["step"] == len(failed.path.states) - 1
    follow_harness(written(tmp_path, arch()), out=out)
    assert "failure.json" not in names(out)


def test_results_go_beside_other_results_unless_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = follow_harness(written(tmp_path, arch(steps=4)), figures=False)
    assert done.folder == Path("processed/harness/line")
    assert names(tmp_path / done.folder) == FILES
    assert build_drawn_sweep(done) is None
    (shape,) = build_drawn_harness(done).shapes
    assert (shape.band, shape.radius_band) == (None, None)


def run(folder: Path, text: str, limit: float | None = None) -> HarnessSolution:
    file = written(folder, text)
    harness = load_harness(file)
    material = read_material(harness, file)
    material = material if limit is None else replace(material, curvature_limit=limit)
    return solve_harness(harness, file, material, folder / "out")


@pytest.mark.slow
def test_a_line_within_its_law_is_ok(tmp_path: Path) -> None:
    result = run(tmp_path, arch(more="show: [6, 2, 8]\n"))
    assert (result.status, result.reasons, result.bands) == (Status.OK, (), None)
    assert result.steps == (2, 6, 8)
    assert {number.status for number in result.results if number.value is not None} == {Status.OK}
    assert result.results[0].value is not None
    assert result.sharpest_bend.radius <= result.results[0].value
    assert not (tmp_path / "out").exists(), "nothing is written here"
    (longer,) = solve_sweep(result, [0.25])
    assert longer.path.line.length == pytest.approx(0.25)
    assert (longer.harness.line.length, longer.bands) == (0.25, None)
    assert longer.sharpest_bend.radius <= longer.final_sharpest_bend.radius
    assert longer.final_sharpest_bend.step == 8
    failed = replace(longer, path=replace(longer.path, status=Status.FAILED))
    assert math.isnan(failed.final_sharpest_bend.radius)
    assert math.isnan(failed.sharpest_bend.radius)


@pytest.mark.slow
def test_one_beyond_its_law_is_doubtful_with_all_its_numbers(tmp_path: Path) -> None:
    for text, limit, code in (
        (arch(TEN_PERCENT), 2.0, "beyond_backed"),
        (arch(STIFFNESS.replace("80 1/m", "5 1/m")), None, "beyond_law"),
    ):
        result = run(tmp_path, text, limit=limit)
        assert result.status is Status.DOUBTFUL
        assert [reason.code for reason in result.reasons] == [code], "once"
        assert (result.bands is None) is (text != arch(TEN_PERCENT))
        numbers = {number.status for number in result.results if number.value is not None}
        assert numbers == {Status.DOUBTFUL}
    coarse = arch().replace("elements: 16", "elements: 6").replace("180 mm, 0 mm", "90 mm, 30 mm")
    result = run(tmp_path, coarse)
    radius, (length,) = result.results[0], solve_sweep(result, [result.path.line.length])
    assert radius.status is Status.DOUBTFUL
    assert length.status is Status.DOUBTFUL, "a length of a sweep has all doubts of its numbers"
    codes = {reason.code for reason in length.reasons}
    assert {reason.code for reason in radius.reasons} <= codes


def test_what_is_nothing_but_rounding_is_no_doubt(tmp_path: Path) -> None:
    """A curl without weight, held at one end: its moment is what the solver leaves."""
    text = pushed(STIFFNESS).partition("  - kind: grip")[0]
    text = text.replace(f"{STIFFNESS}}}", f"{STIFFNESS}, spool: {{curvature: 1 1/m}}}}")
    result = run(tmp_path, f"{text}steps: 2\ngravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n")
    (moment,) = (number for number in result.results if number.name == "moment.bench")
    assert moment.value == pytest.approx(0.0, abs=1e-9)
    assert moment.value != 0.0
    assert {number.status for number in result.results} == {Status.OK}


def test_a_line_that_cannot_be_laid_is_bad_input(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 5 1/m, towards: [2, 0, 0]}\n"
    message = "line: expected a line that fits its boundaries, found one that does not: towards="
    with pytest.raises(ProcessingError, match=re.escape(message)):
        run(tmp_path, arch(line=curl))


def test_a_line_limp_beyond_numbers_fails_without_a_warning(tmp_path: Path) -> None:
    """Warnings are errors here."""
    text = BARE.replace("12000 N*mm^2", "1e-300 N*mm^2").replace("elements: 12", "elements: 40")
    result = run(tmp_path, f"{text}steps: 20\n".replace(", spread: 1 1/m", ""))
    assert result.status is Status.FAILED


NO_WEIGHT = "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"


def bands(
    folder: Path, section: str, more: str = "", *, text: str = ""
) -> tuple[HarnessBands | None, int]:
    file = written(folder, text or arch(section, more=more))
    harness = load_harness(file)
    material = read_material(harness, file)
    count = 0

    def follow_line(number: int, inputs: Inputs) -> RodPath:
        nonlocal count
        count += 1
        prepared = prepare_line(harness, material.sections[number](inputs), inputs)
        return follow(*prepared, steps=harness.steps)

    return predict_bands(follow_line, material, (4, 8)), count


@pytest.mark.slow
def test_without_weight_forces_go_with_the_stiffness_and_shapes_do_not(tmp_path: Path) -> None:
    """A line of one stiffness between clips: forces are 10 % off, the shape next to nothing.

    What is left is the twist of an arch that leaves its plane: it goes by EI / GJ.
    """
    result, count = bands(tmp_path, TEN_PERCENT, NO_WEIGHT)
    assert result is not None
    names = {"smallest_bend_radius", "smallest_bend_radius_on_the_way", "lowest_point"}
    assert set(result.intervals) >= names | {"force.left", "moment.right", "kept_curvature"}
    bend_on_path = result.intervals["smallest_bend_radius_on_the_way"]
    assert 0.0 < bend_on_path.lower <= bend_on_path.upper
    assert count == 3, "at its best and to both sides, each once"
    assert [state.step for state in result.line.states] == [4, 8]
    radius = result.intervals["smallest_bend_radius"]
    assert radius.upper == pytest.approx(radius.lower, rel=0.01)
    force = result.intervals["force.left"]
    assert force.upper / force.lower == pytest.approx(1.22 / 0.82, rel=0.03)
    assert force.lower > 0.0
    places = result.line.states[1].positions
    assert places.upper == pytest.approx(places.lower, abs=5e-4)


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


SWUNG = """\
  - kind: grip
    name: right
    at: end
    holds: position
    path:
      - {step: 4, position: [285 mm, 0 mm, 60 mm]}
      - {step: 8, position: [290 mm, 0 mm, 0 mm]}
"""


def test_a_curl_in_two_directions_has_the_band_of_its_size(tmp_path: Path) -> None:
    """Without weight the curvature is |(k + a, b)|, a and b normal: Rice's distribution."""
    result, _ = bands(tmp_path, "", text=f"{BARE}steps: 8\n{NO_WEIGHT}")
    assert result is not None
    low, high = (float(rice.ppf(share, 0.02)) for share in (0.025, 0.975))
    for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way"):
        interval = result.intervals[name]
        assert 1.0 / interval.lower == pytest.approx(high, rel=0.03)
        assert 1.0 / interval.upper == pytest.approx(min(low, 0.02), rel=0.05)
    assert result.intervals["lowest_point"].upper <= 0.0, "its begin is held there"
    assert result.doubt is None


@pytest.mark.slow
def test_causes_that_do_not_add_up_are_said(tmp_path: Path) -> None:
    result, count = bands(tmp_path, "", text=f"{BARE}{SWUNG}steps: 8\n")
    assert result is not None
    assert count == 5 + 6, "six draws are solved whole"
    assert result.doubt is not None
    assert result.doubt.code == "causes_do_not_add"
    last, bend_on_path = (
        result.intervals[name]
        for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way")
    )
    assert bend_on_path.lower <= last.lower
    assert bend_on_path.upper <= last.upper


def test_nothing_believed_no_bands(tmp_path: Path) -> None:
    assert bands(tmp_path, STIFFNESS) == (None, 0)
