from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.report.calibration_agreement import (
    agreement_words,
    plot_group,
    validation_figure,
)
from labpipe.report.figure_page import style
from tests.report.builders_calibrations import group, predicted, report

REASON = Reason("deflection_too_large", "the curve ends at 40 mm")
LOST = replace(group(), prediction=None, errors=None, reason=REASON)


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style({"text.parse_math": False}):
        yield


def keys(page: Figure) -> list[str]:
    return [text.get_text() for text in page.legends[0].get_texts()]


def note(page: Figure) -> str:
    return page.texts[1].get_text().replace("\n", " ")


def test_samples_mean_and_model_with_their_bands() -> None:
    axes, shown = Figure().subplots(), group()
    plot_group(shown, axes)
    one, _, mean, lower, _, model = axes.lines
    np.testing.assert_allclose(
        np.asarray(one.get_ydata()), next(iter(shown.samples.values())).force
    )
    np.testing.assert_allclose(
        np.asarray(mean.get_data()), [1e3 * shown.band.displacement, shown.band.mean]
    )
    np.testing.assert_allclose(np.asarray(model.get_ydata()), predicted().force)
    np.testing.assert_allclose(np.asarray(lower.get_ydata()), predicted().lower)
    assert len(axes.collections) == 2
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Tip deflection (mm)", "Force (N)")


def test_the_model_is_lighter_where_it_is_doubtful() -> None:
    whole = predicted()
    shown = replace(group(), doubtful_deflection=float(whole.deflection[3]))
    axes = Figure().subplots()
    plot_group(shown, axes)
    sure, doubtful = axes.lines[5], axes.lines[8]
    assert (sure.get_alpha() or 1.0) > 2.0 * (doubtful.get_alpha() or 1.0)
    drawn = [np.asarray(line.get_ydata()) for line in (sure, doubtful)]
    np.testing.assert_allclose(drawn[0], whole.force[:4])
    np.testing.assert_allclose(drawn[1], whole.force[3:])
    bands = [float(each.get_alpha() or 1.0) for each in axes.collections[1:]]
    assert bands[0] > 2.0 * bands[1]
    assert "The model is lighter where the rim" in note(validation_figure([group(), shown]))
    assert "lighter" not in note(validation_figure([group()]))


def test_agreement_in_words() -> None:
    errors = group().errors
    assert errors is not None
    samples, rmse, inside = agreement_words(group()).splitlines()
    assert samples == "2 samples"
    assert rmse.startswith(f"RMSE {1e3 * errors.rmse:.3g} mN, ")
    assert inside.endswith(" of the points inside the band")
    unknown = replace(group(), errors=replace(errors, inside=np.nan))
    assert len(agreement_words(unknown).splitlines()) == 2


def test_one_sample_has_no_band() -> None:
    single = group("A3", 0.12, samples=1)
    assert agreement_words(single).startswith("1 sample, no band of the mean\n")
    page = validation_figure([single])
    assert "95 % band of the mean" not in keys(page)
    assert "One sample has no band." in note(page)


def test_no_prediction_is_said_with_the_reason() -> None:
    words = agreement_words(LOST)
    assert words == "2 samples\nNo prediction. The curve ends at 40 mm."
    page = validation_figure([LOST])
    assert keys(page) == ["sample", "mean of samples", "95 % band of the mean"]
    assert "Blue band" not in note(page)


def test_figure_names_wires_lengths_and_use() -> None:
    page = validation_figure(report().groups)
    assert [axes.get_title(loc="left") for axes in page.axes] == [
        "(a) A2, 85 mm: calibrated",
        "(b) A2, 120 mm: calibrated",
        "(c) A1, 85 mm: predicted",
        "(d) A3, 120 mm: predicted",
    ]
    assert keys(page)[-2:] == ["model", "95 % band of the model"]
    assert "Blue band: the model's for the mean of 2 samples." in note(page)


def test_footnote_tells_bands_apart_and_what_they_leave_out() -> None:
    left_out = QualityNote("one_sample", Severity.WARNING, "A2", "the bands leave it out")
    doubtful = replace(predicted("A1"), notes=(left_out,))
    other = replace(group("A1"), mean_of=1, prediction=doubtful)
    said = note(validation_figure([group(), other, LOST]))
    assert "Blue band: the model's for one more sample (A1 85 mm)." in said
    assert "for the mean of 2 samples (A2 85 mm)." in said
    assert said.endswith("The bands leave it out.")


def test_pages_of_six() -> None:
    assert len(validation_figure([group()] * 6).axes) == 6
    spare = validation_figure([group()] * 3).axes[3]
    assert not spare.axison


@pytest.mark.parametrize("count", [0, 7])
def test_number_of_groups(count: int) -> None:
    with pytest.raises(ValueError, match=rf"{count} groups: allowed are 1 to 6 on a page"):
        validation_figure([group()] * count)
