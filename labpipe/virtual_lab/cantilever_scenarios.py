"""Settings of a virtual cantilever test: specimen, rig, instruments and mishaps.

Everything is SI. The specimen frame used throughout the virtual lab: origin at the clamped end and
moving with it, x along the undeformed axis, y in the plane of bending towards the pull (up), z
normal to both. Deflection is the pull point's y minus its y in the initial rest; force is the
string's tension minus its tension in the initial rest; travel is the distance that the clamp has
been driven down. The marker clock is the true time base; force time = offset + (1 + drift) x marker
time.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.units import GRAVITY
from labpipe.virtual_lab.bundles import TAPED_TYPES, BundleModel
from labpipe.virtual_lab.specimens import StrandedWire, WireModel

TAPED_LENGTH = 0.1143

VirtualWire: TypeAlias = WireModel | StrandedWire | BundleModel
"""A wire defined by its law or by its strands, or a bundle of wires."""


@dataclass(frozen=True, slots=True)
class MechanicalTest:
    """Inputs of the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    wire : the wire's law
    length : m, clamped end to pull point
    string_length : m
    counterweight : kg, at the pull point
    slack : m, travel of the clamp before the string is taut, with the wire hanging under the
        counterweight; None if the string holds the wire straight and carries the counterweight
        from the start
    stroke : m
    cycles : each a loading and an unloading branch
    steps_per_branch : solved positions of the clamp per branch, interpolated between
    crowding : exponent of the positions in a branch: 1 for even ones, above 1 for closer ones at
        its start, where the stiffness changes most
    n_stations : along the wire
    weighs : the weight of the level wire bends it, too
    gravity : m/s^2, on wire and counterweight
    """

    wire: VirtualWire = field(default_factory=WireModel)
    length: float = 0.085
    string_length: float = 0.760
    counterweight: float = 0.0027
    slack: float | None = 0.0015
    stroke: float = 0.053
    cycles: int = 3
    steps_per_branch: int = 150
    crowding: float = 1.0
    n_stations: int = 64
    weighs: bool = True
    gravity: float = GRAVITY

    @property
    def mass_per_length(self) -> float:
        """Return the acting mass per length of the wire, kg/m."""
        return self.wire.mass_per_length if self.weighs else 0.0

    @property
    def self_weight(self) -> float:
        """Return the acting weight per length of the wire, N/m."""
        return self.gravity * self.mass_per_length


@dataclass(frozen=True, slots=True)
class Clocks:
    """The two time bases.

    Parameters
    ----------
    rate : Hz, nominal, of the force recorder
    fps : frames per second of the cameras
    offset : s, force time at marker time zero
    drift : dimensionless; force time = offset + (1 + drift) x marker time
    step_ratio : true over nominal step of the recorder, as in its time axis
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
    gain : N/V, nominal, as on the calibration sheet
    gain_uncertainty : relative standard uncertainty from which the true gain is drawn
    gain_error : relative error of the true gain, shared by tests; None to draw it
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


WIRE_CELL = LoadCell(gain=0.05, gain_uncertainty=0.002, noise=0.5e-3)
"""A cell of 0.5 N for forces of 20 to 250 mN, with a noise of 0.5 mN at any rate. All tests of a
campaign share its gain error."""

TAPED_CELL = LoadCell(gain=0.89, gain_uncertainty=0.002, noise=3e-3)
"""A cell of 2 lb (8.9 N at 10 V). All tests of a campaign share its gain error."""


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Places of the markers and noise of the cameras.

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
    scrambled : label numbers are in random order along the wire
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
        """Return the arc length of each marker from the clamped end, m, evenly spaced."""
        last = length - self.pull_offset
        return tuple(float(s) for s in np.linspace(self.first, last, self.n_markers))


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of the rig in the frame of the motion-capture system (Y up).

    Parameters
    ----------
    yaw, pitch, roll : rad, about Y, X and Z; roll is applied first, yaw last
    origin : m, the clamped end at zero travel
    """

    yaw: float = 0.65
    pitch: float = 0.04
    roll: float = -0.03
    origin: tuple[float, float, float] = (0.215, 1.031, -0.442)

    def rotation(self) -> Floats:
        """Return the rotation from specimen to lab, shape (3, 3)."""
        cos, sin = np.cos, np.sin
        a, b, c = self.yaw, self.pitch, self.roll
        about_y = np.array([[cos(a), 0, sin(a)], [0, 1, 0], [-sin(a), 0, cos(a)]])
        about_x = np.array([[1, 0, 0], [0, cos(b), -sin(b)], [0, sin(b), cos(b)]])
        about_z = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
        turned: Floats = about_y @ about_x @ about_z
        return turned


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of a take in which a mishap affects one marker.

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
    """Mishaps of the markers of a take; `NO_MISHAPS` for a clean one.

    Parameters
    ----------
    n_gaps : short gaps, of 2 to 15 frames, at random times on random markers while the clamp moves
    long_gap : s, length of one long gap on a random marker; 0 for none
    switch : this marker and the next one swap labels
    unlabelled : this marker is renamed ``Unlabeled 1234``
    frozen : this marker's position is constant
    """

    n_gaps: int = 8
    long_gap: float = 1.2
    switch: Stretch | None = Stretch(3, 0.40, 0.55)
    unlabelled: Stretch | None = Stretch(5, 0.70, 0.72)
    frozen: Stretch | None = None


NO_MISHAPS = Mishaps(n_gaps=0, long_gap=0.0, switch=None, unlabelled=None)
MISHAPS = (
    Mishaps(),
    Mishaps(n_gaps=4, long_gap=0.0, switch=Stretch(1, 0.62, 1.0), unlabelled=None),
    Mishaps(n_gaps=12, long_gap=0.8, switch=None, unlabelled=Stretch(2, 0.3, 0.33)),
)
"""Mishaps in the tests of a campaign, in turn."""


@dataclass(frozen=True, slots=True)
class CantileverScenario:
    """A complete virtual test, from wire to test sheet.

    Parameters
    ----------
    name : of the test and of its folder
    specimen_type, spool, sample : for the test sheet
    date : ISO date for the test sheet and the exports
    mechanics : wire and rig
    speed : m/s, of the clamp
    dwell : s, at every turning point
    rest : s, at least, in both records before and after the motion
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

    @property
    def protocol(self) -> str:
        """Return the name of the shipped protocol."""
        is_bundle = isinstance(self.mechanics.wire, BundleModel)
        return "taped-bundle" if is_bundle else "wire-cantilever"


WIRE_TEST = MechanicalTest(slack=None, steps_per_branch=80, crowding=2.5, n_stations=32)
"""The rig of the dissertation for a stranded wire, straight and held by the string. Positions are
closer where the strands begin to slip: the interpolated force is within 0.06 mN (with even
positions 5 mN), with half as many stations within 0.02 mN."""

TAPED_TEST = replace(WIRE_TEST, length=TAPED_LENGTH, steps_per_branch=60, crowding=2.0)
"""The same rig for a taped bundle. Positions are closer where its wires begin to slip: the
interpolated force is within 3 mN of the converged one, and within 12 mN where the tape begins to
slide; the noise is 3 mN. Exports and truth use the same interpolated path."""


def wire_scenario(wire: StrandedWire, length: float, *, cycles: int = 3) -> CantileverScenario:
    """Return a test of a stranded wire, without mishaps.

    Parameters
    ----------
    wire : the sample
    length : m
    cycles : each a loading and an unloading branch
    """
    return CantileverScenario(
        specimen_type=wire.name,
        spool=f"{wire.name}-s1",
        mechanics=replace(WIRE_TEST, wire=wire, length=length, cycles=cycles),
        load_cell=WIRE_CELL,
        markers=MarkerLayout(centre_offset=wire.diameter / 2.0),
        mishaps=NO_MISHAPS,
    )


def taped_scenario(name: str, *, cycles: int = 3) -> CantileverScenario:
    """Return a test of a taped bundle of the dissertation's Table 4.1, without mishaps.

    Parameters
    ----------
    name : key of `TAPED_TYPES`
    cycles : each a loading and an unloading branch

    Returns
    -------
    The scenario: the string is taut from the start and carries the counterweight; markers are in
    the middles of nine intervals of half an inch.

    Raises
    ------
    KeyError
        If the type is unknown.
    """
    marker_spacing = 0.0127
    bundle = TAPED_TYPES[name]
    half = 0.5 * marker_spacing
    return CantileverScenario(
        specimen_type=name,
        spool=f"{name}-s1",
        mechanics=replace(TAPED_TEST, wire=bundle, cycles=cycles),
        load_cell=TAPED_CELL,
        markers=MarkerLayout(
            n_markers=9, first=half, pull_offset=half, centre_offset=bundle.radius
        ),
        mishaps=NO_MISHAPS,
        date="2026-03-11",
    )
