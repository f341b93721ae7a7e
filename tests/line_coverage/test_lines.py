"""The study of lines: what it draws, how it judges; a line of each way of truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw
from tests.judges.foreign import wire_section as foreign
from tests.line_coverage.drawn_lines import FIRST_SEED, KINDS, NODES, WIRES, Way, draw, wire_drawn
from tests.line_coverage.line_judgement import (
    ASKED,
    counted,
    judged,
    predicted,
    tables,
)
from tests.line_coverage.true_lines import Laid, held_at, true_line, true_stops

BY_NAME = {kind.name: kind for kind in KINDS}


def row(kind: str, *, held: bool = True, notes: tuple[str, ...] = ()) -> dict[str, Any]:
    band = {"truth": 1.0 if held else 3.0, "value": 1.0, "lower": 0.5, "upper": 2.0}
    about = {
        "notes": list(notes),
        "inside": {"shape": 1.0, "shape on the way back": 0.5},
        "shares": {"specimen": 0.25, "spool": 0.75},
    }
    rows = [{"name": name, **band} for name in ASKED]
    return {"kind": kind, "error": "", "about": about, "rows": rows}


def test_lines_of_one_seed_share_their_wire_and_nothing_else() -> None:
    wire, truth, _ = wire_drawn(FIRST_SEED)
    lines = [draw(kind, FIRST_SEED) for kind in KINDS]
    assert {each.wire for each in lines} == {wire}
    assert all(each.truth == truth for each in lines)
    assert len({each.off["spool"] for each in lines}) == len({e.length for e in lines}) == 5
    assert draw(KINDS[1], FIRST_SEED) == lines[1]
    assert {wire_drawn(seed)[0] for seed in KINDS[0].seeds} == set(WIRES)


def test_a_way_begins_and_ends_where_it_says() -> None:
    way = Way(1.5, side=-0.5 * np.pi, level=0.5, back=0.8)
    places, turns = way.loading(8)
    assert places[0] == pytest.approx([np.sin(0.7) / 0.7, 0.0, -(1.0 - np.cos(0.7)) / 0.7])
    assert (turns[0, 0], turns[4, 0], turns[-1, 0]) == pytest.approx((0.7, 1.5, 0.75))
    back, turned = way.returning(4)
    assert turned[-1, 0] == pytest.approx(1.2)
    assert back[-1] == pytest.approx([np.sin(1.2) / 1.2, 0.0, -(1.0 - np.cos(1.2)) / 1.2])


@pytest.mark.parametrize("name", ["push", "bow"])
def test_both_rods_agree_on_a_line_with_memory(name: str) -> None:
    """The same law and numbers, links with angles beside nodes with frames."""
    kind = BY_NAME[name]
    drawn = draw(kind, 41007)
    off, stops = drawn.off, true_stops(drawn)
    truth = true_line(kind, drawn, 1e-3)
    kept = stops.stiffness > 0.0
    law = SliderLaw(stops.spring, stops.stiffness[kept], stops.width[kept], 0.0, 100.0)
    mass = foreign.weight_of(foreign.BUILDS[drawn.wire]) / foreign.GRAVITY
    laid = Laid(
        *(law, 1e-3, mass * float(np.exp(off["mass_factor"]))),
        *(drawn.length * float(np.exp(off["length_factor"])), (0.0, off["free_curvature_2"]), off),
    )
    path = laid.follow(kind, drawn)
    held = path.states[held_at(kind)]
    assert np.abs(held.positions - truth.held).max() < 1e-3 * drawn.length
    assert np.abs(path.last.positions - truth.back).max() < 1e-3 * drawn.length
    assert held.reaction_moments[0, 1] == pytest.approx(truth.moment[1], rel=0.02)
    assert len(held.positions) == NODES + 1


def test_bands_that_hold_too_seldom_are_found() -> None:
    good = [row("push", held=n >= 5) for n in range(100)]
    assert not any(judged(good).values())
    assert str(counted(good, "moment")) == "95 of 100"
    assert all(judged([*good, *[row("bow", held=False)] * 12]).values())


def test_doubtful_and_failed_lines_are_counted_apart() -> None:
    doubtful = row("bow", notes=("beyond_tested",))
    failed = {**row("bow"), "about": {"failed": "no_equilibrium"}, "rows": []}
    rows = [row("push"), doubtful, failed]
    assert predicted(rows) == [rows[0]]
    assert predicted(rows, doubtful=True) == [doubtful]
    text = tables(rows)
    assert "1 x `beyond_tested`), 1 failed, 0 ended in an error" in text
    assert "spool 75 %, specimen 25 %" in text
    assert "| push | 1 | 1 of 1 |" in text
