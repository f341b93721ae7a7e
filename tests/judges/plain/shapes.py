"""Plain shapes of a test, made of straight lines and a few curves, and the file they stand in.

Travel in mm, force in N, time in s. The specimen is one straight line up and a sagging curve down,
so that a closed cycle has an area.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tests.judges.plain.definitions import USUAL, Asked, Record, Samples

STROKE = 10.0
"""mm"""


PEAK = 100.0
"""N, at the end of the stroke"""


NEWTON = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605}


LOOP = 0.4
"""How far the force sags on the way down, as a share of what is on the way up, near zero."""


@dataclass(frozen=True)
class Motion:
    """Where the frame is, and which way it goes (1 up, -1 down), at any time; mm."""

    time: Samples
    travel: Samples
    loading: Samples

    def recorded(self, force: Samples | None = None) -> Table:
        return Table(self.time, self.travel, pulled(self) if force is None else force)


@dataclass(frozen=True)
class Table:
    """Columns of the file: s, mm, and N until `unit` says another."""

    time: Samples
    travel: Samples
    force: Samples
    unit: str = "N"

    def rows(self, chosen: npt.NDArray[np.bool_] | slice) -> Table:
        at = chosen if isinstance(chosen, slice) else np.flatnonzero(chosen)
        return replace(self, time=self.time[at], travel=self.travel[at], force=self.force[at])

    def noisy(self, seed: int = 1, force: float = 0.1, travel: float = 5e-4) -> Table:
        """White noise of the given standard deviations, N and mm; the same seed, the same noise."""
        random = np.random.default_rng(seed)
        return replace(
            self,
            force=self.force + force / NEWTON[self.unit] * random.standard_normal(len(self.force)),
            travel=self.travel + travel * random.standard_normal(len(self.travel)),
        )

    def record(self) -> Record:
        """As the file has it, in SI."""
        return Record(self.time, 1e-3 * self.travel, NEWTON[self.unit] * self.force)

    def csv(self) -> bytes:
        """A TestSuite export with every cell quoted; blank where a number is missing."""
        head = ["File Path: C:\\Plain\\Run 1\\DAQ- Crosshead.csv", "Test: Plain shape"]
        head += ["Test Run: Run 1", "Date: 3/9/2026 10:05:00 AM", "", ""]
        rows = [[line] for line in head]
        rows += [["Crosshead ", "Load ", "Time "], ["mm", self.unit, "sec"]]
        columns = (self.travel, self.force, self.time)
        rows += [[_cell(x) for x in row] for row in zip(*columns, strict=True)]
        text = "\r\n".join(",".join(f'"{cell}"' for cell in row) for row in rows)
        return (text + "\r\n").encode("utf-8-sig")


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.10G}"


def pulled(motion: Motion, peak: float = PEAK) -> Samples:
    """Up: straight. Down: straight times 0.6 at zero, growing to 1 at the end of the stroke."""
    share = motion.travel / STROKE
    down = 1.0 - LOOP * (1.0 - share)
    return np.asarray(peak * share * np.where(motion.loading > 0, 1.0, down))


def clock(seconds: float, rate: float, phase: float = 0.0) -> Samples:
    """Sampling times; the first one `phase` steps after zero."""
    return np.arange(0.0, seconds * rate - phase + 1e-9) / rate + phase / rate


def triangle(
    time: Samples,
    *,
    up: float = 10.0,
    down: float | None = None,
    dwell: float = 0.0,
    cycles: int = 3,
    rest: float = 1.0,
) -> Motion:
    """Up, stand for `dwell`, down, stand for `dwell`, and again; `rest` before and behind (s)."""
    down = up if down is None else down
    corners, places = [0.0], [0.0]
    for length, place in [(rest, 0.0), *[(up, 1), (dwell, 1), (down, 0), (dwell, 0)] * cycles]:
        corners.append(corners[-1] + max(length, 1e-9))
        places.append(STROKE * place)
    travel = np.interp(time, corners, places)
    around = up + down + 2.0 * dwell
    loading = np.where((time - rest) % around <= up + 1e-9, 1.0, -1.0)
    return Motion(time, travel, loading)


def sine(time: Samples, *, period: float = 10.0, cycles: int = 3, rest: float = 1.0) -> Motion:
    """From zero to the stroke and back, standing before and behind."""
    turns = np.clip((time - rest) / period, 0.0, cycles)
    travel = 0.5 * STROKE * (1.0 - np.cos(2.0 * np.pi * turns))
    return Motion(time, travel, np.where(turns % 1.0 <= 0.5, 1.0, -1.0))


def whole(
    up: float = 10.0, *, down: float | None = None, dwell: float = 0.0, cycles: int = 3
) -> float:
    """Seconds of `triangle` with both rests of 1 s."""
    return 2.0 + cycles * (up + (up if down is None else down) + 2.0 * dwell)


def pull(time: Samples, speed: float = 1.0, rest: float = 0.0) -> Samples:
    """Travel of a frame that goes one way, mm."""
    return np.clip(time - rest, 0.0, None) * speed


CUT = "partial_cycle|truncated|cut|ends"


UNDER_LOAD = "under_load|begins|start|zero|not_unloaded"


CLIPPED = "saturat|clip"


FROZEN = "frozen|constant|stuck|stale|held|stands"


DRIFT = "zero|drift|jump"


SIGN = "sign|negative|reversed|down|compress"


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


def zero(by: str) -> str:
    each = "  - {{step: zero, channel: {}, over: 0.5 s, by: {}}}\n"
    return each.format("force", by) + each.format("displacement", by)


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


CLEAN: tuple[Callable[[], Iterator[Case]], ...] = (triangles, cyclic, breaks)


FAULTY: tuple[Callable[[], Iterator[Case]], ...] = (cuts, starts, channels)


def all_cases() -> list[Case]:
    """Every shape free of noise and with it, but for those that noise would only blur."""
    both = [case for family in (*CLEAN, *FAULTY) for case in family()]
    names = {case.name for case in both}
    noisy = [case.noisy() for case in both if not case.name.endswith("+noise")]
    return [*both, *(each for each in noisy if each.name not in names)]
