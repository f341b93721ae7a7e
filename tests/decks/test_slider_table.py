"""Sliders as CSV and JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

from labpipe.decks.slider_table import sliders_csv, sliders_json
from labpipe.law.table_sliders import sliders_of
from tests.builders.wire_tables import wire_table


def test_rows_of_the_csv_make_the_law() -> None:
    table = wire_table("A2")
    lines = sliders_csv(table).splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    assert rows[0] == "stiffness [N*m^2],slip_curvature [1/m],slip_moment [N*m]"
    numbers = np.array([row.split(",") for row in rows[1:]], dtype=np.float64)
    assert numbers[0, 1:].tolist() == [np.inf, np.inf]
    bent = np.array([0.5, 5.0, 50.0])
    moment = np.minimum(bent[:, None], numbers[:, 1]) @ numbers[:, 0]
    assert moment == pytest.approx(np.interp(bent, table.curvature, table.moment), rel=0.003)
    assert numbers[1:, 2] == pytest.approx(numbers[1:, 0] * numbers[1:, 1])
    assert any("Loss card" in line for line in lines)
    assert any(f"Mass {table.mass_per_length:.9g} kg/m, torsional" in line for line in lines)


def test_numbers_of_the_json() -> None:
    table = wire_table("A2")
    found, law = json.loads(sliders_json(table)), sliders_of(table)
    assert found["stiffnesses"] == law.stiffnesses.tolist()
    assert found["slip_curvatures"] == law.slip_curvatures.tolist()
    assert found["error"] == law.error < 0.003
    assert found["doubtful_beyond"] == table.doubtful_curvature == pytest.approx(37.5)
    assert found["mass_per_length"] == table.mass_per_length
    assert found["loss_card"]["sliders"]["12"] == law.error
    dahl, bent = found["dahl"], table.curvature[1:]
    moment = dahl["stiffness"] * bent + dahl["moment"] * -np.expm1(-bent / dahl["decay"])
    off = np.max(np.abs(moment / table.moment[1:] - 1.0))
    assert off == pytest.approx(found["loss_card"]["dahl"], rel=0.05)
    assert found["scalar_sliders"]["directions"] == 4
    assert set(found["units"]) >= {"stiffness", "slip_curvatures", "slip_moments", "decay"}
