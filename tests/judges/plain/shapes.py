"""Plain shapes of a test, made of straight lines and a few curves, and the file they stand in.

Travel in mm, force in N, time in s. The specimen is one straight line up and a sagging curve down,
so that a closed cycle has an area.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tests.judges.plain.definitions import Record, Samples

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
