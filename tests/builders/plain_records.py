"""Records that a spreadsheet could write: a machine that goes up and down, and what befalls it.

Knows nothing of the virtual lab: straight and round strokes of a spring, numpy alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from labpipe.records.arrays import Flags, Floats

STIFFNESS = 100.0
"""N/m"""
STROKE = 0.010
"""m"""


@dataclass(frozen=True, slots=True, eq=False)
class PlainRecord:
    """Time (s), displacement (m) and force (N), sample by sample."""

    time: Floats
    displacement: Floats
    force: Floats

    def where(self, kept: Flags) -> Self:
        """Some of the samples; the time stays as it was."""
        return replace(
            self,
            time=self.time[kept],
            displacement=self.displacement[kept],
            force=self.force[kept],
        )

    def up_to(self, end: float) -> Self:
        """The record cut off at a time."""
        return self.where(self.time <= end)

    def arrays(self) -> tuple[Floats, Floats, Floats]:
        """Time, displacement, force."""
        return self.time, self.displacement, self.force


def up_and_down(
    *,
    cycles: int = 2,
    rate: float = 50.0,
    rest: float = 2.0,
    branch: float = 5.0,
    is_round: bool = False,
    noise: float = 1e-3,
    seed: int = 0,
) -> PlainRecord:
    """Pull a spring of 100 N/m by 10 mm and let it back.

    Parameters
    ----------
    cycles, rate, rest, branch : how often; samples per second; s before and behind; s per branch
    is_round : a cosine in place of straight strokes
    noise : of force and displacement, as a share of their ranges
    seed : of the noise
    """
    time: Floats = np.arange(0.0, 2.0 * rest + 2.0 * branch * cycles, 1.0 / rate)
    phase = np.clip((time - rest) / branch, 0.0, 2.0 * cycles)
    share = 0.5 - 0.5 * np.cos(np.pi * phase) if is_round else 1.0 - np.abs(phase % 2.0 - 1.0)
    random = np.random.default_rng(seed)
    path = STROKE * (share + noise * random.normal(size=len(time)))
    peak = STIFFNESS * STROKE
    return PlainRecord(time, path, peak * (share + noise * random.normal(size=len(time))))
