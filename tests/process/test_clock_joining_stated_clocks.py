"""Clocks whose offset is stated by hand, in the protocol or for one test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.clock_joining import stated_clocks
from labpipe.protocol.schema import AlignStated
from labpipe.records.curve import ClockFit
from labpipe.records.quality import Findings
from labpipe.records.signals import Signal
from labpipe.signal.turning_points import find_strokes
from tests.builders.doubts import doubted
from tests.builders.dwelling_tests import Dwelling
from tests.builders.small_tests import Run, make_lab, small_scenario

TEST = Dwelling(1.0, offset=-3.2)


def stated(offset: str, **more: str) -> AlignStated:
    return AlignStated.model_validate(
        {"method": "stated", "offset": offset, "because": "LED in frame 512", **more}
    )


def taken(
    align: AlignStated, *, test: Dwelling = TEST, sign: float = 1.0
) -> tuple[Findings, ClockFit]:
    motion = Signal(*test.seen_by_cameras(), "m", "markers")
    time, force = test.seen_by_load_cell()
    strokes = find_strokes(motion.time, motion.values, min_stroke=5e-3)
    fit, found = stated_clocks(Signal(time, sign * force, "N", "force"), align, motion, strokes)
    return Findings() + found, fit


def test_it_is_taken_as_stated() -> None:
    found, fit = taken(stated("-3.2 s", drift="40 ppm", uncertainty="0.02 s"))
    assert (fit.offset, fit.drift) == (-3.2, 40e-6)
    assert fit.offset_interval.standard_error == pytest.approx(0.02)
    assert fit.to_force_seconds(100.0) == pytest.approx(96.804)
    assert fit.event_errors.tolist() == [0.02]
    assert fit.method == "stated: LED in frame 512"
    (note,) = found.notes
    assert (note.code, note.where, note.severity.value) == ("clocks_stated", "align", "info")
    assert note.message == (
        "the offset of the clocks is stated, not measured: -3.2 s, standard uncertainty 0.02 s, "
        "drift 40 ppm, because: LED in frame 512"
    )
    assert not doubted(found.found)


def test_without_an_uncertainty_it_is_known_to_a_sample() -> None:
    found, fit = taken(stated("-3.2 s"))
    assert fit.offset_interval.standard_error == pytest.approx(0.02)  # 50 frames per second
    assert "standard uncertainty 0.02 s (one sample, as none is stated)" in found.notes[0].message
    assert fit.drift_interval.standard_error == pytest.approx(1e-4 / np.sqrt(3.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("offset", "uncertainty", "wrong"),
    [
        ("-3.2 s", "20 ms", False),
        ("-4.0 s", "20 ms", False),
        ("3.2 s", "20 ms", True),
        ("-53 s", "20 ms", True),
        ("-6 s", "2 s", False),
    ],
)
def test_a_statement_that_the_force_contradicts(
    offset: str, uncertainty: str, wrong: bool, sign: float
) -> None:
    """A wrong sign is found, a statement that is known no better is not."""
    found, _ = taken(stated(offset, uncertainty=uncertainty), sign=sign)
    assert (doubted(found.found) != {}) is wrong
    if wrong:
        assert set(doubted(found.found)) == {"clock", "force"}
        assert doubted(found.found)["clock"].startswith(
            "clocks_stated_wrong: by the stated offset the "
        )
        assert doubted(found.found)["clock"].endswith(
            "(time of the force less time of the motion) and at the files"
        )


@pytest.mark.parametrize("level", [0.0, 0.3])
def test_a_force_that_never_peaks_contradicts_nothing(level: float) -> None:
    motion = Signal(*TEST.seen_by_cameras(), "m", "markers")
    values = level * np.linspace(0.0, 1.0, 1000)
    force = Signal(np.arange(1000) / 10.0, values, "N", "force")
    strokes = find_strokes(motion.time, motion.values, min_stroke=5e-3)
    fit, found = stated_clocks(force, stated("1.5 s", channel="force"), motion, strokes)
    assert fit.offset == 1.5
    assert not doubted(found)


OVERRIDE = """\
  align:
    value: {method: stated, offset: 1.375 s, uncertainty: 10 ms}
    because: the lamp on the recorder lights up in frame 69
"""


@pytest.mark.slow
def test_for_one_test_by_its_sheet(tmp_path: Path, run: Run) -> None:
    """One override, whose reason is that of the offset; a single peak is enough."""
    lab = make_lab(tmp_path, replace(small_scenario(cycles=1), rest=3.0))
    lab.sheet.write_text(lab.sheet.read_text(encoding="utf-8") + OVERRIDE, encoding="utf-8")
    ran = run("process", lab.raw)
    assert ran.status == 0, ran.err
    offset = lab.results["clock_offset"]
    assert offset["value"] == 1.375
    assert offset["status"] == "ok"
    assert offset["method"] == "stated: the lamp on the recorder lights up in frame 69"
    ends = offset["lower"], offset["upper"]
    assert ends == pytest.approx((1.375 - 0.0196, 1.375 + 0.0196), abs=1e-5)
    assert lab.results["peak_force.1"]["status"] == "ok"
    assert lab.notes["clocks_stated"].endswith(
        "because: the lamp on the recorder lights up in frame 69"
    )
