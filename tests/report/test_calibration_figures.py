"""Figures of a calibration: the card, profiles, agreement with tests and foreign curves, shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.wire_calibration import ExternalCurveComparison
from labpipe.report.calibration_agreement import (
    external_figure,
    external_pages,
    validation_figure,
)
from labpipe.report.calibration_card import (
    calibration_card,
    interpolate_profile,
    panel_range,
    plot_profile,
    plot_residuals,
)
from labpipe.report.calibration_figures import shapes_figure
from labpipe.report.calibration_summary import BentShape, CalibrationReport
from labpipe.report.figure_page import finish_layout, style
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


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style({"text.parse_math": False}):
        yield


def compared(*comparisons: ExternalCurveComparison) -> CalibrationReport:
    return CalibrationReport(usual(), (third_group(),), comparisons=comparisons)


REASON = Reason("deflection_too_large", "the curve ends at 40 mm")
LOST = replace(group(), prediction=None, errors=None, reason=REASON)


def test_the_page_is_one_page_and_its_words_stay_on_it() -> None:
    note = QualityNote("residuals_correlated", Severity.WARNING, "A2", "a note: " + "x y " * 50)
    page = calibration_card(replace(troubled(), notes=4 * (note,)))
    assert 25.4 * page.get_figheight() < 270.0  # between the margins of A4
    finish_layout(page)
    page.canvas.draw()
    boxes = [text.get_window_extent() for text in page.axes[6].texts]
    assert min(box.y0 for box in boxes) > page.texts[1].get_window_extent().y1
    assert max(box.x1 for box in boxes) < page.bbox.x1
    assert min(axes.get_window_extent().height for axes in page.axes[:6]) > 18.0 / 25.4 * page.dpi


def panel() -> Axes:
    return Figure().subplots()


def test_residuals_with_and_without_the_factors_of_samples() -> None:
    calibration = usual()
    plain, own = panel(), panel()
    plot_residuals(calibration, plain)
    plot_residuals(calibration, own, has_own_factor=True)
    curve = calibration.curves[0]
    left = 1e3 * (curve.force - curve.model)
    np.testing.assert_allclose(np.asarray(plain.lines[1].get_ydata()), left)
    means = left.reshape(30, 3).mean(axis=1)
    np.testing.assert_allclose(np.asarray(plain.lines[2].get_ydata()), means)
    scaled = 1e3 * (curve.force - curve.sample_factor * curve.model)
    np.testing.assert_allclose(np.asarray(own.lines[1].get_ydata()), scaled)


def test_profile_with_thresholds_value_and_interval() -> None:
    parameter, axes = usual().parameter("insulation_modulus"), panel()
    (profile,) = parameter.profiles
    assert parameter.interval is not None
    plot_profile(parameter, axes)
    curve, dots, below, above, value = axes.lines
    np.testing.assert_allclose(np.asarray(dots.get_xdata()), 1e-6 * profile.value)
    np.testing.assert_allclose(np.asarray(dots.get_ydata()), profile.deviance)
    assert set(np.asarray(below.get_ydata())) == {profile.threshold_below}
    assert set(np.asarray(above.get_ydata())) == {profile.threshold_above}
    assert np.asarray(value.get_xdata())[0] == pytest.approx(1e-6 * parameter.value)
    assert np.min(np.asarray(curve.get_ydata())) == pytest.approx(0.0, abs=1e-12)
    (grey,) = axes.patches
    left, right = grey.get_extents().transformed(axes.transData.inverted()).intervalx
    assert [1e6 * left, 1e6 * right] == pytest.approx(
        [parameter.interval.lower, parameter.interval.upper]
    )


@pytest.mark.slow
def test_two_valleys_and_two_parts() -> None:
    parameter, axes = two_solutions().parameter("copper_scale"), panel()
    plot_profile(parameter, axes)
    assert len(parameter.profiles) == len(parameter.intervals) == 2
    spans = [
        patch.get_extents().transformed(axes.transData.inverted()).intervalx.tolist()
        for patch in axes.patches
    ]
    ends = [(part.lower, part.upper) for part in parameter.intervals]
    assert spans == [pytest.approx(part) for part in ends]
    marks = [line for line in axes.lines if line.get_marker() == "^"]
    least = float(parameter.profiles[1].deviance.min())
    (other,) = [line for line in marks if line.get_markerfacecolor() == "white"]
    assert np.asarray(other.get_ydata())[0] == least > 0.0
    for profile in parameter.profiles:
        values, deviance = interpolate_profile(profile)
        assert deviance.min() == pytest.approx(profile.deviance.min())
        np.testing.assert_allclose(np.interp(profile.value, values, deviance), profile.deviance)
    assert panel_range(parameter)[0] < parameter.intervals[0].lower
    assert panel_range(parameter)[1] > parameter.intervals[1].upper


def test_words_of_agreement(approved: Approve) -> None:
    normal = external_comparison("normal", is_normal=True)
    load = QualityNote("external_curve_load", Severity.INFO, "a", "the model's force is larger")
    left_out = QualityNote("one_sample", Severity.WARNING, "A2", "the bands leave it out")
    doubtful = replace(predicted("A1"), notes=(left_out,))
    other = replace(group("A1"), mean_of=1, prediction=doubtful)
    compared_curves = {
        "each load": (external_comparison(), untested(), normal, external_comparison("other")),
        "another load": (replace(normal, notes=(load,)),) * 2,
        "no model": (unmodelled(), external_comparison("_fe")),
    }
    pages = {
        name: external_figure(panels)
        for name, curves in compared_curves.items()
        for panels in external_pages(compared(*curves))
    }
    groups = {
        "groups": report().groups,
        "doubtful": [group(), replace(group(), doubtful_deflection=0.02)],
        "one sample": [group("A3", 0.12, samples=1)],
        "other bands": [group(), other, LOST],
        "no prediction": [LOST],
    }
    fitted = {name: validation_figure(shown) for name, shown in groups.items()}
    approved([*all_words(pages), *map(without_digits, all_words(fitted))])


def test_words_of_card_and_shapes(approved: Approve) -> None:
    nothing = np.zeros((0, 2))
    bare = BentShape(0.01, np.full((3, 2), np.nan), nothing, nothing)
    pages = {
        "six shapes": shapes_figure("A2, 85 mm", shapes()["A2, 85 mm"]),
        "markers alone": shapes_figure("A2", [bare]),
        "no shape": shapes_figure("A2", []),
    }
    card = calibration_card(usual(), predictions={0.085: predicted()})
    prior = calibration_card(troubled())
    keys = [[text.get_text() for text in page.legends[0].get_texts()] for page in (card, prior)]
    headings = [axes.get_title(loc="left") for axes in card.axes[:6]]
    approved([*all_words(pages), "[card]", *headings, *keys])
