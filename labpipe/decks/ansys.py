"""A wire for Ansys Mechanical APDL: ``SECTYPE,,GENB,PLASTIC`` with its tables.

Mechanical APDL Structural Analysis Guide, "Using Nonlinear General Beam Sections": strain first,
force second, the origin understood; at most 20 points for each component, each later slope below
the first; a plastic section wants all six components with two points or more; beyond the last
strain the stiffness vanishes. ``GENB`` is a type of its own, beside ``BEAM``, and its subtype is
``ELASTIC`` or ``PLASTIC`` (Command Reference, ``SECTYPE``). For BEAM188 and BEAM189.
"""

from __future__ import annotations

from labpipe.decks.deck_law import (
    COMMENT_MOST,
    ansys_name,
    facts,
    mass_of,
    on_one_line,
    skew_excess,
)
from labpipe.decks.deck_losses import deck_losses, hardens
from labpipe.law.thinning import Thinned, thin
from labpipe.records.wire import WireTable

MOST_POINTS = 20
"""Points of a table, the origin not counted."""

LARGEST_STRAIN = 0.01
"""End of the axial table."""
LARGEST_TWIST = 100.0
"""End of the torsion table, rad/m."""
LARGEST_SHEAR = 0.1
"""End of the shear tables."""

_WIDEST = 76  # of a comment: lines end at 80 characters
_SHORTEST = 10.0  # wire diameters: free lengths on which shear is to add nothing
_SHEAR_SHARE = 1e-3  # of the deflection under an end load, at most, that shear adds there


def ansys_deck(table: WireTable, *, section: int = 1) -> str:
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
    The transverse shear of a wire is not known, but a plastic section asks for it: GA = 3 EI /
    (0.001 (10 d)^2) adds a thousandth to the deflection P L^3 / 3 EI of a free length of ten wire
    diameters d, and less to a longer one.
    """
    if section < 1:
        message = f"section={section}: allowed are whole numbers >= 1"
        raise ValueError(message)
    law = thin(table.curvature, table.moment, most=MOST_POINTS + 1)
    lines = [f"! {line}" for line in _comments(table, law)]
    lines += [f"SECTYPE,{section},GENB,PLASTIC,{ansys_name(table.name)}"]
    lines += _linear("BSAX", LARGEST_STRAIN, table.axial_stiffness)
    points = _points(law)
    lines += [f"{command},{point}" for command in ("BSM1", "BSM2") for point in points]
    lines += _linear("BSTQ", LARGEST_TWIST, table.torsional_stiffness)
    for command in ("BSS1", "BSS2"):
        lines += _linear(command, LARGEST_SHEAR, shear_stiffness(table))
    lines += [f"BSMD,{mass_of(table):.9g}"]
    return "\n".join(lines) + "\n"


def shear_stiffness(table: WireTable) -> float:
    """Transverse shear stiffness that leaves bending alone, N (see `ansys_deck`)."""
    length = _SHORTEST * 2.0 * table.layout.wire_radius
    return 3.0 * table.stick_stiffness / (_SHEAR_SHARE * length**2)


def _comments(table: WireTable, law: Thinned) -> tuple[str, ...]:
    own = hardens(table, law.error, "isotropic hardening")
    return (
        *facts(table, on_one_line(table.name, COMMENT_MOST)),
        "Beyond the last point the program has no stiffness: look at the curvatures.",
        f"BSM1, BSM2: {len(law.curvature) - 1} points and the origin, at most {MOST_POINTS} "
        f"allowed;",
        f"the lines between them are within {law.error:.2g} of the wire's moment.",
        "PLASTIC: unloads with the first slope, hardens isotropically on reversal,",
        "where a wire follows Masing's rule. Not for loops.",
        *deck_losses(table, own, wide=_WIDEST),
        "BSM1 and BSM2 do not know of each other: bent askew, the wire is",
        f"up to {100.0 * skew_excess(table):.2g} % too stiff.",
        f"BSAX: of a wire that does not turn, to a strain of {LARGEST_STRAIN:g}.",
        f"BSTQ: of one that does not lengthen, to {LARGEST_TWIST:g} rad/m. No place is there",
        f"for their coupling, {table.stretch_twist_coupling:.4g} N m; free to lengthen, the wire",
        f"has a torsional stiffness of {table.free_torsional_stiffness:.6g} N m^2.",
        "BSS1, BSS2: not the wire's, which is not known: stiff enough to add",
        "less than 0.1 % to the deflection of ten wire diameters and more.",
        "BEAM188 or BEAM189, NLGEOM,ON.",
    )


def _linear(command: str, end: float, stiffness: float) -> list[str]:
    """Two points of a straight line, which a plastic section asks for."""
    return [f"{command},{part:.9g},{stiffness * part:.9g}" for part in (0.1 * end, end)]


def _points(law: Thinned) -> list[str]:
    return [
        f"{curvature:.12g},{moment:.12g}"
        for curvature, moment in zip(law.curvature[1:], law.moment[1:], strict=True)
    ]
