"""Harness bundles: which wires, where they lie, and what holds them together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Ints, frozen

PACKED = "packed"
"""Wires as dense as they go, kinds spread by chance; of one kind, a hexagon where it fits."""

ARRANGEMENTS = (PACKED, "symmetric", "asymmetric")
"""How the kinds of a bundle are spread: ``symmetric`` evenly around its centre, ``asymmetric``
with one kind on one side."""

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
    conduit_bore : inner diameter of the conduit, m; None where there is none, or nobody said it
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
        """Wires in words, such as ``10 B1 + 9 B2``."""
        return " + ".join(f"{wire.number} {wire.type}" for wire in self.wires)

    @property
    def fields(self) -> Mapping[str, str]:
        """What groups can be made by, in words."""
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
class BundleLayout:
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
    x: Floats
    y: Floats
    kind: Ints
    diameter: Floats
    radius: float

    def __post_init__(self) -> None:
        shape = (len(self.kind),)
        for name in ("x", "y", "diameter"):
            object.__setattr__(self, name, frozen(getattr(self, name), shape=shape))
        object.__setattr__(self, "kind", np.asarray(self.kind, dtype=np.int64))
