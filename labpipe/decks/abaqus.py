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
    skew_excess,
    solid_area,
)
from labpipe.decks.deck_losses import deck_losses, hardens
from labpipe.law.thinning import Thinned, thin
from labpipe.records.wire import WireTable

_WAY_BACK = "if it hardens alike on both sides, where a wire follows Masing's rule"
_WIDEST_NAME = 100  # of a wire in a comment: lines end at 256 characters


def abaqus_deck(table: WireTable, *, most_points: int | None = None) -> str:
    """Write the beam section of a wire; the element set has the wire's label.

    Parameters
    ----------
    table : law of the wire
    most_points : of the law, zero and the end included; None for all of its corners

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
    most = len(table.curvature) if most_points is None else most_points
    law = thin(table.curvature, table.moment, most=most)
    label = abaqus_label(table.name)
    lines = [f"** {line}" for line in _comments(table, law, label)]
    lines += [_keyword(table, label), _geometry(table), "0., 0., -1."]
    lines += ["*AXIAL, LINEAR", f"{table.axial_stiffness:.9g}"]
    pairs = _pairs(law)
    lines += ["*M1", *pairs, "*M2", *pairs]
    lines += ["*TORQUE, LINEAR", f"{table.torsional_stiffness:.9g}"]
    return "\n".join(lines) + "\n"


def _comments(table: WireTable, law: Thinned, label: str) -> tuple[str, ...]:
    return (
        *facts(table, on_one_line(table.name, _WIDEST_NAME)),
        f"*M1, *M2: {len(law.curvature)} points; the straight lines between them are within "
        f"{law.error:.2g} of the wire's moment.",
        "Neither ELASTIC nor LINEAR: elastic-plastic, unloads with the first slope. Not for loops.",
        *deck_losses(table, hardens(table, law.error, _WAY_BACK)),
        "The guide does not say what follows the last point: hold SK1, SK2 against the range.",
        f"M1 and M2 do not know of each other: bent askew, the wire is up to "
        f"{100.0 * skew_excess(table):.2g} % too stiff.",
        "*AXIAL: of a wire that does not turn. *TORQUE: of one that does not lengthen. The section",
        f"has no place for their coupling, {table.stretch_twist_coupling:.6g} N m; a wire that is "
        f"free to lengthen",
        f"has a torsional stiffness of {table.free_torsional_stiffness:.6g} N m^2. Both without "
        f"yielding.",
        "Euler-Bernoulli elements (B33, B23): the wire's transverse shear is not known.",
        f"Element set {label}; first axis of the section in the global -z direction.",
    )


def _keyword(table: WireTable, label: str) -> str:
    line = f"*BEAM GENERAL SECTION, SECTION=NONLINEAR GENERAL, ELSET={label}"
    # a keyword line goes on after a comma
    return f"{line},\nDENSITY={mass_of(table) / solid_area(table):.9g}"


def _geometry(table: WireTable) -> str:
    """A, I11, I12, I22, J of the solid parts."""
    second = second_moment(table)
    return f"{solid_area(table):.9g}, {second:.9g}, 0., {second:.9g}, {2.0 * second:.9g}"


def _pairs(law: Thinned) -> list[str]:
    return [
        f"{moment:.12g}, {curvature:.12g}"
        for curvature, moment in zip(law.curvature, law.moment, strict=True)
    ]
