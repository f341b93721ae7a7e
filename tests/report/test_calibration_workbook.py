"""Numbers and sentences of a calibration, in its workbook and on its card."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.quality import Reason
from labpipe.records.wire_calibration import Calibration
from labpipe.report.calibration_summary import (
    CalibrationReport,
    length_words,
    parameter_row,
    percent,
    sentences,
)
from labpipe.report.calibration_workbook import comparison_tables, tables_of
from labpipe.report.workbook_file import Sheet
from tests.approved import Approve
from tests.builders.external_curves import external_comparison, unmodelled, untested
from tests.report.builders_calibrations import (
    group,
    one_sample,
    predicted,
    report,
    troubled,
    two_solutions,
    usual,
)
from tests.report.figure_words import without_digits

LOST = replace(
    group("A1"), prediction=None, errors=None, reason=Reason("no_wire", "not in the sheet")
)


def rows_of(sheet: Sheet) -> list[dict[str, Any]]:
    return [dict(zip(sheet.heads, row, strict=True)) for row in sheet.rows]


def rows(own: CalibrationReport, name: str) -> list[dict[str, Any]]:
    return rows_of(next(sheet for sheet in tables_of(own) if sheet.name == name))


def holds(row: dict[str, Any], expected: dict[str, object]) -> None:
    """Compare some cells of a row."""
    assert {head: row[head] for head in expected} == expected


def test_two_rows_for_each_curve() -> None:
    sheet, _ = comparison_tables([external_comparison(is_normal=True), untested(), unmodelled()])
    external = rows_of(sheet)
    assert [row["compared with"] for row in external] == ["tests", "model"] * 3
    first, second, third, _, _, last = external
    holds(first, {
        "name": "finite elements", "wire": "A2", "load": "normal", "from": "synthetic elements",
        "points compared": 5, "points left out": 1, "points inside the band (%)": 100.0,
        "RMSE (N)": pytest.approx(0.001), "RMSE over the largest force (%)": pytest.approx(1.0),
    })  # fmt: skip
    assert second["RMSE (N)"] == pytest.approx(0.003)
    assert third["reason"] == "no tests of this wire and length"
    holds(last, {
        "points compared": 0, "RMSE (N)": None,
        "reason": "the model has no such curve: it ends earlier",
    })  # fmt: skip
    assert comparison_tables([]) == []


def test_summary() -> None:
    friction, modulus, copper = rows(CalibrationReport(troubled()), "summary")
    conflict = troubled().parameter("copper_scale").conflict
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


def test_correlations_and_singular_values() -> None:
    identified = rows(report(), "identified")
    head = "weight or correlation, insulation_modulus"
    assert identified[0][head] == pytest.approx(usual().correlations[0, 1])
    friction = usual().friction_separability
    assert friction is not None
    own = [row for row in identified if row["quantity"] == "singular value of friction"]
    assert [row["of"] for row in own] == pytest.approx(friction.singular_values)
    holds(own[0], {
        "weight or correlation, radial_force": friction.combinations[0, 2],
        "weight or correlation, copper_scale": None,
    })  # fmt: skip
    apart = {row["of"]: row for row in identified if row["quantity"] == "identified separately"}
    assert apart["strand_friction"]["weight or correlation, strand_friction"] == "no"


def test_agreement_of_each_wire_and_length() -> None:
    first, *_, single = rows(report(), "agreement")
    errors = group().errors
    assert errors is not None
    holds(first, {
        "wire": "A2", "length (mm)": pytest.approx(85.0), "samples": 2, "points": errors.n,
        "SSE (N²)": errors.sse, "RMSE (N)": errors.rmse, "reason": "",
        "RMSE over the largest force (%)": pytest.approx(100.0 * errors.rmse_share),
        "points inside the band (%)": pytest.approx(100.0 * errors.inside),
        "model is": "calibrated by these samples",
    })  # fmt: skip
    holds(single, {"model is": "predicted", "samples": 1})
    assert single["reason"].startswith("one_curve: ")
    (lost,) = rows(CalibrationReport(usual(), (LOST,)), "agreement")
    holds(lost, {"SSE (N²)": None, "reason": "no_wire: not in the sheet"})


def test_forces_of_samples_and_model() -> None:
    forces = [row for row in rows(report(), "forces") if row["wire"] == "A2"]
    shown = group()
    name = next(iter(shown.samples))
    for what, head, values in (
        ("mean of the samples", "force (N)", shown.band.mean),
        ("model", "force, upper (N)", predicted().upper),
        (name, "force (N)", shown.samples[name].force),
    ):
        own = [row for row in forces if (row["what"], round(row["length (mm)"])) == (what, 85)]
        np.testing.assert_allclose([row[head] for row in own], values)
    bare = rows(CalibrationReport(usual(), (LOST,)), "forces")
    assert "model" not in {row["what"] for row in bare}


@pytest.mark.slow
def test_a_row_for_each_solution(approved: Approve) -> None:
    calibration = two_solutions()
    best, other = rows(CalibrationReport(calibration), "solutions")
    assert best["in the 95 % set"] == other["in the 95 % set"] == "yes"
    assert best["rise of the objective"] == 0.0
    assert other["rise of the objective"] == pytest.approx(calibration.solutions[1].rise)
    modulus = next(head for head in other if head.endswith("(MPa)"))
    assert other[modulus] == pytest.approx(1e-6 * calibration.solutions[1].values[1])
    two = parameter_row(calibration.parameter("copper_scale"))
    assert [" to " in part for part in two[2].split(" or ")] == [True, True]
    assert two[4] == "two solutions"
    approved(map(without_digits, sentences(calibration)))


def test_sheets_and_their_rows() -> None:
    sheets = tables_of(report())
    assert [sheet.name for sheet in sheets] == [
        "summary", "solutions", "fit", "identified", "agreement", "curves", "forces", "notes",
    ]  # fmt: skip
    numbers = {row["number"]: row["value"] for row in rows(report(), "fit")}
    holds(numbers, {"points": 360, "RMSE": usual().rmse})
    curves = rows(report(), "curves")
    assert [row["test"] for row in curves] == [curve.test for curve in usual().curves]
    assert curves[0]["factor of the sample"] == usual().curves[0].sample_factor
    forces = sheets[-2]
    assert [chart.title for chart in forces.charts][:2] == ["A2, 85 mm", "A2, 120 mm"]
    first, last = forces.charts[1].lines[0].rows
    assert {row[2] for row in forces.rows[first : last + 1]} == {"mean of the samples"}


def test_rows_of_parameters() -> None:
    """Open intervals, and a held parameter."""
    modulus = parameter_row(usual().parameter("insulation_modulus"))
    assert (modulus[0], *modulus[3:]) == ("Modulus of the insulation", "MPa", "identified")
    assert 900.0 < float(modulus[1]) < 1100.0
    friction = replace(troubled().parameter("radial_friction"), value=1.04e-5)
    assert parameter_row(friction)[1] == "0.010"
    for below, above, interval in (
        (True, False, "below 2"), (True, True, "open on both sides"), (False, True, "above "),
    ):  # fmt: skip
        ends = replace(friction, is_open_below=below, is_open_above=above)
        assert parameter_row(ends)[2].startswith(interval)
    assert parameter_row(troubled().parameter("insulation_modulus")) == (
        "Modulus of the insulation", "1000", "\u2013", "MPa", "fixed",
    )  # fmt: skip


def test_sentences(approved: Approve) -> None:
    """Digits of fitted values are left out: they are asserted above, to a tolerance."""
    lines: list[str] = []
    calibrations: dict[str, Calibration] = {
        "usual": usual(), "troubled": troubled(), "one sample": one_sample(),
    }  # fmt: skip
    for name, calibration in calibrations.items():
        lines += [f"[{name}]", *sentences(calibration)]
    approved(without_digits(line) for line in lines)
    text = "\n".join(sentences(usual()))
    assert f"RMSE {1e3 * usual().rmse:.3g} mN" in text
    assert [percent(share) for share in (0.0193, 1.0, np.nan)] == ["1.9 %", "100 %", ""]
    assert length_words(0.085) == "85 mm"
