"""Half a round bar of twenty-node bricks, cut along its plane of bending.

x runs along the bar, y in the plane of bending. Across it a rectangle of two bricks lies around the
axis, and a ring of four between it and the circle; the outer nodes, those at mid-sides included,
are on the circle. Numbering of a brick: four corners, the four above them, mid-sides below, above
and between (CalculiX CrunchiX User's Manual, "Twenty-node brick element").

A wire for CalculiX CrunchiX: a cantilever of solid bricks with a material that bends as it does.

CalculiX takes no moment-curvature law. The wire is a solid round bar of its diameter, of the
elastic-plastic material of `law.equivalent_material`, clamped at one end and pushed aside at the
other. Beams of the program are bricks, too, one over the whole section
(CalculiX CrunchiX User's Manual, "Three-node beam element"), whose four integration points see
one strain on either side; a circular one is 2.4 % too soft even while it is elastic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    describe_deck_losses,
    find_mass,
    format_percent,
    list_facts,
    shorten_name,
)
from labpipe.mechanics.decks.unloading import Release, release_elastically
from labpipe.mechanics.law.equivalent_material import EquivalentMaterial, fit_equivalent_material
from labpipe.mechanics.law.plays import require
from labpipe.records.arrays import Flags, Floats, Ints, freeze
from labpipe.records.wire import WireTable

_RECTANGLE = 0.55  # half-width of the rectangle, as a share of the radius
_CELL_NODES = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)])
_PLANE_TOLERANCE = 1e-6  # distance of nodes in a plane, over the radius


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
        """Return the nodes of the clamped face, x = 0."""
        return self.nodes[:, 0] < _PLANE_TOLERANCE * self.radius

    @property
    def middle(self) -> Flags:
        """Return the nodes at y = 0, in the neutral plane of bending."""
        return np.abs(self.nodes[:, 1]) < _PLANE_TOLERANCE * self.radius

    @property
    def tip(self) -> Flags:
        """Return the nodes of the free face, x = length."""
        return self.nodes[:, 0] > self.length - _PLANE_TOLERANCE * self.radius

    @property
    def cut(self) -> Flags:
        """Return the nodes of the plane of symmetry, z = 0."""
        return self.nodes[:, 2] < _PLANE_TOLERANCE * self.radius


def mesh_half_bar(radius: float, length: float, *, n_along: int) -> BarMesh:
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
    require("n_along", n_along, "a whole number >= 1", holds=n_along >= 1)
    nodes, bricks = _unit_bar(n_along)
    return BarMesh(nodes * [length, radius, radius], bricks, length, radius)


@lru_cache(maxsize=4)
def _unit_bar(n_along: int) -> tuple[Floats, Ints]:
    """Mesh half a bar of unit radius and length."""
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
    return freeze(np.concatenate(nodes), shape=(None, 3)), np.concatenate(bricks)


def _bricks(numbers: Ints, quads: Ints) -> Ints:
    """Return one layer of bricks on the quadrangles, from the nodes of its three stations."""
    below, middle, above = (number[quads] for number in numbers)
    corners, sides = slice(0, 4), slice(4, 8)
    parts = (below[:, corners], above[:, corners], below[:, sides], above[:, sides])
    return np.concatenate([*parts, middle[:, corners]], axis=1)


def _half_disc() -> tuple[Floats, Ints]:
    """Mesh a unit half-disc: nodes (y, z) and eight-node quadrangles, turning from y to z."""
    y, z = np.meshgrid(
        np.linspace(-_RECTANGLE, _RECTANGLE, 5), np.linspace(0.0, _RECTANGLE, 3), indexing="ij"
    )
    lattices = [np.stack([y, z], axis=-1), _ring()]
    corners = np.concatenate([_quadrangles(lattice) for lattice in lattices]).reshape(-1, 2)
    # rounding merges the nodes that two bricks share
    points, which = np.unique(corners.round(12) + 0.0, axis=0, return_inverse=True)
    return points, which.reshape(-1, 8).astype(np.int64)


def _ring() -> Floats:
    """Return the lattice from the circle inwards to the rectangle, shape (9, 3, 2)."""
    side = np.linspace(0.0, _RECTANGLE, 3)
    left_side = np.column_stack([np.full(3, -_RECTANGLE), side])
    top = np.column_stack([np.linspace(-_RECTANGLE, _RECTANGLE, 5), np.full(5, _RECTANGLE)])
    inner = np.concatenate([left_side, top[1:-1], left_side[::-1] * [-1.0, 1.0]])
    angle = np.linspace(np.pi, 0.0, len(inner))
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    share = np.array([0.0, 0.5, 1.0])[:, np.newaxis]
    lattice: Floats = circle[:, np.newaxis] + share * (inner - circle)[:, np.newaxis]
    return lattice


def _quadrangles(lattice: Floats) -> Floats:
    """Return the nodes of every second cell of a lattice, (cells, 8, 2), turning from y to z."""
    reversed_cell = [0, 3, 2, 1, 7, 6, 5, 4]  # the nodes of a cell in the other sense
    cells = [
        np.array([lattice[i + u, j + v] for u, v in _CELL_NODES])
        for i in range(0, lattice.shape[0] - 1, 2)
        for j in range(0, lattice.shape[1] - 1, 2)
    ]
    return np.array([cell if _area(cell) > 0.0 else cell[reversed_cell] for cell in cells])


def _area(cell: Floats) -> float:
    """Return the area of the polygon of corners, positive if it turns from y to z."""
    y, z = cell[:4].T
    return float(0.5 * np.sum(y * np.roll(z, -1) - np.roll(y, -1) * z))


TIP = "TIPHALF"
"""Set of nodes that is printed: the tip of half the bar, which carries half of the force."""
N_ALONG = 8
"""Bricks along the bar."""


def write_calculix_deck(table: WireTable, *, n_along: int = N_ALONG, n_steps: int = 80) -> str:
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
        As `fit_equivalent_material`, or if there is not one brick or one step.

    Notes
    -----
    Half a bar, cut along its plane of bending. The clamped face is fixed along the bar, but
    may contract; at the tip the nodes at y = 0 are moved across the clamped axis and are free
    along it, and the tip may turn: an end load normal to the clamped axis (PHYSICS 5). The tip is
    moved by 0.6 of the length, or as far as the wire's law goes.
    """
    require("n_steps", n_steps, "a whole number >= 1", holds=n_steps >= 1)
    diameter = 2.0 * table.layout.wire_radius
    material = fit_equivalent_material(table.curvature[1:], table.moment[1:], diameter)
    max_tip_share = 0.6  # of the length; less if the range of the law ends before
    reach = min(max_tip_share * table.spec.length, float(table.tip_deflection[-1]))
    lines = [f"** {line}" for line in (*_facts(table, material), *_loading(table, reach))]
    if reach > 0.0:
        mesh = mesh_half_bar(0.5 * diameter, table.spec.length, n_along=n_along)
        density = find_mass(table) / (np.pi / 4.0 * diameter**2)
        lines += [*_model(mesh), *_material(material, density), *_step(reach, n_steps)]
    return "\n".join(lines) + "\n"


def _facts(table: WireTable, material: EquivalentMaterial) -> tuple[str, ...]:
    return (
        *list_facts(table, shorten_name(table.name, 60)),
        "The wire is a solid round bar, its elastic-plastic material fitted to the wire's law.",
        f"Diameter {material.diameter:.6g} m. Linear up to {material.elastic_curvature:.4g} 1/m:",
        *_closeness(material),
        "On unloading the bar follows its first slope, unlike a wire. Not for cycles.",
        *describe_deck_losses(
            table, _own_loss(material), "a bar with its first slope", _release(table, material)
        ),
    )


def _release(table: WireTable, material: EquivalentMaterial) -> Release:
    """Compute the release of the bar; its fibres do not yield again before zero moment."""
    second_moment = np.pi / 64.0 * material.diameter**4
    return release_elastically(table, material.modulus * second_moment)


def _loading(table: WireTable, reach: float) -> tuple[str, ...]:
    """Describe the loading of the bar, or give the reason why there is none."""
    if reach == 0.0:
        cut = (note.message for note in table.notes if note.code == "cantilever_cut")
        why = shorten_name(next(cut, "the table has no cantilever"), 120)
        return ("No model:", why)
    return (
        "Computed, not measured: a cantilever clamped at x = 0, its tip pushed along y.",
        f"Free length {table.spec.length:.6g} m, tip deflection to {reach:.6g} m.",
        f"Half a bar (z >= 0). Reaction of set {TIP}: half the end load. labpipe reads the",
        "result (ending .dat) as an external curve and doubles the force.",
        "Run: ccx -i NAME, the name of this file without .inp.",
    )


def _closeness(material: EquivalentMaterial) -> Iterator[str]:
    """Describe the error of the law of the bar, and the range in which it is small."""
    worst = int(np.argmax(np.abs(material.error)))
    yield (
        f"there its moment is up to {100.0 * abs(material.error[worst]):.2g} % "
        f"{'above' if material.error[worst] > 0.0 else 'below'} the wire's "
        f"(at {material.curvature[worst]:.4g} 1/m)."
    )
    for tolerance in (0.01, 0.003):  # of the moment
        start = material.holds_from(tolerance)
        off = f"{100.0 * tolerance:g} %"
        if start is None:
            yield f"Its error exceeds {off} of the moment up to the end of the range."
        else:
            yield f"From {start:.4g} 1/m to the end of the range its error is below {off}."


def _own_loss(material: EquivalentMaterial) -> str:
    off, linear = np.abs(material.error), material.curvature <= material.elastic_curvature
    return (
        f"This deck: error on first loading up to {format_percent(float(off[~linear].max()))} of "
        f"the moment from {material.elastic_curvature:.4g} 1/m, up to "
        f"{format_percent(float(off.max()))} below."
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
    numbers_per_line = 12
    yield f"*NSET, NSET={name}"
    numbers = np.flatnonzero(members) + 1
    for start in range(0, len(numbers), numbers_per_line):
        yield f"{', '.join(map(str, numbers[start : start + numbers_per_line].tolist()))},"


def _lines(form: str, rows: Floats | Ints) -> str:
    """Format all rows of numbers at once, which is three times as fast as one by one."""
    return "\n".join([form] * len(rows)) % tuple(rows.ravel().tolist())


def _material(material: EquivalentMaterial, density: float) -> Iterator[str]:
    """Return true stress over plastic strain, constant after the last point; density in kg/m^3."""
    yield from ("*MATERIAL, NAME=WIRE", "*ELASTIC", f"{material.modulus:.9g}, 0.3")
    yield "*PLASTIC"
    for stress, strain in zip(material.stress, material.plastic_strain, strict=True):
        yield f"{stress:.9g}, {strain:.9g}"
    yield from ("*DENSITY", f"{density:.9g}")
    yield "*SOLID SECTION, ELSET=WIRE, MATERIAL=WIRE"


def _step(deflection: float, n_steps: int) -> Iterator[str]:
    """Return the step; with larger increments the iterations do not converge."""
    size = f"{1.0 / n_steps:.9g}"
    yield f"*STEP, NLGEOM, INC={100 * n_steps}"
    yield from ("*STATIC", f"{size}, 1., 1e-8, {size}")
    yield from ("*BOUNDARY", f"{TIP}, 2, 2, {deflection:.9g}")
    yield from (f"*NODE PRINT, NSET={TIP}", "U")
    yield from (f"*NODE PRINT, NSET={TIP}, TOTALS=ONLY", "RF")
    yield "*END STEP"
