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
    typeset,
)
from labpipe.report.calibration_workbook import comparison_tables, tables_of
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


LOST = replace(
    group("A1"), prediction=None, errors=None, reason=Reason("no_wire", "not in the sheet")
)


def rows(own: CalibrationReport, name: str) -> list[dict[str, Any]]:
    sheet = next(sheet for sheet in tables_of(own) if sheet.name == name)
    return [dict(zip(sheet.heads, row, strict=False)) for row in sheet.rows]


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


def test_a_row_for_each_solution() -> None:
    found = two_solutions()
    best, other = rows(CalibrationReport(found), "solutions")
    assert best["rise of the objective"] == 0.0
    assert other["rise of the objective"] == pytest.approx(found.solutions[1].rise)
    assert best["in the 95 % set"] == other["in the 95 % set"] == "yes"
    modulus = next(head for head in other if head.endswith("(MPa)"))
    assert other[modulus] == pytest.approx(1e-6 * found.solutions[1].values[1])


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("the modulus was held at 1e-05 Pa", "The modulus was held at 1 \u00d7 10\u207b\u2075 Pa."),
        ("phi = F_rad (mu_s + mu_p) is 1", "\u03c6 = F_rad (\u03bc_s + \u03bc_p) is 1."),
        (
            "so strand_friction and radial_friction cannot be told apart.",
            "So \u03bc_s and \u03c6 cannot be told apart.",
        ),
        ("copper_scale does not act", "The strength of the copper does not act."),
        ("multiple philtres", "Multiple philtres."),
    ],
)
def test_sentences_fit_for_print(sentence: str, expected: str) -> None:
    assert typeset(sentence) == expected


def test_sheets_and_their_rows() -> None:
    sheets = tables_of(report())
    assert [sheet.name for sheet in sheets] == [
        "summary", "solutions", "fit", "identified", "agreement", "curves", "forces", "notes",
    ]  # fmt: skip
    for sheet in sheets:
        assert {len(row) for row in sheet.rows} <= {len(sheet.heads)}
    numbers = {row["number"]: row["value"] for row in rows(report(), "fit")}
    assert (numbers["points"], numbers["RMSE"]) == (360, usual().rmse)
    curves = rows(report(), "curves")
    assert [row["test"] for row in curves] == [curve.test for curve in usual().curves]
    assert curves[0]["factor of the sample"] == usual().curves[0].sample_factor
    forces = next(sheet for sheet in sheets if sheet.name == "forces")
    assert [chart.title for chart in forces.charts][:2] == ["A2, 85 mm", "A2, 120 mm"]
    first, last = forces.charts[1].lines[0].rows
    assert {row[2] for row in forces.rows[first : last + 1]} == {"mean of the samples"}
    assert comparison_tables([]) == []


def test_rows_of_parameters() -> None:
    """Open intervals, a held parameter, two solutions."""
    modulus = parameter_row(usual().parameter("insulation_modulus"))
    assert (modulus[0], *modulus[3:]) == ("Modulus of the insulation", "MPa", "identified")
    assert 900.0 < float(modulus[1]) < 1100.0
    friction = troubled().parameter("radial_friction")
    assert parameter_row(friction)[2].startswith("below 2")
    assert parameter_row(replace(friction, value=1.04e-5))[1] == "0.010"
    both = replace(friction, is_open_above=True)
    assert parameter_row(both)[2] == "open on both sides"
    assert parameter_row(replace(both, is_open_below=False))[2].startswith("above ")
    assert parameter_row(troubled().parameter("insulation_modulus")) == (
        "Modulus of the insulation", "1000", "\u2013", "MPa", "fixed",
    )  # fmt: skip
    two = parameter_row(two_solutions().parameter("copper_scale"))
    assert [" to " in part for part in two[2].split(" or ")] == [True, True]
    assert two[4] == "two solutions"


def test_sentences(approved: Approve) -> None:
    """Digits of fitted values are left out: they are asserted above, to a tolerance."""
    told: list[str] = []
    calibrations: dict[str, Calibration] = {
        "usual": usual(), "troubled": troubled(), "one sample": one_sample(),
        "two solutions": two_solutions(),
    }  # fmt: skip
    for name, calibration in calibrations.items():
        told += [f"[{name}]", *sentences(calibration)]
    approved(without_digits(line) for line in told)
    usual_words = "\n".join(sentences(usual()))
    assert f"RMSE {1e3 * usual().rmse:.3g} mN" in usual_words
    assert "over 360 points of 4 curves of 4 samples." in usual_words
    assert [percent(share) for share in (0.0193, 1.0, np.nan)] == ["1.9 %", "100 %", ""]
    assert length_words(0.085) == "85 mm"
