"""Write the beam section of a wire as an include file for Abaqus and for Ansys.

Abaqus: ``*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL``. Abaqus Keywords Guide, keywords
``*BEAM GENERAL SECTION``, ``*AXIAL``, ``*M1``, ``*M2``, ``*TORQUE``: data lines give force or
moment first, strain or curvature second; with ``LINEAR`` the stiffness alone; without ``LINEAR``
and ``ELASTIC`` the response is elastic-plastic, with the first slope as the elastic one (Analysis
User's Guide 29.3.7). Such a law is stated for positive strains, from the origin.

Ansys Mechanical APDL: ``SECTYPE,,GENB,PLASTIC`` with its tables, for BEAM188 and BEAM189.
Mechanical APDL Structural Analysis Guide, "Using Nonlinear General Beam Sections": strain first,
force second, the origin is implied; at most 20 points for each component, each later slope below
the first; a plastic section requires all six components with two points or more; beyond the last
strain the stiffness is zero. ``GENB`` is a section type like ``BEAM``, and its subtype is
``ELASTIC`` or ``PLASTIC`` (Command Reference, ``SECTYPE``).
"""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_skew_bending_error,
    describe_deck_losses,
    describe_loading_error,
    fill_template,
    find_mass,
    list_facts,
    make_abaqus_label,
    make_ansys_name,
)
from labpipe.mechanics.decks.unloading import release_elastically
from labpipe.mechanics.law.plays import require
from labpipe.mechanics.law.thinning import ThinnedLaw, thin
from labpipe.records.wire import WireTable

MAX_POINTS = 20
"""Largest number of points in a table of Ansys, without the origin."""


def write_abaqus_deck(table: WireTable) -> str:
    """Write the beam section of a wire for Abaqus; its element set is `make_abaqus_label`.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    Text of an include file, in 7-bit ASCII with lines of at most 256 characters.

    Raises
    ------
    ValueError
        As `thin` and `find_mass`.

    Notes
    -----
    Area and second moments are those of a full circle: a nonlinear general section uses them for
    mass and rotary inertia only. Density is mass per length over area.
    """
    law = thin(table.curvature, table.moment, max_points=len(table.curvature))
    return fill_template(
        "abaqus.inp",
        table=table,
        head=list_facts(table),
        law=law,
        points=np.column_stack([law.moment, law.curvature]),
        losses=_describe_losses(table, law),
        skew=compute_skew_bending_error(table),
        label=make_abaqus_label(table.name),
        mass=find_mass(table),
        area=np.pi * table.layout.wire_radius**2,
        second=np.pi / 4.0 * table.layout.wire_radius**4,  # I11 and I22; half of J
    )


def _describe_losses(table: WireTable, law: ThinnedLaw, line_width: int = 120) -> tuple[str, ...]:
    """Describe the losses of a section that unloads with its first slope."""
    deck_loss = describe_loading_error(law.error)
    deck_release = release_elastically(table, float(law.moment[1] / law.curvature[1]))
    return describe_deck_losses(
        table, deck_loss, "with its first slope", deck_release, line_width=line_width
    )


def write_ansys_deck(table: WireTable, *, section: int = 1) -> str:
    """Write the beam section of a wire as commands of the preprocessor of Ansys.

    Parameters
    ----------
    table : law of the wire
    section : number of the section

    Returns
    -------
    Text of an input file, ASCII with lines of at most 80 characters.

    Raises
    ------
    ValueError
        As `thin` and `find_mass`; if the section's number is below 1.

    Notes
    -----
    The transverse shear stiffness of a wire is unknown, but a plastic section requires one: GA =
    3 EI / (0.001 (10 d)^2) adds a thousandth to the deflection P L^3 / 3 EI of a free length of
    ten wire diameters d, and less to a longer one.
    """
    require("section", section, "a whole number >= 1", holds=section >= 1)
    law = thin(table.curvature, table.moment, max_points=MAX_POINTS + 1)
    comment_width = 76  # lines have at most 80 characters, of which two are the "! " of a comment
    return fill_template(
        "ansys.inp",
        table=table,
        head=list_facts(table, 32),
        law=law,
        points=np.column_stack([law.curvature, law.moment])[1:],
        max_points=MAX_POINTS,
        losses=_describe_losses(table, law, comment_width),
        skew=compute_skew_bending_error(table),
        section=section,
        name=make_ansys_name(table.name),
        shear=compute_shear_stiffness(table),
        mass=find_mass(table),
    )


def compute_shear_stiffness(table: WireTable) -> float:
    """Return a transverse shear stiffness, N, with little effect (see `write_ansys_deck`)."""
    min_length_in_diameters = 10.0  # free length over wire diameter
    max_shear_share = 1e-3  # shear deflection over tip deflection
    length = min_length_in_diameters * 2.0 * table.layout.wire_radius
    return 3.0 * table.stick_stiffness / (max_shear_share * length**2)
