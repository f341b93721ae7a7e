"""Virtual tensile tests: settings, samples of the dissertation, and force over time.

Everything is SI. Displacement is that of the crosshead from its position before the test; force is
the tension in the specimen. The specimen is slack at first. Its *foot* is the displacement at which
its first straight region, extrapolated, reaches zero force.

Sizes, speeds and the stiffness of the twist tubes are from sections 2.2 and 2.3 and from Table 2.3
of the dissertation. Forces that it does not state are plausible values.

The path is continuous and without noise. The crosshead starts at time zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True)
class BilinearLaw:
    """Force of the specimen against the displacement of its ends: slack, toe, two straight lines.

    Parameters
    ----------
    stiffness_first, stiffness_second : N/m
    break_point : m, from the foot to the intersection of the two straight lines
    knee : m, length of the transition between the two lines, half of it on either side of the break
        point; 0 for a corner; toe and knee must not overlap
    slack : m, displacement without force
    toe : m, length over which the slope grows from zero to the first stiffness; 0 for a corner
    """

    stiffness_first: float
    stiffness_second: float
    break_point: float
    knee: float = 0.0
    slack: float = 0.0
    toe: float = 0.0

    @property
    def foot(self) -> float:
        """Return the displacement at which the first straight line reaches zero force, m."""
        return self.slack + 0.5 * self.toe

    def scaled(self, factor: float) -> BilinearLaw:
        """Return the law with all forces multiplied by `factor`."""
        first, second = self.stiffness_first * factor, self.stiffness_second * factor
        return replace(self, stiffness_first=first, stiffness_second=second)


@dataclass(frozen=True, slots=True)
class GripSlip:
    """One slip of the specimen in its grips.

    Parameters
    ----------
    position : m, displacement at which the force begins to fall
    drop : N, by which the force is lower from then on
    duration : s, of the drop
    """

    position: float
    drop: float
    duration: float = 0.05


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of the specimen.

    Parameters
    ----------
    displacement : m, at which the force begins to drop
    duration : s, of the drop
    residue : share of the force that a few fibres still carry
    tail : s, time constant with which these fibres fail
    """

    displacement: float
    duration: float = 0.02
    residue: float = 0.03
    tail: float = 0.2


@dataclass(frozen=True, slots=True)
class LoadFrame:
    """Motion and compliance of the machine.

    Parameters
    ----------
    speed : m/s, of the crosshead
    stroke : m, at which the crosshead stops if the specimen has not failed before
    overrun : s, motion after the failure, or rest at full stroke
    unloads : whether the crosshead returns to its start; only without a failure
    compliance : m/N, of frame, load cell and grips, in series with the specimen
    """

    speed: float
    stroke: float
    overrun: float = 0.5
    unloads: bool = False
    compliance: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameInstruments:
    """Sampling, noise and errors of the load frame's controller.

    Parameters
    ----------
    rate : Hz
    first_sample : s, time of the first sample after the crosshead has started
    last_step : time between the last two samples, in sampling steps; recording stops off the grid
    white_noise : N, rms
    slow_noise : N, rms, of noise that is correlated over `correlation_time`
    correlation_time : s, at which the correlation is 1/e
    displacement_noise : m, rms, white
    displacement_step : m, resolution; 0 for none
    force_step : N, resolution; 0 for none
    tare : N, reading of the load cell without load
    displacement_tare : m, reading of the crosshead before the test
    gain_error : true relative error of the load cell
    gain_uncertainty : relative standard uncertainty on its certificate
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
    """Layout of the export of a test.

    Parameters
    ----------
    force_unit : ``N`` or ``kN`` for MTS TestSuite, ``lbf`` for TestResources R-Controller
    part_at : s, at which TestSuite begins another acquisition step. It then writes three files: one
        for each step, not numbered in the order of time, and one without samples. None for one file
    """

    force_unit: str = "kN"
    part_at: float | None = None


@dataclass(frozen=True, slots=True)
class TensileScenario:
    """A complete virtual tensile test, from specimen to test sheet.

    Parameters
    ----------
    name : of the test and of its folder
    protocol : on the test sheet
    specimen_type, spool, sample : for the test sheet
    length : m, gauge length between the grips
    law : of the specimen
    frame : of the machine
    instruments : of the machine
    slips : in order of position, before the end of the test
    failure : within the stroke of the frame; None if the specimen outlasts the test
    export : layout
    section : m, dimensions of the section that differ from the protocol, by name
    date : ISO date for the test sheet and the exports
    labels, observed : words of the test sheet on the specimen and on the tested sample, by name
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
    labels: tuple[tuple[str, str], ...] = ()
    observed: tuple[tuple[str, str], ...] = ()

    @property
    def last_displacement(self) -> float:
        """Return the displacement at which the specimen fails or the crosshead stops, m."""
        return self.frame.stroke if self.failure is None else self.failure.displacement


TABLE_2_3 = {
    "1a": (58.33, 31.78),
    "1b": (57.71, 33.98),
    "1c": (56.28, 32.98),
    "2a": (47.09, 27.38),
    "2b": (48.19, 28.81),
    "2c": (46.08, 30.50),
}
"""First and second stiffness of the twist tubes, relative to their peak force, 1/m, by sample."""
FRAME_COMPLIANCE = 2e-7
"""Compliance of the MTS frame with load cell and grips, m/N."""
GAIN_UNCERTAINTY = 0.0025
"""Relative standard uncertainty of both load cells: half of the limit of ISO 7500-1 class 0.5."""
_CORRUGATED = BilinearLaw(1.80e3, 0.55e3, 19e-3, knee=18e-3, slack=0.4e-3, toe=0.4e-3)
_TAPE = BilinearLaw(12.0e3, 2.1e3, 6.5e-3, knee=3e-3, slack=0.5e-3, toe=0.8e-3)
_CRIMP = BilinearLaw(0.8e3, 0.2e3, 1.0e-3, knee=0.4e-3, toe=0.2e-3)
"""Of a strength of 1 N, reached 2 mm after the foot."""
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
"""A 500 lbf load cell, and a displacement sensor with a resolution of 1/10000 inch."""


def build_corrugated_tube(
    name: str, *, factor: float = 1.0, gain_error: float = 0.0
) -> TensileScenario:
    """Build a test of a corrugated tube of 10 mm, without slip and failure, to 50 mm.

    Parameters
    ----------
    name : type and number of the sample, such as ``CT-10-slit-1``
    factor : on the forces of the slit tube
    gain_error : of the load cell
    """
    tube_type, _, sample = name.rpartition("-")
    return TensileScenario(
        name=name,
        protocol="corrugated-tube",
        specimen_type=tube_type,
        spool=f"{tube_type}-s1",
        sample=sample,
        length=114.3e-3,
        law=_CORRUGATED.scaled(factor),
        frame=LoadFrame(speed=0.423e-3, stroke=50e-3),
        instruments=replace(_R_CONTROLLER, gain_error=gain_error),
        export=ExportLayout("lbf"),
        date="2026-03-09",
    )


def build_twist_tube(
    sample: str,
    *,
    peak_force: float = 420.0,
    slack: float = 0.9e-3,
    break_point: float = 8.0e-3,
    gain_error: float = 0.0,
) -> TensileScenario:
    """Build a test of a twist tube of Table 2.3, pulled to failure.

    Parameters
    ----------
    sample : of the table
    peak_force : N, at failure
    slack : m
    break_point : m, from the foot, of the crosshead
    gain_error : of the load cell

    Notes
    -----
    The numbers of the table include the compliance of the frame. The displacement d at failure,
    from the foot, follows from 1 = n1 b + n2 (d - b), where b is the break point.
    """
    first, second = TABLE_2_3[sample]
    law = BilinearLaw(
        stiffness_first=_remove_compliance(first * peak_force),
        stiffness_second=_remove_compliance(second * peak_force),
        break_point=break_point * (1.0 - FRAME_COMPLIANCE * first * peak_force),
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
        frame=LoadFrame(speed=5e-3, stroke=60e-3, overrun=0.31, compliance=FRAME_COMPLIANCE),
        instruments=_build_instruments(100.0, gain_error),
        failure=Failure(tears_at, duration=0.02, residue=0.03, tail=0.15),
        export=ExportLayout("kN"),
        date="2026-03-10",
    )


def _remove_compliance(stiffness: float) -> float:
    """Return the stiffness of the specimen alone, without the compliance of the MTS frame."""
    return stiffness / (1.0 - FRAME_COMPLIANCE * stiffness)


def build_pet_tape(
    sample: str, *, factor: float = 1.0, fails_at: float = 60e-3, gain_error: float = 0.0
) -> TensileScenario:
    """Build a test of a PET tape, pulled to failure, of which a few fibres remain.

    Parameters
    ----------
    sample : number over both spools: 1 to 3 are of the first, 4 and 5 of the second
    factor : on the forces
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
        frame=LoadFrame(speed=0.5e-3, stroke=0.1, overrun=2.3, compliance=FRAME_COMPLIANCE),
        instruments=_build_instruments(20.0, gain_error),
        failure=Failure(fails_at, duration=0.15, residue=0.06, tail=1.2),
        export=ExportLayout("N"),
        date="2026-03-11",
    )


def build_crimp_pull(
    specimen_type: str,
    sample: int,
    *,
    strength: float,
    conductor: str,
    separation: str,
    gain_error: float = 0.0,
) -> TensileScenario:
    """Build a pull of a crimp at 25 mm/min until contact and conductor separate.

    Parameters
    ----------
    specimen_type, sample : for the test sheet
    strength : N, largest force, 2.3 mm after the start
    conductor : its section, as the test sheet states it
    separation : kind of separation; of a slip the force falls over 3 mm
    gain_error : of the load cell
    """
    speed = 25e-3 / 60.0
    law = replace(_CRIMP.scaled(strength), slack=0.2e-3)
    fails_at = law.foot + 2.0e-3
    slip = Failure(fails_at, duration=3e-3 / speed, residue=0.0)
    breaks = Failure(fails_at, duration=0.01, residue=0.0)
    return TensileScenario(
        name=f"{specimen_type}-{sample}",
        protocol="crimp-pull",
        specimen_type=specimen_type,
        spool="reel-1",
        sample=str(sample),
        length=0.15,
        law=law,
        frame=LoadFrame(speed=speed, stroke=20e-3, overrun=3.5e-3 / speed),
        instruments=replace(
            _build_instruments(100.0, gain_error), white_noise=0.05, slow_noise=0.05, tare=0.4
        ),
        failure=slip if separation == "slip" else breaks,
        export=ExportLayout("N"),
        date="2026-03-12",
        labels=(("conductor", conductor),),
        observed=(("separation", separation),) if separation else (),
    )


def build_stiff_bar(*, gain_error: float = 0.0) -> TensileScenario:
    """Build a test of a steel bar of 12 mm, which measures the compliance of the MTS frame.

    Parameters
    ----------
    gain_error : of the load cell
    """
    instruments = _build_instruments(10.0, gain_error)
    return TensileScenario(
        name="stiff-bar-1",
        protocol="stiff-bar",
        specimen_type="stiff-bar",
        spool="steel-12",
        sample="1",
        length=0.15,
        law=_BAR,
        frame=LoadFrame(speed=5e-6, stroke=0.35e-3, overrun=0.52, compliance=FRAME_COMPLIANCE),
        instruments=replace(instruments, displacement_noise=2e-8, displacement_tare=0.0),
        export=ExportLayout("kN"),
        date="2026-03-11",
    )


def _build_instruments(rate: float, gain_error: float) -> FrameInstruments:
    """Return the instruments of the MTS frame with a 50 kN load cell, oversized for these tests."""
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


_TABLE_POINTS = 200_001
"""Points of the table for specimen and machine in series, whose error is below 1e-7 N."""


def compute_ramp(distance: Floats, width: float) -> Floats:
    """Compute a ramp: zero, then slope 1, with a corner rounded over `width`.

    Parameters
    ----------
    distance : shape (n,), m, from the corner
    width : m, over which the slope grows linearly, half of it on either side

    Returns
    -------
    shape (n,), m: the integral of the slope.
    """
    ramp = np.maximum(distance, 0.0)
    if width == 0.0:
        return ramp
    within = (distance + 0.5 * width) ** 2 / (2.0 * width)
    return np.where(np.abs(distance) < 0.5 * width, within, ramp)


def compute_specimen_force(law: BilinearLaw, distance: Floats) -> Floats:
    """Compute the force of the specimen alone at first loading.

    Parameters
    ----------
    law : of the specimen
    distance : shape (n,), m, relative displacement of its ends

    Returns
    -------
    shape (n,), N.

    Notes
    -----
    F = k1 r(d - foot, toe) + (k2 - k1) r(d - foot - break point, knee), where r is `compute_ramp`.
    Outside toe and knee these are exactly the two straight lines.
    """
    taut = distance - law.foot
    bend = law.stiffness_second - law.stiffness_first
    first: Floats = law.stiffness_first * compute_ramp(taut, law.toe)
    return first + bend * compute_ramp(taut - law.break_point, law.knee)


def compute_loading_force(law: BilinearLaw, compliance: float, displacement: Floats) -> Floats:
    """Compute the force of specimen and machine in series at first loading, without slips.

    Parameters
    ----------
    law : of the specimen
    compliance : m/N, of the machine
    displacement : shape (n,), m, of the crosshead, not negative

    Returns
    -------
    shape (n,), N.

    Notes
    -----
    The crosshead is at d = distance + compliance F(distance), which is tabulated and interpolated.
    """
    if compliance == 0.0:
        return compute_specimen_force(law, displacement)
    distance = np.linspace(0.0, float(np.max(displacement, initial=0.0)), _TABLE_POINTS)
    force = compute_specimen_force(law, distance)
    return np.interp(displacement, distance + compliance * force, force)


@dataclass(frozen=True, slots=True, eq=False)
class TensilePath:
    """Motion and force of a virtual tensile test.

    Parameters
    ----------
    scenario : the test
    """

    scenario: TensileScenario

    @property
    def last_time(self) -> float:
        """Return the time at which the failure begins or full stroke is reached, s."""
        return self.scenario.last_displacement / self.scenario.frame.speed

    @property
    def end(self) -> float:
        """Return the time at which the machine stops recording, s."""
        frame = self.scenario.frame
        back = frame.stroke / frame.speed if frame.unloads else 0.0
        return self.last_time + frame.overrun + back

    def displacement(self, time: Floats) -> Floats:
        """Return the displacement of the crosshead, m, at times, s."""
        frame = self.scenario.frame
        if self.scenario.failure is not None:
            return frame.speed * np.clip(time, 0.0, self.end)
        turn = self.last_time + frame.overrun
        driven_back = frame.speed * np.maximum(time - turn, 0.0) * frame.unloads
        driven = frame.speed * np.clip(time, 0.0, self.last_time)
        return np.maximum(driven - driven_back, 0.0)

    def force(self, time: Floats) -> Floats:
        """Return the tension in the specimen, N, at times, s."""
        scenario = self.scenario
        before = np.minimum(time, self.last_time)
        force = self._loading(before)
        if scenario.failure is not None:
            return force * _compute_remaining_share(scenario.failure, time - self.last_time)
        if not scenario.frame.unloads:
            return force
        turned = time > self.last_time + scenario.frame.overrun
        return np.where(turned, self._unloading(self.displacement(time)), force)

    def _loading(self, time: Floats) -> Floats:
        scenario = self.scenario
        displacement = self.displacement(time)
        force = compute_loading_force(scenario.law, scenario.frame.compliance, displacement)
        for slip in scenario.slips:
            force = force - _compute_lost_force(slip, time - slip.position / scenario.frame.speed)
        return np.maximum(force, 0.0)

    def _unloading(self, displacement: Floats) -> Floats:
        """Return the force on unloading by Masing's rule, until the specimen is slack again.

        The unloading curve is the taut part of the loading curve, inverted and twice as large:
        F = F_peak - 2 S((d_peak - d) / 2).
        """
        scenario = self.scenario
        law, compliance = scenario.law, scenario.frame.compliance
        peak = float(self._loading(np.array([self.last_time]))[0])
        relief = np.linspace(0.0, scenario.frame.stroke, _TABLE_POINTS)
        taut = BilinearLaw(law.stiffness_first, law.stiffness_second, law.break_point, law.knee)
        released = 2.0 * compute_specimen_force(taut, 0.5 * relief)
        driven_back = relief + compliance * released
        lost = np.interp(scenario.frame.stroke - displacement, driven_back, released)
        return np.maximum(peak - lost, 0.0)


def _compute_lost_force(slip: GripSlip, time: Floats) -> Floats:
    """Return the force lost in a slip, N, at times after its start, s."""
    return slip.drop * np.clip(time / slip.duration, 0.0, 1.0)


def _compute_remaining_share(failure: Failure, time: Floats) -> Floats:
    """Return the remaining share of the force at times after the start of the failure, s."""
    after = np.maximum(time, 0.0)
    intact = 1.0 - np.clip(after / failure.duration, 0.0, 1.0)
    fibres = np.exp(-after / failure.tail)
    share: Floats = (1.0 - failure.residue) * intact + failure.residue * fibres
    return share
