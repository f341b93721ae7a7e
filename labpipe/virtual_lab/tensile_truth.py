"""What really happened in a virtual tensile test, for whoever checks the processing against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenario import TensileScenario

_STEPS = 100_001


@dataclass(frozen=True, slots=True)
class SlipTruth:
    """One grip slip: `position` m of displacement at which the fall begins, `drop` N."""

    position: float
    drop: float


@dataclass(frozen=True, slots=True, eq=False)
class TensileTruth:
    """What really happened, free of tare, gain error and noise.

    *As seen at the crosshead* means with the machine's give in it, which is what a test without
    compliance correction measures. All displacements count from where the crosshead stood before
    the test; whoever counts from the first sample is `displacement[0]` lower.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, at the samples of the record
    foot : m, displacement at which the first straight line meets zero force
    stiffness_first, stiffness_second : N/m, as seen at the crosshead
    specimen_stiffness_first, specimen_stiffness_second : N/m, of the specimen alone
    break_point : m, displacement at which the two straight lines cross, as seen at the crosshead;
        None if the test ends before
    break_point_from_foot : m, the same, from the foot
    break_force : N, at which they cross
    peak_force : N, largest
    peak_displacement : m, at which it is reached
    failure_displacement : m, at which the force begins to be lost; None without a failure
    failure_force : N, there; None without a failure
    energy_to_break : J, integral of force over displacement up to failure; None without one
    slips : in order
    """

    time: Floats
    displacement: Floats
    force: Floats
    foot: float
    stiffness_first: float
    stiffness_second: float
    specimen_stiffness_first: float
    specimen_stiffness_second: float
    break_point: float | None
    break_point_from_foot: float | None
    break_force: float | None
    peak_force: float
    peak_displacement: float
    failure_displacement: float | None
    failure_force: float | None
    energy_to_break: float | None
    slips: tuple[SlipTruth, ...]


def tell_tensile_truth(path: TensilePath, time: Floats) -> TensileTruth:
    """Look up what really happened.

    Parameters
    ----------
    path : the test
    time : shape (n,), s, of the samples

    Returns
    -------
    The truth.
    """
    scenario = path.scenario
    law, give = scenario.law, scenario.frame.compliance
    fine = np.linspace(0.0, path.last_time, _STEPS)
    travelled, pulled = path.displacement(fine), path.force(fine)
    top = int(np.argmax(pulled))
    break_force = law.stiffness_first * law.break_point
    from_foot = law.break_point + give * break_force
    bends = law.foot + from_foot < scenario.last_displacement
    failed = scenario.failure is not None
    return TensileTruth(
        time=time,
        displacement=path.displacement(time),
        force=path.force(time),
        foot=law.foot,
        stiffness_first=in_series(law.stiffness_first, give),
        stiffness_second=in_series(law.stiffness_second, give),
        specimen_stiffness_first=law.stiffness_first,
        specimen_stiffness_second=law.stiffness_second,
        break_point=law.foot + from_foot if bends else None,
        break_point_from_foot=from_foot if bends else None,
        break_force=break_force if bends else None,
        peak_force=float(pulled[top]),
        peak_displacement=float(travelled[top]),
        failure_displacement=scenario.last_displacement if failed else None,
        failure_force=float(pulled[-1]) if failed else None,
        energy_to_break=float(np.trapezoid(pulled, travelled)) if failed else None,
        slips=_slips(scenario),
    )


def in_series(stiffness: float, compliance: float) -> float:
    """Stiffness, N/m, of a specimen in line with a machine of some compliance, m/N."""
    return stiffness / (1.0 + stiffness * compliance)


def _slips(scenario: TensileScenario) -> tuple[SlipTruth, ...]:
    return tuple(SlipTruth(slip.position, slip.drop) for slip in scenario.slips)
