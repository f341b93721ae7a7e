"""Define the records of harness bundles: composition, layout, bending model and friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.quality import QualityNote

PACKED = "packed"
"""Dense packing with the types of wires in random order; wires of one type form a hexagon if
possible."""

ARRANGEMENTS = (PACKED, "symmetric", "asymmetric")
"""Arrangements of the types of wires: ``symmetric`` about the centre, or ``asymmetric`` with one
type on one side."""

STATED_POSITIONS = "stated"
"""Arrangement of a layout with the positions of the test sheet."""

TAPINGS = ("none", "coarse", "half-lap")
"""Windings of the tape: ``coarse`` has gaps of one tape width between turns, and each turn of
``half-lap`` covers half of the previous turn."""

NONE = "none"
"""Text for no tape and for no conduit."""


@dataclass(frozen=True, slots=True)
class BundleWire:
    """Wires of one type in a bundle.

    Parameters
    ----------
    type : type in the wire sheet, such as ``B1``
    number : number of wires
    diameter : diameter over the insulation, m; None if the test sheet does not state it
    """

    type: str
    number: int
    diameter: float | None = None


@dataclass(frozen=True, slots=True)
class Bundle:
    """Composition of a harness bundle.

    Parameters
    ----------
    wires : wires of each type, in the order of the test sheet; at least one type
    arrangement : arrangement of the types, one of `ARRANGEMENTS`
    positions : centre (x, y) of each wire in the order of `wires`, m; y is the direction of
        bending. Empty if the test sheet does not state them
    tape : kind of tape, such as ``PVC``, or ``none``
    taping : winding of the tape, one of `TAPINGS`
    conduit : kind of conduit, such as ``corrugated-tube``, or ``none``
    conduit_bore : inner diameter of the conduit, m; None if it is not stated
    """

    wires: tuple[BundleWire, ...]
    arrangement: str = PACKED
    positions: tuple[tuple[float, float], ...] = ()
    tape: str = NONE
    taping: str = NONE
    conduit: str = NONE
    conduit_bore: float | None = None

    @property
    def number(self) -> int:
        """Number of wires."""
        return sum(wire.number for wire in self.wires)

    @property
    def composition(self) -> str:
        """Text with the number and type of the wires, such as ``10 B1 + 9 B2``."""
        return " + ".join(f"{wire.number} {wire.type}" for wire in self.wires)

    @property
    def fields(self) -> Mapping[str, str]:
        """Text of each field by which bundles are grouped."""
        return {
            "wire": " & ".join(wire.type for wire in self.wires),
            "number": str(self.number),
            "composition": self.composition,
            "arrangement": self.arrangement,
            "tape": self.tape,
            "taping": self.taping,
            "conduit": self.conduit,
        }


@dataclass(frozen=True, slots=True, eq=False)
class BundleLayout(ArrayRecord):
    """Positions of the wires of a bundle; arrays have the shape (wires,).

    Parameters
    ----------
    arrangement : one of `ARRANGEMENTS`, or ``stated`` for positions of the test sheet
    x, y : centre of each wire relative to the centroid of their areas, m; y is the direction of
        bending
    kind : index in `Bundle.wires` of the type of each wire
    diameter : diameter of each wire over the insulation, m
    radius : radius of the smallest circle about the origin that contains all wires, m
    """

    arrangement: str
    x: Vector
    y: Vector
    kind: Annotated[Ints, "n"]
    diameter: Vector
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class BundleModel(ArrayRecord):
    """Bounds of the bending stiffness and moment of a bundle; arrays have the shape (n,).

    Parameters
    ----------
    bundle : composition of the bundle
    layout : positions of the wires
    low : lower bound of the bending stiffness, N m^2, for elastic wires and strands that slip
        without friction: the sum of the slip stiffnesses of the wires
    free : bending stiffness if the wires slip and the strands within them stick, N m^2: the sum of
        the stick stiffnesses of the wires
    high : upper bound of the bending stiffness, N m^2, if nothing slips or yields, bent along y
    tensor : shape (2, 2), N m^2, bending stiffness of the sticking bundle; `high` is its yy
        component
    principal : smallest and largest stiffness of all directions if nothing slips, N m^2
    principal_angle : angle from the x axis to the direction of bending with the largest stiffness,
        rad, in (-pi/2, pi/2]; 0 if all directions are equal
    neutral : (x, y) of the point in which the neutral axes of a sticking bundle intersect, m
    axial_stiffness : axial stiffness of all wires, N
    smallest_bore : diameter of the smallest circle around the wires, m
    middle : (x, y) of the centre of that circle, m
    packing_fraction : area of the wires divided by that of the bore of the conduit; None without a
        bore
    curvature : curvatures, 1/m, increasing from 0 to the smallest range of the laws of the wires
    moment_slip : moment of first loading if the wires slip on each other, N m: the sum of the laws
        of the wires
    moment_stick : moment of first loading if the wires stick to each other, bent along y, N m;
        stretched wires yield, and the strands within them slip as in a single wire
    doubtful_curvature, doubtful_curvature_stick : curvature, 1/m, beyond which the strain at the
        rim of an insulation exceeds the range of its linear law, for slipping and for sticking
        wires; infinite for stress tables
    notes : quality notes on limits and defaults
    """

    bundle: Bundle
    layout: BundleLayout
    low: float
    free: float
    high: float
    tensor: Annotated[Floats, 2, 2]
    principal: tuple[float, float]
    principal_angle: float
    neutral: tuple[float, float]
    axial_stiffness: float
    smallest_bore: float
    middle: tuple[float, float]
    packing_fraction: float | None
    curvature: Vector
    moment_slip: Vector
    moment_stick: Vector
    doubtful_curvature: float
    doubtful_curvature_stick: float
    notes: tuple[QualityNote, ...] = ()

    @property
    def is_doubtful(self) -> Flags:
        """Whether each curvature is beyond `doubtful_curvature`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature)

    @property
    def is_doubtful_stick(self) -> Flags:
        """Whether each curvature is beyond `doubtful_curvature_stick`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature_stick)


@dataclass(frozen=True, slots=True, eq=False)
class BundleLoop(ArrayRecord):
    """Measured cycles of a bundle as a cantilever; arrays have the shape (n,), in order of time.

    A bundle on two supports is treated as a cantilever of half the span under half the force.

    Parameters
    ----------
    length : length of the cantilever, m
    deflection : deflection of its tip, m
    force : force at its tip, N
    branch : index of the branch of each sample; loading and unloading branches alternate
    kink : deflection, m, and force, N, at which the wires begin to slip
    slide : deflection at which the tape begins to slide, m; infinite if it never slides
    self_weight : weight per length of the bundle, N/m; 0 if not stated. The bundle is horizontal at
        rest, and its tip is held
    """

    length: float
    deflection: Vector
    force: Vector
    branch: Annotated[Ints, "n"]
    kink: tuple[float, float]
    slide: float
    self_weight: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FrictionFit(ArrayRecord):
    """Fitted friction of a bundle, and prediction of the cycles that were not fitted.

    Parameters
    ----------
    composite_share : fraction of the axial stiffness of the wires that acts before they slip
    slip_curvature : curvature at which a wire at the mean distance from the neutral axis slips, 1/m
    slide_curvature : curvature at which the tape slides, 1/m; infinite if it never slides
    held : fraction of `composite_share` that remains after the wires slip; the fitted parameter
    held_lower, held_upper : ends of the 95 % interval of `held`, from the residuals of the fit
    loop : measured cycles
    predicted : shape (n,), N, predicted force at the deflections of `loop`
    is_held_out : shape (n,), whether a point was excluded from the fit
    error_fitted, error_held_out : root mean square of predicted minus measured force over the
        fitted and over the excluded points, relative to the largest measured force
    loss, predicted_loss : measured and predicted work of the excluded cycles, J; that of the only
        cycle if only its unloading was excluded
    """

    composite_share: float
    slip_curvature: float
    slide_curvature: float
    held: float
    held_lower: float
    held_upper: float
    loop: BundleLoop
    predicted: Vector
    is_held_out: Annotated[Flags, "n"]
    error_fitted: float
    error_held_out: float
    loss: float
    predicted_loss: float
