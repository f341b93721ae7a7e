"""The slip ledger: where a specimen slid in its grips, and what was done about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from labpipe.records.curve import Interval


class SlipDecision(StrEnum):
    """What is done about a slip."""

    MARKED = "marked"
    """Noted; the curve stays as measured."""
    REPAIRED = "repaired"
    """The force lost is added back to all that follows; drops add up."""
    CUT = "cut"
    """The curve ends before it."""


@dataclass(frozen=True, slots=True)
class Slip:
    """One sudden loss of force at constant speed after which the force goes on lower.

    Parameters
    ----------
    position : m, displacement at which the force falls
    drop : N, force lost, positive
    position_interval, drop_interval : 95 %
    decision : what was done
    start, stop : samples of the curve between which the force falls; `stop` is the first one after
    """

    position: float
    drop: float
    position_interval: Interval
    drop_interval: Interval
    decision: SlipDecision
    start: int
    stop: int
