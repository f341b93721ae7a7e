"""Synthetic tables that figures and workbooks of wires are tested with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from labpipe.mechanics.wire.cross_section import (
    Insulation,
    compute_strand_diameter,
    lay_up,
    place_sectors,
)
from labpipe.mechanics.wire.materials import ANNEALED_COPPER
from labpipe.mechanics.wire.wire_table import make_layout
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireTable
from tests.builders.wire_tables import wire_table

DEFAULTS_TAKEN = QualityNote(
    "defaults_taken", Severity.INFO, "A3", "Not in the sheet: Poisson's ratio 0.34."
)
CUT = QualityNote(
    "cantilever_cut",
    Severity.WARNING,
    "A3",
    "The curve stops at a deflection of 60 mm, where the clamp leaves the range of the law.",
)


def troubled() -> WireTable:
    """A wire with notes, and without a cantilever curve."""
    nothing = np.zeros(0)
    notes = (DEFAULTS_TAKEN, CUT)
    return replace(wire_table("A3"), notes=notes, tip_deflection=nothing, tip_force=nothing)


@cache
def compressed_wire() -> WireTable:
    """The section of B1, seven compressed strands in a wall of 0.2 mm, with the law of A1."""
    strand = compute_strand_diameter(0.35e-6, 7)
    layers = lay_up(7, strand, [float(np.radians(12.0))], ANNEALED_COPPER)
    section = place_sectors(layers, Insulation(0.35e-3, 0.2e-3, 1e9))
    table = wire_table("A1", "B1")
    spec = replace(table.spec, wire_diameter=1.1e-3, strand_diameters=(strand, strand))
    return replace(table, layout=make_layout(section), spec=spec)
