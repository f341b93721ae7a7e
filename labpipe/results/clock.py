"""How the clocks of a test lie to each other, as results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from labpipe.records.declarations import Needs, Output
from labpipe.records.estimates import Estimate, Failure
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import Computed, Kind, Outcome, blocked_or


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockResult(Kind):
    """``clock_offset`` (s) and ``clock_drift`` (1) of the two clocks."""

    result: ClassVar = "clock"
    outputs: ClassVar = (
        Output("clock_offset", "s", "Offset of the clocks", ("clock",)),
        Output("clock_drift", "1", "Drift of the clocks", ("clock",)),
    )
    needs: ClassVar = Needs(clocks=True)

    def compute(self, test: Evidence) -> Computed:
        """Force time against marker time, as the clocks were joined."""
        fit = test.clocks.force
        if fit is None:
            why = blocked_or(test, Failure("one_clock", "there is only one clock"))
            return self.not_available(why, "how the clocks of force and motion were joined")
        events = len(fit.event_times_motion)
        offset = Estimate(fit.offset, fit.offset_interval.standard_error, events)
        drift: Outcome = Estimate(fit.drift, fit.drift_interval.standard_error, events)
        if np.isnan(fit.drift_interval.lower):
            drift = Failure("one_event", "one turning point gives an offset but no drift")
        return Computed(
            tuple(
                self.number(output, outcome, fit.method)
                for output, outcome in zip(self.outputs, (offset, drift), strict=True)
            )
        )


KINDS = (ClockResult,)
