"""A wire for Ansys Mechanical APDL: ``SECTYPE,,GENB,PLASTIC`` with its tables.

Mechanical APDL Structural Analysis Guide, "Using Nonlinear General Beam Sections": strain first,
force second, the origin understood; at most 20 points for each component, each later slope below
the first; a plastic section wants all six components with two points or more; beyond the last
strain the stiffness vanishes. ``GENB`` is a type of its own, beside ``BEAM``, and its subtype is
``ELASTIC`` or ``PLASTIC`` (Command Reference, ``SECTYPE``). For BEAM188 and BEAM189.
"""

from __future__ import annotations

from labpipe.decks.deck_law import (
    ansys_name,
    facts,
    mass_of,
    on_one_line,
    skew_bending_error,
)
from labpipe.decks.deck_losses import deck_losses, isotropic_loss
from labpipe.law.thinning import Thinned, thin
from labpipe.records.wire import WireTable

MAX_POINTS = 20
"""Points of a table without the origin."""

_MAX_STRAIN = 0.01
"""End of the axial table."""
_MAX_TWIST = 100.0
"""End of the torsion table, rad/m."""


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
    The transverse shear stiffness of a wire is unknown, but a plastic section requires one: GA =
    3 EI / (0.001 (10 d)^2) adds a thousandth to the deflection P L^3 / 3 EI of a free length of
    ten wire diameters d, and less to a longer one.
    """
    if section < 1:
        message = f"section={section}: must be an integer >= 1"
        raise ValueError(message)
    law = thin(table.curvature, table.moment, max_points=MAX_POINTS + 1)
    lines = [f"! {line}" for line in _comments(table, law)]
    lines += [f"SECTYPE,{section},GENB,PLASTIC,{ansys_name(table.name)}"]
    lines += _linear("BSAX", _MAX_STRAIN, table.axial_stiffness)
    points = [
        f"{curvature:.12g},{moment:.12g}"
        for curvature, moment in zip(law.curvature[1:], law.moment[1:], strict=True)
    ]
    lines += [f"{command},{point}" for command in ("BSM1", "BSM2") for point in points]
    lines += _linear("BSTQ", _MAX_TWIST, table.torsional_stiffness)
    for command in ("BSS1", "BSS2"):
        lines += _linear(command, 0.1, shear_stiffness(table))  # to a shear strain of 0.1
    lines += [f"BSMD,{mass_of(table):.9g}"]
    return "\n".join(lines) + "\n"


def shear_stiffness(table: WireTable) -> float:
    """Return a transverse shear stiffness, N, that hardly adds to bending (see `ansys_deck`)."""
    # shortest free length, in wire diameters
    min_length_in_diameters = 10.0
    max_shear_share = 1e-3  # of the tip deflection
    length = min_length_in_diameters * 2.0 * table.layout.wire_radius
    return 3.0 * table.stick_stiffness / (max_shear_share * length**2)


def _comments(table: WireTable, law: Thinned) -> tuple[str, ...]:
    line_width = 76  # lines of the deck end at 80 characters, those of comments begin with "! "
    loss = isotropic_loss(table, law.error, "isotropic hardening")
    return (
        *facts(table, on_one_line(table.name, 32)),
        "Beyond the last point the stiffness is zero: check the curvatures.",
        f"BSM1, BSM2: {len(law.curvature) - 1} points and the origin, at most {MAX_POINTS} "
        f"allowed;",
        f"the lines between them are within {law.error:.2g} of the wire's moment.",
        "PLASTIC: unloads with the first slope, hardens isotropically on reversal,",
        "where a wire follows Masing's rule. Not for cycles.",
        *deck_losses(table, loss, wide=line_width),
        "BSM1 and BSM2 are uncoupled: in skew bending the wire is",
        f"up to {100.0 * skew_bending_error(table):.2g} % too stiff.",
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
