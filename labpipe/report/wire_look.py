"""What the figures of wires share: display units, words, the page, looks of several wires."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable
from labpipe.report.page import number_log
from labpipe.report.wording import Scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVATURE = Scale(1.0, "1/m")
LENGTH = Scale(1e3, "mm")
MOMENT = Scale(1e3, "N·mm")
STIFFNESS = Scale(1e6, "N·mm²")
_LARGE_STIFFNESS = Scale(1.0, "N·m²")
FORCE = Scale(1.0, "N")

MOST_WIRES = 12
"""Wires on one page: more could not be told apart."""

_LONGEST_NAME = 24


def stiffness_scale(tables: Sequence[WireTable]) -> Scale:
    """Unit for the stiffnesses of a page: N·mm², or N·m² where a wire has 1 N·m² or more."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS if largest < 1.0 else _LARGE_STIFFNESS


def short_name(table: WireTable) -> str:
    """Name of a wire, cut where it is too long for a line that holds more than it."""
    name = " ".join(table.name.split())
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"


def strand_words(table: WireTable) -> str:
    """Strands in words, such as ``19 × 0.24 mm``; of different ones, layer by layer.

    Examples
    --------
    Layers of one strand of 0.3 mm and six of 0.25 mm are ``1 × 0.3 + 6 × 0.25 mm``.
    """
    groups: list[tuple[int, str]] = []
    for count, diameter in zip(table.spec.layer_counts, table.spec.strand_diameters, strict=True):
        size = f"{LENGTH.factor * diameter:.3g}"
        if groups and groups[-1][1] == size:
            groups[-1] = (groups[-1][0] + count, size)
        else:
            groups.append((count, size))
    return " + ".join(f"{count} \u00d7 {size}" for count, size in groups) + f" {LENGTH.unit}"


def wire_title(table: WireTable) -> str:
    """Name, strands, layout and diameter of a wire in one line."""
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    return (
        f"{short_name(table)}  ·  wire model  ·  {strand_words(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH.unit}"
    )


def warnings_of(table: WireTable) -> str:
    """Sentences of the notes that are more than information, one after the other."""
    told = [note.message for note in table.notes if note.severity is not Severity.INFO]
    return " ".join(told)


def bent(table: WireTable) -> Flags:
    """Tell which points of a table have a place on a logarithmic axis: all but zero curvature."""
    found: Flags = np.asarray(table.curvature > 0.0)
    return found


def set_log(axes: Axes, across: Floats) -> None:
    """Draw against curvature on two logarithmic axes with plain numbers.

    Parameters
    ----------
    axes : with all its lines
    across : shape (n,), 1/m; its first and last are the ends of the axis
    """
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_xlabel(CURVATURE.label("Curvature"))
    for axis in (axes.xaxis, axes.yaxis):
        number_log(axis)
