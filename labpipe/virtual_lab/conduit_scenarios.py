"""Settings of the conduit bundles of the dissertation's Table 4.2 in three-point bending.

Everything is SI. The specimen frame: x along the bundle to the right as seen by the cameras, y up,
z towards the cameras, origin at mid-span at rest. Displacement is that of the upper roller, down;
force is the force of that roller. True time begins when the load frame starts; recorder and cameras
have their own clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeAlias

from labpipe.records.harness_bundle import NONE
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.cantilever_scenarios import LoadCell, Pose
from labpipe.virtual_lab.specimens import ElasticModel, WireModel

GAIN, OFFSET = -0.21082, 0.002846
"""Calibration of the load cell, N/V and N: force is gain x volts + offset."""

CONDUIT_CELL = LoadCell(
    gain=GAIN, gain_uncertainty=0.002, offset=-OFFSET / GAIN, noise=10e-3, full_scale=100.0
)
"""A cell of 500 lb; the recorder writes the volts of its amplifier, up to 100 V."""


@dataclass(frozen=True, slots=True)
class Conduit:
    """A tube around a bundle.

    Parameters
    ----------
    name : for the test sheet
    bore, outer_diameter : m
    stiffness : N m^2, its own
    """

    name: str
    bore: float
    outer_diameter: float
    stiffness: float


CORRUGATED = Conduit("corrugated-tube", 7.4e-3, 10.2e-3, 2e-3)
TWIST_TUBE = Conduit("twist-tube", 7.0e-3, 8.0e-3, 1e-3)

TAPING_EFFECT = {"none": 1.0, "coarse": 1.01, "half-lap": 1.02}
"""Factor on all moments by the taping of the conduit, which has almost no effect."""

_INSIDE = BundleModel(friction_share=0.05, glue_share=0.008, tape=NONE, taping=NONE)
"""Wires in a tube are taped only at their ends: neighbours and glue hold less of them."""


def conduit_bundle(
    wires: tuple[tuple[str, int], ...], conduit: Conduit, taping: str = "none"
) -> BundleModel:
    """Return a bundle in its conduit.

    Parameters
    ----------
    wires : name and number of each kind
    conduit : around it
    taping : of the conduit, a key of `TAPING_EFFECT`

    Raises
    ------
    KeyError
        If the taping is unknown.
    """
    bundle = replace(
        _INSIDE,
        wires=wires,
        conduit=conduit.name,
        conduit_bore=conduit.bore,
        conduit_stiffness=conduit.stiffness,
        tape=NONE if taping == NONE else "PVC",
        taping=taping,
    )
    return bundle.scaled(TAPING_EFFECT[taping])


_B1, _B2 = (("B1", 19),), (("B2", 19),)
_MIXED = (("B1", 10), ("B2", 9))


CONDUIT_TYPES = {
    "CWB-1": (conduit_bundle(_B1, CORRUGATED), CORRUGATED),
    "CWB-2a": (conduit_bundle(_B2, CORRUGATED), CORRUGATED),
    "CWB-2b": (conduit_bundle(_B2, CORRUGATED, "coarse"), CORRUGATED),
    "CWB-2c": (conduit_bundle(_B2, CORRUGATED, "half-lap"), CORRUGATED),
    "CWB-3": (conduit_bundle((("B2", 12),), CORRUGATED), CORRUGATED),
    "CWB-4": (
        replace(conduit_bundle(_MIXED, CORRUGATED), arrangement="symmetric"),
        CORRUGATED,
    ),
    "CWB-5": (conduit_bundle(_B1, TWIST_TUBE), TWIST_TUBE),
    "CWB-6": (conduit_bundle(_B2, TWIST_TUBE), TWIST_TUBE),
}
"""Cases of Table 4.2: bundle and conduit."""


BentModel: TypeAlias = BundleModel | WireModel | ElasticModel


@dataclass(frozen=True, slots=True)
class ThreePointTest:
    """Inputs of the path; equal tests share one solution.

    Parameters
    ----------
    bundle : its law
    span : m, between the centres of the lower rollers
    overhang : m, beyond each of them
    roller_radius : m
    outer_radius : m, of the specimen on the rollers
    friction : mu, between it and the lower rollers
    build_up : u0, m, over which friction builds up or reverses
    stroke : m, of the upper roller, once down and up
    steps_per_branch, crowding : as those of `cantilever_scenarios.MechanicalTest`
    n_stations : of the half, evenly spread
    """

    bundle: BentModel
    span: float = 0.1524
    overhang: float = 0.0254
    roller_radius: float = 5e-3
    outer_radius: float = 5.1e-3
    friction: float = 0.1
    build_up: float = 0.3e-3
    stroke: float = 0.0294
    steps_per_branch: int = 60
    crowding: float = 1.8
    n_stations: int = 97

    @property
    def reach(self) -> float:
        """Return the distance from the centre of a roller to the axis of the bundle, m."""
        return self.roller_radius + self.outer_radius


@dataclass(frozen=True, slots=True)
class ConduitClocks:
    """Three time bases; times are counted from the start of the load frame.

    Parameters
    ----------
    rate : Hz, of the force recorder
    fps : frames per second of the cameras
    frame_rate : Hz, of the load frame's own record
    trigger_lag : s, from the start of the frame to the first sample of the recorder
    recorder_drift : recorder's time = (1 + drift) x (true time - lag)
    camera_lead : s, from the start of the cameras to the start of the frame
    """

    rate: float = 500.0
    fps: float = 25.0
    frame_rate: float = 10.0
    trigger_lag: float = 6e-3
    recorder_drift: float = 20e-6
    camera_lead: float = 1.9


@dataclass(frozen=True, slots=True)
class CylinderMarkers:
    """Spherical markers in lines along a cylinder.

    Parameters
    ----------
    n_sections : odd, one at mid-span
    spacing : m, along the bundle
    angles : rad, of the lines, from the side of the cameras upwards
    centre_offset : m, axis of the bundle to marker centre
    twist : rad, rotation of the sample about its axis at full stroke, right-handed about x,
        proportional to the displacement, uniform, and constant after the roller leaves
    noise : m, rms per axis
    scrambled : label numbers are in random order
    """

    n_sections: int = 11
    spacing: float = 12.7e-3
    angles: tuple[float, ...] = (0.6108652381980153, -0.6108652381980153)
    centre_offset: float = 6.6e-3
    twist: float = 0.06
    noise: float = 3e-5
    scrambled: bool = True


@dataclass(frozen=True, slots=True)
class FrameCell:
    """Noise and tare of the load frame's own record.

    Parameters
    ----------
    displacement_noise : m, rms
    force_noise : N, rms, of its 50 kN cell, which is too coarse for these forces
    force_tare : N
    """

    displacement_noise: float = 1e-6
    force_noise: float = 1.5
    force_tare: float = 4.0


@dataclass(frozen=True, slots=True)
class ConduitScenario:
    """A complete virtual test of a conduit bundle.

    Parameters
    ----------
    name : of the test and of its folder
    specimen_type, spool, sample, date : for the test sheet and the exports
    test : bundle and rig; the bundle's own factor is that of its type
    factor : of this sample on all moments and forces
    speed : m/s, of the crosshead
    rest : s, before and after the motion of the crosshead
    clocks, load_cell, markers, frame, pose : the instruments
    has_frame_export : the load frame's record is available
    length_unit : of the motion-capture export
    """

    test: ThreePointTest
    name: str = "CWB-1-1"
    specimen_type: str = "CWB-1"
    spool: str = "CWB-1-s1"
    sample: int = 1
    date: str = "2026-03-12"
    factor: float = 1.0
    speed: float = 0.5e-3
    rest: float = 4.0
    clocks: ConduitClocks = ConduitClocks()
    load_cell: LoadCell = CONDUIT_CELL
    markers: CylinderMarkers = CylinderMarkers()
    frame: FrameCell = FrameCell()
    pose: Pose = field(default_factory=Pose)
    has_frame_export: bool = True
    length_unit: str = "m"
    protocol: ClassVar[str] = "conduit-bundle"

    @property
    def bundle(self) -> BundleModel:
        """Return the sample, with its factor.

        Raises
        ------
        TypeError
            If the specimen is not a bundle.
        """
        if not isinstance(self.test.bundle, BundleModel):
            message = f"bundle: expected a BundleModel, found {type(self.test.bundle).__name__}"
            raise TypeError(message)
        return self.test.bundle.scaled(self.factor)


def conduit_scenario(name: str) -> ConduitScenario:
    """Return a test of a case of Table 4.2.

    Parameters
    ----------
    name : key of `CONDUIT_TYPES`

    Raises
    ------
    KeyError
        If the case is unknown.
    """
    marker_radius = 1.5e-3
    bundle, conduit = CONDUIT_TYPES[name]
    radius = 0.5 * conduit.outer_diameter
    return ConduitScenario(
        test=ThreePointTest(bundle, outer_radius=radius),
        name=f"{name}-1",
        specimen_type=name,
        spool=f"{name}-s1",
        markers=CylinderMarkers(centre_offset=radius + marker_radius),
    )
