"""Format an input file for CalculiX CrunchiX: a wire as a cantilever of solid bricks.

CalculiX has no moment-curvature law. The wire is modelled as a solid round bar of its diameter.
`law.loss_card` fits the elastic-plastic material of the bar. One end is clamped, and the other is
displaced laterally. Beam elements of CalculiX are not accurate enough. The program expands each
element into one brick over the whole section (CalculiX CrunchiX User's Manual, "Three-node beam
element"). In the section, this brick has two by two integration points. The strain is evaluated at
a single distance from the neutral plane, so that a circular beam is 2.4 % too flexible even while
it is elastic.

The mesh consists of twenty-node bricks. It covers one half of the bar, which is cut along the plane
of bending. x runs along the bar and y lies in the plane of bending. In the section, two bricks form
a rectangle at the axis, and four bricks form half a ring between the rectangle and the circle. All
outer nodes, also those at the middle of an edge, lie on the circle. The nodes of a brick are
numbered as in the manual ("Twenty-node brick element"): the four corners of the lower face, which
is nearer to the clamp, those of the upper face, then the mid-side nodes of the lower face, of the
upper face, and of the edges between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    describe_deck_errors,
    explain_missing_model,
    fill_template,
    format_percent,
    get_mass_per_length,
    shorten_name,
)
from labpipe.mechanics.decks.unloading import compute_linear_release
from labpipe.mechanics.law.loss_card import fit_equivalent_material
from labpipe.mechanics.law.plays import require_whole
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.wire import WireTable

TIP_SET = "TIPHALF"
"""Name of the node set whose displacement and force are printed: the tip of half the bar, which
carries half of the force."""
N_BRICKS_ALONG = 8
"""Default number of bricks along the bar."""
_RECTANGLE_HALF_WIDTH = 0.55
"""Half-width of the rectangle at the axis, relative to the radius."""
_QUADRANGLE_NODES = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)])
"""Lattice indices of the nodes of a quadrangle, relative to its first corner: four corners, then
four mid-side nodes."""


@dataclass(frozen=True, slots=True, eq=False)
class BarMesh:
    """Nodes and bricks of the half with z >= 0 of a bar of unit radius and length.

    Parameters
    ----------
    nodes : shape (nodes, 3), coordinates x, relative to the length, y and z, relative to the radius
    bricks : shape (bricks, 20), node numbers of each brick, counted from 1
    """

    nodes: Floats
    bricks: Ints

    @property
    def node_sets(self) -> dict[str, Flags]:
        """Return a flag for each node of each constrained or printed set, keyed by the set's name.

        ``CLAMP`` is the clamped face x = 0, ``HINGE`` the neutral axis y = 0 of that face, ``CUT``
        the plane of symmetry z = 0, and `TIP_SET` the neutral axis of the free face.
        """
        tolerance = 1e-6  # largest distance of a node from the plane to which it belongs
        x, y, z = self.nodes.T
        is_clamped, is_neutral = x < tolerance, np.abs(y) < tolerance
        is_tip = x > 1.0 - tolerance
        return {
            "CLAMP": is_clamped,
            "HINGE": is_clamped & is_neutral,
            "CUT": z < tolerance,
            TIP_SET: is_tip & is_neutral,
        }


@lru_cache(maxsize=4)
def mesh_half_bar(n_bricks_along: int) -> BarMesh:
    """Mesh half a round bar of unit radius and length.

    Parameters
    ----------
    n_bricks_along : number of bricks along the bar

    Raises
    ------
    ValueError
        If `n_bricks_along` is not a whole number >= 1.
    """
    require_whole("n_bricks_along", n_bricks_along, 1)
    points, quadrangles = _mesh_half_disc()
    corners, mid_sides = quadrangles[:, :4], quadrangles[:, 4:]
    section_points = np.hstack([corners, corners, mid_sides, mid_sides, corners])
    # A brick has nodes at three of the stations along the bar: lower face, upper face, middle.
    stations = np.repeat([0, 2, 0, 2, 1], 4) + 2 * np.arange(n_bricks_along)[:, None, None]
    places, bricks = np.unique(stations * len(points) + section_points, return_inverse=True)
    station, point = np.divmod(places, len(points))
    station_x = np.linspace(0.0, 1.0, 2 * n_bricks_along + 1)
    return BarMesh(np.column_stack([station_x[station], points[point]]), bricks.reshape(-1, 20) + 1)


def _mesh_half_disc() -> tuple[Floats, Ints]:
    """Mesh a half-disc of unit radius: a rectangle at the axis, and a half-ring around it.

    Return the points (y, z), shape (points, 2), and the indices of the points of eight-node
    quadrangles, shape (quadrangles, 8).
    """
    half_width = _RECTANGLE_HALF_WIDTH
    y, z = np.linspace(-half_width, half_width, 5), np.linspace(0.0, half_width, 3)
    rectangle = np.stack(np.meshgrid(y, z, indexing="ij"), axis=-1)
    outline = np.concatenate([rectangle[0], rectangle[1:-1, -1], rectangle[-1, ::-1]])
    angle = np.linspace(np.pi, 0.0, len(outline))
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    inward_fraction = np.array([1.0, 0.5, 0.0])[:, np.newaxis]
    ring = circle[:, np.newaxis] + inward_fraction * (outline - circle)[:, np.newaxis]
    quadrangles = np.concatenate([_list_quadrangles(lattice) for lattice in (rectangle, ring)])
    # Rounding merges the nodes that two quadrangles share. Adding 0.0 converts -0.0 to 0.0.
    points, point_indices = np.unique(
        quadrangles.reshape(-1, 2).round(12) + 0.0, axis=0, return_inverse=True
    )
    return points, point_indices.reshape(-1, 8).astype(np.int64)


def _list_quadrangles(lattice: Floats) -> Floats:
    """Return the node coordinates of the quadrangles of a lattice, shape (quadrangles, 8, 2)."""
    return np.array(
        [
            [lattice[i + u, j + v] for u, v in _QUADRANGLE_NODES]
            for i in range(0, lattice.shape[0] - 1, 2)
            for j in range(0, lattice.shape[1] - 1, 2)
        ]
    )


def format_calculix_deck(
    table: WireTable, *, n_bricks_along: int = N_BRICKS_ALONG, n_steps: int = 80
) -> str:
    """Return the input file of a cantilever test of a wire, ready to run in CalculiX.

    Parameters
    ----------
    table : table of the wire
    n_bricks_along : number of bricks along the bar
    n_steps : number of equal increments of the tip displacement. CalculiX divides an increment that
        does not converge. With far fewer increments than the default, it may stop without
        convergence

    Returns
    -------
    Text of the file, in 7-bit ASCII with lines of at most 132 characters. The text contains only
    comments, with the reason, if the table has no cantilever curve (note ``cantilever_cut`` of the
    table), or if the bar does not fit the law (`explain_missing_model`).

    Raises
    ------
    ValueError
        If `n_steps` or, in a deck with a model, `n_bricks_along` is not a whole number >= 1, or the
        mass per length is not finite and positive.

    Notes
    -----
    The clamped face cannot move along the bar, but may contract in its plane. At the tip, the nodes
    at y = 0 are displaced along y. They are free along x, and the tip may rotate. This represents
    an end load normal to the undeformed axis. The tip deflection is 0.6 of the free length, or the
    largest deflection within the range of the wire's law if that is smaller.
    """
    require_whole("n_steps", n_steps, 1)
    diameter = 2.0 * table.layout.wire_radius
    material = fit_equivalent_material(table.curvature[1:], table.moment[1:], diameter)
    max_deflection = 0.6  # relative to the free length
    deflection = min(max_deflection * table.spec.length, float(table.tip_deflection[-1]))
    errors, is_plastic = np.abs(material.error), material.curvature > material.elastic_curvature
    plastic_error = float(errors[is_plastic].max())
    percent, plastic_percent = format_percent(float(errors.max())), format_percent(plastic_error)
    deck_error_sentence = (
        f"In this deck, the error of the moment on first loading is at most {plastic_percent} "
        f"above {material.elastic_curvature:.4g} 1/m, and at most {percent} over the whole range."
    )
    # The release is elastic: no fibre of the bar yields in reverse before the moment is zero.
    deck_release = compute_linear_release(table, material.modulus * np.pi / 64.0 * diameter**4)
    reason = explain_missing_model(plastic_error)
    if deflection == 0.0:
        notes = (note.message for note in table.notes if note.code == "cantilever_cut")
        reason = next(notes, "the table has no cantilever")
    common_values = {
        "table": table,
        "material": material,
        "error_sentences": describe_deck_errors(
            table, deck_error_sentence, "a bar with its first slope", deck_release
        ),
        "reason": shorten_name(reason, 120),
    }
    if reason:
        return fill_template("calculix.inp", **common_values)
    mesh = mesh_half_bar(n_bricks_along)
    scale = np.array([table.spec.length, 0.5 * diameter, 0.5 * diameter])
    return fill_template(
        "calculix.inp",
        tip=TIP_SET,
        nodes=_number_rows(mesh.nodes * scale + 0.0),
        bricks=_number_rows(mesh.bricks),
        node_sets={
            name: (np.flatnonzero(nodes) + 1).tolist() for name, nodes in mesh.node_sets.items()
        },
        # True stress against plastic strain; CalculiX keeps the last stress beyond the last strain.
        plastic_curve=np.column_stack([material.stress, material.plastic_strain]),
        density=get_mass_per_length(table) / (np.pi / 4.0 * diameter**2),
        deflection=deflection,
        n_steps=n_steps,
        **common_values,
    )


def _number_rows(rows: Floats | Ints) -> Floats:
    """Prepend a column with the row numbers, counted from 1."""
    return np.column_stack([np.arange(1.0, len(rows) + 1.0), rows])
