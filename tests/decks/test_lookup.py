from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from labpipe import __version__
from labpipe.decks.lookup import COLUMNS, lookup_csv, lookup_json
from tests.builders.wire_tables import wire_table


def test_the_csv_gives_the_whole_table_back_to_the_last_digit() -> None:
    table = wire_table()
    frame = pd.read_csv(io.StringIO(lookup_csv(table)), comment="#")
    assert list(frame.columns) == [f"{name} [{unit}]" for name, unit in COLUMNS.items()]
    for name, unit in COLUMNS.items():
        assert np.array_equal(frame[f"{name} [{unit}]"].to_numpy(), getattr(table, name))


def test_the_csv_says_name_range_and_constants() -> None:
    table = wire_table()
    heading = [line for line in lookup_csv(table).splitlines() if line.startswith("#")]
    said = " ".join(heading)
    assert "Wire A2" in said
    assert "curvature from 0 to 125 1/m" in said
    assert "Beyond this range the deck is not valid." in said
    assert f"Stick stiffness {table.stick_stiffness:.9g} N m^2" in said


@pytest.mark.parametrize("name", ["two\nlines", "a # b", '"quoted", name', "Käbel"])
def test_a_name_breaks_no_table(name: str) -> None:
    text = lookup_csv(replace(wire_table(), name=name))
    frame = pd.read_csv(io.StringIO(text), comment="#")
    assert frame.shape == (len(wire_table().curvature), len(COLUMNS))


def test_the_json_table() -> None:
    table = wire_table()
    read = json.loads(lookup_json(table))
    assert read["wire"] == "A2"
    assert read["labpipe"] == __version__
    assert read["range"] == {"curvature": [0.0, table.curvature[-1]], "beyond": "not valid"}
    assert read["curvature"] == table.curvature.tolist()
    assert read["moment"] == table.moment.tolist()
    for name in (
        *("stick_stiffness", "axial_stiffness", "torsional_stiffness", "mass_per_length"),
        *("free_torsional_stiffness", "stretch_twist_coupling"),
    ):
        assert read[name] == getattr(table, name)
    assert read["diameter"] == pytest.approx(table.spec.wire_diameter)
    assert read["length"] == table.spec.length


def test_every_number_of_the_json_has_a_unit() -> None:
    read = json.loads(lookup_json(wire_table()))
    words = {"schema", "labpipe", "wire", "range", "law", "torsion", "units", "doubtful_beyond"}
    assert set(read["units"]) == set(read) - words - {"loss_card"}
