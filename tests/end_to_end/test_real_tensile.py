"""Real exports of load frames through the generic protocol, against what their README says."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.store.read import read_result
from tests.builders.reasons import why
from tests.builders.small_tests import state
from tests.builders.tensile_tests import TensileLab

pytestmark = pytest.mark.realdata

LLOYD = "lloyd_nexygen/tensile_22awg_{}_50mm.txt"
TIMED = "DAQ- Crosshead, … - (Timed).csv"


@dataclass(frozen=True)
class Real:
    """One export, the length between its grips (from its name), and what is known of it."""

    file: str
    length: str
    rows: int
    status: int
    peak: float | None = None
    cycles: int = 1
    window: tuple[str, str] | None = None
    failed: tuple[str, ...] = ()


NOT_BROKEN = ("failure_displacement", "failure_force", "energy_to_break")
TESTS = {
    # Copper at 0.1 mm a row: neither toe nor 0.5 mm hold eight samples.
    "copper-1": Real(
        LLOYD.format("copper_1"), "50 mm", 88, 1, 76.678, failed=("slack", "stiffness")
    ),
    "copper-1a": Real(
        *(LLOYD.format("copper_1a"), "50 mm", 81, 1),
        failed=("slack", "stiffness", *NOT_BROKEN),
    ),
    "copper-2": Real(LLOYD.format("copper_2"), "50 mm", 88, 1, failed=("slack", "stiffness")),
    # Steepest where they begin, and not broken.
    "silicone-1": Real(
        *(LLOYD.format("silicone_1"), "50 mm", 98, 1),
        window=("2 mm", "12 mm"),
        failed=("slack", *NOT_BROKEN),
    ),
    "silicone-2": Real(
        *(LLOYD.format("silicone_2"), "50 mm", 86, 1),
        window=("2 mm", "12 mm"),
        failed=("slack", *NOT_BROKEN),
    ),
    "cable-ld": Real(f"mts/REU/SteelCableLD_200mm_Trial3/{TIMED}", "200 mm", 635, 0, 504.26132),
    "cable-sd": Real(f"mts/REU/SteelCableSD_100mm_Trial1/{TIMED}", "100 mm", 297, 0, 180.28583),
    "cable-cycles": Real(
        *(f"mts/REU/Hysteresis_SteelCableSD_Trial1/{TIMED}", "100 mm", 3888, 1, 105.39071),
        cycles=15,
        failed=NOT_BROKEN,
    ),
}


def made(home: Path, name: str, realdata: Path) -> TensileLab:
    lab, test = TensileLab(home, name), TESTS[name]
    lab.raw.mkdir(parents=True)
    source = realdata / test.file
    shutil.copy(source, lab.raw / source.name)
    lab.sheet.write_text(
        f"test: {name}\nprotocol: tensile\n"
        f'specimen: {{type: {name}, spool: "1", sample: "1", length: {test.length}}}\n'
        f'files: {{frame: "{source.name}"}}\n',
        encoding="utf-8",
    )
    if test.window is not None:
        lab.override("results.stiffness.from", test.window[0])
        lab.override("results.stiffness.to", test.window[1])
    return lab


@pytest.fixture(scope="module")
def done(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, TensileLab]:
    labs = {name: made(tmp_path_factory.mktemp("real"), name, realdata) for name in TESTS}
    for name, lab in labs.items():
        raw = state(lab.home / "raw")
        assert main(["process", str(lab.raw)]) == TESTS[name].status, name
        assert state(lab.home / "raw") == raw
    return labs


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTS)
def test_results(done: dict[str, TensileLab], name: str) -> None:
    results, test = done[name].results, TESTS[name]
    failed = {each for each, found in results.items() if found["status"] == "failed"}
    assert failed == set(test.failed)
    peaks = [each for each in results if each.startswith("peak_force.")]
    assert len(peaks) == test.cycles
    for each in set(results) - failed:
        assert results[each]["lower"] <= results[each]["estimate"] <= results[each]["upper"]


@pytest.mark.parametrize("name", [name for name, test in TESTS.items() if test.peak is not None])
def test_peaks(done: dict[str, TensileLab], name: str) -> None:
    found = [
        each["value"]
        for each_name, each in done[name].results.items()
        if each_name.startswith("peak_force.")
    ]
    assert max(found) == pytest.approx(TESTS[name].peak, rel=1e-6)
    recording = read_result(done[name].result).recordings["frame"]
    (force,) = (channel.values for channel in recording.channels if channel.name == "force")
    assert len(force) == TESTS[name].rows
    assert np.nanmax(force) == pytest.approx(TESTS[name].peak, rel=1e-6)


def test_every_cycle_has_its_peak(done: dict[str, TensileLab]) -> None:
    """Force-controlled, to 105 N: the largest samples lie between 104.5 N and 105.4 N."""
    for number in range(1, 16):
        found = done["cable-cycles"].results[f"peak_force.{number}"]
        assert found["status"] == "ok"
        assert found["value"] == pytest.approx(105.0, abs=0.8)


def test_rows_without_time_say_sample_numbers(done: dict[str, TensileLab]) -> None:
    for name in ("copper-1a", "silicone-1", "silicone-2"):
        found = done[name].results["peak_force.1"]
        if why(found):
            rows = TESTS[name].rows
            assert why(found).startswith(
                f"partial_cycle: the record ends at sample {rows}, while still loading"
            )


def test_silicone_has_no_toe(done: dict[str, TensileLab]) -> None:
    reason = why(done["silicone-1"].results["slack"])
    assert reason.startswith("no_toe: the line meets zero force at -4.596 mm, before the first ")
    # 1.736 N at 13.105 mm and 0.457 N at 2.418 mm
    found = done["silicone-1"].results["stiffness"]["value"]
    assert found == pytest.approx((1.7352 - 0.45677) / (13.105e-3 - 2.4177e-3), rel=0.05)


def test_copper_breaks_where_its_force_is_lost(done: dict[str, TensileLab]) -> None:
    found = done["copper-1"].results["failure_displacement"]
    assert 10.2e-3 < found["value"] < 11.2e-3
    assert why(found).startswith("slack_unknown: ")


@pytest.mark.parametrize("name", TESTS)
def test_figures(done: dict[str, TensileLab], name: str) -> None:
    figures = {
        path.name: path.stat().st_size for path in (done[name].processed / "figures").iterdir()
    }
    names = ("force-displacement", "stiffness-lines")
    assert set(figures) == {f"{each}.svg" for each in names}
    assert min(figures.values()) > 5000
