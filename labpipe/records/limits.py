"""From which difference on does the lab doubt a record: shares, speeds, times.

These are judgements of a laboratory, not tolerances of an algorithm. Each is a key of the block
``limits`` of a protocol or test sheet, with the default here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from labpipe.records.declarations import Compliance, Duration, LinearMass, Ratio, Share


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Differences beyond which a record or a number is doubtful."""

    speed_deviation: Annotated[
        Share, "Mean speed of the first branch against `rig.crosshead_speed`"
    ] = 0.2
    mid_span_deviation: Annotated[
        Share, "Mid-span deflection seen by cameras against the displacement"
    ] = 0.2
    zero_overlap: Annotated[Duration, "Time by which a zero reaches into the motion"] = 0.25
    rest_force: Annotated[
        Ratio, "Force before the motion that no step zeroes, of the largest force"
    ] = 0.005
    rest_force_drift: Annotated[
        Ratio, "Change of the force at rest over the test, of the largest force"
    ] = 0.03
    pulling_force: Annotated[
        Ratio, "Force below zero of a load that only presses, of the largest force"
    ] = 0.02
    hold_time: Annotated[Duration, "Time that the motion stands within a test"] = 0.25
    loading_shortfall: Annotated[
        Ratio, "Distance to the earlier turns at which a record ends, of the stroke"
    ] = 0.005
    unloading_shortfall: Annotated[
        Ratio, "Distance to the start at which a record ends, of the stroke"
    ] = 0.02
    force_shortfall: Annotated[
        Ratio, "Part of the last branch that the record of the force lacks"
    ] = 0.02
    cycle_change: Annotated[
        Ratio, "Change of scale, or of level (of the largest force), between two cycles"
    ] = 0.008
    force_lag: Annotated[
        Ratio, "Median growth of the force after the turns, of the largest force"
    ] = 0.007
    turn_jump: Annotated[Ratio, "Growth of the force after one turn, of the largest force"] = 0.03
    energy_gain: Annotated[Ratio, "Energy that a cycle gives back beyond that of its loading"] = (
        0.05
    )
    broken_force: Annotated[
        Share, "Force on the way back of a broken specimen, of the first loading"
    ] = 0.05
    second_loading: Annotated[
        Share, "Force in a loading after a break that is another specimen, of the first loading"
    ] = 0.5
    machine_compliance: Annotated[
        Compliance, "Compliance of frame and grips that is assumed where none is stated"
    ] = 1e-7
    machine_share: Annotated[
        Share, "Part of the displacement that this compliance makes before a modulus is doubtful"
    ] = 0.02
    unstated_mass: Annotated[LinearMass, "Mass per length that is assumed where none is stated"] = (
        1e-3
    )
    weight_share: Annotated[
        Share, "Part of a moment that this mass makes before a bending stiffness is doubtful"
    ] = 0.01


LIMITS = Limits()
