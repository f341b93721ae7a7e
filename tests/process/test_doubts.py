"""What records leave in doubt: the results, and the reasons that a reader approved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.quality import Severity
from labpipe.records.result import Status
from tests.approved import Approve
from tests.builders.plain_records import STROKE, PlainRecord, up_and_down
from tests.builders.reduced import loop, reduced

ASKED = """\
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: stiffness, from: 4 mm, to: 8 mm}
  - {result: energy}
"""
LINES = """\
steps:
  - {step: zero, channel: force, over: 0.4 s, by: line}
  - {step: zero, channel: displacement, over: 0.4 s, by: line}
"""
DISPLACEMENT_ALONE = LINES.replace("force, over", "displacement, over")
FAILURE = (
    "displacement: displacement}",
    "displacement: displacement, failure: {force_below: 50 %}}",
)
SLACK = (
    "displacement: displacement}",
    "displacement: displacement, slack: {from: 30 %, to: 60 %}}",
)


def changed(record: PlainRecord, *, force: float = 0.0, path: float = 0.0) -> PlainRecord:
    """Other zeros of the channels."""
    return replace(record, force=record.force + force, displacement=record.displacement + path)


def turned(record: PlainRecord) -> PlainRecord:
    return replace(record, force=-record.force, displacement=-record.displacement)


def late(share: float, noise: float = 1e-3) -> PlainRecord:
    """Cycles whose first rows are missing, as a share of the first loading."""
    record = up_and_down(rest=0.0, noise=noise)
    return record.where(record.time >= 5.0 * share)


def with_force(change: Callable[[Floats, Floats], Floats]) -> PlainRecord:
    """Cycles whose force is made of time and force."""
    record = up_and_down()
    return replace(record, force=change(record.time, record.force))


def looped(change: Callable[[Floats], Floats], path: Callable[[Floats], Floats]) -> PlainRecord:
    """Two cycles of 20 s; what is added to force and displacement, of the time."""
    time, displacement, force = loop(noise=5e-3)
    return PlainRecord(time, displacement + path(time), force + change(time))


def with_dwells(lasts: float, rate: float) -> PlainRecord:
    """Two cycles that stand at each turn."""
    corners = [2.0, 7.0, 12.0, 17.0, 22.0]
    ends = [corner + lasts * (i - end) for i, corner in enumerate(corners) for end in (1, 0)]
    time: Floats = np.arange(0.0, 24.0 + 3.0 * lasts, 1.0 / rate)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (2, len(time)))
    path = 1e-2 * np.interp(time, ends, np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], 2))
    return PlainRecord(time, path + 1e-3 * noise[0], 100.0 * path + noise[1])


def through(*corners: tuple[float, float]) -> PlainRecord:
    """A motion through corners (s, mm) along 100 N/m, with noise of 1 mN."""
    time: Floats = np.arange(0.0, 100.0, 0.05)
    path = 1e-3 * np.interp(time, *np.transpose(corners))
    noise = np.random.default_rng(20261128).normal(0.0, 1e-3, len(time))
    return PlainRecord(time, path, 100.0 * path + noise)


def broken(left: float) -> PlainRecord:
    """A pull to 1 N whose force stands at `left` once it is broken."""
    time: Floats = np.arange(0.0, 12.0, 0.02)
    force = np.where(time < 10.0, 0.1 * time, left)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, len(time))
    return PlainRecord(time, 1e-3 * time, force + noise)


def with_preload() -> PlainRecord:
    """Cycles between a tenth of the load and all of it."""
    record = up_and_down(rest=0.0, cycles=3)
    return replace(
        record, force=0.1 + 0.9 * record.force, displacement=1e-3 + 0.9 * record.displacement
    )


def zero(time: Floats) -> Floats:
    return 0.0 * time


def begun_on_the_way() -> PlainRecord:
    """Cycles whose recording begins in mid-stroke, with new zeros."""
    record = late(0.4)
    return changed(record, force=-record.force[0], path=-record.displacement[0])


def with_limited_path() -> PlainRecord:
    """Cycles whose displacement does not go beyond a limit but for noise."""
    record = up_and_down()
    noise = np.random.default_rng(0).normal(0.0, 1e-3 * STROKE, len(record.time))
    return replace(record, displacement=np.minimum(record.displacement, 0.7 * STROKE) + noise)


def stopped_at_a_turn() -> PlainRecord:
    """Cycles whose first turn was not recorded, on one even clock."""
    recorded = PlainRecord(*loop(noise=1e-3))
    recorded = recorded.where(np.abs(recorded.time - 12.0) > 2.0)
    return replace(recorded, time=0.02 * np.arange(float(len(recorded.time))))


def with_jump_in_a_hold() -> PlainRecord:
    """A hold between two loadings, in which the force rises by a fifth."""
    record = through((0.0, 0.0), (5.0, 5.0), (25.0, 5.0), (30.0, 10.0), (40.0, 0.0))
    return replace(record, force=record.force * np.where(record.time > 15.0, 1.2, 1.0))


def with_reversed_path() -> PlainRecord:
    """Cycles whose second displacement has the other sign."""
    record = up_and_down()
    sign = np.where(record.time > 0.5 * record.time[-1], -1.0, 1.0)
    return replace(record, displacement=sign * record.displacement)


RECORDS = {
    "whole": up_and_down(),
    "cut while loading": up_and_down(noise=5e-3).up_to(15.5),
    "cut while loading, ten samples a second": up_and_down(rate=10.0).up_to(15.5),
    "cut behind the peak of the second loading": up_and_down().up_to(17.0),
    "cut while unloading": up_and_down(noise=5e-3).up_to(19.5),
    "cut while unloading, round": up_and_down(rate=10.0, is_round=True).up_to(19.5),
    "cut at rest": up_and_down(noise=5e-3).up_to(22.0),
    "one loading that was cut": up_and_down(cycles=1).up_to(6.5),
    "gives way before it is cut": with_force(
        lambda time, force: np.where(time > 15.0, 0.5 * force, force)
    ).up_to(16.5),
    "a force that ends first": with_force(lambda time, f: np.where(time > 15.5, np.nan, f)),
    "a full force": with_force(lambda _, force: np.minimum(force, 0.7)),
    "a full force under noise": with_force(
        lambda time, force: (
            np.minimum(force, 0.7) + np.random.default_rng(0).normal(0.0, 5e-3, len(time))
        )
    ),
    "a full displacement under noise": with_limited_path(),
    "a spike before the loss": with_force(
        lambda time, f: np.where(time < 6.5, f + (np.abs(time - 6.48) < 0.005) * 0.2, 0.0)
    ).up_to(6.9),
    "a force that overflows": with_force(lambda _, force: (force + 0.1) % 0.2 - 0.1),
    "zeroed on the way": begun_on_the_way(),
    "stopped at a turn": stopped_at_a_turn(),
    "a frozen force": with_force(
        lambda time, f: np.where(np.abs(time - 14.5) < 1.0, f[np.argmax(time > 13.5)], f)
    ),
    "counted downwards": turned(up_and_down()),
    "dwells": with_dwells(1.5, 50.0),
    "dwells, ten samples a second": with_dwells(1.5, 10.0),
    "a hold at the end": through((0.0, 0.0), (10.0, 10.0)),
    "holds": through((0.0, 0.0), (5.0, 5.0), (25.0, 5.0), (30.0, 10.0), (35.0, 10.0), (45.0, 0.0)),
    "longer and longer cycles": through(
        (0.0, 0.0), (4.0, 4.0), (8.0, 0.0), (15.0, 7.0), (22.0, 0.0)
    ),
    "a force that jumps in a hold": with_jump_in_a_hold(),
    "a displacement that changes its sign": with_reversed_path(),
    "first rows missing": late(0.05),
    "more rows missing": late(0.2),
    "an unloading first": up_and_down(rest=0.0).where(up_and_down(rest=0.0).time >= 5.0),
    "a force that jumps": looped(lambda time: np.where(time > 35.0, 0.1, 0.0), zero),
    "a force that jumps down": looped(lambda time: np.where(time > 35.0, -0.1, 0.0), zero),
    "a drifting zero": looped(lambda time: 0.1 * time / time[-1], zero),
    "a zero that drifts down": looped(lambda time: -0.1 * time / time[-1], zero),
    "a zero that hardly drifts": looped(lambda time: 0.01 * time / time[-1], zero),
    "outliers of the displacement": looped(
        zero, lambda time: np.where(np.abs(time - 8.0) < 0.02, -2e-3, 0.0)
    ),
    "a crosshead zeroed late": looped(zero, lambda time: np.where(time < 1.0, 0.05, 0.0)),
    "a force zeroed in loading": with_force(lambda time, f: f - np.where(time > 4.0, 0.4, 0.0)),
    "a force that falls for good": with_force(lambda time, f: f - np.where(time > 4.0, 0.05, 0.0)),
    "a specimen that slides far": with_force(
        lambda time, force: force - np.where(time > 4.0, 0.3, 0.0)
    ).up_to(6.5),
    "a specimen that slips": looped(
        lambda time: np.where((time > 8.0) & (time < 12.0), -0.05, 0.0), zero
    ),
}


ZEROED = {
    "first rows missing": (late(0.05, 0.0), LINES),
    "more rows missing": (late(0.2), LINES),
    "only the displacement": (late(0.1), DISPLACEMENT_ALONE),
    "an offset of a load cell": (changed(up_and_down(rest=0.0), force=0.05, path=3e-3), LINES),
    "an offset that no load cell has": (
        changed(up_and_down(rest=0.0, cycles=1).up_to(4.9), force=0.3, path=0.7),
        LINES,
    ),
    "the same, ended at its start": (changed(up_and_down(rest=0.0), force=0.3, path=0.7), LINES),
    "a preload": (with_preload(), LINES),
    "a force that jumps after its zero": (
        with_force(lambda time, force: force + 0.05 * (time > 1.2)),
        "steps: [{step: zero, channel: force, over: 1 s}]\n",
    ),
}


def doubts(record: PlainRecord, more: str, replaced: tuple[str, str] = ("", "")) -> list[str]:
    """Warnings, and the results by the reason that they are not right."""
    test, results = reduced(*record.arrays(), more=more, replaced=replaced)
    notes = [note for note in test.findings.notes if note.severity is not Severity.INFO]
    holds = [note for note in test.findings.notes if note.code == "hold"]
    reasons: dict[str, list[str]] = {}
    for result in results.values():
        if result.reason_text:
            reasons.setdefault(result.reason_text, []).append(result.name)
    lines = [f"{note.code}: {note.message}" for note in [*notes, *holds]]
    return [*lines, *(f"{', '.join(names)}: {why}" for why, names in reasons.items())]


@pytest.mark.parametrize("name", RECORDS)
def test_records(name: str, approved: Approve) -> None:
    approved(doubts(RECORDS[name], ASKED))


@pytest.mark.parametrize("name", ZEROED)
def test_records_that_were_zeroed(name: str, approved: Approve) -> None:
    record, steps = ZEROED[name]
    approved(doubts(record, steps + ASKED))


@pytest.mark.parametrize("left", [-0.06, -0.02, 0.06])
def test_the_force_once_the_specimen_is_broken(left: float, approved: Approve) -> None:
    approved(doubts(broken(left), ASKED, FAILURE))


def test_slack_finds_the_zero_of_the_displacement() -> None:
    """A line through the linear region goes back to zero force, which was exported as such."""
    steps = "steps:\n  - {step: zero, channel: displacement, over: 0.4 s, by: line}\n"
    record = late(0.1, noise=1e-4).up_to(4.9)
    _, results = reduced(*record.arrays(), more=steps + ASKED, replaced=SLACK)
    assert results["stiffness"].status is Status.OK
    assert results["stiffness"].value == pytest.approx(100.0, rel=0.01)


@pytest.mark.parametrize(("replaced", "doubted"), [(("", ""), False), (SLACK, True)])
def test_zero_of_the_force_and_the_stiffness(replaced: tuple[str, str], doubted: bool) -> None:
    """A force at rest makes a slope doubtful only if slack, which it moves, was subtracted."""
    record = changed(up_and_down(), force=0.05)
    _, results = reduced(*record.arrays(), more=ASKED, replaced=replaced)
    codes = {
        name: [reason.code for reason in results[name].reasons]
        for name in ("peak_force.1", "stiffness")
    }
    assert "rest_force" in codes["peak_force.1"]
    assert ("rest_force" in codes["stiffness"]) is doubted
