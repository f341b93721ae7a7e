"""From a harness YAML to files: what is written, and what is not when it fails."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from labpipe.errors import LabpipeError
from labpipe.records.result import Status
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
    assert [each["role"] for each in said["inputs"]] == ["harness", "wires"]
    values = {each["name"]: each["value"] for each in said["results"]}
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
    radii = [each.bend.radius for each in done.sweep]
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
    force = next(each for each in said["results"] if each["name"] == "force.left")
    assert force["lower"] < force["value"] < force["upper"]
    head, *rows = (tmp_path / "out" / "shape.csv").read_text().splitlines()
    assert head.endswith("curvature_lower [1/m],curvature_upper [1/m]")
    cells = dict(zip(head.split(","), rows[8].split(","), strict=True))
    assert float(cells["z_lower [m]"]) < float(cells["z [m]"]) < float(cells["z_upper [m]"])
    head, *rows = (tmp_path / "out" / "forces.csv").read_text().splitlines()
    cells = dict(zip(head.split(","), rows[-2].split(","), strict=True))
    assert float(cells["fx_lower [N]"]) < float(cells["fx [N]"]) < float(cells["fx_upper [N]"])
    assert said["bands"]["shares"]["reaction_forces"] == {"stiffness as stated": 1.0}
    assert all(each["upper"] > each["lower"] for each in said["sweep"])


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
