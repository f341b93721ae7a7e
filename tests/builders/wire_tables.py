"""Tables of the source's wires, made of the parts of the wire model."""

from __future__ import annotations

from functools import cache

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire import WireLayout, WireSpec, WireTable
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.end_load_path import end_load_curve
from labpipe.wire.friction import slip_onsets
from labpipe.wire.moment_curvature import moment_curvature, orientation_range
from labpipe.wire.wire_law import play_law
from tests.builders.stranded_wires import LAYS, WIRES, contacts_of, wire

LENGTH = 85e-3


def spec_of(name: str, section: CrossSection, called: str) -> WireSpec:
    diameter, strands, strand = WIRES[name]
    return WireSpec(
        name=called,
        wire_diameter=diameter,
        layer_counts=tuple(layer.count for layer in section.layers),
        strand_diameters=tuple(strand for _ in section.layers),
        lay_angles=tuple(float(np.radians(angle)) for angle in LAYS[strands]),
        insulation_thickness=0.3e-3,
        length=LENGTH,
        place="sheet 'wires', row 2",
    )


def layout_of(section: CrossSection) -> WireLayout:
    assert section.insulation is not None
    diameter = np.array([section.layers[layer].diameter for layer in section.layer])
    bore = section.insulation.bore_radius
    outside = bore + section.insulation.thickness
    return WireLayout(section.kind, section.x, section.y, section.layer, diameter, bore, outside)


def axial_stiffness(section: CrossSection) -> float:
    """N, of strands that keep their lay; E A cos^3(alpha) of each, and the tube."""
    assert section.insulation is not None
    strands = sum(
        layer.count * layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    return float(strands + section.insulation.axial_stiffness)


def torsional_stiffness(section: CrossSection) -> float:
    """N m^2, of strands that do not grip each other."""
    strands = sum(
        layer.count * layer.material.modulus / (2.0 + 2.0 * layer.poisson) * layer.diameter**4
        for layer in section.layers
    )
    return float(strands * np.pi / 32.0)


def grid(onsets: Floats, end: float, count: int) -> Floats:
    even = np.geomspace(1e-4 * end, end, count - 1)
    knots = np.union1d(even, onsets[onsets < end])
    return np.concatenate([[0.0], knots[np.diff(knots, prepend=0.0) > 1e-6 * knots]])


@cache
def wire_table(name: str = "A2", called: str | None = None, count: int = 120) -> WireTable:
    section = wire(name)
    contacts = contacts_of(section)
    end = 1.0 / (5.0 * WIRES[name][0])
    onsets = np.unique(slip_onsets(section, contacts))
    curvature = grid(onsets, end, count)
    curve = moment_curvature(section, contacts, curvature)
    lowest, highest = orientation_range(section, contacts, curvature)
    tip = np.linspace(0.0, 0.5 * LENGTH, 11)
    law = play_law(section, contacts, largest_curvature=end)
    return WireTable(
        name=called or name,
        spec=spec_of(name, section, called or name),
        layout=layout_of(section),
        curvature=curvature,
        moment=curve.moment,
        stick=curve.stick,
        slip=curve.slip,
        bending=curve.bending,
        plastic=curve.plastic,
        insulation=curve.insulation,
        tangent_stiffness=curve.tangent_stiffness,
        secant_stiffness=curve.secant_stiffness,
        stick_stiffness=curve.stick_stiffness,
        slip_stiffness=curve.slip_stiffness,
        axial_stiffness=axial_stiffness(section),
        torsional_stiffness=torsional_stiffness(section),
        slip_onsets=onsets,
        lowest_moment=lowest,
        highest_moment=highest,
        tip_deflection=tip,
        tip_force=end_load_curve(law, LENGTH, tip),
    )
