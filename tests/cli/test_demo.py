from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.builders.pulls import broken, pull
from tests.builders.small_tests import Run, make_lab, small_scenario
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def quick_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two small tests and two pulls in place of the campaigns, which take a while."""

    def simulate(folder: Path) -> None:
        made = make_lab(folder.parent.parent / "made", small_scenario())
        for name in ("T1", "T2"):
            goal = folder / name
            goal.mkdir(parents=True)
            for path in made.raw.iterdir():
                text = path.read_bytes()
                if path.name == "test.yaml":
                    text = text.replace(b"test: T1", f"test: {name}".encode())
                (goal / path.name).write_bytes(text)

    def simulate_tensile(folder: Path) -> None:
        for seed, name in enumerate(("P-1", "P-2")):
            lab = TensileLab(folder.parent.parent / "pulls", name)
            travel, force = pull(slack=0.001, seed=seed)
            write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
            shutil.copytree(lab.raw, folder / name)

    small = {"wires": simulate, "tensile": simulate_tensile}
    monkeypatch.setattr("labpipe.cli.demo.CAMPAIGNS", small)


@pytest.mark.usefixtures("quick_campaign")
def test_processes_all_and_says_where(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--no-figures", "--jobs", 1)
    assert ran.status == 0
    assert "T1  (wire-cantilever): " in ran.out
    assert "T2  (wire-cantilever): " in ran.out
    for name in ("wires/T1", "wires/T2", "tensile/P-1", "tensile/P-2"):
        assert (tmp_path / "processed" / "demo" / name / "summary.json").is_file()
    assert ran.err.startswith("making a synthetic campaign in ")
    assert "figures to look at" not in ran.out


@pytest.mark.usefixtures("quick_campaign")
def test_the_first_of_each_kind_is_told_in_full_and_all_are_reported(
    run: Run, tmp_path: Path
) -> None:
    out = run("demo", tmp_path, "--no-figures", "--jobs", 1).out
    one, other = (out.index(f"{name}  (tensile): ") for name in ("P-1", "P-2"))
    assert "failure_displacement" in out[one:other]
    assert "failure_displacement" not in out[other : out.index("A2  (wire-cantilever): ")]
    assert "synthetic  (tensile): 2 samples from 1 spool\n" in out
    page = tmp_path / "processed" / "demo" / "report" / "report.html"
    assert "Synthetic demo campaign" in page.read_text(encoding="utf-8")
    assert "report.html" in out


@pytest.mark.usefixtures("quick_campaign")
def test_names_the_figures(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def one(result: object, folder: Path) -> list[Path]:
        folder.mkdir()
        drawn = [folder / "timeline.svg", folder / "timeline.png"]
        for path in drawn:
            path.write_text("drawn", encoding="utf-8")
        return drawn

    monkeypatch.setattr("labpipe.report.figures.save_figures", one)
    ran = run("demo", tmp_path, "--jobs", 1)
    folder = tmp_path / "processed" / "demo"
    _, _, told = ran.out.partition(
        "\nfigures to look at, of the first test of each kind and of the calibration:\n"
    )
    names = [line.strip().rpartition("/")[2] for line in told.splitlines()]
    assert names[:3] == ["timeline.png", "timeline.png", "calibration.png"]
    assert (folder / "wires" / "T1" / "figures" / "timeline.png").is_file()
    assert not (folder / "wires" / "T2" / "figures").exists()
    for name in ("P-1", "T1"):
        assert str(Path(name) / "figures" / "timeline.png") in told


@pytest.mark.slow
def test_the_whole_demo(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--jobs", 1)
    assert ran.status == 0
    assert ran.out.count("wire-shapes.png") == 1
    assert len(list((tmp_path / "raw" / "demo").iterdir())) == 24
    page = tmp_path / "processed" / "demo" / "report" / "report.html"
    assert page.stat().st_size < 1_000_000
