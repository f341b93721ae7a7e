"""A wire for CalculiX CrunchiX: a cantilever of solid bricks with a material that bends as it does.

CalculiX takes no moment-curvature law. The wire is a solid round bar of its diameter, of the
elastic-plastic material of `wire.equivalent_material`, clamped at one end and pushed aside at the
other. Why bricks and not the program's beams: those are bricks too, one over the whole section
(CalculiX CrunchiX User's Manual, "Three-node beam element"), whose four points of integration see
one strain on either side; a circular one is 2.4 % too soft even as long as it is elastic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from labpipe.decks.bar_mesh import BarMesh, half_bar
from labpipe.decks.facts import facts
from labpipe.decks.names import on_one_line
from labpipe.records.arrays import Flags, Ints
from labpipe.records.wire import WireTable
from labpipe.wire.equivalent_material import EquivalentMaterial, equivalent_material

TIP = "TIPHALF"
"""Set of nodes that is printed: the tip of half a bar, whose force counts twice."""
FARTHEST = 0.6
"""Tip deflection at the end, as a share of the length, where the law goes that far."""
N_ALONG = 8
"""Bricks along the bar."""
N_STEPS = 80
"""Increments of equal size."""
POISSON = 0.3
"""Of the elastic part; where the bar yields its volume is kept, and the wire's law has none."""

_WIDEST_NAME = 60  # of a wire in a comment
_WIDEST = 120  # of a comment: lines end at 132 characters
_TOLERANCES = (0.01, 0.003)  # of the moment, from where on the law is said to hold
_PER_LINE = 12  # numbers of nodes


def calculix_deck(table: WireTable, *, n_along: int = N_ALONG, n_steps: int = N_STEPS) -> str:
    """Write the cantilever of a wire, of the length in its sheet, which CalculiX runs as it is.

    Parameters
    ----------
    table : law of the wire
    n_along : bricks along the bar
    n_steps : increments of equal size

    Returns
    -------
    Text of an input file, in 7-bit ASCII with lines of at most 132 characters. It holds comments
    alone where the table has no cantilever (its note ``cantilever_cut`` says why).

    Raises
    ------
    ValueError
        As `equivalent_material`, or if there is not one brick or one step.

    Notes
    -----
    Half a bar, cut along its plane of bending. The clamped face keeps its place along the bar, but
    may shrink; at the tip the nodes half-way up are moved across the clamped axis and are free
    along it, and the tip may turn: an end load normal to the clamped axis (PHYSICS 5). The tip is
    moved by 0.6 of the length, or as far as the wire's law goes.
    """
    if n_steps < 1:
        message = f"n_steps={n_steps}: allowed are whole numbers >= 1"
        raise ValueError(message)
    diameter = 2.0 * table.layout.wire_radius
    material = equivalent_material(table.curvature[1:], table.moment[1:], diameter)
    reach = min(FARTHEST * table.spec.length, float(table.tip_deflection[-1]))
    lines = [f"** {line}" for line in (*_facts(table, material), *_loading(table, reach))]
    if reach > 0.0:
        mesh = half_bar(0.5 * diameter, table.spec.length, n_along=n_along)
        lines += [*_model(mesh), *_material(material), *_step(reach, n_steps)]
    return "\n".join(lines) + "\n"


def _facts(table: WireTable, material: EquivalentMaterial) -> tuple[str, ...]:
    return (
        *facts(table, on_one_line(table.name, _WIDEST_NAME)),
        "The wire is a solid round bar, its elastic-plastic material fitted to the wire's law.",
        f"Diameter {material.diameter:.6g} m. Linear up to {material.elastic_curvature:.4g} 1/m:",
        *_closeness(material),
        "Where the bar unloads it does so with its first slope, not as a wire does.",
    )


def _loading(table: WireTable, reach: float) -> tuple[str, ...]:
    """What is done to the bar, or why nothing is."""
    if reach == 0.0:
        cut = (note.message for note in table.notes if note.code == "cantilever_cut")
        why = on_one_line(next(cut, "the table has no cantilever"), _WIDEST)
        return ("No model of it:", why)
    return (
        "Computed, not measured: a cantilever clamped at x = 0, its tip pushed along y.",
        f"Free length {table.spec.length:.6g} m, tip deflection to {reach:.6g} m.",
        f"Half a bar (z >= 0). Reaction of set {TIP}: half the end load. labpipe reads the",
        "result (ending .dat) as a curve to compare with and doubles the force.",
        "Run: ccx -i, and the name of this file without .inp.",
    )


def _closeness(material: EquivalentMaterial) -> Iterator[str]:
    """How far the bar's law is from the wire's, and from where on it is near."""
    worst = int(np.argmax(np.abs(material.error)))
    yield (
        f"there its moment is up to {100.0 * abs(material.error[worst]):.2g} % "
        f"{'above' if material.error[worst] > 0.0 else 'below'} the wire's "
        f"(at {material.curvature[worst]:.4g} 1/m)."
    )
    for tolerance in _TOLERANCES:
        start = material.holds_from(tolerance)
        off = f"{100.0 * tolerance:g} %"
        if start is None:
            yield f"Nowhere up to the end of the range is it within {off} of the wire's moment."
        else:
            yield f"From {start:.4g} 1/m to the end of the range it is within {off}."


def _model(mesh: BarMesh) -> Iterator[str]:
    yield "*NODE, NSET=ALL"
    for number, (x, y, z) in enumerate(mesh.nodes + 0.0, start=1):
        yield f"{number}, {x:.9g}, {y:.9g}, {z:.9g}"
    yield "*ELEMENT, TYPE=C3D20R, ELSET=WIRE"
    for number, brick in enumerate(mesh.bricks, start=1):
        yield f"{number}, {_listed(brick[:10])},"
        yield _listed(brick[10:])
    yield from _set("CLAMP", mesh.clamp)
    yield from _set("HINGE", mesh.clamp & mesh.middle)
    yield from _set("CUT", mesh.cut)
    yield from _set(TIP, mesh.tip & mesh.middle)
    yield from ("*BOUNDARY", "CLAMP, 1", "HINGE, 2", "CUT, 3")


def _set(name: str, members: Flags) -> Iterator[str]:
    yield f"*NSET, NSET={name}"
    numbers = np.flatnonzero(members) + 1
    for start in range(0, len(numbers), _PER_LINE):
        yield f"{_listed(numbers[start : start + _PER_LINE])},"


def _listed(numbers: Ints | Sequence[int]) -> str:
    return ", ".join(str(number) for number in numbers)


def _material(material: EquivalentMaterial) -> Iterator[str]:
    """True stress against plastic strain; after the last point the stress stays as it is."""
    yield from ("*MATERIAL, NAME=WIRE", "*ELASTIC", f"{material.modulus:.9g}, {POISSON:g}")
    yield "*PLASTIC"
    for stress, strain in zip(material.stress, material.plastic_strain, strict=True):
        yield f"{stress:.9g}, {strain:.9g}"
    yield "*SOLID SECTION, ELSET=WIRE, MATERIAL=WIRE"


def _step(deflection: float, n_steps: int) -> Iterator[str]:
    """Small increments: with large ones the program's iterations do not find their way."""
    size = f"{1.0 / n_steps:.9g}"
    yield f"*STEP, NLGEOM, INC={100 * n_steps}"
    yield from ("*STATIC", f"{size}, 1., 1e-8, {size}")
    yield from ("*BOUNDARY", f"{TIP}, 2, 2, {deflection:.9g}")
    yield from (f"*NODE PRINT, NSET={TIP}", "U")
    yield from (f"*NODE PRINT, NSET={TIP}, TOTALS=ONLY", "RF")
    yield "*END STEP"
