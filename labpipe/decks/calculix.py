"""Half a round bar of twenty-node bricks, cut along its plane of bending.

x runs along the bar, y in the plane of bending. Across it a rectangle of two bricks lies around the
axis, and a ring of four between it and the circle; the outer nodes, those at mid-sides included,
are on the circle. Numbering of a brick: four corners, the four above them, mid-sides below, above
and between (CalculiX CrunchiX User's Manual, "Twenty-node brick element").

A wire for CalculiX CrunchiX: a cantilever of solid bricks with a material that bends as it does.

CalculiX takes no moment-curvature law. The wire is a solid round bar of its diameter, of the
elastic-plastic material of `law.equivalent_material`, clamped at one end and pushed aside at the
other. Why bricks and not the program's beams: those are bricks too, one over the whole section
(CalculiX CrunchiX User's Manual, "Three-node beam element"), whose four points of integration see
one strain on either side; a circular one is 2.4 % too soft even as long as it is elastic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.decks.deck_law import facts, mass_of, on_one_line
from labpipe.decks.deck_losses import deck_losses, percent
from labpipe.law.equivalent_material import EquivalentMaterial, equivalent_material
from labpipe.records.arrays import Flags, Floats, Ints, frozen
from labpipe.records.wire import WireTable

_INNER = 0.55  # half-width of the rectangle, as a share of the radius
_AROUND = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)])
_TURNED = [0, 3, 2, 1, 7, 6, 5, 4]  # the same cell, turning the other way
_SMALL = 1e-6  # of the radius: nodes as near as that to a plane are in it


@dataclass(frozen=True, slots=True, eq=False)
class BarMesh:
    """Nodes and bricks of half a bar; the half with z >= 0.

    Parameters
    ----------
    nodes : shape (nodes, 3), m; the first has the number 1
    bricks : shape (bricks, 20), numbers of nodes
    length, radius : m
    """

    nodes: Floats
    bricks: Ints
    length: float
    radius: float

    @property
    def clamp(self) -> Flags:
        """Nodes of the clamped face, x = 0."""
        return self.nodes[:, 0] < _SMALL * self.radius

    @property
    def middle(self) -> Flags:
        """Nodes half-way up, y = 0: those that bending does not strain."""
        return np.abs(self.nodes[:, 1]) < _SMALL * self.radius

    @property
    def tip(self) -> Flags:
        """Nodes of the free face, x = length."""
        return self.nodes[:, 0] > self.length - _SMALL * self.radius

    @property
    def cut(self) -> Flags:
        """Nodes of the plane that cuts the bar in halves, z = 0."""
        return self.nodes[:, 2] < _SMALL * self.radius


def half_bar(radius: float, length: float, *, n_along: int) -> BarMesh:
    """Mesh half a round bar.

    Parameters
    ----------
    radius, length : m
    n_along : bricks along the bar

    Raises
    ------
    ValueError
        If there is not one brick.
    """
    if n_along < 1:
        message = f"n_along={n_along}: allowed are whole numbers >= 1"
        raise ValueError(message)
    nodes, bricks = _unit_bar(n_along)
    return BarMesh(nodes * [length, radius, radius], bricks, length, radius)


@lru_cache(maxsize=4)
def _unit_bar(n_along: int) -> tuple[Floats, Ints]:
    """Nodes and bricks of half a bar of unit radius and length."""
    points, quads = _half_disc()
    corners = np.unique(quads[:, :4])
    stations = [np.arange(len(points)) if i % 2 == 0 else corners for i in range(2 * n_along + 1)]
    first = np.cumsum([1, *map(len, stations)])
    numbers = np.zeros((len(stations), len(points)), dtype=np.int64)
    for i, members in enumerate(stations):
        numbers[i, members] = first[i] + np.arange(len(members))
    along = np.linspace(0.0, 1.0, len(stations))
    nodes = [
        np.column_stack([np.full(len(members), x), points[members]])
        for x, members in zip(along, stations, strict=True)
    ]
    bricks = [_bricks(numbers[2 * i : 2 * i + 3], quads) for i in range(n_along)]
    return frozen(np.concatenate(nodes), shape=(None, 3)), np.concatenate(bricks)


def _bricks(numbers: Ints, quads: Ints) -> Ints:
    """One layer of bricks on the quadrangles, from the nodes of its three stations."""
    below, between, above = (number[quads] for number in numbers)
    corners, sides = slice(0, 4), slice(4, 8)
    parts = (below[:, corners], above[:, corners], below[:, sides], above[:, sides])
    return np.concatenate([*parts, between[:, corners]], axis=1)


def _half_disc() -> tuple[Floats, Ints]:
    """Nodes (y, z) of a unit half-disc, and its eight-node quadrangles, turning from y to z."""
    y, z = np.meshgrid(np.linspace(-_INNER, _INNER, 5), np.linspace(0.0, _INNER, 3), indexing="ij")
    lattices = [np.stack([y, z], axis=-1), _ring()]
    corners = np.concatenate([_quadrangles(lattice) for lattice in lattices]).reshape(-1, 2)
    # rounding makes one of nodes that two bricks share, and zeros of what is nearly zero
    points, which = np.unique(corners.round(12) + 0.0, axis=0, return_inverse=True)
    return points, which.reshape(-1, 8).astype(np.int64)


def _ring() -> Floats:
    """Lattice from the circle inwards to the rectangle, shape (9, 3, 2)."""
    side = np.linspace(0.0, _INNER, 3)
    left = np.column_stack([np.full(3, -_INNER), side])
    top = np.column_stack([np.linspace(-_INNER, _INNER, 5), np.full(5, _INNER)])
    inner = np.concatenate([left, top[1:-1], left[::-1] * [-1.0, 1.0]])
    angle = np.linspace(np.pi, 0.0, len(inner))
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    share = np.array([0.0, 0.5, 1.0])[:, np.newaxis]
    lattice: Floats = circle[:, np.newaxis] + share * (inner - circle)[:, np.newaxis]
    return lattice


def _quadrangles(lattice: Floats) -> Floats:
    """Nodes of every second cell of a lattice, shape (cells, 8, 2), each turning from y to z."""
    cells = [
        np.array([lattice[i + u, j + v] for u, v in _AROUND])
        for i in range(0, lattice.shape[0] - 1, 2)
        for j in range(0, lattice.shape[1] - 1, 2)
    ]
    return np.array([cell if _area(cell) > 0.0 else cell[_TURNED] for cell in cells])


def _area(cell: Floats) -> float:
    """Area of the corners' polygon, positive if it turns from y to z."""
    y, z = cell[:4].T
    return float(0.5 * np.sum(y * np.roll(z, -1) - np.roll(y, -1) * z))


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
        density = mass_of(table) / (np.pi / 4.0 * diameter**2)
        lines += [*_model(mesh), *_material(material, density), *_step(reach, n_steps)]
    return "\n".join(lines) + "\n"


def _facts(table: WireTable, material: EquivalentMaterial) -> tuple[str, ...]:
    return (
        *facts(table, on_one_line(table.name, _WIDEST_NAME)),
        "The wire is a solid round bar, its elastic-plastic material fitted to the wire's law.",
        f"Diameter {material.diameter:.6g} m. Linear up to {material.elastic_curvature:.4g} 1/m:",
        *_closeness(material),
        "Where the bar unloads it does so with its first slope, not as a wire does. Not for loops.",
        *deck_losses(table, _own_loss(material)),
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


def _own_loss(material: EquivalentMaterial) -> str:
    off, linear = np.abs(material.error), material.curvature <= material.elastic_curvature
    return (
        f"This deck: first loading within {percent(float(off[~linear].max()))} of the wire's "
        f"moment from {material.elastic_curvature:.4g} 1/m on, within {percent(float(off.max()))} "
        f"below it."
    )


def _model(mesh: BarMesh) -> Iterator[str]:
    yield "*NODE, NSET=ALL"
    nodes = np.column_stack([np.arange(1, len(mesh.nodes) + 1), mesh.nodes + 0.0])
    yield _lines("%d, %.9g, %.9g, %.9g", nodes)
    yield "*ELEMENT, TYPE=C3D20R, ELSET=WIRE"
    bricks = np.column_stack([np.arange(1, len(mesh.bricks) + 1), mesh.bricks])
    yield _lines(", ".join(["%d"] * 11) + ",\n" + ", ".join(["%d"] * 10), bricks)
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


def _listed(numbers: Ints) -> str:
    return ", ".join(map(str, numbers.tolist()))


def _lines(form: str, rows: Floats | Ints) -> str:
    """Rows of numbers as lines of one form, at once: one by one takes three times as long."""
    return "\n".join([form] * len(rows)) % tuple(rows.ravel().tolist())


def _material(material: EquivalentMaterial, density: float) -> Iterator[str]:
    """True stress against plastic strain; after the last point the stress stays as it is.

    The density, kg/m^3, is that of a bar as heavy as the wire.
    """
    yield from ("*MATERIAL, NAME=WIRE", "*ELASTIC", f"{material.modulus:.9g}, {POISSON:g}")
    yield "*PLASTIC"
    for stress, strain in zip(material.stress, material.plastic_strain, strict=True):
        yield f"{stress:.9g}, {strain:.9g}"
    yield from ("*DENSITY", f"{density:.9g}")
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
