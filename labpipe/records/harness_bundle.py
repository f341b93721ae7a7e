"""Harness bundles: which wires, where they lie, and what holds them together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.quality import QualityNote

PACKED = "packed"
"""Wires as dense as they go, kinds spread by chance; of one kind, a hexagon where it fits."""

ARRANGEMENTS = (PACKED, "symmetric", "asymmetric")
"""How the kinds of a bundle are spread: ``symmetric`` evenly around its centre, ``asymmetric``
with one kind on one side."""

STATED = "stated"
"""Of a layout: positions of the test sheet."""

TAPINGS = ("none", "coarse", "half-lap")
"""``coarse``: windings a width of the tape apart; ``half-lap``: each covers half of the last."""

NONE = "none"
"""No tape, or no conduit."""


@dataclass(frozen=True, slots=True)
class BundleWire:
    """Wires of one type in a bundle.

    Parameters
    ----------
    type : as the wire sheet calls it, such as ``B1``
    number : of wires
    diameter : over the insulation, m; None where the test sheet does not say it
    """

    type: str
    number: int
    diameter: float | None = None


@dataclass(frozen=True, slots=True)
class Bundle:
    """What a bundle is made of.

    Parameters
    ----------
    wires : by type, in the order of the test sheet; at least one
    arrangement : one of `ARRANGEMENTS`
    positions : m, (x, y) of every wire in the order of `wires`, where the test sheet gives them;
        y is the direction of bending
    tape : such as ``PVC``, or ``none``
    taping : one of `TAPINGS`
    conduit : such as ``corrugated-tube``, or ``none``
    conduit_bore : inner diameter of the conduit, m; None where there is none, or it is not stated
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
        """Return the wires in words, such as ``10 B1 + 9 B2``."""
        return " + ".join(f"{wire.number} {wire.type}" for wire in self.wires)

    @property
    def fields(self) -> Mapping[str, str]:
        """Return what groups can be made by, in words."""
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
    """Where the wires of a bundle lie; arrays of shape (wires,).

    Parameters
    ----------
    arrangement : one of `ARRANGEMENTS`, or ``stated`` for positions of the test sheet
    x, y : m, centres of the wires, about the centroid of the bundle; y is the direction of bending
    kind : index into the wires of the `Bundle`
    diameter : m, over the insulation
    radius : m, of the smallest circle about the origin that holds all wires
    """

    arrangement: str
    x: Vector
    y: Vector
    kind: Annotated[Ints, "n"]
    diameter: Vector
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class BundleModel(ArrayRecord):
    """Between what bounds the bending of a bundle lies; arrays of shape (n,).

    Parameters
    ----------
    bundle : what it is made of
    layout : where the wires lie
    low : N m^2, all wires slip on each other, and the strands within them, without friction and
        elastic: the sum of the wires' slip stiffnesses
    free : N m^2, all wires slip on each other, the strands within them stick: the sum of the wires'
        stick stiffnesses
    high : N m^2, nothing slips or yields, bent along y
    tensor : shape (2, 2), N m^2, of what `high` is the yy part
    principal : N m^2, least and largest stiffness of all directions with nothing slipping
    principal_angle : rad, in (-pi/2, pi/2], from the x axis to the direction of bending of the
        largest; 0 where all directions are equal
    neutral : m, (x, y) where the neutral axes of a sticking bundle cross
    axial_stiffness : N, of all wires
    smallest_bore : m, diameter of the smallest circle that holds the wires as they lie
    middle : m, (x, y) of the centre of that circle
    packing_fraction : area of the wires / area of the conduit's bore; None without a bore
    curvature : 1/m, from 0, increasing, to the end of the shortest of the wires' laws
    moment_slip : N m, first loading, wires that slip on each other: the sum of the wires' laws
    moment_stick : N m, first loading, wires that stick to each other, bent along y; they yield as
        they are stretched, and the strands within them slip as in a wire alone
    doubtful_curvature, doubtful_curvature_stick : 1/m, beyond which the rim of an insulation is
        strained beyond what its straight line is taken to hold for, in wires that slip and, far
        sooner, in wires that stick and are stretched; infinite for stress tables
    notes : limits met, defaults taken
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
    """Cycles of a bundle that was bent as a cantilever; arrays of shape (n,), in order of travel.

    A bundle on two supports is two cantilevers back to back, of half the span under half the force.

    Parameters
    ----------
    length : m, of the cantilever
    deflection : m, of its tip
    force : N, at its tip
    branch : counted from 0, loading and unloading in turns
    kink : deflection, m, and force, N, at which the wires begin to slip
    slide : m, deflection from which the tape slides; infinite where it never does
    self_weight : N/m, of the bundle that lies level at rest, its tip held; 0 where it is not stated
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
    """Friction between the bounds of a bundle, and how it predicts cycles left out of the fit.

    Parameters
    ----------
    composite_share : of the axial stiffness of the wires, that takes part before they slip
    slip_curvature : 1/m, at which a wire at the mean distance from the neutral axis slips
    slide_curvature : 1/m, at which what holds the wires after that slides; infinite where nothing
        does
    held : share of `composite_share` that is still held once the wires slip; the parameter fitted
    held_lower, held_upper : ends of its 95 % interval, by what the fitted points are off
    loop : measured cycles
    predicted : shape (n,), N, at the deflections of `loop`
    is_held_out : shape (n,), whether a point was left out of the fit
    error_fitted, error_held_out : root of the mean square of predicted - measured force over the
        points of the fit and over those left out, as shares of the largest measured force
    loss, predicted_loss : J, work over the cycles that were left out; over the one cycle where
        only its unloading was
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
