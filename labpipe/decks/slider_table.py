"""Law of a wire as sliders, for programs that read numbers: CSV and JSON, with its errors."""

from __future__ import annotations

import json
from dataclasses import asdict

from labpipe import __version__
from labpipe.decks.deck_law import facts, mass_of, on_one_line
from labpipe.decks.deck_losses import card_numbers, loss_text
from labpipe.law.loss_card import DIRECTIONS
from labpipe.law.slider_directions import in_directions
from labpipe.law.sliders import slip_moments
from labpipe.law.table_sliders import sliders_of, table_card
from labpipe.records.wire import WireTable

SCHEMA = 1
"""Version of the JSON."""

_MEANING = (
    "moment = stiffness * curvature + sum of stiffnesses[j] * stop[j], |stop[j]| <= "
    "slip_curvatures[j]; stop[j] changes with the curvature and stays at its limit; in space "
    "stop[j] is a vector"
)
_DAHL = "moment = stiffness * curvature + moment * (1 - exp(-curvature / decay)) on first loading"
_UNITS = {
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
    about = {"schema": SCHEMA, "labpipe": __version__, "wire": table.name}
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
        "units": _UNITS,
    }
    return json.dumps(document, indent=1) + "\n"
