"""Beam sections of a wire for Abaqus and Ansys: include files.

Abaqus: ``*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL`` as an include file.

Abaqus Keywords Guide, ``*BEAM GENERAL SECTION``, ``*AXIAL``, ``*M1``, ``*M2``, ``*TORQUE``: data
lines give force or moment first, strain or curvature second; with ``LINEAR`` the stiffness alone;
without ``LINEAR`` and ``ELASTIC`` the response is elastic-plastic, with the first slope as the
elastic one (Analysis User's Guide 29.3.7). Such a law is given on the positive side from the
origin.

A wire for Ansys Mechanical APDL: ``SECTYPE,,GENB,PLASTIC`` with its tables.

Mechanical APDL Structural Analysis Guide, "Using Nonlinear General Beam Sections": strain first,
force second, the origin understood; at most 20 points for each component, each later slope below
the first; a plastic section wants all six components with two points or more; beyond the last
strain the stiffness vanishes. ``GENB`` is a type of its own, beside ``BEAM``, and its subtype is
``ELASTIC`` or ``PLASTIC`` (Command Reference, ``SECTYPE``). For BEAM188 and BEAM189.
"""

from __future__ import annotations

from labpipe.mechanics.decks.deck_law import (
    compute_second_moment,
    compute_skew_bending_error,
    compute_solid_area,
    describe_deck_losses,
    describe_isotropic_loss,
    find_mass,
    list_facts,
    make_abaqus_label,
    make_ansys_name,
    shorten_name,
)
from labpipe.mechanics.decks.unloading import Release, release_elastically
from labpipe.mechanics.law.plays import require
from labpipe.mechanics.law.thinning import Thinned, thin
from labpipe.records.wire import WireTable


def write_abaqus_deck(table: WireTable, *, max_table_points: int | None = None) -> str:
    """Write the beam section of a wire; the element set has the wire's label.

    Parameters
    ----------
    table : law of the wire
    max_table_points : of the law, zero and the end included; None for all of its corners

    Returns
    -------
    Text of an include file, in 7-bit ASCII with lines of at most 256 characters.

    Raises
    ------
    ValueError
        As `thin`.

    Notes
    -----
    Area and second moments are those of strands and insulation: in a nonlinear general section they
    serve mass and rotary inertia only. Density is mass per length over area.
    """
    max_points = len(table.curvature) if max_table_points is None else max_table_points
    law = thin(table.curvature, table.moment, max_points=max_points)
    label = make_abaqus_label(table.name)
    lines = [f"** {line}" for line in _abaqus_comments(table, law, label)]
    # a keyword line that ends with a comma is continued
    lines += [
        f"*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL, ELSET={label},",
        f"DENSITY={find_mass(table) / compute_solid_area(table):.9g}",
    ]
    second = compute_second_moment(table)  # I11 and I22; half of J
    lines += [
        f"{compute_solid_area(table):.9g}, {second:.9g}, 0., {second:.9g}, {2.0 * second:.9g}"
    ]
    lines += ["0., 0., -1."]
    lines += ["*AXIAL, LINEAR", f"{table.axial_stiffness:.9g}"]
    pairs = [
        f"{moment:.12g}, {curvature:.12g}"
        for curvature, moment in zip(law.curvature, law.moment, strict=True)
    ]
    lines += ["*M1", *pairs, "*M2", *pairs]
    lines += ["*TORQUE, LINEAR", f"{table.torsional_stiffness:.9g}"]
    return "\n".join(lines) + "\n"


def _unloading(table: WireTable, law: Thinned) -> tuple[str, Release]:
    """Return the rule of a section that unloads with its first slope, and its release."""
    first_slope = float(law.moment[1] / law.curvature[1])
    return "with its first slope", release_elastically(table, first_slope)


def _abaqus_comments(table: WireTable, law: Thinned, label: str) -> tuple[str, ...]:
    return (
        *list_facts(table, shorten_name(table.name)),
        f"*M1, *M2: {len(law.curvature)} points; the straight lines between them are within "
        f"{law.error:.2g} of the wire's moment.",
        "Without ELASTIC and LINEAR: elastic-plastic, unloads with the first slope. No cycles.",
        *describe_deck_losses(
            table,
            describe_isotropic_loss(table, law.error, "assuming isotropic hardening"),
            *_unloading(table, law),
        ),
        "The response beyond the last point is not documented: compare SK1, SK2 with the range.",
        f"M1 and M2 are uncoupled: in skew bending the wire is up to "
        f"{100.0 * compute_skew_bending_error(table):.2g} % too stiff.",
        "*AXIAL: at constant twist. *TORQUE: at constant length. Both are linear; their",
        f"coupling, {table.stretch_twist_coupling:.6g} N m, has no place in the section. The",
        f"torsional stiffness at zero tension is {table.free_torsional_stiffness:.6g} N m^2.",
        "Euler-Bernoulli elements (B33, B23): the transverse shear stiffness is unknown.",
        f"Element set {label}; first axis of the section in the global -z direction.",
    )


MAX_POINTS = 20
"""Points of a table without the origin."""

_MAX_STRAIN = 0.01
"""End of the axial table."""
_MAX_TWIST = 100.0
"""End of the torsion table, rad/m."""


def write_ansys_deck(table: WireTable, *, section: int = 1) -> str:
    """Write the beam section of a wire as commands of the preprocessor.

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
        As `thin`; if the section's number is below 1.

    Notes
    -----
    The transverse shear stiffness of a wire is unknown, but a plastic section requires one: GA =
    3 EI / (0.001 (10 d)^2) adds a thousandth to the deflection P L^3 / 3 EI of a free length of
    ten wire diameters d, and less to a longer one.
    """
    require("section", section, "a whole number >= 1", holds=section >= 1)
    law = thin(table.curvature, table.moment, max_points=MAX_POINTS + 1)
    lines = [f"! {line}" for line in _ansys_comments(table, law)]
    lines += [f"SECTYPE,{section},GENB,PLASTIC,{make_ansys_name(table.name)}"]
    lines += _linear("BSAX", _MAX_STRAIN, table.axial_stiffness)
    points = [
        f"{curvature:.12g},{moment:.12g}"
        for curvature, moment in zip(law.curvature[1:], law.moment[1:], strict=True)
    ]
    lines += [f"{command},{point}" for command in ("BSM1", "BSM2") for point in points]
    lines += _linear("BSTQ", _MAX_TWIST, table.torsional_stiffness)
    for command in ("BSS1", "BSS2"):
        lines += _linear(command, 0.1, compute_shear_stiffness(table))  # to a shear strain of 0.1
    lines += [f"BSMD,{find_mass(table):.9g}"]
    return "\n".join(lines) + "\n"


def compute_shear_stiffness(table: WireTable) -> float:
    """Return a transverse shear stiffness, N, that adds little (see `write_ansys_deck`)."""
    # shortest free length, in wire diameters
    min_length_in_diameters = 10.0
    max_shear_share = 1e-3  # of the tip deflection
    length = min_length_in_diameters * 2.0 * table.layout.wire_radius
    return 3.0 * table.stick_stiffness / (max_shear_share * length**2)


def _ansys_comments(table: WireTable, law: Thinned) -> tuple[str, ...]:
    line_width = 76  # lines of the deck end at 80 characters, those of comments begin with "! "
    loss = describe_isotropic_loss(table, law.error, "isotropic hardening")
    return (
        *list_facts(table, shorten_name(table.name, 32)),
        "Beyond the last point the stiffness is zero: check the curvatures.",
        f"BSM1, BSM2: {len(law.curvature) - 1} points and the origin, at most {MAX_POINTS} "
        f"allowed;",
        f"the lines between them are within {law.error:.2g} of the wire's moment.",
        "PLASTIC: unloads with the first slope, hardens isotropically on reversal,",
        "friction included. Not for cycles.",
        *describe_deck_losses(table, loss, *_unloading(table, law), wide=line_width),
        "BSM1 and BSM2 are uncoupled: in skew bending the wire is",
        f"up to {100.0 * compute_skew_bending_error(table):.2g} % too stiff.",
        f"BSAX: at constant twist, to a strain of {_MAX_STRAIN:g}.",
        f"BSTQ: at constant length, to {_MAX_TWIST:g} rad/m. The section cannot",
        f"represent their coupling, {table.stretch_twist_coupling:.4g} N m. The torsional",
        f"stiffness at zero tension is {table.free_torsional_stiffness:.6g} N m^2.",
        "BSS1, BSS2: assumed, as the shear stiffness of the wire is unknown. They",
        "add less than 0.1 % to the deflection of ten wire diameters or more.",
        "BEAM188 or BEAM189, NLGEOM,ON.",
    )


def _linear(command: str, end: float, stiffness: float) -> list[str]:
    """Return two points of a straight line, as a plastic section requires."""
    return [f"{command},{part:.9g},{stiffness * part:.9g}" for part in (0.1 * end, end)]
