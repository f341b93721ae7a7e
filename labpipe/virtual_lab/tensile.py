"""Simulate tensile tests: settings, samples, force over time, record, and true values.

All numbers are in SI units. Displacement is that of the crosshead from its position before the
test, and force is the tension in the specimen. The specimen is slack at first. The *foot* of its
curve is the displacement at which the first straight region, extrapolated, reaches zero force.

Sizes, speeds and the stiffness of the twist tubes are from sections 2.2 and 2.3 and from Table 2.3
of [1]_. Forces that [1]_ does not state are assumed.

True displacement and force are continuous in time. The crosshead starts at time zero.

A tension test of a metal has an extensometer. Its first loading follows Ramberg and Osgood:
strain = s / E + 0.2 % (s / Rp)^n, with the stress s, so that the 0.2 % proof stress is Rp by
definition. Beyond the uniform strain the specimen necks: the force decreases with the square of the
additional strain, until the specimen breaks.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import Truth
from labpipe.virtual_lab.instruments import ExportLayout, FrameRecord, Setting, TensionRecord
from labpipe.virtual_lab.specimens import read_catalog

_N_TABLE_POINTS = 200_001
"""Number of points of a force table, from which forces are interpolated with an error below 1e-7 N.
"""


@dataclass(frozen=True, slots=True)
class BilinearLaw:
    """Force of the specimen against the displacement of its ends: slack, toe, two straight lines.

    Parameters
    ----------
    stiffness_first, stiffness_second : slopes of the two straight lines, N/m
    break_point : displacement from the foot to the intersection of the two straight lines, m
    knee : length of the transition between the two lines, half of it on either side of the break
        point, m; 0 for a corner. Toe and knee must not overlap
    slack : displacement without force, m
    toe : length over which the slope increases from zero to the first stiffness, m; 0 for a corner
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

    def scale(self, factor: float) -> BilinearLaw:
        """Multiply all forces of the law by a factor."""
        first, second = self.stiffness_first * factor, self.stiffness_second * factor
        return replace(self, stiffness_first=first, stiffness_second=second)

    def compute_force(self, distance: Floats) -> Floats:
        """Compute the force of the specimen at first loading.

        Parameters
        ----------
        distance : shape (n,), m, relative displacement of the ends of the specimen

        Returns
        -------
        Force, shape (n,), N.

        Notes
        -----
        F = k1 r(d - foot, toe) + (k2 - k1) r(d - foot - break point, knee), where d is the
        distance, k1 and k2 are the stiffnesses, and r is `compute_ramp`. Outside toe and knee these
        are exactly the two straight lines.
        """
        extension = distance - self.foot
        slope_change = self.stiffness_second - self.stiffness_first
        first_force: Floats = self.stiffness_first * compute_ramp(extension, self.toe)
        return first_force + slope_change * compute_ramp(extension - self.break_point, self.knee)

    def compute_series_force(self, displacement: Floats, compliance: float) -> Floats:
        """Compute the force of specimen and machine in series at first loading, without slips.

        Parameters
        ----------
        displacement : shape (n,), m, displacement of the crosshead, not negative
        compliance : compliance of the machine, m/N

        Returns
        -------
        Force, shape (n,), N.

        Notes
        -----
        The displacement of the crosshead is distance + compliance x force at this distance. It is
        tabulated and interpolated.
        """
        if compliance == 0.0:
            return self.compute_force(displacement)
        distance = np.linspace(0.0, float(np.max(displacement, initial=0.0)), _N_TABLE_POINTS)
        force = self.compute_force(distance)
        return np.interp(displacement, distance + compliance * force, force)


def compute_ramp(distance: Floats, width: float) -> Floats:
    """Compute a ramp, which is zero and then has slope 1, with a corner rounded over `width`.

    Parameters
    ----------
    distance : shape (n,), m, distance from the corner
    width : length over which the slope increases linearly, half of it on either side of the corner,
        m; 0 for a sharp corner

    Returns
    -------
    Height of the ramp, shape (n,), m.
    """
    ramp = np.maximum(distance, 0.0)
    if width == 0.0:
        return ramp
    corner = (distance + 0.5 * width) ** 2 / (2.0 * width)
    return np.where(np.abs(distance) < 0.5 * width, corner, ramp)


@dataclass(frozen=True, slots=True)
class GripSlip:
    """Slip of the specimen in its grips.

    Parameters
    ----------
    position : displacement at which the force begins to fall, m
    drop : decrease of the force, N
    duration : duration of the drop, s
    """

    position: float
    drop: float
    duration: float = 0.05


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of the specimen.

    Parameters
    ----------
    displacement : displacement at which the force begins to drop, m
    duration : duration of the drop, s
    residue : fraction of the force that the remaining fibres carry
    tail : time constant with which the force of these fibres decreases, s
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
    speed : speed of the crosshead, m/s
    stroke : displacement at which the crosshead stops if the specimen does not fail, m
    overrun : duration of motion after the failure, or of rest at full stroke, s
    unloads : whether the crosshead returns to its start; only without a failure
    compliance : compliance of frame, load cell and grips, in series with the specimen, m/N
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
    rate : sampling rate, Hz
    first_sample : time of the first sample after the crosshead has started, s
    last_step : time between the last two samples, as a fraction of the sampling step
    white_noise : rms white noise of the force, N
    slow_noise : rms noise of the force that is correlated over `correlation_time`, N
    correlation_time : lag at which the correlation is 1/e, s
    displacement_noise : rms white noise of the displacement, m
    displacement_step : resolution of the displacement, m; 0 for no rounding
    force_step : resolution of the force, N; 0 for no rounding
    tare : reading of the load cell without load, N
    displacement_tare : reading of the displacement before the test, m
    gain_error : true relative error of the gain of the load cell
    gain_uncertainty : relative standard uncertainty of the gain on the certificate
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

    def compute_sample_times(self, end_time: float) -> Floats:
        """Compute the sample times, s, which are evenly spaced except for the last one.

        Parameters
        ----------
        end_time : time at which the machine stops recording, s; no sample is later

        Raises
        ------
        ValueError
            If there are fewer than three samples.
        """
        step = 1.0 / self.rate
        last_step = self.last_step * step
        n_even = int(np.floor((end_time - last_step - self.first_sample) / step)) + 1
        if n_even < 2:
            facts = {"rate": self.rate, "count": n_even + 1, "end_time": end_time}
            raise ValueError(format_sentence("virtual_lab.few_samples", **facts))
        even_times = self.first_sample + step * np.arange(n_even)
        return np.append(even_times, even_times[-1] + last_step)

    def draw_slow_noise(self, time: Floats, random: np.random.Generator) -> Floats:
        """Draw correlated noise at given times, N.

        Parameters
        ----------
        time : shape (n,), s, increasing times, not necessarily evenly spaced
        random : random generator of the noise

        Returns
        -------
        Shape (n,), N, stationary first-order autoregressive noise with the correlation
        exp(-lag / correlation time).
        """
        correlation = np.exp(-np.diff(time, prepend=-np.inf) / self.correlation_time)
        innovations = np.sqrt(1.0 - correlation**2) * random.standard_normal(len(time))
        noise = [0.0]
        for factor, innovation in zip(correlation, innovations, strict=True):
            noise.append(factor * noise[-1] + innovation)
        return self.slow_noise * np.array(noise[1:])


@dataclass(frozen=True, slots=True)
class TensileScenario:
    """Virtual tensile test: specimen, machine, instruments, and entries of the test sheet.

    Parameters
    ----------
    name : name of the test and of its folder
    protocol : name of the protocol in the test sheet
    specimen_type, spool, sample : specimen type, spool and sample in the test sheet
    length : gauge length between the grips, m
    law : force of the specimen against displacement
    frame : motion and compliance of the machine
    instruments : sampling, noise and errors of the machine's controller
    slips : slips in the grips, before the end of loading
    failure : failure of the specimen; None if it does not fail
    export : layout of the export
    section : name and size, m, of each dimension of the section that differs from the protocol
    date : ISO date for the test sheet and the exports
    labels, observed : name and text of each entry of the blocks ``labels`` (specimen) and
        ``observed`` (sample after the test) of the test sheet
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
    export: ExportLayout = field(default_factory=ExportLayout)
    section: tuple[tuple[str, float], ...] = ()
    date: str = "2026-03-09"
    labels: tuple[tuple[str, str], ...] = ()
    observed: tuple[tuple[str, str], ...] = ()

    @property
    def final_displacement(self) -> float:
        """Return the displacement at the end of loading: at failure or full stroke, m."""
        return self.frame.stroke if self.failure is None else self.failure.displacement

    @property
    def loading_time(self) -> float:
        """Return the time at the end of loading: at failure or full stroke, s."""
        return self.final_displacement / self.frame.speed

    @property
    def end_time(self) -> float:
        """Return the time at which the machine stops recording, s."""
        return_time = self.frame.stroke / self.frame.speed if self.frame.unloads else 0.0
        return self.loading_time + self.frame.overrun + return_time

    def compute_displacement(self, time: Floats) -> Floats:
        """Compute the displacement of the crosshead, m, at given times, s."""
        frame = self.frame
        if self.failure is not None:
            return frame.speed * np.clip(time, 0.0, self.end_time)
        reversal_time = self.loading_time + frame.overrun
        return_travel = frame.speed * np.maximum(time - reversal_time, 0.0) * frame.unloads
        outward_travel = frame.speed * np.clip(time, 0.0, self.loading_time)
        return np.maximum(outward_travel - return_travel, 0.0)

    def compute_force(self, time: Floats) -> Floats:
        """Compute the tension in the specimen, N, at given times, s."""
        force = self._compute_loading_force(np.minimum(time, self.loading_time))
        if self.failure is not None:
            failure, elapsed_time = self.failure, np.maximum(time - self.loading_time, 0.0)
            unbroken_fraction = 1.0 - np.clip(elapsed_time / failure.duration, 0.0, 1.0)
            decay = np.exp(-elapsed_time / failure.tail)
            return force * ((1.0 - failure.residue) * unbroken_fraction + failure.residue * decay)
        if not self.frame.unloads:
            return force
        is_returning = time > self.loading_time + self.frame.overrun
        unloading_force = self._compute_unloading_force(self.compute_displacement(time))
        return np.where(is_returning, unloading_force, force)

    def _compute_loading_force(self, time: Floats) -> Floats:
        """Compute the tension, N, at times, s, until the specimen fails or the crosshead stops."""
        displacement = self.compute_displacement(time)
        force = self.law.compute_series_force(displacement, self.frame.compliance)
        for slip in self.slips:
            elapsed_time = time - slip.position / self.frame.speed
            force = force - slip.drop * np.clip(elapsed_time / slip.duration, 0.0, 1.0)
        return np.maximum(force, 0.0)

    def _compute_unloading_force(self, displacement: Floats) -> Floats:
        """Compute the tension, N, on unloading by Masing's rule; it is zero when slack.

        The unloading curve of the specimen is the loading curve S without slack and toe, inverted
        and enlarged by a factor of two: F = F_peak - 2 S((d_peak - d) / 2).
        """
        peak_force = float(self._compute_loading_force(np.array([self.loading_time]))[0])
        distance = np.linspace(0.0, self.frame.stroke, _N_TABLE_POINTS)
        force_decrease = 2.0 * replace(self.law, slack=0.0, toe=0.0).compute_force(0.5 * distance)
        crosshead_distance = distance + self.frame.compliance * force_decrease
        decrease = np.interp(self.frame.stroke - displacement, crosshead_distance, force_decrease)
        return np.maximum(peak_force - decrease, 0.0)

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the record ``frame`` with a seed of its noise, and list the true values."""
        random, instruments = np.random.default_rng(seed), self.instruments
        time = instruments.compute_sample_times(self.end_time)
        force = (1.0 + instruments.gain_error) * self.compute_force(time) + instruments.tare
        force += instruments.white_noise * random.standard_normal(len(time))
        force += instruments.draw_slow_noise(time, random)
        displacement = self.compute_displacement(time) + instruments.displacement_tare
        displacement += instruments.displacement_noise * random.standard_normal(len(time))
        displacement = _quantise(displacement, instruments.displacement_step)
        force = _quantise(force, instruments.force_step)
        return {"frame": FrameRecord(time, displacement, force, self.export)}, self._evaluate(time)

    def _evaluate(self, time: Floats) -> Truth:
        """Compute the true values of a test, without tare, gain error and noise.

        ``time``, ``displacement`` and ``force`` are those of the samples. Displacements are
        relative to the position of the crosshead before the test; relative to that at the first
        sample they are smaller by ``displacement[0]``. ``stiffness_first`` and
        ``stiffness_second``, N/m, include the compliance of the machine, as in a measurement
        without compliance correction. ``foot`` is the displacement at which the first straight line
        has zero force. ``break_point`` is the displacement at which the two lines intersect; None
        if loading ends before. ``failure_displacement`` is the displacement at which the force
        begins to drop, and ``energy_to_break`` is the work up to it, J; None without a failure.
        """
        law, compliance = self.law, self.frame.compliance
        fine_time = np.linspace(0.0, self.loading_time, 100_001)
        fine_displacement = self.compute_displacement(fine_time)
        fine_force = self.compute_force(fine_time)
        peak_index = int(np.argmax(fine_force))
        break_force = law.stiffness_first * law.break_point
        break_distance = law.break_point + compliance * break_force
        has_break_point = law.foot + break_distance < self.final_displacement
        has_failure = self.failure is not None
        energy = float(np.trapezoid(fine_force, fine_displacement))
        stiffnesses = np.array([law.stiffness_first, law.stiffness_second])
        series_stiffnesses = (stiffnesses / (1.0 + stiffnesses * compliance)).tolist()
        return {
            "time": time,
            "displacement": self.compute_displacement(time),
            "force": self.compute_force(time),
            "foot": law.foot,
            "stiffness_first": series_stiffnesses[0],
            "stiffness_second": series_stiffnesses[1],
            "specimen_stiffness_first": law.stiffness_first,
            "specimen_stiffness_second": law.stiffness_second,
            "break_point": law.foot + break_distance if has_break_point else None,
            "break_point_from_foot": break_distance if has_break_point else None,
            "break_force": break_force if has_break_point else None,
            "peak_force": float(fine_force[peak_index]),
            "peak_displacement": float(fine_displacement[peak_index]),
            "failure_displacement": self.final_displacement if has_failure else None,
            "failure_force": float(fine_force[-1]) if has_failure else None,
            "energy_to_break": energy if has_failure else None,
            "slips": [asdict(slip) for slip in self.slips],
        }

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as block ``specimen`` of the test sheet; a float is a length, m."""
        blocks = {"labels": dict(self.labels), "observed": dict(self.observed)}
        return {"length": self.length} | {name: block for name, block in blocks.items() if block}

    def list_settings(self) -> list[Setting]:
        """List settings that override the protocol: load-cell uncertainty and sizes of a tube."""
        key = "sources.frame.channels.force.scale_uncertainty"
        uncertainty = f"{100.0 * self.instruments.gain_uncertainty:.10g} %"
        settings = [Setting(key, uncertainty, "certificate of the load cell")]
        for name, size in self.section:
            settings.append(Setting(f"specimen.section.{name}", size, "a tube of another size"))
        return settings


def _quantise(values: Floats, step: float) -> Floats:
    """Round values to multiples of a step; with a step of 0, return them unchanged."""
    return values if step == 0.0 else step * np.rint(values / step)


GAIN_UNCERTAINTY = 0.0025
"""Relative standard uncertainty of both load cells: half of the limit of ISO 7500-1 class 0.5."""
TABLE_2_3 = {name: tuple(numbers) for name, numbers in read_catalog()["table_2_3"].items()}
"""First and second stiffness of each twist tube, relative to its peak force, 1/m."""
_COMPONENTS = {
    "law": BilinearLaw,
    "frame": LoadFrame,
    "instruments": FrameInstruments,
    "failure": Failure,
    "export": ExportLayout,
}
"""Class of each component of a scenario that is a table in the catalog."""


def _read_scenario(protocol: str, *, gain_error: float, **values: Any) -> TensileScenario:
    """Build a test from the catalog; `values` are fields that differ from the catalog."""
    table = read_catalog()["tensile"][protocol]
    components = {key: build(**table[key]) for key, build in _COMPONENTS.items() if key in table}
    scenario = TensileScenario(**({"protocol": protocol} | table | components | values))
    return replace(scenario, instruments=replace(scenario.instruments, gain_error=gain_error))


def build_corrugated_tube(
    name: str, *, factor: float = 1.0, gain_error: float = 0.0
) -> TensileScenario:
    """Build a test of a 10 mm corrugated tube, stretched by 50 mm without slip or failure.

    Parameters
    ----------
    name : type and number of the sample, such as ``CT-10-slit-1``
    factor : ratio of the forces to those of the slit tube of the catalog
    gain_error : relative error of the gain of the load cell
    """
    tube_type, _, sample = name.rpartition("-")
    entries = {"specimen_type": tube_type, "spool": f"{tube_type}-s1", "sample": sample}
    tube = _read_scenario("corrugated-tube", gain_error=gain_error, name=name, **entries)
    return replace(tube, law=tube.law.scale(factor))


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
    sample : key of `TABLE_2_3`, such as ``2b``
    peak_force : force at failure, N
    slack : displacement without force, m
    break_point : displacement of the crosshead from the foot to the break point, m
    gain_error : relative error of the gain of the load cell

    Notes
    -----
    The stiffnesses n1 and n2 of the table, relative to the peak force, include the compliance of
    the frame. The displacement d at failure, from the foot, follows from 1 = n1 b + n2 (d - b),
    where b is the break point.
    """
    entries = {"name": f"twist-tube-{sample}", "spool": f"twist-tube-s{sample[0]}"}
    tube = _read_scenario("twist-tube", gain_error=gain_error, sample=sample, **entries)
    compliance = tube.frame.compliance
    n1, n2 = TABLE_2_3[sample]
    law = replace(
        tube.law,
        stiffness_first=n1 * peak_force / (1.0 - compliance * (n1 * peak_force)),
        stiffness_second=n2 * peak_force / (1.0 - compliance * (n2 * peak_force)),
        break_point=break_point * (1.0 - compliance * n1 * peak_force),
        slack=slack,
    )
    failure_displacement = law.foot + break_point + (1.0 - n1 * break_point) / n2
    return _move_failure(replace(tube, law=law), failure_displacement)


def _move_failure(scenario: TensileScenario, displacement: float) -> TensileScenario:
    """Move the failure of a test to a displacement, m."""
    assert scenario.failure is not None
    return replace(scenario, failure=replace(scenario.failure, displacement=displacement))


def build_pet_tape(
    sample: str,
    *,
    factor: float = 1.0,
    failure_displacement: float = 60e-3,
    gain_error: float = 0.0,
) -> TensileScenario:
    """Build a test of a PET tape to failure, after which a few fibres remain.

    Parameters
    ----------
    sample : number of the sample; samples 1 to 3 are from the first spool, others from the second
    factor : ratio of the forces to those of the catalog
    failure_displacement : displacement at failure, m
    gain_error : relative error of the gain of the load cell
    """
    spool = "pet-tape-s1" if int(sample) <= 3 else "pet-tape-s2"
    entries = {"name": f"pet-tape-{sample}", "spool": spool, "sample": sample}
    tape = _read_scenario("pet-tape", gain_error=gain_error, **entries)
    return _move_failure(replace(tape, law=tape.law.scale(factor)), failure_displacement)


def build_crimp_pull(
    specimen_type: str,
    sample: int,
    *,
    strength: float,
    conductor: str,
    separation: str,
    gain_error: float = 0.0,
) -> TensileScenario:
    """Build a crimp pull test at 25 mm/min until contact and conductor separate.

    Parameters
    ----------
    specimen_type, sample : specimen type, and number of the sample, in the test sheet
    strength : largest force, 2.3 mm after the start, N
    conductor : cross-section of the conductor, as text of the test sheet
    separation : kind of separation, empty if it is not observed. After a ``slip``, the force
        decreases over 3 mm
    gain_error : relative error of the gain of the load cell
    """
    entries = {"specimen_type": specimen_type, "labels": (("conductor", conductor),)}
    entries |= {"name": f"{specimen_type}-{sample}", "sample": str(sample)}
    if separation:
        entries["observed"] = (("separation", separation),)
    pull = _read_scenario("crimp-pull", gain_error=gain_error, **entries)
    pull = _move_failure(replace(pull, law=pull.law.scale(strength)), pull.law.foot + 2.0e-3)
    if separation != "slip" or pull.failure is None:
        return pull
    return replace(pull, failure=replace(pull.failure, duration=3e-3 / pull.frame.speed))


def build_stiff_bar(*, gain_error: float = 0.0) -> TensileScenario:
    """Build a test of a steel bar of 12 mm, which measures the compliance of the MTS frame.

    Parameters
    ----------
    gain_error : relative error of the gain of the load cell
    """
    return _read_scenario("stiff-bar", gain_error=gain_error)


@dataclass(frozen=True, slots=True)
class MetalTension:
    """Virtual tension test of a metal with an extensometer.

    Parameters
    ----------
    name : name of the test and of its folder
    modulus : Young's modulus E, Pa
    proof_stress : proof stress Rp0.2, Pa
    hardening : exponent n of the law of Ramberg and Osgood
    diameter : diameter of the specimen, m
    gauge_length : gauge length of the extensometer, m
    uniform_strain, last_strain : strains at the largest force and at the break
    last_share : force at the break divided by the largest force
    extensometer_off : strain above which the extensometer is removed; None if it is not removed
    rate : sampling rate, Hz
    strain_rates : strain rate up to a strain of 0.4 %, and strain rate above, 1/s
    force_noise, extension_noise : rms white noise of force, N, and of extension, m
    frame_compliance : compliance of machine and grips, m/N
    preload : force at the start, N
    """

    name: str = "tension-1"
    modulus: float = 200e9
    proof_stress: float = 400e6
    hardening: float = 12.0
    diameter: float = 5e-3
    gauge_length: float = 25e-3
    uniform_strain: float = 0.10
    last_strain: float = 0.15
    last_share: float = 0.75
    extensometer_off: float | None = None
    rate: float = 10.0
    strain_rates: tuple[float, float] = (1e-4, 1e-3)
    force_noise: float = 3.0
    extension_noise: float = 3e-8
    frame_compliance: float = 4e-8
    preload: float = 50.0
    protocol: ClassVar[str] = "iso-6892"
    specimen_type: ClassVar[str] = "virtual steel"
    spool: ClassVar[str] = "bar-1"
    sample: ClassVar[str] = "1"
    date: ClassVar[str] = "2026-03-13"

    @property
    def area(self) -> float:
        """Return the original area of the cross-section, m^2."""
        return 0.25 * np.pi * self.diameter**2

    def compute_stress(self, strain: Floats) -> Floats:
        """Compute the stress of first loading without necking, Pa, at strains of any shape."""
        stresses = self.proof_stress * np.linspace(0.0, 4.0, 40_001)
        strains = stresses / self.modulus + 0.002 * (stresses / self.proof_stress) ** self.hardening
        return np.interp(strain, strains, stresses)

    def compute_force(self, strain: Floats) -> Floats:
        """Compute the force, N, at strains of any shape, including necking."""
        uniform_force = self.area * self.compute_stress(np.minimum(strain, self.uniform_strain))
        neck_fraction = (strain - self.uniform_strain) / (self.last_strain - self.uniform_strain)
        return uniform_force * (1.0 - (1.0 - self.last_share) * np.maximum(neck_fraction, 0.0) ** 2)

    def compute_truth(self) -> dict[str, float]:
        """Compute the true values of the results of the protocol ``iso-6892``, in SI units."""
        strength = float(self.compute_stress(np.array(self.uniform_strain)))
        last_stress = self.last_share * strength
        return {
            "elastic_modulus": self.modulus,
            "proof_stress_0_2": self.proof_stress,
            "proof_stress_1": self.proof_stress * (0.01 / 0.002) ** (1.0 / self.hardening),
            "tensile_strength": strength,
            "elongation_at_maximum_force": self.uniform_strain,
            "plastic_elongation_at_maximum_force": self.uniform_strain - strength / self.modulus,
            "elongation_at_break": self.last_strain,
            "plastic_elongation_at_break": self.last_strain - last_stress / self.modulus,
        }

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the record ``frame`` with a seed of its noise, and list the true values."""
        random = np.random.default_rng([seed, 68])
        slow_rate, fast_rate = self.strain_rates
        start_strain = self.preload / (self.area * self.modulus)
        rate_change_strain = 0.004
        rate_change_time = (rate_change_strain - start_strain) / slow_rate
        end_time = rate_change_time + (self.last_strain - rate_change_strain) / fast_rate
        time = np.arange(int(end_time * self.rate)) / self.rate
        slow_strain = slow_rate * np.minimum(time, rate_change_time)
        fast_strain = fast_rate * np.maximum(time - rate_change_time, 0.0)
        strain = start_strain + slow_strain + fast_strain
        force, extension = self.compute_force(strain), self.gauge_length * (strain - start_strain)
        # The free length of the specimen is 1.2 gauge lengths.
        travel = 1.2 * extension + self.frame_compliance * force
        noisy_extension = extension + random.normal(0.0, self.extension_noise, len(time))
        if self.extensometer_off is not None:
            noisy_extension[strain > self.extensometer_off] = np.nan
        force = force + random.normal(0.0, self.force_noise, len(time))
        return {"frame": TensionRecord(time, force, travel, noisy_extension)}, self.compute_truth()

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as block ``specimen`` of the test sheet; a float is a length, m."""
        return {"gauge_length": self.gauge_length, "section": {"outer_diameter": self.diameter}}

    def list_settings(self) -> list[Setting]:
        """Return no settings: the machine has those of the protocol."""
        return []
