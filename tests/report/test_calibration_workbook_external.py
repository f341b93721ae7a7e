from __future__ import annotations

import pytest

from labpipe.report.calibration_workbook import comparison_tables
from tests.builders.external_curves import external_comparison, unmodelled, untested


def test_two_rows_for_each_curve() -> None:
    sheet, _ = comparison_tables([external_comparison(is_normal=True), untested(), unmodelled()])
    assert sheet.name == "external curves"
    rows = [dict(zip(sheet.heads, row, strict=True)) for row in sheet.rows]
    assert [row["compared with"] for row in rows] == ["tests", "model"] * 3
    first, second, third, _, _, last = rows
    assert (first["name"], first["wire"], first["load"]) == ("finite elements", "A2", "normal")
    assert (first["points compared"], first["points left out"]) == (5, 1)
    assert first["RMSE (N)"] == pytest.approx(0.001)
    assert first["RMSE over the largest force (%)"] == pytest.approx(1.0)
    assert first["points inside the band (%)"] == 100.0
    assert second["RMSE (N)"] == pytest.approx(0.003)
    assert first["from"] == "synthetic elements"
    assert third["reason"] == "no tests of this wire and length"
    assert (last["points compared"], last["RMSE (N)"]) == (0, None)
    assert last["reason"] == "the model has no such curve: it ends earlier"


def test_points_beside_what_they_are_held_against() -> None:
    _, sheet = comparison_tables([external_comparison(), untested()])
    assert sheet.name == "external curves, points"
    rows = list(sheet.rows)
    assert len(rows) == 12
    assert rows[0] == ("finite elements", *(pytest.approx(v) for v in (10, 0.021, 0.02, 0.018)))
    assert rows[5][3:] == (None, None)
    assert rows[6][3] is None


def test_nothing_without_any() -> None:
    assert comparison_tables([]) == []
