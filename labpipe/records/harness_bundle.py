"""Define the records of harness bundles: wires, positions, tape, conduit; model and its fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.quality import QualityNote

PACKED = "packed"
"""Dense packing with the kinds of wires at random; for one kind, a hexagon if it fits."""

ARRANGEMENTS = (PACKED, "symmetric", "asymmetric")
"""Arrangements of the kinds of wires: ``symmetric`` about the centre, or ``asymmetric`` with one
kind on one side."""

STATED = "stated"
"""Arrangement of a layout with the positions of the test sheet."""

TAPINGS = ("none", "coarse", "half-lap")
"""``coarse``: turns one tape width apart; ``half-lap``: each turn covers half of the previous."""

NONE = "none"
"""Text for no tape and for no conduit."""


@dataclass(frozen=True, slots=True)
class BundleWire:
    """Wires of one type in a bundle.

    Parameters
    ----------
    type : type in the wire sheet, such as ``B1``
    number : number of wires
    diameter : over the insulation, m; None if the test sheet does not state it
    """

    type: str
    number: int
    diameter: float | None = None


@dataclass(frozen=True, slots=True)
class Bundle:
    """The composition of a bundle.

    Parameters
    ----------
    wires : wires of each type, in the order of the test sheet; at least one type
    arrangement : one of `ARRANGEMENTS`
    positions : m, (x, y) of every wire in the order of `wires`, if the test sheet states them; y is
        the direction of bending
    tape : such as ``PVC``, or ``none``
    taping : one of `TAPINGS`
    conduit : such as ``corrugated-tube``, or ``none``
    conduit_bore : inner diameter of the conduit, m; None without a conduit or if it is not stated
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
        """Return the number of wires."""
        return sum(wire.number for wire in self.wires)

    @property
    def composition(self) -> str:
        """Return a text of the wires, such as ``10 B1 + 9 B2``."""
        return " + ".join(f"{wire.number} {wire.type}" for wire in self.wires)

    @property
    def fields(self) -> Mapping[str, str]:
        """Return the grouping fields, as text by field."""
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
    """Positions of the wires of a bundle; arrays of shape (wires,).

    Parameters
    ----------
    arrangement : one of `ARRANGEMENTS`, or ``stated`` for positions of the test sheet
    x, y : m, centres of the wires, about the centroid of their areas; y is the direction of bending
    kind : index into the wires of the `Bundle`
    diameter : m, over the insulation
    radius : m, of the smallest circle about the origin that contains all wires
    """

    arrangement: str
    x: Vector
    y: Vector
    kind: Annotated[Ints, "n"]
    diameter: Vector
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class BundleModel(ArrayRecord):
    """Bounds of the bending of a bundle; arrays of shape (n,).

    Parameters
    ----------
    bundle : composition
    layout : positions of the wires
    low : N m^2, lower bound: wires and strands slip without friction and are elastic; the sum of
        the slip stiffnesses of the wires
    free : N m^2, wires slip on each other and the strands within them stick: the sum of the stick
        stiffnesses of the wires
    high : N m^2, upper bound: nothing slips or yields, bent along y
    tensor : shape (2, 2), N m^2, bending stiffness of the sticking bundle; `high` is its yy
        component
    principal : N m^2, smallest and largest stiffness of all directions if nothing slips
    principal_angle : rad, in (-pi/2, pi/2], from the x axis to the direction of bending of the
        largest; 0 where all directions are equal
    neutral : m, (x, y) of the intersection of the neutral axes of a sticking bundle
    axial_stiffness : N, of all wires
    smallest_bore : m, diameter of the smallest circle around the wires
    middle : m, (x, y) of the centre of that circle
    packing_fraction : area of the wires / area of the conduit's bore; None without a bore
    curvature : 1/m, from 0, increasing, up to the smallest range of the laws of its wires
    moment_slip : N m, first loading, if wires slip on each other: the sum of the laws of the wires
    moment_stick : N m, first loading, if wires stick to each other, bent along y; stretched wires
        yield, and the strands within them slip as in a single wire
    doubtful_curvature, doubtful_curvature_stick : 1/m, curvature beyond which the strain at the rim
        of an insulation exceeds the range of its linear law, for slipping and for sticking wires;
        infinite for stress tables
    notes : on limits and defaults
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
        """Return whether each curvature is beyond `doubtful_curvature`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature)

    @property
    def is_doubtful_stick(self) -> Flags:
        """Return whether each curvature is beyond `doubtful_curvature_stick`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature_stick)


@dataclass(frozen=True, slots=True, eq=False)
class BundleLoop(ArrayRecord):
    """Measured cycles of a bundle bent as a cantilever; arrays of shape (n,), in order of time.

    A bundle on two supports counts as a cantilever of half the span under half the force.

    Parameters
    ----------
    length : m, of the cantilever
    deflection : m, of its tip
    force : N, at its tip
    branch : counted from 0, alternately loading and unloading
    kink : deflection, m, and force, N, at which the wires begin to slip
    slide : m, deflection at which the tape begins to slide; infinite if it never does
    self_weight : N/m, of the bundle, which is horizontal at rest with its tip held; 0 if not stated
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
    """Fitted friction of a bundle, and its prediction of cycles that were not fitted.

    Parameters
    ----------
    composite_share : share of the axial stiffness of the wires that acts before they slip
    slip_curvature : 1/m, curvature at which a wire at the mean distance from the neutral axis slips
    slide_curvature : 1/m, curvature at which the tape slides; infinite if it never does
    held : remaining share of `composite_share` after the wires slip; the fitted parameter
    held_lower, held_upper : ends of its 95 % interval, from the residuals of the fit
    loop : measured cycles
    predicted : shape (n,), N, at the deflections of `loop`
    is_held_out : shape (n,), whether a point was excluded from the fit
    error_fitted, error_held_out : root mean square of predicted minus measured force over the
        fitted and over the excluded points, relative to the largest measured force
    loss, predicted_loss : J, work of the excluded cycles; of the only cycle if only its unloading
        was excluded
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
