"""Conduit bundles of the virtual lab through the command, against their truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labpipe.cli import main
from labpipe.virtual_lab.conduit_scenarios import conduit_scenario
from labpipe.virtual_lab.observations import simulate_test

pytestmark = pytest.mark.slow

SHARED = ("peak_force", "peak_displacement", "energy")


class Done:
    """A test processed once by the command, and its truth."""

    def __init__(self, home: Path, name: str, seed: int, *, has_frame: bool) -> None:
        scenario = replace(conduit_scenario(name), has_frame_export=has_frame)
        folder = home / "raw" / "conduits" / name
        folder.mkdir(parents=True)
        simulate_test(scenario, folder, seed)
        self.status = main(["process", str(home / "raw")])
        (summary,) = (home / "processed").rglob("summary.json")
        self.summary: dict[str, Any] = json.loads(summary.read_text(encoding="utf-8"))
        self.results = {each["name"]: each for each in self.summary["results"]}
        (truth,) = (home / "raw").rglob("truth.json")
        self.truth: dict[str, Any] = json.loads(truth.read_text(encoding="utf-8"))

    def holds(self, name: str, value: float, *, widths: float = 2.0) -> bool:
        """A wide net: coverage at 95 % is counted elsewhere, over many seeds."""
        found = self.results[name]
        half = widths * 0.5 * (found["upper"] - found["lower"])
        return bool(abs(found["estimate"] - value) <= half)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Done:
    return Done(tmp_path_factory.mktemp("lab"), "CWB-1", 0, has_frame=True)


@pytest.fixture(scope="module")
def by_speed(tmp_path_factory: pytest.TempPathFactory) -> Done:
    return Done(tmp_path_factory.mktemp("lab"), "CWB-2a", 1, has_frame=False)


@pytest.mark.parametrize("which", ["measured", "by_speed"])
def test_every_number_against_its_truth(which: str, request: pytest.FixtureRequest) -> None:
    done: Done = request.getfixturevalue(which)

    assert done.status == 0
    assert {each["status"] for each in done.results.values()} == {"ok"}
    for name in SHARED:
        assert done.holds(f"{name}.1", done.truth[name]), name
    assert done.holds("bending_stiffness", done.truth["bending_stiffness"])
    assert done.holds("mid_span_curvature", max(done.truth["curvature"]))
    turned = max(map(abs, done.truth["twist"]))
    assert done.holds("twist", turned) or done.holds("twist", -turned)


def test_what_was_done_without_a_frame(by_speed: Done, measured: Done) -> None:
    assert "displacement_from_speed" in {each["code"] for each in by_speed.summary["quality"]}
    assert "clock_offset" not in by_speed.results
    assert "clock_offset" in measured.results
    assert {each["role"] for each in by_speed.summary["inputs"]} == {"force", "markers"}
