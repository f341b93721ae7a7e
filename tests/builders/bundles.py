"""Bundles of solid elastic wires, whose numbers are known by hand, and of the example sheet's."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from labpipe.records.harness_bundle import PACKED, Bundle, BundleWire
from labpipe.records.wire import WireSpec, WireTable
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire.wire_table import wire_table

MODULUS = 100e9
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"


def bundle(*wires: tuple[str, int], arrangement: str = PACKED, **more: object) -> Bundle:
    kinds = tuple(BundleWire(name, number) for name, number in wires)
    return Bundle(kinds, arrangement, **more)  # type: ignore[arg-type]


@cache
def solid_wire(
    name: str = "S", *, core: float = 0.8e-3, wall: float = 0.1e-3, modulus: float = MODULUS
) -> WireTable:
    """One elastic strand in a soft tube: EI and EA by hand, and no slip inside."""
    spec = WireSpec(
        name=name,
        wire_diameter=core + 2.0 * wall,
        layer_counts=(1,),
        strand_diameters=(core,),
        lay_angles=(),
        insulation_thickness=wall,
        insulation_modulus=1e3,
        insulation_strain=1.0,
        stress_table=((0.5,), (0.5 * modulus,)),
        largest_curvature=50.0,
    )
    return wire_table(spec)


def solid_stiffnesses(core: float = 0.8e-3, modulus: float = MODULUS) -> tuple[float, float]:
    """EI and EA of the core by hand."""
    return modulus * np.pi * core**4 / 64.0, modulus * np.pi * core**2 / 4.0


@cache
def example_wires() -> dict[str, WireTable]:
    specs = {spec.name: spec for spec in read_wire_sheet(EXAMPLES)}
    return {name: wire_table(specs[name]) for name in ("B1", "B2")}
