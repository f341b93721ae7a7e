"""What a failed number tells to write in the test sheet makes it available."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.records.arrays import Floats
from tests.builders.reasons import why
from tests.builders.tensile_tests import TensileLab, write_pull

SAID = re.compile(r"'([\w.-]+): \{value: (.+?), because: \.\.\.\}'")
SLACK, BREAK = {"slack"}, {"failure_displacement", "failure_force", "energy_to_break"}


def bent_over(travel: Floats, *, knee: float, most: float) -> Floats:
    """Force of a wire that yields, N: steep at first, and flat then."""
    return np.asarray(most * np.tanh(np.maximum(travel, 0.0) / knee))


def ends_in(force: Floats, *shares: float) -> Floats:
    """The last samples at these shares of the largest force."""
    return np.concatenate([force[: -len(shares)], force.max() * np.array(shares)])


ROWS = 90
COARSE = np.linspace(0.0, 12e-3, ROWS)
"""A sample each 0.13 mm."""
LATE = np.linspace(0.7e-3, 80e-3, ROWS)
FINE = np.linspace(0.0, 12e-3, 400)
SLOW = np.linspace(1.0, 0.0, 60)
PULLS = {
    "too few samples": (
        COARSE,
        ends_in(bent_over(COARSE - 0.3e-3, knee=0.6e-3, most=76.0), 0.02, 0.0),
        {*SLACK, "stiffness"},
        {"curve.slack.to", "results.stiffness.to"},
    ),
    "begins late, never breaks": (
        LATE,
        3.0 + bent_over(LATE, knee=60e-3, most=12.0),
        {*SLACK, *BREAK, "stiffness"},
        {
            *("curve.slack", "results.slack", "results.failure", "results.energy-to-break"),
            *("results.stiffness.from", "results.stiffness.to"),
        },
    ),
    "stops in mid-break": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), 0.73, 0.72),
        BREAK,
        {"curve.failure.force_below"},
    ),
    "stops while it necks": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), *np.linspace(1.0, 0.7, 40)),
        BREAK,
        {"curve.failure.force_below", "curve.failure.within"},
    ),
    "breaks slowly": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), *SLOW),
        BREAK,
        {"curve.failure.within"},
    ),
}


def processed(lab: TensileLab) -> Mapping[str, Mapping[str, str]]:
    main(["process", str(lab.raw), "--no-figures"])
    return lab.results


@pytest.mark.parametrize("name", PULLS)
def test_what_is_told_makes_it_available(tmp_path: Path, name: str) -> None:
    travel, force, failed, keys = PULLS[name]
    lab = TensileLab(tmp_path, "T-1")
    noise = np.random.default_rng(3).normal(0.0, 0.02, len(force))
    write_pull(lab, "tensile", force + noise, travel, rate=10.0)
    found = processed(lab)
    assert {each for each in found if found[each]["status"] == "failed"} == failed
    told = {key: value for each in failed for key, value in SAID.findall(why(found[each]))}
    assert set(told) == keys
    for key, value in told.items():
        lab.override(key, value)
    after = processed(lab)
    assert not {each for each in after if after[each]["status"] == "failed"}
    assert len(after) == len(found) - sum(each in failed for each in set(found) - set(after))


def test_a_window_beyond_the_travel_is_cut_to_it(tmp_path: Path) -> None:
    lab = TensileLab(tmp_path, "T-1")
    force = ends_in(bent_over(FINE, knee=6e-3, most=100.0), 0.0)
    write_pull(lab, "force-displacement", force, FINE, rate=10.0)
    text = lab.sheet.read_text("utf-8")
    own = tmp_path / "own.yaml"
    own.write_text(
        "version: 1\nname: own\nsources:\n  frame:\n    reader: load-frame\n    channels:\n"
        "      force: {channel: Load}\n      displacement: {channel: Crosshead}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 mm}\nresults:\n"
        "  - {result: stiffness, name: first, from: 1 mm, to: 2 mm}\n"
        "  - {result: stiffness, name: second, from: 2 mm, to: 80 mm}\n"
        "  - {result: two-segments, from: 1 mm, to: 90 mm}\n",
        encoding="utf-8",
    )
    lab.sheet.write_text(text.replace("force-displacement", str(own)), "utf-8")
    found = processed(lab)
    assert found["first"]["status"] == "ok"
    assert dict(SAID.findall(why(found["second"]))) == {"results.second.to": "12 mm"}
    assert dict(SAID.findall(why(found["break_point"]))) == {"results.two-segments.to": "12 mm"}
