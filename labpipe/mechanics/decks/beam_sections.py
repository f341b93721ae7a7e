"""Format the law of a wire as a beam section for Abaqus and for Ansys.

In Abaqus, the section is ``*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL`` with the keywords
``*AXIAL``, ``*M1``, ``*M2`` and ``*TORQUE`` [1]_. Data lines state force or moment first, and
strain or curvature second. With ``LINEAR``, they state only the stiffness. Without ``LINEAR`` and
``ELASTIC``, the response is elastic-plastic, and the first slope is the elastic stiffness [2]_.
Such a law is stated for positive strains, from the origin.

In Ansys Mechanical APDL, the section is ``SECTYPE,,GENB,PLASTIC`` with its tables, for BEAM188 and
BEAM189 [3]_. ``GENB`` is a section type like ``BEAM``, and its subtype is ``ELASTIC`` or
``PLASTIC`` [4]_. A table states strain first, and force second. The origin is implied. A table has
at most 20 points for each component. All slopes after the first must be smaller than the first, but
the points of a linear component may lie on a straight line. A plastic section requires all six
components, each with two points or more. Beyond the last strain, the stiffness is zero.

References
----------
.. [1] Abaqus Keywords Guide.
.. [2] Abaqus Analysis User's Guide, section 29.3.7.
.. [3] Mechanical APDL Structural Analysis Guide, "Using Nonlinear General Beam Sections".
.. [4] Mechanical APDL Command Reference, ``SECTYPE``.
"""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_skew_bending_error,
    describe_deck_errors,
    describe_loading_error,
    explain_missing_model,
    fill_template,
    get_mass_per_length,
    make_abaqus_label,
    make_ansys_name,
)
from labpipe.mechanics.decks.unloading import compute_linear_release
from labpipe.mechanics.law.plays import require_whole
from labpipe.mechanics.law.thinning import ThinnedLaw, thin_law
from labpipe.records.wire import WireTable

MAX_ANSYS_POINTS = 20
"""Largest number of points in a table of Ansys, without the origin."""


def format_abaqus_deck(table: WireTable) -> str:
    """Return the beam section of a wire for Abaqus, for an element set with its label.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Text of an include file, in 7-bit ASCII with lines of at most 256 characters. The element set is
    named by `make_abaqus_label`. If the law of the deck differs too much from that of the wire
    (`explain_missing_model`), the text contains only comments.

    Raises
    ------
    ValueError
        If the law cannot be represented (`thin_law`), or the mass per length is not finite and
        positive.

    Notes
    -----
    Area and second moments are those of a full circle. A nonlinear general section uses them only
    for mass and rotary inertia. The density is mass per length over area.
    """
    law = thin_law(table.curvature, table.moment, max_points=len(table.curvature))
    return fill_template(
        "abaqus.inp",
        table=table,
        reason=explain_missing_model(law.error),
        points=np.column_stack([law.moment, law.curvature]),
        error_sentences=_describe_errors(table, law),
        skew_error=compute_skew_bending_error(table),
        label=make_abaqus_label(table.name),
        mass_per_length=get_mass_per_length(table),
        area=np.pi * table.layout.wire_radius**2,
        second_moment=np.pi / 4.0 * table.layout.wire_radius**4,  # I11 and I22; half of J
    )


def _describe_errors(table: WireTable, law: ThinnedLaw) -> tuple[str, ...]:
    """Return sentences on the errors of a section that unloads with its first slope."""
    deck_error_sentence = describe_loading_error(law.error)
    deck_release = compute_linear_release(table, float(law.moment[1] / law.curvature[1]))
    return describe_deck_errors(table, deck_error_sentence, "with its first slope", deck_release)


def format_ansys_deck(table: WireTable, *, section_number: int = 1) -> str:
    """Return the beam section of a wire as commands of the preprocessor of Ansys.

    Parameters
    ----------
    table : table of the wire
    section_number : number of the section in the model

    Returns
    -------
    Text of an input file, in 7-bit ASCII with lines of at most 80 characters. If the law of the
    deck differs too much from that of the wire (`explain_missing_model`), the text contains only
    comments.

    Raises
    ------
    ValueError
        If the law cannot be represented (`thin_law`), the mass per length is not finite and
        positive, or `section_number` is not a whole number >= 1.

    Notes
    -----
    The transverse shear stiffness of a wire is unknown, but a plastic section requires one. With
    GA = 3 EI / (0.001 (10 d)^2), the deflection P L^3 / (3 EI) of a free length of ten wire
    diameters d increases by a thousandth. The deflection of a longer wire increases by less.
    """
    require_whole("section_number", section_number, 1)
    law = thin_law(table.curvature, table.moment, max_points=MAX_ANSYS_POINTS + 1)
    points = np.column_stack([law.curvature, law.moment])[1:]
    if len(points) == 1:  # a linear law; the program requires two points
        points = np.vstack([0.1 * points, points])
    return fill_template(
        "ansys.inp",
        table=table,
        reason=explain_missing_model(law.error),
        points=points,
        max_points=MAX_ANSYS_POINTS,
        error_sentences=_describe_errors(table, law),
        skew_error=compute_skew_bending_error(table),
        section_number=section_number,
        name=make_ansys_name(table.name),
        shear_stiffness=compute_shear_stiffness(table),
        mass_per_length=get_mass_per_length(table),
    )


def compute_shear_stiffness(table: WireTable) -> float:
    """Return a transverse shear stiffness, N, with little effect (Notes of `format_ansys_deck`)."""
    min_relative_length = 10.0  # free length relative to the wire diameter
    max_shear_ratio = 1e-3  # shear deflection relative to tip deflection
    length = min_relative_length * 2.0 * table.layout.wire_radius
    return 3.0 * table.stick_stiffness / (max_shear_ratio * length**2)
