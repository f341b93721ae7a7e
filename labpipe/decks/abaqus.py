"""A wire for Abaqus: ``*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL`` as an include file.

Abaqus Keywords Guide, ``*BEAM GENERAL SECTION``, ``*AXIAL``, ``*M1``, ``*M2``, ``*TORQUE``: data
lines give force or moment first, strain or curvature second; with ``LINEAR`` the stiffness alone;
without ``LINEAR`` and ``ELASTIC`` the response is elastic-plastic, with the first slope as the
elastic one (Analysis User's Guide 29.3.7). Such a law is given on the positive side from the
origin.
"""

from __future__ import annotations

from labpipe.decks.deck_law import (
    abaqus_label,
    facts,
    mass_of,
    on_one_line,
    second_moment,
    skew_bending_error,
    solid_area,
)
from labpipe.decks.deck_losses import deck_losses, isotropic_loss
from labpipe.law.thinning import Thinned, thin
from labpipe.records.wire import WireTable


def abaqus_deck(table: WireTable, *, max_table_points: int | None = None) -> str:
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
    label = abaqus_label(table.name)
    lines = [f"** {line}" for line in _comments(table, law, label)]
    # a keyword line that ends with a comma is continued
    lines += [
        f"*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL, ELSET={label},",
        f"DENSITY={mass_of(table) / solid_area(table):.9g}",
    ]
    second = second_moment(table)  # I11 and I22; half of J
    lines += [f"{solid_area(table):.9g}, {second:.9g}, 0., {second:.9g}, {2.0 * second:.9g}"]
    lines += ["0., 0., -1."]
    lines += ["*AXIAL, LINEAR", f"{table.axial_stiffness:.9g}"]
    pairs = [
        f"{moment:.12g}, {curvature:.12g}"
        for curvature, moment in zip(law.curvature, law.moment, strict=True)
    ]
    lines += ["*M1", *pairs, "*M2", *pairs]
    lines += ["*TORQUE, LINEAR", f"{table.torsional_stiffness:.9g}"]
    return "\n".join(lines) + "\n"


def _comments(table: WireTable, law: Thinned, label: str) -> tuple[str, ...]:
    return (
        *facts(table, on_one_line(table.name)),
        f"*M1, *M2: {len(law.curvature)} points; the straight lines between them are within "
        f"{law.error:.2g} of the wire's moment.",
        "Without ELASTIC and LINEAR: elastic-plastic, unloads with the first slope. No cycles.",
        *deck_losses(table, isotropic_loss(table, law.error, "assuming isotropic hardening")),
        "The response beyond the last point is not documented: compare SK1, SK2 with the range.",
        f"M1 and M2 are uncoupled: in skew bending the wire is up to "
        f"{100.0 * skew_bending_error(table):.2g} % too stiff.",
        "*AXIAL: at constant twist. *TORQUE: at constant length. Both are linear; their",
        f"coupling, {table.stretch_twist_coupling:.6g} N m, has no place in the section. The",
        f"torsional stiffness at zero tension is {table.free_torsional_stiffness:.6g} N m^2.",
        "Euler-Bernoulli elements (B33, B23): the transverse shear stiffness is unknown.",
        f"Element set {label}; first axis of the section in the global -z direction.",
    )
