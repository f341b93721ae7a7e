"""Three-point bending of thin bundles on a Lloyd frame, by a protocol in YAML alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from labpipe.cli import main
from tests.builders.reasons import why
from tests.builders.small_tests import state
from tests.builders.tensile_tests import TensileLab

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

SPANS = {
    "1": "12.8 mm",
    "1b": "12.8 mm",
    "2": "12.8 mm",
    "3": "73.6 mm",
    "4": "40 mm",
    "5": "57.6 mm",
    "6": "76.8 mm",
    "7": "96 mm",
}
"""By group, as the README of the exports says; 1b is taken to be as 1."""
STRAIGHT = {"2_test1", "3_test1", "4_test1", "5_test1", "5_test2", "5_test3"}
"""No bend in the first 4 mm (a quarter of the shortest span) that two segments would be told by."""
SEGMENTS = ("segment_stiffness_first", "segment_stiffness_second", "break_point")


PEAKS = {"1_test1": 0.83469, "1_test2": 0.78565, "1_test3": 0.69346, "4_test1": 0.97611}


def made(home: Path, source: Path, span: str, *changes: str) -> TensileLab:
    lab = TensileLab(home, source.stem.replace(" ", "_"))
    lab.raw.mkdir(parents=True)
    shutil.copy(source, lab.raw / source.name)
    lab.sheet.write_text(
        f"test: {lab.raw.name}\nprotocol: three-point-bend\n"
        f'specimen: {{type: bundle, spool: "1", sample: "1", span: {span}}}\n'
        f'files: {{frame: "{source.name}"}}\n',
        encoding="utf-8",
    )
    for change in changes:
        key, _, value = change.partition("=")
        lab.override(key, value)
    return lab


@pytest.fixture(scope="module")
def done(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, TensileLab]:
    labs = {}
    for source in sorted((realdata / "lloyd_nexygen").glob("3pb_*.txt")):
        name = source.stem.removeprefix("3pb_hm3_")
        span = SPANS[name.partition("_")[0]]
        change = ("results.two-segments.to=3.2 mm",) if span == "12.8 mm" else ()
        labs[name] = made(tmp_path_factory.mktemp("real"), source, span, *change)
        raw = state(labs[name].home / "raw")
        assert main(["process", str(labs[name].raw)]) == (1 if name in STRAIGHT else 0), name
        assert state(labs[name].home / "raw") == raw
    return labs


@pytest.mark.slow
def test_all_are_there(done: dict[str, TensileLab]) -> None:
    assert len(done) == 14


def test_two_segments_or_the_reason_why_not(done: dict[str, TensileLab]) -> None:
    for name, lab in done.items():
        found = lab.results
        for each in (*SEGMENTS, "bending_stiffness"):
            if name in STRAIGHT:
                assert found[each]["status"] == "failed"
                continue
            own = found[each]
            assert own["lower"] < own["estimate"] < own["upper"], (name, each)
        if name in STRAIGHT:
            assert why(found["break_point"]).startswith("no_bend: ")
        else:
            assert found["segment_stiffness_first"]["value"] > found[SEGMENTS[1]]["value"]


def test_bending_stiffness_is_that_of_a_beam(done: dict[str, TensileLab]) -> None:
    """K L^3 / 48, and what an elastic rod on knife edges gets softer by up to a sixth of a span."""
    for name, lab in done.items():
        if name in STRAIGHT:
            continue
        span = float(SPANS[name.partition("_")[0]].split()[0]) * 1e-3
        plain = lab.results[SEGMENTS[0]]["value"] * span**3 / 48.0
        assert 1.0 < lab.results["bending_stiffness"]["value"] / plain < 1.35, name
        assert "large-deflection" in lab.results["bending_stiffness"]["method"]


def test_blank_cells_are_said(done: dict[str, TensileLab]) -> None:
    """Load and extension are cut at other rows, which touches no result."""
    for name, lab in done.items():
        assert "samples are blank or not finite" in lab.notes["missing_samples"], name
        for each in lab.results.values():
            assert not why(each).startswith("missing_samples: "), name


def test_peaks_are_the_largest_sample(done: dict[str, TensileLab]) -> None:
    for name, peak in PEAKS.items():
        assert done[name].results["peak_force.1"]["value"] == pytest.approx(peak, rel=1e-6)


def test_no_span_is_said(realdata: Path, tmp_path: Path) -> None:
    source = realdata / "lloyd_nexygen" / "3pb_hm3_6_test1.txt"
    lab = made(tmp_path, source, "76.8 mm")
    lab.sheet.write_text(
        lab.sheet.read_text(encoding="utf-8").replace(", span: 76.8 mm", ""), encoding="utf-8"
    )
    assert main(["process", str(lab.raw)]) == 1
    assert why(lab.results["bending_stiffness"]) == (
        "no_span: specimen.span is missing: write it into the test sheet, such as 'span: 152.4 mm'"
    )
