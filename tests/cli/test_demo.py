from __future__ import annotations

from pathlib import Path

import pytest

from tests.builders.small_tests import Run, make_lab, small_scenario


@pytest.fixture
def quick_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two small tests in place of the campaign, which takes a while."""

    def simulate(folder: Path, *, samples: int) -> None:
        assert samples == 3
        made = make_lab(folder.parent.parent / "made", small_scenario())
        for name in ("T1", "T2"):
            goal = folder / name
            goal.mkdir(parents=True)
            for path in made.raw.iterdir():
                text = path.read_bytes()
                if path.name == "test.yaml":
                    text = text.replace(b"test: T1", f"test: {name}".encode())
                (goal / path.name).write_bytes(text)

    monkeypatch.setattr("labpipe.cli.demo.simulate_campaign", simulate)


@pytest.mark.usefixtures("quick_campaign")
def test_processes_all_and_says_where(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--no-figures")
    assert ran.status == 0
    assert "T1  (wire-cantilever): " in ran.out
    assert "T2  (wire-cantilever): " in ran.out
    for name in ("T1", "T2"):
        assert (tmp_path / "processed" / "demo" / name / "summary.json").is_file()
    assert ran.err.startswith("making a synthetic campaign of 3 tests in ")
    assert "figures to look at" not in ran.out


@pytest.mark.usefixtures("quick_campaign")
def test_names_the_figures(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def one(result: object, folder: Path) -> list[Path]:
        folder.mkdir()
        drawn = [folder / "timeline.svg", folder / "timeline.png"]
        for path in drawn:
            path.write_text("drawn", encoding="utf-8")
        return drawn

    monkeypatch.setattr("labpipe.report.figures.save_figures", one)
    ran = run("demo", tmp_path)
    where = tmp_path / "processed" / "demo" / "T2" / "figures" / "timeline.png"
    assert "\nfigures to look at:\n" in ran.out
    assert f"  {where}\n" in ran.out
    assert where.is_file()


@pytest.mark.slow
def test_the_whole_demo(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path)
    assert ran.status == 0
    assert ran.out.count("wire-shapes.png") == 3
    assert len(list((tmp_path / "raw" / "demo").iterdir())) == 3
