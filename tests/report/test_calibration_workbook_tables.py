from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.quality import Reason
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_workbook import tables_of
from tests.builders.external_curves import UNTESTED, untested
from tests.report.builders_calibrations import group, predicted, report, source, troubled, usual

LOST = replace(
    group("A1"), prediction=None, errors=None, reason=Reason("no_wire", "not in the sheet")
)


def rows(own: CalibrationReport, name: str) -> list[dict[str, Any]]:
    sheet = next(sheet for sheet in tables_of(own) if sheet.name == name)
    return [dict(zip(sheet.heads, row, strict=False)) for row in sheet.rows]


def test_names_of_tables() -> None:
    names = [sheet.name for sheet in tables_of(report(), ["read me"])]
    assert names == [
        "summary", "solutions", "fit", "identified", "agreement", "curves", "notes",
        "A2, 85 mm", "A2, 120 mm", "A1, 85 mm", "A3, 120 mm",
    ]  # fmt: skip
    twice = replace(report(), groups=(group(), group()))
    assert [sheet.name for sheet in tables_of(twice)][-2:] == ["A2, 85 mm", "A2, 85 mm 2"]


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


def test_numbers_of_the_fit_and_of_the_source() -> None:
    numbers = {row["number"]: row["value"] for row in rows(report(), "fit")}
    assert numbers["points"] == 360
    assert numbers["RMSE"] == usual().rmse
    assert numbers["method: source, F_rad (mu_s + mu_p)"] == source().radial_friction
    assert numbers["method: source, start"] == "0.2, 0.2, 0.2"
    alone = rows(CalibrationReport(usual()), "fit")
    assert not any("source" in str(row["number"]) for row in alone)


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
    assert sum(row["what"] == "singular value, method: source" for row in found) == 3


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


def test_curves_of_a_wire_and_length() -> None:
    found = rows(report(), "A2, 85 mm")
    shown = group()
    mean = [row["mean (N)"] for row in found if row.get("mean (N)") is not None]
    np.testing.assert_allclose(mean, shown.band.mean)
    upper = [row["model, upper (N)"] for row in found if row["model, upper (N)"] is not None]
    np.testing.assert_allclose(upper, predicted().upper)
    name = next(iter(shown.samples))
    force = [row[f"{name}, force (N)"] for row in found[:90]]
    np.testing.assert_allclose(force, shown.samples[name].force)
    bare = rows(CalibrationReport(usual(), (LOST,)), "A1, 85 mm")
    assert "model (N)" not in bare[0]


def test_external_curves_have_sheets_and_notes() -> None:
    own = replace(report(), comparisons=(untested(),))
    assert len(rows(own, "external curves")) == 2
    assert len(rows(own, "external curves, points")) == 6
    (told,) = [row for row in rows(own, "notes") if row["code"] == "external_curve_untested"]
    assert (told["of"], told["what"]) == ("external curve 'paper'", UNTESTED.message)
