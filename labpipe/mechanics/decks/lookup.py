"""Format the table and the sliders of a wire as CSV and JSON, for cable simulators."""

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
    describe_deck_errors,
    describe_law_errors,
    describe_loading_error,
    fill_template,
    get_mass_per_length,
    make_loss_card_entry,
)
from labpipe.mechanics.decks.unloading import make_elastic_release, make_growing_slider_entry
from labpipe.mechanics.law.loss_card import N_DIRECTIONS, fit_wire_sliders, make_table_card
from labpipe.mechanics.law.sliders import fit_directions
from labpipe.messages import format_sentence
from labpipe.records.wire import WireTable

LOOKUP_SCHEMA_VERSION = 2
"""Version of the format of the JSON table."""
SLIDERS_SCHEMA_VERSION = 1
"""Version of the format of the JSON file of sliders."""

_UNITS = tomllib.loads((files("labpipe.mechanics.decks") / "units.toml").read_text("utf-8"))
LOOKUP_COLUMNS: Mapping[str, str] = _UNITS["columns"]
"""Unit of each column of the CSV table, keyed by its name, which is a field of `WireTable`."""


def format_lookup_csv(table: WireTable) -> str:
    """Return the table as CSV text, one row for each curvature.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Comment lines that begin with ``#``, a heading with columns such as ``curvature [1/m]``, and
    rows with full precision.

    Raises
    ------
    ValueError
        If the mass per length is not finite and positive.
    """
    error_sentence = describe_loading_error(error=0.0)
    elastic_release = make_elastic_release(table)  # a curve has no hysteresis
    heading = ",".join(f"{name} [{unit}]" for name, unit in LOOKUP_COLUMNS.items())
    return fill_template(
        "lookup.csv",
        table=table,
        mass_per_length=get_mass_per_length(table),
        error_sentences=describe_deck_errors(table, error_sentence, "a curve", elastic_release),
        heading=heading,
        rows=np.column_stack([getattr(table, name) for name in LOOKUP_COLUMNS]),
        row_format=",".join("%d" if name == "is_doubtful" else "%r" for name in LOOKUP_COLUMNS),
    )


def format_lookup_json(table: WireTable) -> str:
    """Return curvatures, moments, constant stiffnesses and the loss card as JSON text.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    JSON text; the units are under ``units``.

    Raises
    ------
    ValueError
        If the mass per length is not finite and positive.
    """
    converted_values = {
        "curvature": table.curvature.tolist(),
        "moment": table.moment.tolist(),
        "diameter": 2.0 * table.layout.wire_radius,
        "length": table.spec.length,
        "mass_per_length": get_mass_per_length(table),
    }
    values = {name: converted_values.get(name) or getattr(table, name) for name in _UNITS["lookup"]}
    content = {
        "schema": LOOKUP_SCHEMA_VERSION,
        "labpipe": __version__,
        "wire": table.name,
        "range": {"curvature": [0.0, float(table.curvature[-1])], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "law": FIRST_LOADING_TEXT,
        "torsion": format_sentence("mechanics.decks.torsion"),
        **values,
        "loss_card": make_loss_card_entry(table),
        "units": _UNITS["lookup"],
    }
    return _format_json(content)


def _format_json(content: Mapping[str, object]) -> str:
    """Return a JSON object with one line for each key."""
    lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in content.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def describe_missing_sliders(error: ValueError) -> str:
    """Return a sentence that states why a deck has no sliders.

    Parameters
    ----------
    error : error raised by `fit_wire_sliders`
    """
    return f"Sliders cannot be fitted, so that this deck has no model: {error}."


def format_sliders_csv(table: WireTable) -> str:
    """Return the sliders as CSV text: a row for the spring that never slides, then one per slider.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the reason replaces the rows

    Raises
    ------
    ValueError
        If sliders are fitted and the mass per length is not finite and positive.
    """
    try:
        law = fit_wire_sliders(table)
    except ValueError as error:
        reason = describe_missing_sliders(error)
        return fill_template("sliders.csv", table=table, reason=reason)
    stiffnesses, slip_curvatures = law.slider_stiffnesses, law.slip_curvatures
    columns = (stiffnesses, slip_curvatures, stiffnesses * slip_curvatures)
    return fill_template(
        "sliders.csv",
        table=table,
        reason="",
        mass_per_length=get_mass_per_length(table),
        law=law,
        error_sentences=describe_law_errors(table),
        rows=[
            "stiffness [N*m^2],slip_curvature [1/m],slip_moment [N*m]",
            f"{law.spring_stiffness!r},inf,inf",
            *(",".join(map(repr, row)) for row in np.transpose(columns).tolist()),
        ],
    )


def format_sliders_json(table: WireTable) -> str:
    """Return sliders, scalar sliders in four directions, a Dahl law and the loss card as JSON text.

    Parameters
    ----------
    table : table of the wire; if sliders cannot be fitted to it, the reason replaces the law

    Raises
    ------
    ValueError
        If sliders are fitted and the mass per length is not finite and positive.
    """
    identity = {"schema": SLIDERS_SCHEMA_VERSION, "labpipe": __version__, "wire": table.name}
    try:
        law, card = fit_wire_sliders(table), make_table_card(table)
    except ValueError as error:
        return _format_json({**identity, "reason": describe_missing_sliders(error)})
    scalar_law = fit_directions(law, N_DIRECTIONS)
    content = {
        **identity,
        "range": {"curvature": [law.min_curvature, law.max_curvature], "beyond": "not valid"},
        "doubtful_beyond": table.doubtful_curvature if table.is_doubtful.any() else None,
        "meaning": format_sentence("mechanics.decks.slider_law"),
        "stiffness": law.spring_stiffness,
        "stiffnesses": law.slider_stiffnesses.tolist(),
        "slip_curvatures": law.slip_curvatures.tolist(),
        "slip_moments": (law.slider_stiffnesses * law.slip_curvatures).tolist(),
        "error": law.error,
        "growing": make_growing_slider_entry(table),
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
        "loss_card": make_loss_card_entry(table),
        "mass_per_length": get_mass_per_length(table),
        "torsional_stiffness": table.torsional_stiffness,
        "units": _UNITS["sliders"],
    }
    return _format_json(content)
