"""The plain shapes: what stands in each file, what is wrong with it, and what that may touch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tests.judges.plain.definitions import Samples
from tests.judges.plain.numbers import USUAL, Asked
from tests.judges.plain.shapes import (
    NEWTON,
    PEAK,
    STROKE,
    Table,
    clock,
    pull,
    pulled,
    sine,
    triangle,
    whole,
)

CUT = "partial_cycle|truncated|cut|ends"
UNDER_LOAD = "under_load|begins|start|zero|not_unloaded"
CLIPPED = "saturat|clip"
FROZEN = "frozen|constant|stuck|stale|held|stands"
DRIFT = "zero|drift|jump"
SIGN = "sign|negative|reversed|down|compress"
BLANK = "missing|blank|not_finite|gap"
NO_BREAK = "no_break|no_failure"
STILL = "no_motion|constant|no_cycle"


@dataclass(frozen=True)
class Case:
    """One file; results that match no pattern of `hurt` must be ok."""

    name: str
    table: Table
    asked: Asked = USUAL
    true: Table | None = None
    """The faultless recording, if the file has a fault; numbers are judged by it."""
    hurt: Mapping[str, str] = field(default_factory=dict)
    refusal: str = ""
    sign_free: bool = False
    steps: str = ""
    smooth: int = 0
    """Samples of a moving average over both channels."""
    stated: str = ""
    """What the protocol says of the force beside the name of its channel."""
    kept: float = 1.0
    """Share of the bytes of the file that is there."""

    def noisy(self) -> Case:
        """With noise of 0.1 % of the largest force and 0.5 um, in the faultless recording, too."""
        true = None if self.true is None else self.true.noisy()
        return replace(self, name=f"{self.name}+noise", table=self.table.noisy(), true=true)


def table(time: Samples, travel: Samples, force: Samples) -> Table:
    return Table(time, np.asarray(travel, dtype=float), np.asarray(force, dtype=float))


def triangles() -> Iterator[Case]:
    """At 10 Hz, with few and many samples in a branch, sampled at any phase."""
    for samples in (8, 12, 20, 40, 200):
        for phase in (0.0, 0.3, 0.5, 0.77):
            up = samples / 10.0
            time = clock(whole(up), 10.0, phase)
            yield Case(f"triangle-{samples}-phase-{phase}", triangle(time, up=up).recorded())


def cyclic() -> Iterator[Case]:
    for samples in (20, 200):
        up = samples / 10.0
        time = clock(2.0 + 6.0 * up, 10.0, 0.3)
        yield Case(f"sine-{samples}", sine(time, period=2.0 * up).recorded())
    for rate, down in ((10.0, 0.1), (100.0, 0.1), (100.0, 1.0)):
        motion = triangle(clock(whole(10.0, down=down), rate, 0.3), down=down)
        yield Case(f"sawtooth-{rate:g}Hz-{down:g}s", motion.recorded())
    for rate in (10.0, 100.0):
        for dwell in (1.0, 5.0):
            motion = triangle(clock(whole(dwell=dwell), rate, 0.3), dwell=dwell)
            yield Case(f"dwell-{dwell:g}s-{rate:g}Hz", motion.recorded())
    for cycles, up in ((1, 10.0), (2, 10.0), (155, 1.0)):
        time = clock(whole(up, cycles=cycles), 20.0, 0.3)
        yield Case(f"cycles-{cycles}", triangle(time, up=up, cycles=cycles).recorded())
    steps = np.where(np.arange(2000) % 100 < 30, 0.1, 0.005)
    time = np.cumsum(steps)
    yield Case("variable-rate", triangle(time[time < whole()]).recorded())
    for unit in ("kN", "lbf", "mN"):
        motion = triangle(clock(whole(), 20.0, 0.3))
        yield Case(
            f"unit-{unit}", replace(motion.recorded(pulled(motion) / NEWTON[unit]), unit=unit)
        )
    motion = triangle(clock(whole(), 20.0), rest=0.0)
    yield Case("no-rest-before", motion.recorded())
    motion = triangle(clock(60.0 + whole(), 20.0, 0.3), rest=60.0)
    yield Case("long-rest-before", motion.recorded())
    motion = triangle(clock(whole(), 20.0, 0.3))
    yield Case("force-in-steps", motion.recorded(np.round(2.0 * pulled(motion)) / 2.0))
    motion = triangle(clock(whole(), 100.0))
    half = "{step: smooth, channel: %s, method: moving-average, span: 21 samples}"
    steps_ = f"  - {half % 'force'}\n  - {half % 'displacement'}\n"
    yield Case("smoothed", motion.recorded(), steps=steps_, smooth=21)


def zeroed() -> Iterator[Case]:
    """The file counts from 5 N and 3 mm; the protocol takes that off."""
    for name, by, rate, rest in (
        ("zero-mean", "mean", 20.0, 1.0),
        ("zero-line-10Hz", "line", 10.0, 0.0),
        ("zero-line-100Hz", "line", 100.0, 0.0),
        # Begins to move within the stretch: neither mean nor line is right.
        ("zero-line-over-rest-and-motion", "line", 100.0, 0.25),
        ("zero-mean-over-rest-and-motion", "mean", 100.0, 0.25),
    ):
        true = triangle(clock(whole(), rate), rest=rest).recorded()
        off = replace(true, travel=true.travel + 3.0, force=true.force + 5.0)
        hurt = {"*": "zero"} if "motion" in name else {}
        yield Case(name, off, true=true, steps=zero(by), hurt=hurt)


def zero(by: str) -> str:
    each = "  - {{step: zero, channel: {}, over: 0.5 s, by: {}}}\n"
    return each.format("force", by) + each.format("displacement", by)


def relaxed(time: Samples, since: float) -> Samples:
    """Share of the force that is left of a hold."""
    return np.asarray(0.7 + 0.3 * np.exp(-np.clip(time - since, 0.0, None) / 200.0))


def holds() -> Iterator[Case]:
    ends = {"energy.1": CUT}
    for name, rest, minutes in (
        ("30min", 1.0, 30.0),
        ("30min-no-rest", 0.0, 30.0),
        ("1h", 1.0, 60.0),
    ):
        time = clock(rest + 10.0 + 60.0 * minutes, 10.0)
        travel = np.minimum(pull(time, rest=rest), STROKE)
        held = table(time, travel, 10.0 * travel * relaxed(time, rest + 10.0))
        yield Case(f"ramp-hold-{name}", held, hurt=ends)
    time = clock(1822.0, 10.0)
    travel = np.interp(time, [1.0, 11.0, 1811.0, 1821.0], [0.0, STROKE, STROKE, 0.0])
    down = np.maximum(10.0 * travel - 30.0, 0.0)
    force = np.where(time > 1811.0, down, 10.0 * travel * relaxed(time, 11.0))
    yield Case("ramp-hold-unload", table(time, travel, force))
    time = clock(611.0, 10.0)
    travel = np.minimum(pull(time, rest=1.0), STROKE)
    grown = travel + np.log1p(np.clip(time - 11.0, 0.0, None) / 60.0)
    # Force that stands to the last digit while the motion goes on looks full, or frozen.
    creep = {"peak_*": CUT, "energy.1": CUT}
    full = {"peak_force.1": f"{CUT}|{CLIPPED}|{FROZEN}", **creep}
    yield Case("creep", table(time, grown, 10.0 * travel), hurt=full)
    yield replace(Case("creep", table(time, grown, 10.0 * travel), hurt=creep).noisy())


def necking(travel: Samples) -> Samples:
    """Up to 98 N, then smoothly down to 70 N at 20 mm, where it breaks within 20 ms."""
    smooth = PEAK * (1.0 - np.exp(-travel)) - 30.0 * (np.clip(travel - 4.0, 0.0, None) / 16.0) ** 2
    share = np.clip(1.0 - (travel - 20.0) / 0.02, 0.0, 1.0)
    return np.asarray(smooth * np.where(travel > 20.0, share, 1.0))


def yarn(travel: Samples, loss: float) -> Samples:
    """Up to 100 N at 10 mm, then one part after the other lets go; what is left is pulled on."""
    lost = np.floor(np.clip(travel - STROKE + 1e-9, -1.0, None)) + 1.0
    pulled_on = np.clip(travel - STROKE, 0.0, None)
    force = 10.0 * np.minimum(travel, STROKE) + pulled_on - PEAK * loss * lost
    return np.maximum(force, 0.0)


def breaks() -> Iterator[Case]:
    ends = {"energy.1": CUT, "peak_displacement.1": CUT}
    for rate in (10.0, 100.0, 1000.0):
        time = clock(21.5, rate, 0.3)
        necked = table(time, pull(time), necking(pull(time)))
        small = Asked(window=(0.2, 1.2))
        yield Case(f"necking-{rate:g}Hz", necked, asked=small, hurt=ends)
        time = clock(11.5, rate, 0.3)
        force = np.where(pull(time) <= STROKE, 10.0 * pull(time), 0.0)
        yield Case(f"brittle-{rate:g}Hz", table(time, pull(time), force), hurt=ends)
    for loss in (0.08, 0.15):
        time = clock(26.0, 20.0, 0.3)
        steps = {"failure*": f"lost_in_steps|slip|{NO_BREAK}"} if loss == 0.15 else {}
        steps |= {"energy_to_break": steps["failure*"]} if steps else {}
        torn = table(time, pull(time), yarn(pull(time), loss))
        yield Case(f"yarn-{100 * loss:g}%", torn, hurt=ends | steps)
    time = clock(14.0, 50.0, 0.3)
    force = np.where(pull(time) <= 12.0, 10.0 * np.clip(pull(time) - 2.0, 0.0, None), 0.0)
    slack = Asked(window=(2.0, 8.0), slack=True)
    yield Case("slack", table(time, pull(time), force), asked=slack, hurt=ends)


def cuts() -> Iterator[Case]:
    for rate in (10.0, 100.0, 200.0):
        true = triangle(clock(whole(), rate, 0.3)).recorded()
        yield Case(
            f"cut-in-loading-{rate:g}Hz", true.rows(true.time < 46.0), true=true, hurt={"*.3": CUT}
        )
        less = true.rows(true.time < 56.0)
        yield Case(f"cut-in-unloading-{rate:g}Hz", less, true=true, hurt={"energy.3": CUT})
    motion = triangle(clock(60.0, 20.0), rest=0.0)
    true, keep = motion.recorded(), int(0.99 * 1201)
    short = true.rows(slice(0, keep))
    yield Case("cut-at-99%-of-rows", short, true=true, hurt={"energy.3": CUT})
    yield Case("cut-in-a-row", true, true=true, kept=0.97, hurt={"energy.3": CUT})
    time = clock(11.5, 50.0, 0.3)
    true = table(time, pull(time), np.where(time <= 10.0, 10.0 * pull(time), 0.0))
    broken = {"peak_*": CUT, "energy*": f"{CUT}|{NO_BREAK}", "failure*": f"{CUT}|{NO_BREAK}"}
    yield Case("cut-before-break", true.rows(true.time < 9.0), true=true, hurt=broken)
    time = clock(10.0, 20.0)
    ends = {"peak_*": CUT, "energy.1": CUT}
    yield Case("never-unloads", table(time, pull(time), 10.0 * pull(time)), hurt=ends)


def starts() -> Iterator[Case]:
    """The first loading has begun when the recording does."""
    for share in (5, 10, 20):
        true = triangle(clock(whole(), 20.0), rest=0.0).recorded()
        late = true.rows(true.time > 10.0 * share / 100.0)
        for by in ("mean", "line", ""):
            yield Case(
                f"begins-under-load-{share}%{'-zero-' if by else ''}{by}",
                late,
                true=true,
                hurt={"*": UNDER_LOAD, "stiffness": f"{UNDER_LOAD}|not_reached"},
                steps=zero(by) if by else "",
            )
    true = triangle(clock(whole(), 20.0), rest=0.0).recorded()
    peak = {"*": f"{UNDER_LOAD}|{SIGN}|not_reached|no_cycle|{CUT}"}
    yield Case("starts-at-the-peak", true.rows(true.time >= 10.0), true=true, hurt=peak)


def channels() -> Iterator[Case]:
    """A channel that is full, stands still, or whose zero moves.

    Noise comes before the fault: a full or frozen channel repeats its number to the last digit.
    """
    quiet = triangle(clock(whole(), 100.0, 0.3)).recorded()
    for true, suffix in ((quiet, ""), (quiet.noisy(), "+noise")):
        for case in (*full(true), *standing(true), *moving_zero(true)):
            yield replace(case, name=case.name + suffix, true=true)


def full(true: Table) -> Iterator[Case]:
    for share in (10, 60):
        level = float(np.quantile(true.force, 1.0 - share / 100.0))
        touched = ("peak_force.*", "energy.*", *(["stiffness"] if level < 80.0 else []))
        clipped = replace(true, force=np.minimum(true.force, level))
        yield Case(f"clipped-{share}%", clipped, hurt=dict.fromkeys(touched, CLIPPED))


def standing(true: Table) -> Iterator[Case]:
    for name, since, hurt in (
        ("first-loading", 5.0, ("stiffness", "peak_force.1", "energy.1")),
        ("second-loading", 25.0, ("peak_force.2", "energy.2")),
    ):
        held = replace(true, force=frozen(true.force, true.time, since))
        yield Case(f"frozen-force-{name}", held, hurt=dict.fromkeys(hurt, FROZEN))
        held = replace(true, travel=frozen(true.travel, true.time, since))
        codes = dict.fromkeys((*hurt, f"*.{hurt[-1][-1]}"), FROZEN)
        yield Case(f"frozen-travel-{name}", held, hurt=codes)


def moving_zero(true: Table) -> Iterator[Case]:
    spiked = true.force.copy()
    spiked[1500] += 50.0
    yield Case("spike", replace(true, force=spiked), hurt={"*.1": "stray|spike"})
    moved = dict.fromkeys(("peak_force.*", "energy.*", "stiffness"), DRIFT)
    jump = replace(true, force=true.force + np.where(true.time > 26.0, 10.0, 0.0))
    yield Case("zero-jumps", jump, hurt=moved, steps=zero("mean"))
    drift = replace(true, force=true.force + 10.0 * true.time / true.time[-1])
    yield Case("zero-drifts", drift, hurt=moved, steps=zero("mean"))


def frozen(values: Samples, time: Samples, since: float) -> Samples:
    """A fifth of the record holds the value that its first sample has."""
    first = int(np.searchsorted(time, since))
    held = values.copy()
    held[first : first + len(values) // 5] = values[first]
    return held


def signs() -> Iterator[Case]:
    true = triangle(clock(whole(), 20.0, 0.3)).recorded()
    sign: Mapping[str, str] = {"*": SIGN}
    for name, travel, force in (
        ("counts-down", -true.travel, true.force),
        ("compression-negative", -true.travel, -true.force),
    ):
        turned = replace(true, travel=travel, force=force)
        yield Case(name, turned, sign_free=True, hurt=sign)


def scales() -> Iterator[Case]:
    """What the protocol says of the force contradicts the file."""
    true = triangle(clock(whole(), 20.0, 0.3)).recorded()
    small = replace(true, force=true.force / 1e3, unit="kN")
    yield Case("unit-contradicted", small, stated=", unit: N", hurt={"*": "unit"}, refusal="unit")
    hurt = dict.fromkeys(("peak_force.*", "energy.*", "stiffness"), "implausible|scale|unit")
    wrong = replace(true, force=true.force / 1e3)
    limits = ", plausible_peak: {from: 20 N, to: 5 kN}"
    yield Case("scale-implausible", wrong, true=true, stated=limits, hurt=hurt)


def bad() -> Iterator[Case]:
    """A number, or a reason that a technician understands."""
    five: Samples = np.arange(5.0) / 4.0
    few = "few_samples|partial_cycle|no_motion|not_reached"
    given = table(five, 10.0 * five, PEAK * five)
    yield Case("five-samples", given, hurt={"*": few}, refusal="samples")
    flat = np.ones(200)
    given = table(0.1 * np.arange(200.0), flat, flat)
    yield Case("all-equal", given, hurt={"*": STILL}, refusal="constant|never changes|not move")
    true = triangle(clock(whole(), 20.0)).recorded()
    twice = replace(true, time=np.repeat(true.time[::2], 2)[: len(true.time)])
    yield Case("time-repeats", twice, true=true, hurt={"*": "time"}, refusal="time")
    back = true.time.copy()
    back[600:] -= 20.0
    backwards = replace(true, time=back)
    yield Case("time-runs-back", backwards, true=true, hurt={"*": "time"}, refusal="time")
    force = true.force.copy()
    force[:15] = force[-15:] = np.nan
    blank = replace(true, force=force)
    yield Case("blank-at-both-ends", blank, true=true, hurt={"*": BLANK})
    travel = np.where(np.arange(len(true.time)) % 40 < 10, np.nan, true.travel)
    gone = replace(true, travel=travel)
    yield Case("blank-quarter", gone, true=true, hurt={"*": BLANK}, refusal=BLANK)
    motion = triangle(clock(whole(0.05, down=5.0), 20.0), up=0.05, down=5.0)
    yield Case(
        "one-sample-branch", motion.recorded(), hurt={"stiffness": "too_few_samples|not_reached"}
    )
    random = np.random.default_rng(3)
    shaken = 0.05 * true.travel + 2.0 * random.standard_normal(len(true.travel))
    lost = {"*": "noise|no_motion|scatter"}
    noise = replace(true, travel=shaken, force=0.05 * true.force)
    still = replace(true, travel=0.05 * true.travel)
    yield Case("noise-above-stroke", noise, true=still, hurt=lost, refusal="noise|motion|scatter")


CLEAN: tuple[Callable[[], Iterator[Case]], ...] = (triangles, cyclic, zeroed, holds, breaks)
FAULTY: tuple[Callable[[], Iterator[Case]], ...] = (cuts, starts, channels, signs)


def all_cases() -> list[Case]:
    """Every shape free of noise and with it, but for those that noise would only blur."""
    both = [case for family in (*CLEAN, *FAULTY) for case in family()]
    names = {case.name for case in both}
    noisy = [case.noisy() for case in both if not case.name.endswith("+noise")]
    return [*both, *(each for each in noisy if each.name not in names), *scales(), *bad()]
