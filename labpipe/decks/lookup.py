"""Tables of a wire for programs that read numbers: CSV, and JSON for cable simulators."""

from __future__ import annotations

import json

from labpipe import __version__
from labpipe.decks.deck_law import FIRST_LOADING, facts, mass_of, on_one_line
from labpipe.decks.deck_losses import card_numbers, deck_losses, memoryless_loss
from labpipe.records.wire import WireTable

SCHEMA = 2
"""Version of the JSON table."""


COLUMNS = {
    "curvature": "1/m",
    "moment": "N*m",
    "stick": "N*m",
    "slip": "N*m",
    "bending": "N*m",
    "plastic": "N*m",
    "insulation": "N*m",
    "tangent_stiffness": "N*m^2",
    "secant_stiffness": "N*m^2",
    "lowest_moment": "N*m",
    "highest_moment": "N*m",
    "insulation_share": "1",
    "is_doubtful": "1",
}
"""Columns of the CSV table, as the fields of `WireTable`, and their units."""

_UNITS = {
    "curvature": "1/m",
    "moment": "N*m",
    "stick_stiffness": "N*m^2",
    "slip_stiffness": "N*m^2",
    "axial_stiffness": "N",
    "torsional_stiffness": "N*m^2",
    "free_torsional_stiffness": "N*m^2",
    "stretch_twist_coupling": "N*m",
    "diameter": "m",
    "length": "m",
    "mass_per_length": "kg/m",
}


def lookup_csv(table: WireTable) -> str:
    """Write the whole table, one row for each curvature.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    Text: lines that begin with ``#``, a heading such as ``curvature [1/m]``, rows with full digits.
    """
    lines = [f"# {line}" for line in facts(table, on_one_line(table.name))]
    lines += [
        f"# Stick stiffness {table.stick_stiffness:.9g} N m^2, slip stiffness "
        f"{table.slip_stiffness:.9g} N m^2, mass {mass_of(table):.9g} kg/m.",
        f"# Axial stiffness EA {table.axial_stiffness:.9g} N (constant twist), torsional stiffness "
        f"GJ {table.torsional_stiffness:.9g} N m^2",
        f"# (constant length; {table.free_torsional_stiffness:.9g} at zero tension), coupling C "
        f"{table.stretch_twist_coupling:.9g} N m.",
        *(f"# {line}" for line in deck_losses(table, memoryless_loss(table), wide=1000)),
        "# moment = stick + slip + bending + plastic + insulation; lowest and highest over all "
        "directions of bending.",
        "# insulation_share: of the moment. is_doubtful: 1 beyond the range of the insulation's "
        "straight line.",
        ",".join(f"{name} [{unit}]" for name, unit in COLUMNS.items()),
    ]
    numbers = {name: getattr(table, name) for name in COLUMNS} | {
        "is_doubtful": table.is_doubtful.astype(int)
    }
    columns = [map(repr, number.tolist()) for number in numbers.values()]
    lines += map(",".join, zip(*columns, strict=True))
    return "\n".join(lines) + "\n"


def lookup_json(table: WireTable) -> str:
    """Write pairs of curvature and moment, and the constant stiffnesses.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    JSON text; units of all numbers are under ``units``.
    """
    numbers: dict[str, object] = {
        "curvature": table.curvature.tolist(),
        "moment": table.moment.tolist(),
        "stick_stiffness": table.stick_stiffness,
        "slip_stiffness": table.slip_stiffness,
        "axial_stiffness": table.axial_stiffness,
        "torsional_stiffness": table.torsional_stiffness,
        "free_torsional_stiffness": table.free_torsional_stiffness,
        "stretch_twist_coupling": table.stretch_twist_coupling,
        "diameter": 2.0 * table.layout.wire_radius,
        "length": table.spec.length,
        "mass_per_length": mass_of(table),
    }
    document = {
        "schema": SCHEMA,
        "labpipe": __version__,
        "wire": table.name,
        "range": {"curvature": [0.0, float(table.curvature[-1])], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "law": FIRST_LOADING,
        "torsion": (
            "tension and torque are [EA, C; C, GJ] times strain and twist: axial_stiffness EA is "
            "at constant twist, torsional_stiffness GJ at constant length, "
            "free_torsional_stiffness GJ - C^2 / EA at zero tension"
        ),
        **numbers,
        "loss_card": card_numbers(table),
        "units": {name: _UNITS[name] for name in numbers},
    }
    return json.dumps(document, indent=1) + "\n"
