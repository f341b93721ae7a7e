"""Tables of the source's wires."""

from __future__ import annotations

from functools import cache

import numpy as np

from labpipe.mechanics.law.loss_card import SLIDER_COUNTS, LossCard, make_loss_card
from labpipe.mechanics.law.sliders import fit_sliders
from labpipe.mechanics.wire.wire_table import tabulate_wire as table_of
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireSpec, WireTable
from tests.builders.stranded_wires import LAYS, WIRES, layers_of

LENGTH = 85e-3


def spec_of(name: str, called: str) -> WireSpec:
    diameter, strands, strand = WIRES[name]
    layers = layers_of(name)
    return WireSpec(
        name=called,
        wire_diameter=diameter,
        layer_counts=tuple(layer.count for layer in layers),
        strand_diameters=tuple(strand for _ in layers),
        lay_angles=tuple(float(np.radians(angle)) for angle in LAYS[strands]),
        insulation_thickness=0.3e-3,
        length=LENGTH,
        place="sheet 'wires', row 2",
    )


@cache
def wire_table(name: str = "A2", called: str | None = None) -> WireTable:
    return table_of(spec_of(name, called or name))


def loss_card(
    curvature: Floats, moment: Floats, *, counts: tuple[int, ...] = SLIDER_COUNTS
) -> LossCard:
    """What a law loses."""
    laws = [fit_sliders(curvature, moment, count) for count in counts]
    return make_loss_card(curvature, moment, laws)


def told(table: WireTable) -> list[QualityNote]:
    """Notes but that on the insulation, which every wire bent to five diameters has."""
    return [note for note in table.notes if note.code != "insulation_doubtful"]


def codes(table: WireTable) -> list[str]:
    return [note.code for note in told(table)]
