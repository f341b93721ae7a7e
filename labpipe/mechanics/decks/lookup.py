"""Tables of a wire for programs that read numbers: CSV, and JSON for cable simulators."""

from __future__ import annotations

import json
from dataclasses import asdict

from labpipe import __version__
from labpipe.mechanics.decks.deck_law import (
    FIRST_LOADING,
    card_numbers,
    deck_losses,
    facts,
    loss_text,
    mass_of,
    memoryless_loss,
    on_one_line,
)
from labpipe.mechanics.law.loss_card import sliders_of, table_card
from labpipe.mechanics.law.sliders import in_directions, slip_moments
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
    derived = {
        "curvature": table.curvature.tolist(),
        "moment": table.moment.tolist(),
        "diameter": 2.0 * table.layout.wire_radius,
        "length": table.spec.length,
        "mass_per_length": mass_of(table),
    }
    numbers = {name: derived.get(name) or getattr(table, name) for name in _UNITS}
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
        "units": _UNITS,
    }
    return json.dumps(document, indent=1) + "\n"


SLIDERS_SCHEMA = 1
"""Version of the JSON."""
DIRECTIONS = 4
"""Directions of scalar sliders in space."""

_MEANING = (
    "moment = stiffness * curvature + sum of stiffnesses[j] * stop[j], |stop[j]| <= "
    "slip_curvatures[j]; stop[j] changes with the curvature and stays at its limit; in space "
    "stop[j] is a vector"
)
_DAHL = "moment = stiffness * curvature + moment * (1 - exp(-curvature / decay)) on first loading"
_SLIDER_UNITS = {
    "stiffness": "N*m^2",
    "stiffnesses": "N*m^2",
    "slip_curvatures": "1/m",
    "slip_moments": "N*m",
    "moment": "N*m",
    "decay": "1/m",
    "curvature": "1/m",
    "mass_per_length": "kg/m",
    "torsional_stiffness": "N*m^2",
    "error": "1",
    "sideways": "1",
}


def no_sliders_text(error: ValueError) -> str:
    """Return the sentence of a deck that has no sliders.

    Parameters
    ----------
    error : of `fit_sliders`
    """
    return f"No sliders, and nothing to run: {error}."


def sliders_csv(table: WireTable) -> str:
    """Write a row for each slider, the spring first, which never slides.

    Parameters
    ----------
    table : law of the wire; one that cannot be fitted by sliders gets the reason and no rows
    """
    lines = [f"# {line}" for line in facts(table, on_one_line(table.name))]
    try:
        law = sliders_of(table)
    except ValueError as error:
        return "\n".join([*lines, f"# {no_sliders_text(error)}"]) + "\n"
    lines += [
        f"# Mass {mass_of(table):.9g} kg/m, torsional stiffness {table.torsional_stiffness:.9g} "
        "N m^2.",
        f"# {len(law.stiffnesses)} sliders, within {100.0 * law.error:.2g} % of the wire's moment.",
        f"# {loss_text(table_card(table))}",
        "# The first row is the spring, which never slides. On reversal a slider slips after twice "
        "its slip curvature (Masing).",
        "stiffness [N*m^2],slip_curvature [1/m],slip_moment [N*m]",
        f"{law.stiffness!r},inf,inf",
    ]
    columns = (law.stiffnesses, law.slip_curvatures, slip_moments(law))
    lines += [",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns), strict=True)]
    return "\n".join(lines) + "\n"


def sliders_json(table: WireTable) -> str:
    """Write sliders, scalar sliders in four directions, a Dahl law, and the loss card.

    Parameters
    ----------
    table : law of the wire; one that cannot be fitted by sliders gets the reason and no numbers
    """
    about = {"schema": SLIDERS_SCHEMA, "labpipe": __version__, "wire": table.name}
    try:
        law, card = sliders_of(table), table_card(table)
    except ValueError as error:
        return json.dumps({**about, "reason": no_sliders_text(error)}, indent=1) + "\n"
    space = in_directions(law, DIRECTIONS)
    document = {
        **about,
        "range": {"curvature": [law.first, law.last], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "meaning": _MEANING,
        "stiffness": law.stiffness,
        "stiffnesses": law.stiffnesses.tolist(),
        "slip_curvatures": law.slip_curvatures.tolist(),
        "slip_moments": slip_moments(law).tolist(),
        "error": law.error,
        "scalar_sliders": {
            "directions": space.directions,
            "apart": "180 / directions degrees; each acts on its component of the curvature",
            "stiffness": space.stiffness,
            "stiffnesses": space.stiffnesses.tolist(),
            "slip_curvatures": space.slip_curvatures.tolist(),
            "error": space.error,
            "sideways": space.sideways,
        },
        "dahl": {"meaning": _DAHL, **asdict(card.dahl)},
        "loss_card": card_numbers(table),
        "mass_per_length": mass_of(table),
        "torsional_stiffness": table.torsional_stiffness,
        "units": _SLIDER_UNITS,
    }
    return json.dumps(document, indent=1) + "\n"
