"""What a virtual tensile test is, as frozen settings, and the samples of the source.

Everything is SI. Displacement is how far the crosshead has been driven from where it stood before
the test; force is the tension in the specimen. The specimen is slack at first; its *foot* is the
displacement at which its first straight region, carried on downwards, meets zero force.

Sizes, speeds and the stiffness of the twist tubes are those of sections 2.2 and 2.3 and Table 2.3
of the source; forces that it does not print are plausible ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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

    def scaled(self, factor: float) -> BilinearLaw:
        """The same law with all forces multiplied by `factor`."""
        first, second = self.stiffness_first * factor, self.stiffness_second * factor
        return replace(self, stiffness_first=first, stiffness_second=second)


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


TABLE_2_3 = {
    "1a": (58.33, 31.78),
    "1b": (57.71, 33.98),
    "1c": (56.28, 32.98),
    "2a": (47.09, 27.38),
    "2b": (48.19, 28.81),
    "2c": (46.08, 30.50),
}
"""First and second stiffness of the twist tubes over their peak force, 1/m, by sample."""
GIVE = 2e-7
"""Compliance of the MTS frame with load cell and grips, m/N."""
GAIN_UNCERTAINTY = 0.0025
"""Relative standard uncertainty of both load cells: half of the limit of ISO 7500-1 class 0.5."""
_CORRUGATED = BilinearLaw(1.80e3, 0.55e3, 19e-3, knee=18e-3, slack=0.4e-3, toe=0.4e-3)
_TAPE = BilinearLaw(12.0e3, 2.1e3, 6.5e-3, knee=3e-3, slack=0.5e-3, toe=0.8e-3)
_BAR = BilinearLaw(1.55e8, 1.55e8, 1.0, slack=20e-6, toe=0.3e-6)

_R_CONTROLLER = FrameInstruments(
    rate=20.0,
    first_sample=0.087,
    white_noise=0.02,
    slow_noise=0.03,
    correlation_time=0.3,
    displacement_noise=1e-6,
    displacement_step=2.54e-6,
    force_step=4.4482216152605e-3,
    tare=-0.83,
    displacement_tare=1.016e-3,
    gain_uncertainty=GAIN_UNCERTAINTY,
)
"""A 500 lbf load cell and a displacement sensor that reads to 1/10000 inch."""


def corrugated_tube(name: str, *, factor: float = 1.0, gain_error: float = 0.0) -> TensileScenario:
    """One corrugated tube of 10 mm: no slip, no failure, stopped at 50 mm.

    Parameters
    ----------
    name : type and number of the sample, such as ``CT-10-slit-1``
    factor : by which its forces are larger than those of the slit tube
    gain_error : of the load cell
    """
    kind, _, sample = name.rpartition("-")
    return TensileScenario(
        name=name,
        protocol="corrugated-tube",
        specimen_type=kind,
        spool=f"{kind}-s1",
        sample=sample,
        length=114.3e-3,
        law=_CORRUGATED.scaled(factor),
        frame=LoadFrame(speed=0.423e-3, stroke=50e-3),
        instruments=replace(_R_CONTROLLER, gain_error=gain_error),
        export=ExportLayout(Program.R_CONTROLLER, "lbf"),
        date="2026-03-09",
    )


def twist_tube(
    sample: str,
    *,
    peak_force: float = 420.0,
    slack: float = 0.9e-3,
    break_point: float = 8.0e-3,
    gain_error: float = 0.0,
) -> TensileScenario:
    """One twist tube of Table 2.3, pulled until it tears.

    Parameters
    ----------
    sample : of the table
    peak_force : N, at which it tears
    slack : m
    break_point : m, from the foot, as seen at the crosshead
    gain_error : of the load cell

    Notes
    -----
    The table's numbers are those seen at the crosshead. Where the tube tears follows from them:
    1 = n1 b + n2 (d - b), with d the displacement from the foot and b the break point.
    """
    first, second = TABLE_2_3[sample]
    law = BilinearLaw(
        stiffness_first=_without_give(first * peak_force),
        stiffness_second=_without_give(second * peak_force),
        break_point=break_point * (1.0 - GIVE * first * peak_force),
        knee=1.0e-3,
        slack=slack,
        toe=0.6e-3,
    )
    tears_at = law.foot + break_point + (1.0 - first * break_point) / second
    return TensileScenario(
        name=f"twist-tube-{sample}",
        protocol="twist-tube",
        specimen_type="twist-tube-10",
        spool=f"twist-tube-s{sample[0]}",
        sample=sample,
        length=75e-3,
        law=law,
        frame=LoadFrame(speed=5e-3, stroke=60e-3, overrun=0.31, compliance=GIVE),
        instruments=_test_suite(100.0, gain_error),
        failure=Failure(tears_at, duration=0.02, residue=0.03, tail=0.15),
        export=ExportLayout(Program.TEST_SUITE, "kN"),
        date="2026-03-10",
    )


def _without_give(stiffness: float) -> float:
    """Stiffness of the specimen alone, from what is seen at the crosshead of the MTS frame."""
    return stiffness / (1.0 - GIVE * stiffness)


def pet_tape(
    sample: str, *, factor: float = 1.0, fails_at: float = 60e-3, gain_error: float = 0.0
) -> TensileScenario:
    """One PET tape, pulled until it breaks; a few fibres hold on.

    Parameters
    ----------
    sample : counted over both spools: 1 to 3 of the first, 4 and 5 of the second
    factor : by which its forces are larger than usual
    fails_at : m, displacement
    gain_error : of the load cell
    """
    return TensileScenario(
        name=f"pet-tape-{sample}",
        protocol="pet-tape",
        specimen_type="pet-tape",
        spool="pet-tape-s1" if int(sample) <= 3 else "pet-tape-s2",
        sample=sample,
        length=0.3,
        law=_TAPE.scaled(factor),
        frame=LoadFrame(speed=0.5e-3, stroke=0.1, overrun=2.3, compliance=GIVE),
        instruments=_test_suite(20.0, gain_error),
        failure=Failure(fails_at, duration=0.15, residue=0.06, tail=1.2),
        export=ExportLayout(Program.TEST_SUITE, "N"),
        date="2026-03-11",
    )


def stiff_bar(*, gain_error: float = 0.0) -> TensileScenario:
    """A steel bar of 12 mm in the MTS frame: what the crosshead travels is the frame's give.

    Parameters
    ----------
    gain_error : of the load cell
    """
    usual = _test_suite(10.0, gain_error)
    return TensileScenario(
        name="stiff-bar-1",
        protocol="stiff-bar",
        specimen_type="stiff-bar",
        spool="steel-12",
        sample="1",
        length=0.15,
        law=_BAR,
        frame=LoadFrame(speed=5e-6, stroke=0.35e-3, overrun=0.52, compliance=GIVE),
        instruments=replace(usual, displacement_noise=2e-8, displacement_tare=0.0),
        export=ExportLayout(Program.TEST_SUITE, "kN"),
        date="2026-03-11",
    )


def _test_suite(rate: float, gain_error: float) -> FrameInstruments:
    """A 50 kN load cell, strong for what it measures here."""
    return FrameInstruments(
        rate=rate,
        first_sample=1.95 / rate,
        white_noise=0.15,
        slow_noise=0.25,
        correlation_time=5.0 / rate,
        displacement_noise=2e-7,
        displacement_tare=1.2e-5,
        tare=2.7,
        gain_error=gain_error,
        gain_uncertainty=GAIN_UNCERTAINTY,
    )
