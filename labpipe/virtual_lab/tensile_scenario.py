"""What a virtual tensile test is: specimen, load frame, instruments and export, as frozen settings.

Everything is SI. Displacement is how far the crosshead has been driven from where it stood before
the test; force is the tension in the specimen. The specimen is slack at first; its *foot* is the
displacement at which its first straight region, carried on downwards, meets zero force.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Program(StrEnum):
    """The program of the load frame, and with it the layout of the export."""

    TEST_SUITE = "MTS TestSuite"
    R_CONTROLLER = "TestResources R-Controller"


@dataclass(frozen=True, slots=True)
class BilinearLaw:
    """Force of the specimen against the distance between its ends: slack, toe, two straight lines.

    Parameters
    ----------
    stiffness_first, stiffness_second : N/m
    break_point : m, from the foot to where the two straight lines cross
    knee : m, length over which the slope goes from one to the other, half of it on either side of
        the break point; 0 for a sharp bend
    slack : m, distance before the specimen pulls at all
    toe : m, length over which the slope grows from nothing to the first stiffness; 0 for a corner
    """

    stiffness_first: float
    stiffness_second: float
    break_point: float
    knee: float = 0.0
    slack: float = 0.0
    toe: float = 0.0

    def __post_init__(self) -> None:
        first, second = self.stiffness_first, self.stiffness_second
        if not (first > 0.0 and second >= 0.0):
            message = (
                f"stiffness_first={first} must be above, stiffness_second={second} not below 0"
            )
            raise ValueError(message)
        if min(self.knee, self.slack, self.toe) < 0.0:
            message = f"knee={self.knee}, slack={self.slack}, toe={self.toe}: not negative"
            raise ValueError(message)
        if self.break_point < 0.5 * (self.knee + self.toe):
            message = f"break_point={self.break_point} m: toe and knee overlap"
            raise ValueError(message)

    @property
    def foot(self) -> float:
        """Distance at which the first straight line meets zero force, m."""
        return self.slack + 0.5 * self.toe


@dataclass(frozen=True, slots=True)
class GripSlip:
    """One sudden slide of the specimen in its grips.

    Parameters
    ----------
    position : m, displacement at which the force begins to fall
    drop : N, force lost; the force goes on parallel to what it would have been, lower by this
    duration : s, that the fall takes
    """

    position: float
    drop: float
    duration: float = 0.05


@dataclass(frozen=True, slots=True)
class Failure:
    """How the specimen breaks.

    Parameters
    ----------
    displacement : m, at which the force begins to be lost
    duration : s, that the loss takes
    residue : share of the force that a few fibres still hold then
    tail : s, time constant with which these fibres go
    """

    displacement: float
    duration: float = 0.02
    residue: float = 0.03
    tail: float = 0.2


@dataclass(frozen=True, slots=True)
class LoadFrame:
    """How the machine moves, and how much it gives way.

    Parameters
    ----------
    speed : m/s, of the crosshead
    stroke : m, at which it stops if the specimen has not failed before
    overrun : s, that it goes on after the specimen has failed, or that it stands at full stroke
    unloads : whether it drives back to where it began; only without a failure
    compliance : m/N, of frame, load cell and grips, in line with the specimen
    """

    speed: float
    stroke: float
    overrun: float = 0.5
    unloads: bool = False
    compliance: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameInstruments:
    """What the load frame's controller measures, and how well.

    Parameters
    ----------
    rate : Hz
    first_sample : s, time of the first sample after the crosshead has started
    last_step : time between the last two samples, in sampling steps: the program stops off the grid
    white_noise : N, rms
    slow_noise : N, rms, of a noise that is correlated over `correlation_time`
    correlation_time : s, after which the correlation has fallen to 1/e
    displacement_noise : m, rms, white
    displacement_step : m, resolution; 0 for none
    force_step : N, resolution; 0 for none
    tare : N, what the load cell says without load
    displacement_tare : m, what the crosshead says before the test
    gain_error : relative error of the load cell in truth
    gain_uncertainty : relative standard uncertainty that its certificate states
    """

    rate: float
    first_sample: float
    last_step: float = 0.63
    white_noise: float = 0.0
    slow_noise: float = 0.0
    correlation_time: float = 0.1
    displacement_noise: float = 0.0
    displacement_step: float = 0.0
    force_step: float = 0.0
    tare: float = 0.0
    displacement_tare: float = 0.0
    gain_error: float = 0.0
    gain_uncertainty: float = 0.005


@dataclass(frozen=True, slots=True)
class ExportLayout:
    """How the program exports the test.

    Parameters
    ----------
    program : which layout
    force_unit : ``N`` or ``kN`` for TestSuite, ``lbf`` for R-Controller
    in_parts : whether TestSuite writes two acquisition steps into two files whose numbers are not
        in the order of time, and a third one that took no samples
    part_at : s, between the two parts
    """

    program: Program = Program.TEST_SUITE
    force_unit: str = "kN"
    in_parts: bool = False
    part_at: float = 0.0


@dataclass(frozen=True, slots=True)
class TensileScenario:
    """A whole virtual tensile test, from specimen to test sheet.

    Parameters
    ----------
    name : of the test and of its folder
    protocol : that the test sheet names
    specimen_type, spool, sample : for the test sheet
    length : m, gauge length between the grips
    law : of the specimen
    frame : of the machine
    instruments : of the machine
    slips : in order of position
    failure : None if the specimen outlasts the test
    export : how the test is exported
    section : m, measures of the section that differ from the protocol's, by name
    date : ISO date for the test sheet and the exports
    """

    name: str
    protocol: str
    specimen_type: str
    spool: str
    sample: str
    length: float
    law: BilinearLaw
    frame: LoadFrame
    instruments: FrameInstruments
    slips: tuple[GripSlip, ...] = ()
    failure: Failure | None = None
    export: ExportLayout = ExportLayout()
    section: tuple[tuple[str, float], ...] = ()
    date: str = "2026-03-09"

    def __post_init__(self) -> None:
        end = self.last_displacement
        positions = [slip.position for slip in self.slips]
        if positions != sorted(positions) or any(not 0.0 < p < end for p in positions):
            message = f"slips at {positions} m: must be in order and before {end} m"
            raise ValueError(message)
        if not 0.0 < end <= self.frame.stroke:
            message = f"failure at {end} m: must lie within the stroke of {self.frame.stroke} m"
            raise ValueError(message)
        if self.failure is not None and self.frame.unloads:
            message = "unloads=True: a specimen that has failed is not unloaded"
            raise ValueError(message)

    @property
    def last_displacement(self) -> float:
        """Displacement at which the specimen fails, or at which the crosshead stops, m."""
        return self.frame.stroke if self.failure is None else self.failure.displacement
