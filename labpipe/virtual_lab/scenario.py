"""What a virtual cantilever test is: wire, rig, instruments and mishaps, as frozen settings.

Everything is SI. The specimen frame used throughout the virtual lab: origin at the clamped end and
moving with it, x along the undeformed axis, y in the plane of bending towards the pull (up), z
normal to both. Deflection is the pull point's y minus its y in the initial rest; force is the
string's tension minus its tension in the initial rest; travel is how far the clamp has been driven
down. The marker clock is the true time base; force time = offset + (1 + drift) x marker time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.stranded import StrandedWire
from labpipe.wire.laws import PlayLaw
from labpipe.wire.play_fit import stick_slip_law

GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class WireModel:
    """Moment-curvature law of the wire by its parameters (`wire.play_fit.stick_slip_law`).

    Parameters
    ----------
    stick_stiffness : N m^2, of the first response and of unloading
    stick_moment : N m, up to which everything sticks
    slip_stiffness : N m^2, secant stiffness of the power law at `reference_moment` beyond that
    reference_moment : N m
    hardening : exponent, 0 to 1
    last_moment : N m, up to which the law is followed
    n_plays : number of plays
    """

    stick_stiffness: float = 5.0e-3
    stick_moment: float = 0.002
    slip_stiffness: float = 5.0e-3
    reference_moment: float = 0.05
    hardening: float = 0.5
    last_moment: float = 0.3
    n_plays: int = 40

    def law(self) -> PlayLaw:
        """Build the law."""
        return stick_slip_law(
            stick_stiffness=self.stick_stiffness,
            stick_moment=self.stick_moment,
            slip_stiffness=self.slip_stiffness,
            reference_moment=self.reference_moment,
            hardening=self.hardening,
            last_moment=self.last_moment,
            n_plays=self.n_plays,
        )

    def scaled(self, factor: float) -> WireModel:
        """The same wire with all moments at a given curvature multiplied by `factor`."""
        return WireModel(
            self.stick_stiffness * factor,
            self.stick_moment * factor,
            self.slip_stiffness * factor,
            self.reference_moment * factor,
            self.hardening,
            self.last_moment * factor,
            self.n_plays,
        )


VirtualWire: TypeAlias = WireModel | StrandedWire | BundleModel
"""A wire by the numbers of its law, or by what it is made of; or a bundle of wires."""


@dataclass(frozen=True, slots=True)
class MechanicalTest:
    """What decides the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    wire : the wire's law
    length : m, clamped end to pull point
    string_length : m
    counterweight : kg, at the pull point
    slack : m, travel of the clamp before the string first pulls, the wire hanging under the
        counterweight until then; None where the string holds the wire straight from the start and
        carries the counterweight
    stroke : m
    cycles : each a loading and an unloading branch
    steps_per_branch : solved positions of the clamp per branch, interpolated between
    crowding : 1 for even positions; above, they lie closer at the start of each branch, where a
        wire that begins to slip gives way fastest: travel goes with this power of their number
    n_stations : along the wire
    """

    wire: VirtualWire = WireModel()
    length: float = 0.085
    string_length: float = 0.760
    counterweight: float = 0.0027
    slack: float | None = 0.0015
    stroke: float = 0.053
    cycles: int = 3
    steps_per_branch: int = 150
    crowding: float = 1.0
    n_stations: int = 64


@dataclass(frozen=True, slots=True)
class Clocks:
    """The two time bases.

    Parameters
    ----------
    rate : Hz, nominal, of the force recorder
    fps : frames per second of the cameras
    offset : s, force time at marker time zero
    drift : dimensionless; force time = offset + (1 + drift) x marker time
    step_ratio : the recorder's true step over its nominal one; its time axis says so
    """

    rate: float = 10_000.0
    fps: float = 50.0
    offset: float = 1.37
    drift: float = 40e-6
    step_ratio: float = 0.99985


@dataclass(frozen=True, slots=True)
class LoadCell:
    """Load cell, amplifier and converter.

    Parameters
    ----------
    gain : N/V, nominal: what the calibration sheet says
    gain_uncertainty : relative standard uncertainty from which the true gain is drawn
    gain_error : relative error of the true gain, where tests share it; None to draw it
    offset : V, output at no load
    noise : N, rms, white
    bits, full_scale : of the converter, +- `full_scale` in V
    """

    gain: float = 0.5
    gain_uncertainty: float = 0.002
    gain_error: float | None = None
    offset: float = 0.013
    noise: float = 4e-3
    bits: int = 16
    full_scale: float = 10.0


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Where the markers are and how well the cameras see them.

    Parameters
    ----------
    n_markers : along the wire
    first : m, clamped end to the first marker, along the wire
    pull_offset : m, last marker to pull point, along the wire
    centre_offset : m, wire axis to marker centre along the local normal, towards the pull
    pivot : m, the clamp's pivot in the specimen frame
    noise : m, rms per axis, of a marker
    pivot_noise : m, rms per axis, of the clamp's pivot
    turn_noise : rad, rms per axis, of the clamp's orientation
    scrambled : whether label numbers follow no order along the wire
    """

    n_markers: int = 8
    first: float = 0.008
    pull_offset: float = 0.004
    centre_offset: float = 0.0008
    pivot: tuple[float, float, float] = (-0.006, -0.009, 0.012)
    noise: float = 3e-5
    pivot_noise: float = 1e-5
    turn_noise: float = 3e-4
    scrambled: bool = True

    def arc_lengths(self, length: float) -> tuple[float, ...]:
        """Arc length of each marker from the clamped end, m, evenly spaced."""
        last = length - self.pull_offset
        return tuple(float(s) for s in np.linspace(self.first, last, self.n_markers))


@dataclass(frozen=True, slots=True)
class Pose:
    """How the rig stands in the frame of the motion-capture system (Y up).

    Parameters
    ----------
    yaw, pitch, roll : rad, about Y, X and Z: turned by roll first, yaw last
    origin : m, the clamped end at zero travel
    """

    yaw: float = 0.65
    pitch: float = 0.04
    roll: float = -0.03
    origin: tuple[float, float, float] = (0.215, 1.031, -0.442)

    def rotation(self) -> Floats:
        """Rotation lab <- specimen, shape (3, 3)."""
        cos, sin = np.cos, np.sin
        a, b, c = self.yaw, self.pitch, self.roll
        about_y = np.array([[cos(a), 0, sin(a)], [0, 1, 0], [-sin(a), 0, cos(a)]])
        about_x = np.array([[1, 0, 0], [0, cos(b), -sin(b)], [0, sin(b), cos(b)]])
        about_z = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
        turned: Floats = about_y @ about_x @ about_z
        return turned


@dataclass(frozen=True, slots=True)
class Stretch:
    """Something that happens to one marker for part of a take.

    Parameters
    ----------
    marker : counted from 0 at the clamp
    start, stop : shares of the take's frames, 0 to 1; 1 is the end
    """

    marker: int
    start: float
    stop: float


@dataclass(frozen=True, slots=True)
class Mishaps:
    """What goes wrong with the markers of a take; `NO_MISHAPS` for a clean one.

    Parameters
    ----------
    n_gaps : short gaps, of 2 to 15 frames, at random on random markers while the clamp moves
    long_gap : s, length of one long gap on a random marker; 0 for none
    switch : this marker and the next one swap labels
    unlabelled : this marker goes on as ``Unlabeled 1234``
    frozen : this marker's position stands still
    """

    n_gaps: int = 8
    long_gap: float = 1.2
    switch: Stretch | None = Stretch(3, 0.40, 0.55)
    unlabelled: Stretch | None = Stretch(5, 0.70, 0.72)
    frozen: Stretch | None = None


NO_MISHAPS = Mishaps(n_gaps=0, long_gap=0.0, switch=None, unlabelled=None)


@dataclass(frozen=True, slots=True)
class CantileverScenario:
    """A whole virtual test, from wire to test sheet.

    Parameters
    ----------
    name : of the test and of its folder
    specimen_type, spool, sample : for the test sheet
    date : ISO date for the test sheet and the exports
    mechanics : wire and rig
    speed : m/s, of the clamp
    dwell : s, at every turning point
    rest : s, at least, on both records before the motion and after it
    clocks, load_cell, markers, pose, mishaps : the instruments
    length_unit : of the motion-capture export: m, cm or mm
    """

    name: str = "A2-085-1"
    specimen_type: str = "A2"
    spool: str = "A2-s1"
    sample: int = 1
    date: str = "2026-03-04"
    mechanics: MechanicalTest = MechanicalTest()
    speed: float = 1e-3
    dwell: float = 0.0
    rest: float = 5.0
    clocks: Clocks = Clocks()
    load_cell: LoadCell = LoadCell()
    markers: MarkerLayout = MarkerLayout()
    pose: Pose = Pose()
    mishaps: Mishaps = field(default_factory=Mishaps)
    length_unit: str = "m"
