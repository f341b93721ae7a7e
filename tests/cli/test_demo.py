from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.cli.demo import CALIBRATED_WORDS, CAMPAIGNS, FIRST_LOOK, SHEET_WORDS
from labpipe.virtual_lab import Campaign
from labpipe.virtual_lab.sheet_texts import protocol_of
from tests.builders.harness_files import EXAMPLES, pushed, written
from tests.builders.pulls import broken, pull
from tests.builders.small_tests import Run, make_lab, small_scenario
from tests.builders.tensile_tests import TensileLab, write_pull


def simulated(make: Callable[[Path], None] | list[Callable[[Path], None]], raw: Path) -> list[Path]:
    before = set(raw.glob("*/"))
    for each in make if isinstance(make, list) else [make]:
        each(raw)
    return sorted(set(raw.glob("*/")) - before)


@pytest.fixture
def quick_campaign(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two small tests, two pulls and a short line in place of the campaigns and examples."""

    def simulate(folder: Path) -> None:
        small = small_scenario()
        straight = replace(small.mechanics, slack=None)
        for seed, name in enumerate(("T1", "T2"), start=1):
            home = folder.parent.parent / "made" / name
            made = make_lab(home, replace(small, mechanics=straight), seed)
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

    campaigns = {"wires": simulate, "tensile": simulate_tensile}
    monkeypatch.setattr("labpipe.cli.demo.CAMPAIGNS", campaigns)
    monkeypatch.setattr("labpipe.cli.demo.FIRST_LOOK", (simulate_tensile,))
    monkeypatch.setattr("labpipe.cli.demo.simulate_campaigns", simulated)
    examples = tmp_path / "examples"
    examples.mkdir()
    written(examples, pushed(SHEET_WORDS), name="harness-push.yaml")
    monkeypatch.setattr("labpipe.cli.demo.shipped_folder", {"examples": examples}.__getitem__)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_campaign")
def test_processes_reports_and_calibrates_and_says_where(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--full", "--no-figures", "--jobs", 1)
    assert ran.status == 0
    assert ran.err.startswith("making synthetic campaigns in ")
    done = tmp_path / "processed" / "demo"
    for name in ("wires/T1", "wires/T2", "tensile/P-1", "tensile/P-2"):
        assert (done / name / "summary.json").is_file()
        assert f"{name.partition('/')[2]}  (" in ran.out
    one, other = (ran.out.index(f"{name}  (tensile): ") for name in ("P-1", "P-2"))
    assert "failure_displacement" in ran.out[one:other]
    assert "failure_displacement" not in ran.out[other:]
    for name in ("wires", "tensile"):
        page = done / name / "report" / "report.html"
        assert f"Synthetic demo campaign: {name}" in page.read_text(encoding="utf-8")
        assert f"  {page}\n" in ran.out
    assert "radial_friction" in ran.out
    line = json.loads((done / "lines" / "harness-push" / "summary.json").read_text())
    assert [each["role"] for each in line["inputs"]] == ["harness", "wires", "calibration"]
    assert line["bands"]["kind"] == "pointwise 95 %", "it has the law that was calibrated"
    assert "\nharness-push: " in ran.out
    assert (done / "wires" / "calibration" / "calibration.json").is_file()
    assert "figures to look at" not in ran.out


@pytest.mark.slow
@pytest.mark.usefixtures("quick_campaign")
def test_names_the_figures(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def card(report: object, folder: Path, **more: object) -> list[Path]:
        return [folder / "calibration.svg", folder / "calibration.png"]

    monkeypatch.setattr("labpipe.studies.calibration_study.save_calibration_figures", card)
    ran = run("demo", tmp_path, "--full", "--jobs", 1)
    folder = tmp_path / "processed" / "demo"
    _, _, told = ran.out.partition(
        "\nfigures to look at, of a test of each kind, the calibration and the lines:\n"
    )
    names = [line.strip().rpartition("/")[2] for line in told.splitlines()]
    assert names.pop() == "harness.svg"
    assert names.pop() == "calibration.svg"
    assert names.count("force-displacement.svg") == 2
    assert all(name.endswith(".svg") for name in names)
    assert (folder / "wires" / "T1" / "figures" / "timeline.svg").is_file()
    assert not (folder / "wires" / "T2" / "figures").exists()
    for name in ("P-1", "T1"):
        assert str(Path(name) / "figures" / "force-displacement.svg") in told


@pytest.mark.slow
@pytest.mark.usefixtures("quick_campaign")
def test_one_report_of_a_test_of_each_kind(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--png", "--jobs", 1)
    assert ran.status == 0
    folder = tmp_path / "processed" / "demo" / "one-of-each"
    out = ran.out.replace(f"{tmp_path}{os.sep}", "").replace(os.sep, "/")
    assert "failure_displacement" in out.partition("P-2  (tensile)")[0], "numbers of the first test"
    assert "failure_displacement" not in out.partition("P-2  (tensile)")[2]
    shown = out.partition("open in a browser, the report first:\n")[2].partition("\n\n")[0]
    assert [line.removeprefix("processed/demo/one-of-each/") for line in shown.split()] == [
        "report/report.html",
        "P-1/figures/stiffness-lines.svg",
        "P-2/figures/stiffness-lines.svg",
    ]
    assert (folder / "P-2" / "figures" / "stiffness-lines.png").is_file()
    assert (tmp_path / out.partition("labpipe inspect ")[2].splitlines()[0]).is_file()
    page = (folder / "report" / "report.html").read_text(encoding="utf-8")
    assert "Synthetic demo campaign: one-of-each" in page
    assert not (tmp_path / "processed" / "demo" / "wires").exists()


def test_the_first_look_has_a_test_of_each_kind_of_the_campaigns() -> None:
    def kinds(campaigns: Iterable[Campaign]) -> Counter[str]:
        return Counter(protocol_of(test) for each in campaigns for test, _ in each.scenarios())

    first = kinds(FIRST_LOOK)
    assert set(first) == set(kinds(each for several in CAMPAIGNS.values() for each in several))
    assert set(first.values()) == {1}


def test_an_example_is_of_the_wire_that_the_demo_calibrates() -> None:
    texts = [path.read_text(encoding="utf-8") for path in EXAMPLES.glob("harness-*.yaml")]
    assert len(texts) == 4
    assert sum(SHEET_WORDS in text for text in texts) == 1
    assert CALIBRATED_WORDS.startswith(SHEET_WORDS[:-1])


@pytest.mark.slow
def test_the_whole_demo(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--full", "--jobs", 1)
    assert ran.status == 0
    assert ran.out.count("wire-shapes.svg") == 3  # a wire, a bundle in tape, one in a conduit
    assert len(list((tmp_path / "raw" / "demo").glob("*/*/test.yaml"))) == 99
    for name in ("wires", "tensile", "harness"):
        page = tmp_path / "processed" / "demo" / name / "report" / "report.html"
        assert page.stat().st_size < 2_000_000
