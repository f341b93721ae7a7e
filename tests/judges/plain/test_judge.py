"""The judge itself: its definitions on tables of a few rows, and that it finds what is wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.judges.plain.definitions import (
    Break,
    Cycle,
    Plain,
    Record,
    cycles,
    failure,
    peak_force,
    slack,
    stiffness,
    trapezoid,
)
from tests.judges.plain.judge import Expected, Ran, complaints

TRAVEL = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 2.0, 1.0, 0.0, 0.0, 1.0, 2.0])
FORCE = np.array([0.0, 10.0, 20.0, 30.0, 31.0, 15.0, 5.0, 0.0, 0.0, 9.0, 18.0])
RECORD = Record(None, TRAVEL, FORCE)


def test_numbers_of_eleven_rows() -> None:
    first, _ = cycles(TRAVEL, 1.0)
    assert peak_force(RECORD, first, 1.0) == Plain(30.0, 31.0)  # it stands for two rows
    assert stiffness(RECORD, first, 0.5, 2.5) == Plain(10.0, 10.0)
    assert trapezoid(TRAVEL[:5], FORCE[:5]) == pytest.approx(45.0)
    late = Record(None, TRAVEL[:4] + 0.5, FORCE[:4])
    assert slack(late, Cycle(0, 3, 3, None), 0.3, 0.8) == pytest.approx(0.5)


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


def ran(status: str = "ok", value: float = 100.0, reason: str = "", **more: Any) -> Ran:
    told = [each.split(": ") for each in reason.split("; ") if each]
    reasons = [{"code": code, "message": message} for code, message in told]
    result = {"name": "peak_force.1", "value": value, "status": status, "reasons": reasons}
    return Ran(0, "", "", {"results": [{**result, "method": ""}], "quality": [], **more})


FINE = Expected({"peak_force.1": Plain(100.0, 100.0)})
CUT = replace(FINE, causes={"peak_*": "partial_cycle"}, own=False)


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
