"""Figures of a calibration: the card, profiles, agreement with tests and foreign curves, shapes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.wire import ExternalCurveComparison
from labpipe.report.calibration_report import (
    BentShape,
    CalibrationReport,
    describe_calibration,
    format_intervals,
    format_parameter,
    group_external_curves,
    make_bent_shapes_page,
    make_calibration_page,
    make_external_page,
    make_profile_plot,
    make_residual_plot,
    make_tables,
    make_validation_page,
)
from labpipe.report.figure_page import draw_page, use_style
from labpipe.report.table_records import Table
from tests.approved import Approve
from tests.builders.external_curves import external_comparison, third_group, unmodelled, untested
from tests.report.builders_calibrations import (
    group,
    predicted,
    report,
    shapes,
    troubled,
    two_solutions,
    usual,
)
from tests.report.figure_words import all_words, without_digits


def compared(*comparisons: ExternalCurveComparison) -> CalibrationReport:
    return CalibrationReport(usual(), (third_group(),), comparisons=comparisons)


REASON = Reason("deflection_too_large", "the curve ends at 40 mm")
LOST = replace(group(), prediction=None, errors=None, reason=REASON)


def test_residuals_with_and_without_the_factors_of_samples() -> None:
    calibration = usual()
    plain = make_residual_plot(calibration, "").lines
    scaled = make_residual_plot(calibration, "", has_sample_factors=True).lines
    curve = calibration.curves[0]
    residual = curve.force - curve.model
    np.testing.assert_allclose(plain[1].y, residual)
    np.testing.assert_allclose(plain[2].y, residual.reshape(30, 3).mean(axis=1))
    np.testing.assert_allclose(scaled[1].y, curve.force - curve.sample_factor * curve.model)


def test_profile_with_thresholds_value_and_interval() -> None:
    parameter = usual().get_parameter("insulation_modulus")
    (profile,) = parameter.profiles
    assert parameter.interval is not None
    grey, curve, dots, below, above, value = make_profile_plot(parameter).lines
    np.testing.assert_allclose(dots.x, profile.value)
    np.testing.assert_allclose(dots.y, profile.deviance)
    assert set(below.y) == {profile.threshold_below}
    assert set(above.y) == {profile.threshold_above}
    assert value.x[0] == pytest.approx(parameter.value)
    assert np.min(curve.y) == pytest.approx(0.0, abs=1e-12)
    ends = [parameter.interval.lower, parameter.interval.upper]
    assert [grey.x.min(), grey.x.max()] == pytest.approx(ends)


def test_words_of_agreement(approved: Approve) -> None:
    normal = external_comparison("normal", is_normal=True)
    load = QualityNote("external_curve_load", Severity.INFO, "a", "the model's force is larger")
    left_out = QualityNote("one_sample", Severity.WARNING, "A2", "the bands leave it out")
    doubtful = replace(predicted("A1"), notes=(left_out,))
    one_sample_predicted = replace(group("A1"), prediction=doubtful)
    compared_curves = {
        "each load": (external_comparison(), untested(), normal, external_comparison("other")),
        "another load": (replace(normal, notes=(load,)),) * 2,
        "no model": (unmodelled(), external_comparison("_fe")),
    }
    pages = {
        name: make_external_page("figure", panels)
        for name, curves in compared_curves.items()
        for panels in group_external_curves(compared(*curves))
    }
    groups = {
        "groups": report().groups,
        "doubtful": [group(), replace(group(), doubtful_deflection=0.02)],
        "one sample": [group("A3", 0.12, samples=1)],
        "other bands": [group(), one_sample_predicted, LOST],
        "no prediction": [LOST],
    }
    fitted = {name: make_validation_page("figure", shown) for name, shown in groups.items()}
    approved([*all_words(pages), *map(without_digits, all_words(fitted))])


def test_words_of_card_and_shapes(approved: Approve) -> None:
    nothing = np.zeros((0, 2))
    bare = BentShape(0.01, np.full((3, 2), np.nan), nothing, nothing)
    pages = {
        "six shapes": make_bent_shapes_page("figure", "A2, 85 mm", shapes()["A2, 85 mm"]),
        "markers alone": make_bent_shapes_page("figure", "A2", [bare]),
        "no shape": make_bent_shapes_page("figure", "A2", []),
    }
    page = make_calibration_page(usual(), predictions={0.085: predicted()})
    with use_style():
        card, prior = map(draw_page, (page, make_calibration_page(troubled())))
    keys = [[text.get_text() for text in page.legends[0].get_texts()] for page in (card, prior)]
    headings = [axes.get_title(loc="left") for axes in card.axes[:6]]
    approved([*all_words(pages), "[card]", *headings, *keys])


NOT_IN_SHEET = replace(
    group("A1"), prediction=None, errors=None, reason=Reason("no_wire", "not in the sheet")
)


def rows_of(table: Table) -> list[dict[str, Any]]:
    return [dict(zip(table.headings, row, strict=True)) for row in table.rows]


def rows(report: CalibrationReport, name: str) -> list[dict[str, Any]]:
    return rows_of(next(table for table in make_tables(report) if table.title == name))


def holds(row: dict[str, Any], expected: dict[str, object]) -> None:
    """Compare some cells of a row."""
    assert {head: row[head] for head in expected} == expected


def test_two_rows_for_each_curve() -> None:
    curves = (external_comparison(is_normal=True), untested(), unmodelled())
    external = rows(CalibrationReport(usual(), comparisons=curves), "external curves")
    assert [row["compared with"] for row in external] == ["tests", "model"] * 3
    with_tests, with_model, without_tests, _, _, without_model = external
    holds(with_tests, {
        "name": "finite elements", "wire": "A2", "load": "normal", "from": "synthetic elements",
        "points compared": 5, "points left out": 1, "points inside the band (%)": 100.0,
        "RMSE (N)": pytest.approx(0.001), "RMSE over the largest force (%)": pytest.approx(1.0),
    })  # fmt: skip
    assert with_model["RMSE (N)"] == pytest.approx(0.003)
    assert without_tests["reason"] == "no tests of this wire and length"
    holds(without_model, {
        "points compared": 0, "RMSE (N)": None,
        "reason": "the model has no such curve: it ends earlier",
    })  # fmt: skip


def test_summary() -> None:
    friction, modulus, copper = rows(CalibrationReport(troubled()), "summary")
    conflict = troubled().get_parameter("copper_scale").conflict
    assert conflict is not None
    holds(friction, {"open below": "yes", "verdict": "not identified", "contradicts": ""})
    holds(modulus, {
        "value": pytest.approx(1e3), "unit": "MPa", "lower": None,
        "in words": "The modulus of the insulation was held at 1000 MPa.",
    })  # fmt: skip
    holds(copper, {
        "prior, centre": pytest.approx(1.6), "conflict (standard errors)": conflict.size,
        "contradicts": "yes", "verdict": "contradicts its prior",
    })  # fmt: skip


def test_agreement_of_each_wire_and_length() -> None:
    first, *_, single = rows(report(), "agreement")
    errors = group().errors
    assert errors is not None
    holds(first, {
        "wire": "A2", "length (mm)": pytest.approx(85.0), "samples": 2, "points": errors.n,
        "SSE (N²)": errors.sse, "RMSE (N)": errors.rmse, "reason": "",
        "RMSE over the largest force (%)": pytest.approx(100.0 * errors.rmse_share),
        "points inside the band (%)": pytest.approx(100.0 * errors.coverage),
        "model is": "calibrated by these samples",
    })  # fmt: skip
    holds(single, {"model is": "predicted", "samples": 1})
    assert single["reason"].startswith("one_curve: ")
    (row,) = rows(CalibrationReport(usual(), (NOT_IN_SHEET,)), "agreement")
    holds(row, {"SSE (N²)": None, "reason": "no_wire: not in the sheet"})


def test_forces_of_samples_and_model() -> None:
    forces = [row for row in rows(report(), "forces") if row["wire"] == "A2"]
    shown = group()
    name = next(iter(shown.samples))
    for curve, head, values in (
        ("mean of the samples", "force (N)", shown.band.mean),
        ("model", "force, upper (N)", predicted().upper),
        (name, "force (N)", shown.samples[name].force),
    ):
        points = [row for row in forces if (row["what"], round(row["length (mm)"])) == (curve, 85)]
        np.testing.assert_allclose([row[head] for row in points], values)
    bare = rows(CalibrationReport(usual(), (NOT_IN_SHEET,)), "forces")
    assert "model" not in {row["what"] for row in bare}


@pytest.mark.slow
def test_a_row_for_each_solution(approved: Approve) -> None:
    calibration = two_solutions()
    best, second = rows(CalibrationReport(calibration), "solutions")
    assert best["in the 95 % set"] == second["in the 95 % set"] == "yes"
    assert best["rise of the objective"] == 0.0
    assert second["rise of the objective"] == pytest.approx(calibration.solutions[1].rise)
    modulus = next(head for head in second if head.endswith("(MPa)"))
    assert second[modulus] == pytest.approx(1e-6 * calibration.solutions[1].values[1])
    factor = calibration.get_parameter("copper_scale")
    assert format_parameter(factor).endswith("), two solutions")
    assert [" to " in part for part in format_intervals(factor).split(" or ")] == [True, True]
    approved(map(without_digits, describe_calibration(calibration)))


def test_sheets_and_their_rows() -> None:
    sheets = make_tables(report())
    assert [sheet.title for sheet in sheets] == [
        "summary", "solutions", "fit", "agreement", "curves", "forces", "notes",
    ]  # fmt: skip
    numbers = {row["number"]: row["value"] for row in rows(report(), "fit")}
    holds(numbers, {"points": 360, "RMSE": usual().rmse})
    curves = rows(report(), "curves")
    assert [row["test"] for row in curves] == [curve.test for curve in usual().curves]
    assert curves[0]["factor of the sample"] == usual().curves[0].sample_factor
    forces = sheets[-2]
    assert [chart.title for chart in forces.charts][:2] == ["A2, 85 mm", "A2, 120 mm"]
    start, stop = next(iter(forces.charts[1].lines.values()))
    assert {row[2] for row in forces.rows[start : stop + 1]} == {"mean of the samples"}
