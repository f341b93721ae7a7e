"""Tests of the virtual lab as the study draws them: far too few to count, enough to see a fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.records.result import Result
from labpipe.virtual_lab.bundles import TAPED_TYPES
from labpipe.virtual_lab.specimens import ElasticModel
from tests.coverage import lab_bending, lab_tensile
from tests.coverage.lab import KINDS, compared, made, rows

MOST = 4.5 / 1.96
"""Half widths beyond which chance is no explanation in some hundred intervals."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_of_each(kind: str, tmp_path: Path) -> None:
    """All that a protocol asks for has a truth, and nothing is off by more than chance can do."""
    for seed in range(6 if kind in lab_tensile.KINDS else 2):
        results, truth = made(kind, seed, tmp_path)
        assert {each.name for each in results} <= set(truth)
        assert len(results) >= (1 if kind == "stiff-bar" else 8)
        found = compared(results, truth)
        assert not [row for row in found if row["status"] not in {"ok", "doubtful"}]
        assert not [row for row in found if row["status"] == "ok" and not halves(row) < MOST]


def halves(row: dict[str, float]) -> float:
    """How far the truth is from the middle of the interval."""
    middle, half = 0.5 * (row["upper"] + row["lower"]), 0.5 * (row["upper"] - row["lower"])
    return abs(middle - row["truth"]) / half


def test_slips_that_are_not_there_count_as_failed() -> None:
    slip, peak = (Result(name, 1.0, "N") for name in ("slip_drop.1", "peak_force.1"))
    truth = {"slip_drop.1": 1.0, "slip_drop.2": 2.0, "peak_force.1": 1.0}
    found = {row["name"]: row["status"] for row in compared((slip, peak), truth)}
    assert found == {"peak_force.1": "ok", "slip_drop.1": "failed", "slip_drop.2": "failed"}


@pytest.mark.slow
def test_the_largest_force_may_come_before_the_turn(tmp_path: Path) -> None:
    """A tape that lets go: the force at the turn is 1.4 % lower, seven standard errors."""
    seed = list(TAPED_TYPES).index("TWB-MX-sym-PVC")
    (peak,) = [row for row in rows("taped-bundle", seed, tmp_path) if row["name"] == "peak_force.1"]
    assert halves(peak) < MOST


def test_an_elastic_bar_is_as_stiff_as_itself() -> None:
    """On rollers that rub, at deflections that are not small."""
    rig = lab_bending.conduit_bundle(0).test
    stiffness = lab_bending.windowed(replace(rig, bundle=ElasticModel(0.03)))
    assert lab_bending.as_elastic_bar(rig, stiffness) == pytest.approx(0.03, rel=1e-4)
    assert stiffness * rig.span**3 / 48.0 != pytest.approx(0.03, rel=0.01)
