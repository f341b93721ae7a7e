"""From processed tests to a report through the command: whole campaigns and bad folders."""

from __future__ import annotations

import contextlib
import io
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from openpyxl import load_workbook

from labpipe.campaign.reporting import make_campaign
from labpipe.cli import main
from labpipe.process.targets import find_results
from labpipe.virtual_lab.observations import simulate_test
from labpipe.virtual_lab.tensile_scenarios import (
    TABLE_2_3,
    GripSlip,
    TensileScenario,
    corrugated_tube,
    twist_tube,
)
from tests.builders.small_tests import Run, state

TUBES = ("1a", "1b", "1c", "2a", "2b", "2c")


def simulated(raw: Path, *scenarios: TensileScenario) -> None:
    for seed, scenario in enumerate(scenarios, start=1):
        simulate_test(scenario, raw / scenario.name, seed)


def processed(raw: Path, out: Path) -> Path:
    assert main(["process", str(raw), "--out", str(out), "--no-figures"]) in (0, 1)
    return out


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six twist tubes of two spools, and two corrugated tubes, one of which slipped."""
    home = tmp_path_factory.mktemp("campaign")
    slipped = replace(corrugated_tube("CT-10-2"), slips=(GripSlip(24e-3, 0.8),))
    simulated(home / "raw", *map(twist_tube, TUBES), corrugated_tube("CT-10-1"), slipped)
    return processed(home / "raw", home / "processed")


class Reported:
    """A report made once by the command, and what the folder held before."""

    def __init__(self, tests: Path) -> None:
        self.tests, self.before = tests, state(tests)
        said, complained = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            self.status = main(["report", str(tests)])
        self.out, self.err = said.getvalue(), complained.getvalue()
        self.folder = tests / "report"


@pytest.fixture(scope="module")
def reported(campaign: Path) -> Reported:
    return Reported(campaign)


@pytest.fixture
def tests(campaign: Path, tmp_path: Path) -> Path:
    """Three tests of the campaign, to be changed."""
    copied = tmp_path / "processed"
    for name in ("twist-tube-1a", "twist-tube-1b", "twist-tube-2a"):
        shutil.copytree(campaign / name, copied / name)
    return copied


def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def words(folder: Path) -> str:
    """The page without its marks, blanks made one."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page(folder)))


def change_sheet(test: Path, old: str, new: str) -> None:
    """Change the sheet of a test that has not been processed yet."""
    path = test / "test.yaml"
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, (old, text)
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.slow
def test_a_campaign(reported: Reported) -> None:
    assert (reported.status, reported.err) == (0, "")
    assert "twist-tube-10  (twist-tube): 6 samples from 2 spools\n" in reported.out
    assert "CT-10  (corrugated-tube): 2 samples from 1 spool\n" in reported.out
    assert reported.out.endswith(f"report: {reported.folder / 'report.html'}\n")
    after = state(reported.tests)
    assert {name: after[name] for name in reported.before} == reported.before
    written = {Path(name).suffix for name in set(after) - set(reported.before)}
    assert written == {".html", ".xlsx"}
    assert (reported.folder / "report.html").stat().st_size < 1_000_000


def test_the_page_stands_alone(reported: Reported) -> None:
    text = page(reported.folder)
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!#|data:)", text)
    assert "<svg" in text
    assert "@import" not in text


def test_table_2_3_and_the_decision_not_to_pool(reported: Reported) -> None:
    first = [table[0] for table in TABLE_2_3.values()]
    (line,) = (each for each in reported.out.splitlines() if "stiffness_first_per_peak" in each)
    assert float(line.split()[1]) == pytest.approx(sum(first) / len(first), rel=0.01)
    low, high = re.findall(r"95 %: (\S+) to (\S+)", line)[0]
    # Over two spools: one degree of freedom.
    factor = math.exp(65.6 / 52.28)  # on a log scale
    assert float(low) == pytest.approx(52.28 / factor, rel=0.05)
    assert float(high) == pytest.approx(52.28 * factor, rel=0.05)
    assert "Over 2 spool means" in words(reported.folder)


def test_the_workbook_holds_the_numbers(reported: Reported) -> None:
    book = load_workbook(reported.folder / "tables.xlsx", read_only=True)
    cells = [cell for sheet in book for row in sheet.iter_rows(values_only=True) for cell in row]
    book.close()
    assert "stiffness_first_per_peak_force" in {str(cell) for cell in cells}
    numbers = [cell for cell in cells if isinstance(cell, float)]
    assert any(abs(number - 52.3) < 0.6 for number in numbers)


def test_repaired_slips_are_told(reported: Reported) -> None:
    text = words(reported.folder)
    found = re.search(
        r"CT-10: slips in the grips Sample .*? CT-10-2 (\S+) .*? to (\S+) (\S+) ", text
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(23.97, abs=0.03)
    assert float(found[3]) == pytest.approx(0.8, abs=0.1)
    assert "repaired" in text


def test_an_empty_folder(run: Run, tmp_path: Path) -> None:
    ran = run("report", tmp_path)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == (
        f"labpipe report: {tmp_path}: expected a result.h5, or a folder with processed tests, "
        "found none. `labpipe process` makes them from the exports of a test.\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_results(run: Run, tmp_path: Path) -> None:
    simulated(tmp_path / "raw", twist_tube("1a"))
    ran = run("report", tmp_path / "raw")
    assert ran.status == 2
    assert "raw: expected a result.h5, or a folder with processed tests, found none. " in ran.err


def test_a_folder_that_is_not_there(run: Run, tmp_path: Path) -> None:
    ran = run("report", tmp_path / "nowhere")
    assert ran.status == 2
    assert "nowhere: expected a result.h5, or a folder with processed tests, found no" in ran.err


def test_a_damaged_result_among_good_ones(tests: Path, run: Run) -> None:
    damaged = tests / "twist-tube-1a" / "result.h5"
    damaged.write_bytes(damaged.read_bytes()[:3000])
    ran = run("report", tests)
    assert ran.status == 2
    assert ran.err.startswith(f"labpipe report: left out: {damaged}: expected a whole result file,")
    assert ran.err.endswith("Process the test again from its exports.\n")
    assert "twist-tube-10  (twist-tube): 2 samples from 2 spools\n" in ran.out
    assert "twist-tube-1a" in words(tests / "report")
    assert "expected a whole result file" in words(tests / "report")


def test_nothing_but_damaged_results(tests: Path, run: Run) -> None:
    for file in tests.rglob("result.h5"):
        file.write_bytes(b"no result")
    ran = run("report", tests)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.count("expected a result file, found a file that is not HDF5. ") == 3
    assert not (tests / "report").exists()


def test_something_else_than_a_result(tests: Path, run: Run) -> None:
    ran = run("report", tests / "twist-tube-1a" / "summary.json")
    assert ran.status == 2
    assert "summary.json: expected a result file, found a file that is not HDF5. " in ran.err


def test_one_sample_has_no_band(tests: Path, run: Run) -> None:
    ran = run("report", tests / "twist-tube-1b", "--out", tests / "one")
    assert ran.status == 0
    assert "twist-tube-10  (twist-tube): 1 sample from 1 spool\n" in ran.out
    assert "95 %" not in ran.out
    assert re.search(r"one sample|single sample", words(tests / "one"), re.IGNORECASE)


@pytest.mark.slow
def test_samples_whose_ranges_do_not_overlap(run: Run, tmp_path: Path) -> None:
    """One tube was stopped after 3 s, the record of the other one begins after 6 s."""
    simulated(tmp_path / "raw", *(corrugated_tube(f"CT-10-{n}") for n in (1, 2)))
    first, second = (next((tmp_path / "raw" / f"CT-10-{n}").glob("*.xlsx")) for n in (1, 2))
    keep_rows(first, lambda row: row[0] <= 3.0)
    keep_rows(second, lambda row: row[0] >= 6.0)
    for number in (1, 2):
        test = tmp_path / "raw" / f"CT-10-{number}"
        with (test / "test.yaml").open("a", encoding="utf-8") as sheet:
            sheet.write(
                "overrides:\n  branches.min_stroke: {value: 0.2 mm, because: a short test}\n"
                "  steps: {value: [], because: counted from where the frame began}\n"
                "  sources.frame.channels.force.plausible_peak: "
                "{value: {from: 0.1 N, to: 1 kN}, because: a short test}\n"
            )
    processed(tmp_path / "raw", tmp_path / "processed")
    ran = run("report", tmp_path / "processed")
    assert ran.status == 1
    assert "CT-10  (corrugated-tube): 2 samples from 1 spool\n" in ran.out
    assert "No displacement that every curve has" in words(tmp_path / "processed" / "report")
    (group,) = make_campaign(find_results([tmp_path / "processed"]), "again").groups
    assert group.band.reason is not None
    assert group.band.reason.code == "no_overlap"


def keep_rows(file: Path, wanted: Callable[[list[float]], bool]) -> None:
    """Keep the rows of numbers of a workbook that are wanted; the others stand together."""
    book = load_workbook(file)
    for sheet in book:
        gone = [
            number
            for number, row in enumerate(sheet.iter_rows(values_only=True), start=1)
            if len(row) > 2
            and all(isinstance(cell, int | float) for cell in row[:3])
            and not wanted([float(str(cell)) for cell in row[:3]])
        ]
        if gone:
            assert gone[-1] - gone[0] == len(gone) - 1
            sheet.delete_rows(gone[0], len(gone))
    book.save(file)


@pytest.mark.slow
def test_two_protocols_for_one_type(run: Run, tmp_path: Path) -> None:
    simulated(tmp_path / "raw", twist_tube("1a"), twist_tube("1b"))
    change_sheet(tmp_path / "raw" / "twist-tube-1b", "protocol: twist-tube", "protocol: tensile")
    processed(tmp_path / "raw", tmp_path / "processed")
    ran = run("report", tmp_path / "processed")
    assert ran.status == 0
    assert "twist-tube-10, tensile  (tensile): 1 sample from 1 spool\n" in ran.out
    assert "twist-tube-10, twist-tube  (twist-tube): 1 sample from 1 spool\n" in ran.out


def test_a_report_folder_that_cannot_be_written(tests: Path, run: Run) -> None:
    (tests / "taken").write_text("a file", encoding="utf-8")
    for out in (tests / "taken", tests / "taken" / "report"):
        ran = run("report", tests, "--out", out)
        assert (ran.status, ran.out) == (2, "")
        assert re.match(r"labpipe report: [^\n]+: expected [^\n]+, found [^\n]+\.\n$", ran.err)
    assert (tests / "taken").read_text(encoding="utf-8") == "a file"


def test_a_second_report_over_the_first(tests: Path, run: Run) -> None:
    run("report", tests)
    (tests / "report" / "notes.txt").write_text("mine", encoding="utf-8")
    first = {name: digest for name, (digest, _) in state(tests / "report").items()}
    assert run("report", tests).status == 0
    second = {name: digest for name, (digest, _) in state(tests / "report").items()}
    assert set(first) == set(second)
    assert first["report.html"] == second["report.html"]
    assert first["notes.txt"] == second["notes.txt"]
    assert main(["report", str(tests), "--title", "Another <title> & more"]) == 0
    assert "Another &lt;title&gt; &amp; more" in page(tests / "report")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["=1+1", "<script>alert(1)</script>", 'ß & "quoted"'])
def test_names_are_text_everywhere(run: Run, tmp_path: Path, name: str) -> None:
    simulated(tmp_path / "raw", twist_tube("1a"))
    quoted = name.replace("\\", "\\\\").replace('"', '\\"')
    for key, old in (("type", "twist-tube-10"), ("spool", "twist-tube-s1"), ("sample", "1a")):
        change_sheet(tmp_path / "raw" / "twist-tube-1a", f'{key}: "{old}"', f'{key}: "{quoted}"')
    processed(tmp_path / "raw", tmp_path / "processed")
    ran = run("report", tmp_path / "processed", "--figures", "--pages")
    assert ran.status == 0
    assert f"{name}  (twist-tube): 1 sample" in ran.out
    folder = tmp_path / "processed" / "report"
    assert "<script>alert" not in page(folder)
    book = load_workbook(folder / "tables.xlsx")
    kinds = {
        cell.data_type
        for sheet in book
        for row in sheet.iter_rows()
        for cell in row
        if cell.value == name
    }
    assert kinds == {"s"}
    below = [path for path in (folder / "figures").rglob("*") if path.is_file()]
    assert below
    assert all(path.parent == folder / "figures" for path in below)
