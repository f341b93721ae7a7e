"""Write the table and the sliders of a wire as CSV and JSON, for cable simulators."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from importlib.resources import files

import numpy as np

from labpipe import __version__
from labpipe.mechanics.decks.deck_law import (
    FIRST_LOADING_TEXT,
    collect_card_numbers,
    describe_deck_losses,
    describe_loading_error,
    describe_losses,
    fill_template,
    get_mass_per_length,
    list_facts,
)
from labpipe.mechanics.decks.unloading import collect_growing_numbers, make_zero_release
from labpipe.mechanics.law.loss_card import N_DIRECTIONS, fit_wire_sliders, make_table_card
from labpipe.mechanics.law.sliders import fit_directions
from labpipe.messages import format_sentence
from labpipe.records.wire import WireTable

SCHEMA = 2
"""Version of the JSON table."""

_UNITS = tomllib.loads((files("labpipe.mechanics.decks") / "units.toml").read_text("utf-8"))
LOOKUP_COLUMNS: Mapping[str, str] = _UNITS["columns"]
"""Unit of each column of the CSV table, keyed by its name, which is a field of `WireTable`."""


def write_lookup_csv(table: WireTable) -> str:
    """Write the table as CSV, one row for each curvature.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Text with lines that begin with ``#``, a heading such as ``curvature [1/m]``, and rows with all
    digits.
    """
    deck_loss = describe_loading_error(0.0)
    deck_release = make_zero_release(table)
    heading = ",".join(f"{name} [{unit}]" for name, unit in LOOKUP_COLUMNS.items())
    return fill_template(
        "lookup.csv",
        table=table,
        head=list_facts(table),
        mass=get_mass_per_length(table),
        losses=describe_deck_losses(table, deck_loss, "a curve", deck_release, line_width=1000),
        heading=heading,
        rows=np.column_stack([getattr(table, name) for name in LOOKUP_COLUMNS]),
        row_format=",".join("%d" if name == "is_doubtful" else "%r" for name in LOOKUP_COLUMNS),
    )


def write_lookup_json(table: WireTable) -> str:
    """Write curvatures, moments, constant stiffnesses and the loss card as JSON.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    JSON text; the units are under ``units``.
    """
    derived = {
        "curvature": table.curvature.tolist(),
        "moment": table.moment.tolist(),
        "diameter": 2.0 * table.layout.wire_radius,
        "length": table.spec.length,
        "mass_per_length": get_mass_per_length(table),
    }
    numbers = {name: derived.get(name) or getattr(table, name) for name in _UNITS["lookup"]}
    document = {
        "schema": SCHEMA,
        "labpipe": __version__,
        "wire": table.name,
        "range": {"curvature": [0.0, float(table.curvature[-1])], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "law": FIRST_LOADING_TEXT,
        "torsion": format_sentence("mechanics.decks.torsion"),
        **numbers,
        "loss_card": collect_card_numbers(table),
        "units": _UNITS["lookup"],
    }
    return _write_json(document)


SLIDERS_SCHEMA = 1
"""Version of the JSON file of sliders."""


def _write_json(document: Mapping[str, object]) -> str:
    """Write a document with one line for each of its values."""
    lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in document.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def describe_missing_sliders(error: ValueError) -> str:
    """Describe in a sentence why a deck has no sliders.

    Parameters
    ----------
    error : error raised by `fit_sliders`
    """
    return f"No sliders, and nothing to run: {error}."


def write_sliders_csv(table: WireTable) -> str:
    """Write the sliders as CSV: a row for the spring, which never slides, and one for each slider.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the text has the reason instead of
        rows
    """
    head = list_facts(table)
    try:
        law = fit_wire_sliders(table)
    except ValueError as error:
        return fill_template("sliders.csv", head=head, reason=describe_missing_sliders(error))
    stiffnesses, slip_curvatures = law.slider_stiffnesses, law.slip_curvatures
    columns = (stiffnesses, slip_curvatures, stiffnesses * slip_curvatures)
    return fill_template(
        "sliders.csv",
        table=table,
        head=head,
        reason="",
        mass=get_mass_per_length(table),
        law=law,
        losses=describe_losses(table),
        rows=[
            "stiffness [N*m^2],slip_curvature [1/m],slip_moment [N*m]",
            f"{law.spring_stiffness!r},inf,inf",
            *(",".join(map(repr, row)) for row in np.transpose(columns).tolist()),
        ],
    )


def write_sliders_json(table: WireTable) -> str:
    """Write sliders, scalar sliders in four directions, a Dahl law and the loss card as JSON.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the reason replaces the law
    """
    identity = {"schema": SLIDERS_SCHEMA, "labpipe": __version__, "wire": table.name}
    try:
        law, card = fit_wire_sliders(table), make_table_card(table)
    except ValueError as error:
        return _write_json({**identity, "reason": describe_missing_sliders(error)})
    scalar_law = fit_directions(law, N_DIRECTIONS)
    document = {
        **identity,
        "range": {"curvature": [law.min_curvature, law.max_curvature], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "meaning": format_sentence("mechanics.decks.slider_law"),
        "stiffness": law.spring_stiffness,
        "stiffnesses": law.slider_stiffnesses.tolist(),
        "slip_curvatures": law.slip_curvatures.tolist(),
        "slip_moments": (law.slider_stiffnesses * law.slip_curvatures).tolist(),
        "error": law.error,
        "growing": collect_growing_numbers(table),
        "scalar_sliders": {
            "directions": scalar_law.n_directions,
            "apart": "180 / directions degrees; each acts on its component of the curvature",
            "stiffness": scalar_law.spring_stiffness,
            "stiffnesses": scalar_law.slider_stiffnesses.tolist(),
            "slip_curvatures": scalar_law.slip_curvatures.tolist(),
            "error": scalar_law.error,
            "sideways": scalar_law.transverse_ratio,
        },
        "dahl": {"meaning": format_sentence("mechanics.decks.dahl_law"), **asdict(card.dahl_law)},
        "loss_card": collect_card_numbers(table),
        "mass_per_length": get_mass_per_length(table),
        "torsional_stiffness": table.torsional_stiffness,
        "units": _UNITS["sliders"],
    }
    return _write_json(document)
