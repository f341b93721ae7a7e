"""Bundles of solid elastic wires, whose numbers are known by hand, and of the example sheet's."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.records.harness_bundle import PACKED, Bundle, BundleWire
from labpipe.records.wire import WireSpec, WireTable

MODULUS, CORE, WALL = 100e9, 0.8e-3, 0.1e-3
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"


def bundle(*wires: tuple[str, int], arrangement: str = PACKED, **more: object) -> Bundle:
    kinds = tuple(BundleWire(name, number) for name, number in wires)
    return Bundle(kinds, arrangement, **more)  # type: ignore[arg-type]


@cache
def solid_wire(name: str = "S", *, modulus: float = MODULUS) -> WireTable:
    """One elastic strand in a soft tube: EI and EA by hand, and no slip inside."""
    spec = WireSpec(
        name=name,
        wire_diameter=CORE + 2.0 * WALL,
        layer_counts=(1,),
        strand_diameters=(CORE,),
        lay_angles=(),
        insulation_thickness=WALL,
        insulation_modulus=1e3,
        insulation_strain=1.0,
        stress_table=((0.5,), (0.5 * modulus,)),
        largest_curvature=50.0,
    )
    return tabulate_wire(spec)


def solid_stiffnesses() -> tuple[float, float]:
    """EI and EA of the core by hand."""
    return MODULUS * np.pi * CORE**4 / 64.0, MODULUS * np.pi * CORE**2 / 4.0


@cache
def example_wires() -> dict[str, WireTable]:
    specs = {spec.name: spec for spec in read_wire_sheet(EXAMPLES).specs}
    return {name: tabulate_wire(specs[name]) for name in ("B1", "B2")}
