from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.quality import Reason
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_workbook import tables_of
from tests.builders.external_curves import UNTESTED, untested
from tests.report.builders_calibrations import (
    group,
    predicted,
    report,
    troubled,
    two_solutions,
    usual,
)

LOST = replace(
    group("A1"), prediction=None, errors=None, reason=Reason("no_wire", "not in the sheet")
)


def rows(own: CalibrationReport, name: str) -> list[dict[str, Any]]:
    sheet = next(sheet for sheet in tables_of(own) if sheet.name == name)
    return [dict(zip(sheet.heads, row, strict=False)) for row in sheet.rows]


def test_one_sheet_for_each_question() -> None:
    names = [
        "summary", "solutions", "fit", "identified", "agreement", "curves", "forces", "notes",
    ]  # fmt: skip
    assert [sheet.name for sheet in tables_of(report())] == names
    assert all(sheet.asks.count("?") for sheet in tables_of(report()))


def test_rows_are_as_long_as_headings() -> None:
    for sheet in tables_of(report()):
        assert {len(row) for row in sheet.rows} <= {len(sheet.heads)}


def test_summary() -> None:
    own = CalibrationReport(troubled())
    friction, modulus, copper = rows(own, "summary")
    assert friction["open below"] == "yes"
    assert friction["verdict"] == "not identified"
    assert (modulus["value"], modulus["unit"], modulus["lower"]) == (
        pytest.approx(1e3),
        "MPa",
        None,
    )
    assert modulus["in words"] == "The modulus of the insulation was held at 1000 MPa."
    conflict = troubled().parameter("copper_scale").conflict
    assert conflict is not None
    assert copper["prior, centre"] == pytest.approx(1.6)
    assert copper["conflict (standard errors)"] == conflict.size
    assert (copper["contradicts"], friction["contradicts"]) == ("yes", "")
    assert copper["prior in words"].endswith("; the other values are drawn along with it.")
    assert copper["verdict"] == "contradicts its prior"


def test_numbers_of_the_fit() -> None:
    numbers = {row["number"]: row["value"] for row in rows(report(), "fit")}
    assert numbers["points"] == 360
    assert numbers["RMSE"] == usual().rmse


def test_correlations_and_singular_values() -> None:
    found = rows(report(), "identified")
    heads = "weight or correlation, insulation_modulus"
    assert found[0][heads] == pytest.approx(usual().correlations[0, 1])
    friction = usual().friction_separability
    assert friction is not None
    own = [row for row in found if row["what"] == "singular value of friction"]
    assert [row["of"] for row in own] == pytest.approx(friction.singular_values)
    assert own[0]["weight or correlation, radial_force"] == friction.combinations[0, 2]
    assert own[0]["weight or correlation, copper_scale"] is None
    apart = {row["of"]: row for row in found if row["what"] == "told apart"}
    assert apart["strand_friction"]["weight or correlation, strand_friction"] == "no"


def test_agreement_of_each_wire_and_length() -> None:
    first, *_, single = rows(report(), "agreement")
    errors = group().errors
    assert errors is not None
    assert (first["wire"], first["length (mm)"], first["samples"]) == ("A2", pytest.approx(85.0), 2)
    assert (first["points"], first["SSE (N²)"], first["RMSE (N)"]) == (
        errors.n, errors.sse, errors.rmse,
    )  # fmt: skip
    assert first["RMSE over the largest force (%)"] == pytest.approx(100.0 * errors.rmse_share)
    assert first["points inside the band (%)"] == pytest.approx(100.0 * errors.inside)
    assert first["model is"] == "calibrated by these samples"
    assert (single["model is"], single["samples"]) == ("predicted", 1)
    assert (first["reason"], single["reason"][:11]) == ("", "one_curve: ")
    (lost,) = rows(CalibrationReport(usual(), (LOST,)), "agreement")
    assert (lost["SSE (N²)"], lost["reason"]) == (None, "no_wire: not in the sheet")


def test_curves_one_by_one() -> None:
    found = rows(report(), "curves")
    assert [row["test"] for row in found] == [curve.test for curve in usual().curves]
    assert found[0]["factor of the sample"] == usual().curves[0].sample_factor


def test_notes_worst_first_and_what_is_told_apart() -> None:
    found = rows(CalibrationReport(troubled(), (group(),)), "notes")
    assert found[0]["kind"] == "warning"
    assert {"prior_contradicts_data", "not_identified", "told_apart"} <= {
        row["code"] for row in found
    }
    assert found[-1]["code"] == "told_apart"
    warned = replace(predicted(), notes=(troubled().notes[0],))
    both = CalibrationReport(usual(), (replace(group(), prediction=warned),))
    assert "prediction" in [row["of"] for row in rows(both, "notes")]


def test_forces_of_samples_and_model() -> None:
    every = rows(report(), "forces")
    found = [row for row in every if (row["wire"], round(row["length (mm)"])) == ("A2", 85)]
    shown = group()
    mean = [row["force (N)"] for row in found if row["what"] == "mean of the samples"]
    np.testing.assert_allclose(mean, shown.band.mean)
    upper = [row["force, upper (N)"] for row in found if row["what"] == "model"]
    np.testing.assert_allclose(upper, predicted().upper)
    name = next(iter(shown.samples))
    own = [row for row in found if row["what"] == name]
    np.testing.assert_allclose([row["force (N)"] for row in own], shown.samples[name].force)
    assert own[0]["mean sample, lower (N)"] is None
    bare = rows(CalibrationReport(usual(), (LOST,)), "forces")
    assert "model" not in {row["what"] for row in bare}


def test_a_chart_for_each_wire_and_length() -> None:
    sheet = next(sheet for sheet in tables_of(report()) if sheet.name == "forces")
    assert [chart.title for chart in sheet.charts][:2] == ["A2, 85 mm", "A2, 120 mm"]
    line = sheet.charts[1].lines[0]
    first, last = line.rows
    assert {row[2] for row in sheet.rows[first : last + 1]} == {"mean of the samples"}
    assert sheet.rows[first - 1][1] == pytest.approx(85.0)


def test_external_curves_have_sheets_and_notes() -> None:
    own = replace(report(), comparisons=(untested(),))
    assert len(rows(own, "external curves")) == 2
    assert len(rows(own, "external curves, points")) == 6
    (told,) = [row for row in rows(own, "notes") if row["code"] == "external_curve_untested"]
    assert (told["of"], told["what"]) == ("external curve 'paper'", UNTESTED.message)


def test_a_row_for_each_solution() -> None:
    found = two_solutions()
    best, other = rows(CalibrationReport(found), "solutions")
    assert best["rise of the objective"] == 0.0
    assert other["rise of the objective"] == pytest.approx(found.solutions[1].rise)
    assert best["in the 95 % set"] == other["in the 95 % set"] == "yes"
    modulus = next(head for head in other if head.endswith("(MPa)"))
    assert other[modulus] == pytest.approx(1e-6 * found.solutions[1].values[1])
