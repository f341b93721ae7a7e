"""Whole records of results of curves with known truth: values, both ends, reasons, notes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np
import pytest

from labpipe.process.story import Reduction
from labpipe.records.arrays import Floats
from labpipe.records.result import Status
from tests.approved import Approve
from tests.builders.bundle_loops import FIRST, FLAT, KINK, LATER, ONSET, SECOND, first_loading
from tests.builders.bundle_loops import NOISE as LOOP_NOISE
from tests.builders.bundle_loops import cycles as bundle
from tests.builders.pulls import BREAK, LINE, MARKED, SECTION, broken, pull, slipped
from tests.builders.pulls import reduction as of_pull
from tests.builders.reduced import loop
from tests.builders.reduced import reduction as of_loop

REPAIRED = MARKED.replace("marked", "repaired")
SLACK = "slack: {from: 10 %, to: 30 %}"
SLOPE = "stiffness, from: 2 mm, to: 10 mm"
MODULUS = "modulus, of: stiffness, area: stated"
NORMALISED = "normalised-stiffness, of: stiffness"
AT_BREAK = ("failure", "energy-to-break")
AREAS = {
    **{"stated": 5e-6, "rectangle": 2e-5, "thin-wall": np.pi * 0.0095 * 0.0005},
    "annulus": 0.25 * np.pi * (0.01**2 - 0.008**2),
}
MODULI = [f"modulus, name: {area[:4]}, of: stiffness, area: {area}" for area in AREAS]
TWO = "two-segments, from: 1 mm, to: 18 mm"
KINK_OF_PULL = "kink, from: 1 mm, to: 18 mm"
TANGENTS = "plateau, slope_below: 10 %, of: stiffness, over: 2 mm"
SHORT_LINE = "stiffness, from: 1 mm, to: 3 mm"

TRAVEL, PULL = pull()
LOOSE = pull(slack=0.003)[1]
TWICE = np.concatenate([pull(length=0.01)[0], pull(length=0.01)[0][-2:0:-1], TRAVEL])
TORN = broken(TRAVEL, PULL, at=0.01601)
SLIPS = ((0.006, 3.0), (0.012, 2.0))
SLIPPED = slipped(TRAVEL, PULL, *SLIPS)


def bent(less: float, at: float = 0.008) -> Floats:
    """A pull of 5 N/mm up to a place, and so much less beyond."""
    return PULL - less * np.maximum(TRAVEL - at, 0.0)


def with_sample(values: Floats, place: int, more: float) -> Floats:
    changed = values.copy()
    changed[place] += more
    return changed


FADING = 50e-6 * np.arange(160.0)
EARLIER = with_sample(TORN, int(np.flatnonzero(TRAVEL <= 0.01601)[-1]), -5.0)
NOISE_OF_TWO = np.random.default_rng(1).normal(0.0, 0.02, len(TWICE))
NOT_THERE = "{length: 1 m, section: {outer_diameter: 8 mm}}"

LOOP = loop(noise=1e-3)
LOOP_TIME = LOOP[0]
TOP = int(np.argmax(np.where(LOOP_TIME < 22.0, LOOP[2], -1.0)))
OF_LOOP = {
    **{"peak_force": 1.0, "peak_displacement": 0.010, "unloading_stiffness": 125.0},
    **{"energy": 0.5 * 1.0 * 0.010 - 0.5 * 1.0 * 0.008, "residual_displacement": 0.002},
}
OF_LOOPS = {f"{name}.{cycle}": true for name, true in OF_LOOP.items() for cycle in (1, 2)}


def part_of(record: tuple[Floats, Floats, Floats], stop: float) -> Iterator[Floats]:
    recorded = record[0] < stop
    return (values[recorded] for values in record)


def without_force(
    record: tuple[Floats, Floats, Floats], start: float, stop: float
) -> tuple[Floats, Floats, Floats]:
    time, path, force = record
    return time, path, np.where((time > start) & (time < stop), np.nan, force)


HARDENING = """\
results:
  - {result: loading-stiffness, over: 5 mm}
  - {result: hardening, over: 5 mm}
"""
ASKED = """\
results:
  - {result: initial-stiffness, from: 0.2 mm, to: 1.8 mm}
  - {result: kink, from: 0.2 mm, to: 5 mm}
  - {result: plateau, slope_below: 20 %}
  - result: bending-stiffness
    of: initial_stiffness
    support: cantilever
    length_uncertainty: 1 mm
"""
LENGTH = "specimen: {length: 100 mm}\n"
THREE_POINT = ASKED.replace("support: cantilever", "support: three-point")
BUNDLE = bundle(noise=LOOP_NOISE)
BUNDLE_TIME = BUNDLE[0]
FLAT_FROM = ONSET - 0.001 + 0.002 * (SECOND - 0.2 * FIRST) / (SECOND - FLAT)
LEVER = np.linspace(0.0, 0.005, 251) - 0.0025
FIRST_CYCLE = float(LEVER @ first_loading(LEVER + 0.0025) / (LEVER @ LEVER))

Case = tuple[Mapping[str, float], partial[Reduction]]


def of_pulls(truth: Mapping[str, float], *record: Floats, **options: object) -> Case:
    return truth, partial(of_pull, *record, **options)  # type: ignore[arg-type]


STIFF = {"stiffness": 5000.0}
CASES: dict[str, Case] = {
    "a straight pull": of_pulls(
        STIFF | {"compliance": 2e-4} | {area[:4]: 500.0 / size for area, size in AREAS.items()},
        *(TRAVEL, PULL),
        results=[LINE, *MODULI, "compliance, from: 10 N, to: 80 N", "peak-force", NORMALISED],
        specimen=SECTION,
        scale="1 %",
    ),
    "a break": of_pulls(
        {
            **{"failure_displacement": 0.01601, "failure_force": 80.05},
            **{"energy_to_break": 0.5 * 5e3 * 0.01601**2, "stiffness_per_peak_force": 5e3 / 80.05},
        },
        *(TRAVEL, TORN),
        curve=BREAK,
        results=[*AT_BREAK, LINE, NORMALISED],
        scale="5 %",
    ),
    "a specimen that tears slowly": of_pulls(
        {"failure_displacement": 0.015, "failure_force": 25.0},
        *(TRAVEL, PULL - 1e4 * np.maximum(TRAVEL - 0.01, 0.0)),
        curve=BREAK,
        results=["failure"],
    ),
    "a loss that began a sample earlier": of_pulls(
        {}, TRAVEL, EARLIER, curve=BREAK, results=AT_BREAK
    ),
    "a break in the second cycle": of_pulls(
        {
            **{"energy_to_break": 0.5 * 5e3 * 0.016**2, "stiffness": 5000.0},
            "stiffness_per_peak_force": 5000.0 / 80.0,
        },
        *(TWICE, broken(TWICE, 5e3 * TWICE + NOISE_OF_TWO, at=0.016)),
        curve=BREAK,
        results=[*AT_BREAK, "stiffness, from: 2 mm, to: 8 mm", NORMALISED],
    ),
    "no break": of_pulls({}, TRAVEL, PULL, curve=BREAK, results=[*AT_BREAK, LINE, NORMALISED]),
    "the stroke of the rig": of_pulls(
        {"peak_force.1": 99.9},
        *(TRAVEL, PULL),
        results=["peak-force"],
        specimen="{length: 100 mm}\nrig: {stroke: 20 mm}",
    ),
    "rows without times": of_pulls(
        {"stiffness": 5000.0, "slack": 0.003},
        *(TRAVEL, broken(TRAVEL, LOOSE, at=0.016)),
        curve=f"{BREAK}, {MARKED}, {SLACK}",
        results=[LINE, *AT_BREAK, "slack", "peak-force"],
        time=False,
    ),
    "rows that end while loading": of_pulls({}, TRAVEL, PULL, results=["peak-force"], time=False),
    "nothing moves": of_pulls(
        {},
        *(0.01 * TRAVEL, PULL),
        curve=f"{BREAK}, {MARKED}, {SLACK}",
        results=[*AT_BREAK, LINE, TWO, NORMALISED, MODULUS, "slack", "slips", TANGENTS],
    ),
    "windows behind the end": of_pulls(
        {},
        *(TRAVEL, PULL),
        results=[LINE.replace("10 mm", "30 mm"), NORMALISED, MODULUS],
        specimen=SECTION,
    ),
    "a window before the first sample": of_pulls({}, TRAVEL + 0.004, PULL, results=[LINE]),
    "a force that falls": of_pulls({}, TRAVEL, 200.0 - PULL, results=[LINE]),
    "no force": of_pulls({}, TRAVEL, PULL - 5e3 * TRAVEL, results=[LINE, NORMALISED]),
    "sizes that are missing": of_pulls(
        STIFF, TRAVEL, PULL, specimen="{section: {area: 5 mm**2}}", results=[LINE, MODULUS]
    ),
    "an outer diameter alone": of_pulls(
        STIFF, TRAVEL, PULL, specimen=NOT_THERE, results=[LINE, *MODULI]
    ),
    "a specimen as stiff as its machine": of_pulls(
        {"stiffness": 5e5}, TRAVEL, 100.0 * PULL, specimen=SECTION, results=[LINE, MODULUS]
    ),
    "a machine that was taken off": of_pulls(
        {"stiffness": 1.0 / (1.0 / 5e5 - 1e-7), "modulus": 0.1 / (1.0 / 5e5 - 1e-7) / 5e-6},
        *(TRAVEL, 100.0 * PULL),
        curve="compliance: {value: 0.1 um/N, uncertainty: 10 %}",
        results=[SLOPE, MODULUS],
        specimen=SECTION,
    ),
    "slips that are marked": of_pulls(
        {"slip_position.1": 0.006, "behind": 5000.0},
        *(TRAVEL, broken(TRAVEL, SLIPPED, at=0.019)),
        curve=f"{BREAK}, {MARKED}",
        results=[
            *(LINE, "stiffness, name: behind, from: 13 mm, to: 18 mm", MODULUS, NORMALISED),
            *("modulus, name: modulus_behind, of: behind, area: stated", "slips", TWO),
        ],
        specimen=SECTION,
    ),
    "slips that are repaired": of_pulls(
        {"stiffness": 5000.0, "failure_force": 90.0},
        *(TRAVEL, broken(TRAVEL, SLIPPED, at=0.018)),
        curve=f"{BREAK}, {REPAIRED}",
        results=[SLOPE, "failure", "peak-displacement"],
    ),
    "slips that end the curve": of_pulls(
        {},
        *(TRAVEL, SLIPPED),
        curve=f"{BREAK}, {MARKED.replace('marked', 'cut')}",
        results=["peak-force", "peak-displacement", SLOPE, "failure"],
    ),
    "too short for slips": of_pulls({}, *pull(length=0.0012), curve=MARKED, results=["slips"]),
    "slack and a break": of_pulls(
        {"slack": 0.003, "failure_displacement": 0.013, "stiffness": 5000.0},
        *(TRAVEL, broken(TRAVEL, LOOSE, at=0.016)),
        curve=f"{BREAK}, {SLACK}",
        results=["failure", "slack", LINE, "peak-displacement"],
    ),
    "slack that cannot be found": of_pulls(
        {},
        *(TRAVEL, broken(TRAVEL, LOOSE, at=0.016)),
        curve=f"{BREAK}, slack: {{from: 10 %, to: 10.1 %}}",
        results=["failure", "slack"],
    ),
    "slack and a frame that gives": of_pulls(
        {"slack": 0.003, "stiffness": 1.0 / (1.0 / 5000.0 - 1e-5)},
        *(TRAVEL, LOOSE),
        curve=f"compliance: {{value: 10 um/N, uncertainty: 10 %}}, {SLACK}",
        results=["slack", LINE],
    ),
    "no toe": of_pulls(
        {},
        *(TRAVEL + 0.001, 100.0 * (1.0 - np.exp(-TRAVEL / 0.004)) + (PULL - 5e3 * TRAVEL)),
        curve="slack: {from: 40 %, to: 70 %}",
        results=["slack", "peak-displacement"],
    ),
    "taut from the start": of_pulls(
        {},
        *(TRAVEL, PULL - 5e3 * TRAVEL**2),
        curve="slack: {from: 10 %, to: 30 %}",
        results=["slack"],
    ),
    "a preload": of_pulls(
        {"slack": -0.002},
        *(TRAVEL, PULL + 10.0),
        curve="slack: {from: 20 %, to: 50 %}",
        results=["slack", "peak-displacement"],
    ),
    "a bad sample": of_pulls(
        {"failure_force": 90.0, "peak_force.1": 90.0},
        *(TRAVEL, with_sample(broken(TRAVEL, PULL, at=0.018), 500, 1150.0)),
        curve=BREAK,
        results=["peak-force", "failure"],
    ),
    "two segments": of_pulls(
        {
            **{"segment_stiffness_first": 5000.0, "segment_stiffness_second": 2000.0},
            **{"break_point": 0.008, "modulus": 2000.0 * 0.1 / 5e-6},
            **{"kink_displacement": 0.008, "kink_force": 40.0},
        },
        *(TRAVEL, bent(3e3)),
        results=[TWO, MODULUS.replace("stiffness", "segment_stiffness_second"), KINK_OF_PULL],
        specimen=SECTION,
        scale="1 %",
    ),
    "no kink in a line": of_pulls({}, TRAVEL, PULL, results=[KINK_OF_PULL, TWO]),
    "no kink where a slope rises": of_pulls({}, TRAVEL, bent(-2e3), results=[KINK_OF_PULL]),
    **{  # Two lines meet at 2.0488 mm, by numpy, 20 000 samples and all breaks tried.
        f"a gradual bend, {phase:g} of a step off": of_pulls(
            {"kink_displacement": 2.0488e-3},
            *(FADING + 50e-6 * phase, 8.0 * (1.0 - np.exp(-(FADING + 50e-6 * phase) / 2e-3))),
            results=["kink, from: 0.2 mm, to: 5 mm"],
        )
        for phase in (0.0, 0.25, 0.75)
    },
    **{
        f"an end of {share:g} of the slope": of_pulls(
            STIFF, *(TRAVEL, bent((1.0 - share) * 5e3)), results=[SHORT_LINE, TANGENTS]
        )
        for share in (0.099, 0.09)
    },
    "loops": (OF_LOOPS | {"initial_stiffness": 100.0}, partial(of_loop, *LOOP)),
    "loops downwards": (
        {},  # a sign that is doubted
        partial(of_loop, LOOP_TIME, -LOOP[1], -LOOP[2]),
    ),
    "one loading": ({"initial_stiffness": 100.0}, partial(of_loop, *part_of(LOOP, 11.9))),
    "cut while unloading": ({"peak_force.2": 1.0}, partial(of_loop, *part_of(LOOP, 38.0))),
    "a gap in a loop": (
        {"energy.2": 0.001, "peak_displacement.1": 0.010},
        partial(of_loop, *without_force(LOOP, 15.0, 15.1)),
    ),
    "a gap beside the peak": (
        {"peak_force.2": 1.0},
        partial(of_loop, *without_force(LOOP, LOOP_TIME[TOP - 5], LOOP_TIME[TOP])),
    ),
    "a cycle without force": (
        {"peak_force.1": 1.0},
        partial(of_loop, *without_force(LOOP, 21.5, np.inf)),
    ),
    "hardening": (
        {
            **{"loading_stiffness.1": FIRST_CYCLE, "loading_stiffness.2": LATER},
            **{"loading_stiffness.3": LATER, "hardening.2": LATER / FIRST_CYCLE},
            "hardening.3": LATER / FIRST_CYCLE,
        },
        partial(of_loop, *BUNDLE, more=HARDENING),
    ),
    "a force that stays": (
        {"loading_stiffness.1": FIRST_CYCLE},
        partial(
            of_loop,
            *(*BUNDLE[:2], np.where(BUNDLE_TIME > 60.0, BUNDLE[2] + 2.0, BUNDLE[2])),
            more=HARDENING,
        ),
    ),
    "one cycle": (
        {"loading_stiffness.1": FIRST_CYCLE},
        partial(of_loop, *bundle(1, noise=LOOP_NOISE), more=HARDENING),
    ),
    "no first cycle": (
        {"loading_stiffness.2": LATER},
        partial(
            of_loop, *(*BUNDLE[:2], np.where(BUNDLE_TIME < 50.0, 0.0, BUNDLE[2])), more=HARDENING
        ),
    ),
    "a plateau": (
        {
            **{"initial_stiffness": FIRST, "bending_stiffness": FIRST * 0.1**3 / 3.0},
            **{"kink_displacement": KINK, "kink_force": FIRST * KINK, "end_slope": FLAT / FIRST},
            "plateau_displacement": FLAT_FROM,
            "plateau_force": float(first_loading(np.array([FLAT_FROM]))[0]),
        },
        partial(of_loop, *BUNDLE, more=LENGTH + ASKED),
    ),
    "no plateau": (
        {"end_slope": SECOND / FIRST, "bending_stiffness": FIRST * 0.1**3 / 48.0},
        partial(
            of_loop,
            *bundle(noise=LOOP_NOISE, has_plateau=False),
            more="specimen: {span: 100 mm}\n" + THREE_POINT,
        ),
    ),
    "a record that breaks off": (
        {"initial_stiffness": FIRST},
        partial(of_loop, *part_of(BUNDLE, 23.0), more=ASKED),
    ),
    "a force that is not known at the end": (
        {"initial_stiffness": FIRST},
        partial(of_loop, *without_force(BUNDLE, 40.0, 60.0), more=THREE_POINT),
    ),
}


def page(done: Reduction) -> Iterator[str]:
    """Notes, results with their budgets, and lines, to five digits.

    A cause that adds less than a ten-thousandth of the variance is named without its change, which
    may be rounding of the processor.
    """
    for note in done.reduced_test.findings.notes:
        yield f"{note.severity.value} {note.code} of {note.where}: {note.message}"
    for result in done.results:
        ends = result.interval and f" {result.interval.lower:.5g} to {result.interval.upper:.5g}"
        number = "-" if result.value is None else f"{result.value:.5g}{ends} {result.unit}"
        yield f"{result.name}: {number}, {result.n}, {result.status.value}; {result.full_method}"
        yield from (f"  {reason.code}: {reason.message}" for reason in result.reasons)
        parts = (
            f"{part.cause} {part.change:.3g}" if share > 1e-4 else part.cause
            for part, share in zip(result.budget, result.fractions, strict=True)
        )
        yield f"  {', '.join(parts) or 'no budget'}"
    for line in done.lines:
        numbers = (line.start, line.stop, line.level, line.slope)
        yield f"line of {line.result}: {' '.join(f'{number:.5g}' for number in numbers)}"


@pytest.mark.parametrize("name", CASES)
def test_records(name: str, approved: Approve) -> None:
    """Intervals hold the truth, values lie near it, and all digits are those that were approved."""
    truth, reduce = CASES[name]
    done = reduce()
    results = {result.name: result for result in done.results}
    for key, true in truth.items():
        result = results[key]
        assert result.status is Status.OK, result.reason_text
        assert result.interval is not None
        assert result.value == pytest.approx(true, rel=0.02)
        half = 0.5 * (result.interval.upper - result.interval.lower)
        assert result.value == pytest.approx(true, abs=2.0 * half)
    approved(page(done))
