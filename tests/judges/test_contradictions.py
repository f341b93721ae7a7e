"""Of tests that contradict themselves no wrong number is ok, and sound ones stay so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.judges.contradictions import CYCLIC, PULLED, SEEDS, SHEET, Accident, made
from tests.judges.plain.judge import RunSummary, process

ALARMS = {
    *("cycle_scale", "cycle_level", "turn_jump", "force_late", "energy_gained"),
    *("second_specimen", "zero_jump"),
}
EVERY_ACCIDENT = [*((accident, False) for accident in CYCLIC), *((each, True) for each in PULLED)]


def processed(
    folder: Path, accident: Accident | None, seed: int, *, pulled: bool
) -> tuple[RunSummary, dict[str, float]]:
    protocol, table, truth = made(accident, seed, pulled=pulled)
    files = {"cycles.yaml": protocol.encode(), "table.csv": table.encode()}
    return process(folder, SHEET, files), truth


def silent(ran: RunSummary, truth: dict[str, float]) -> list[str]:
    """Names of numbers that are ok and beyond three half widths, and half a per cent, of truth."""
    wrong = []
    for name, right in truth.items():
        result = ran.results.get(name)
        if result is None or result["status"] != "ok" or result["value"] is None:
            continue
        half = (result["upper"] - result["lower"]) / 2.0
        if abs(result["value"] - right) > max(3.0 * half, 0.005 * abs(right)):
            wrong.append(name)
    return wrong


@pytest.mark.parametrize(("accident", "pulled"), EVERY_ACCIDENT)
@pytest.mark.parametrize(
    "seed", [SEEDS[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[1:])]
)
def test_no_number_is_silently_wrong(
    accident: Accident, pulled: bool, seed: int, tmp_path: Path
) -> None:
    ran, truth = processed(tmp_path, accident, seed, pulled=pulled)
    assert silent(ran, truth) == []
    assert ran.notes


@pytest.mark.parametrize("pulled", [False, True])
@pytest.mark.parametrize(
    "seed", [500, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(501, 550))]
)
def test_a_sound_record_has_no_alarm(pulled: bool, seed: int, tmp_path: Path) -> None:
    ran, truth = processed(tmp_path, None, seed, pulled=pulled)
    assert silent(ran, truth) == []
    assert not ALARMS & {note["code"] for note in ran.notes}
