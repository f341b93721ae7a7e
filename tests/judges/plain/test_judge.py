"""The judge itself: its definitions on tables of a few rows, and that it finds what is wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.judges.plain.bench import Ran
from tests.judges.plain.definitions import (
    Break,
    Cycle,
    Plain,
    Record,
    cycles,
    failure,
    moving_average,
    peak_force,
    slack,
    stiffness,
    straight_ends,
    trapezoid,
)
from tests.judges.plain.judge import Expected, complaints
from tests.judges.plain.shape_cases import all_cases
from tests.judges.plain.still_wrong import STILL_WRONG
from tests.judges.plain.test_real_exports import CASES as REAL
from tests.judges.plain.test_shapes import CASES as SHAPES

TRAVEL = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 2.0, 1.0, 0.0, 0.0, 1.0, 2.0])
FORCE = np.array([0.0, 10.0, 20.0, 30.0, 31.0, 15.0, 5.0, 0.0, 0.0, 9.0, 18.0])
RECORD = Record(None, TRAVEL, FORCE)


def test_cycles_of_eleven_rows() -> None:
    assert cycles(TRAVEL, 1.0) == [Cycle(0, 3, 4, 7), Cycle(7, 10, 10, None)]
    assert cycles(-TRAVEL, 1.0) == cycles(TRAVEL, 1.0)
    assert cycles(0.1 * TRAVEL, 1.0) == []


def test_numbers_of_eleven_rows() -> None:
    first, _ = cycles(TRAVEL, 1.0)
    assert peak_force(RECORD, first, 1.0) == Plain(30.0, 31.0)  # it stands for two rows
    assert stiffness(RECORD, first, 0.5, 2.5) == Plain(10.0, 10.0)
    assert trapezoid(TRAVEL[:5], FORCE[:5]) == pytest.approx(45.0)
    late = Record(None, TRAVEL[:4] + 0.5, FORCE[:4])
    assert slack(late, Cycle(0, 3, 3, None), 0.3, 0.8) == pytest.approx(0.5)


def test_a_window_ends_with_its_piece() -> None:
    rising = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    assert moving_average(rising, 3, [3])[3] == 3.0
    assert moving_average(rising, 3, [3], centred=False)[3] == 2.5
    assert straight_ends(rising, 3, [3])[3] == 3.0


@pytest.mark.parametrize(
    ("force", "found"),
    [
        ([0, 50, 100, 0, 0], Break(2, 2)),
        ([0, 50, 100, 95, 90, 86, 2], Break(5, 5)),  # what goes before is necking
        ([0, 50, 100, 85, 55, 20, 0], Break(2, 2)),
        ([0, 50, 100, 92, 84, 76, 68, 60, 52, 44, 36], None),
        ([0, 50, 100, 92, 84, 76, 68, 60, 52, 44, 30], Break(8, 9, sure=False)),
    ],
)
def test_breaks(force: list[int], found: Break | None) -> None:
    travel = np.arange(float(len(force)))
    record = Record(0.1 * travel, travel, np.array(force, dtype=float))
    assert failure(record, Cycle(0, len(force) - 1, len(force) - 1, None)) == found


def test_a_break_at_any_rate_is_within_one_slow_step() -> None:
    for rate in (10.0, 100.0, 1000.0, 10000.0):
        time = np.arange(0.0, 12.0, 1.0 / rate)
        force = 10.0 * time * np.clip(1.0 - (time - 10.0) / 0.004, 0.0, 1.0) * (time < 10.004)
        last = len(time) - 1
        found = failure(Record(time, time, force), Cycle(0, last, last, None))
        assert found is not None
        assert time[found.first] >= 9.9
        assert time[found.last] <= 10.002


def ran(status: str = "ok", value: float = 100.0, reason: str = "", **more: Any) -> Ran:
    told = [each.split(": ") for each in reason.split("; ") if each]
    reasons = [{"code": code, "message": message} for code, message in told]
    result = {"name": "peak_force.1", "value": value, "status": status, "reasons": reasons}
    return Ran(0, "", "", {"results": [{**result, "method": ""}], "quality": [], **more})


FINE = Expected({"peak_force.1": Plain(100.0, 100.0)})
CUT = replace(FINE, causes={"peak_*": "partial_cycle"}, own=False)


def test_what_is_right_passes() -> None:
    assert complaints(ran(value=100.29), FINE) == []
    assert complaints(ran("doubtful", 50.0, "partial_cycle: cut"), CUT) == []
    assert complaints(ran("doubtful", 50.0, "not_reached: 8 mm; partial_cycle: cut"), CUT) == []


@pytest.mark.parametrize(
    ("outcome", "rule", "said"),
    [
        (ran(value=100.31), FINE, "peak_force.1: 100.31 is ok, plainly 100 (+0.31 %)"),
        (ran("doubtful", 50.0, "saturation: full"), FINE, "must be ok"),
        (ran("doubtful", 50.0, "saturation: full"), CUT, "not the cause (partial_cycle)"),
        (ran("doubtful", 50.0), CUT, "no reason"),
        (ran("failed", 0.0, "partial_cycle: nan s"), CUT, "no sentence"),
        (ran(value=50.0), CUT, "is ok, plainly"),
        (ran("doubtful", 50.0, "partial_cycle: x"), replace(CUT, own=True), "is doubtful, plainly"),
        (ran(value=-100.0), replace(FINE, sign_free=True), "negative, and no reason is given"),
        (ran(), Expected({"peak_force.1": None}), "there is no such number"),
        (ran(), Expected({}), "there is no such number"),
        (ran(), Expected({"energy.1": Plain(1.0, 1.0)}), "energy.1: not in the summary"),
        (replace(ran(), err="RuntimeWarning: x"), FINE, "terminal: "),
        (replace(ran(), status=1), FINE, "exit status 1, with no failed result"),
        (Ran(2, "", "no"), FINE, "refused: no"),
        (Ran(-1, "", "Traceback"), FINE, "exit status -1"),
    ],
)
def test_what_is_wrong_is_found(outcome: Ran, rule: Expected, said: str) -> None:
    assert any(said in each for each in complaints(outcome, rule))


def test_the_table_names_cases_that_there_are() -> None:
    assert set(STILL_WRONG) <= set(SHAPES) | set(REAL)
    assert len(SHAPES) == len(all_cases())  # no name twice
