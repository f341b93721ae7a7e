from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import Calibration
from labpipe.report.calibration_card import calibration_card
from labpipe.report.figure_page import finish_layout, style
from tests.report.builders_calibrations import predicted, troubled, usual

A4_MM = 270.0
"""Height of a page between its margins."""


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style({"text.parse_math": False}):
        yield


def keys(page: Figure) -> list[str]:
    return [text.get_text() for text in page.legends[0].get_texts()]


def test_panels_keys_and_words() -> None:
    page = calibration_card(usual(), predictions={0.085: predicted()})
    headings = [axes.get_title(loc="left") for axes in page.axes[:6]]
    assert headings == [
        "(a) first loadings",
        "(b) residuals",
        "(c) residuals, each sample by its own factor",
        "(d) friction",
        "(e) insulation",
        "(f) copper",
    ]
    assert page.texts[0].get_text().startswith("A2  \u00b7  calibration of the wire model")
    assert keys(page) == [
        "measured, 85 mm (2)",
        "measured, 120 mm (2)",
        "model",
        "its 95 % band, mean sample",
        "95 % threshold",
        "95 % interval",
    ]
    said = "\n".join(text.get_text() for text in page.axes[6].texts)
    assert "Friction \u03c6" in said


def test_without_band_and_with_prior() -> None:
    page = calibration_card(troubled())
    assert page.texts[1].get_text().endswith("Drawn without the band of the model.")
    assert keys(page)[-1] == "prior alone"
    weights = {text.get_text(): text.get_fontweight() for text in page.axes[6].texts}
    assert weights["not identified"] == "bold"
    assert weights["fixed"] == "normal"


def _wordy() -> Calibration:
    notes = tuple(
        QualityNote(
            "residuals_correlated", Severity.WARNING, "A2", f"note {number}: " + "x y " * 50
        )
        for number in range(4)
    )
    return replace(troubled(), notes=notes)


@pytest.mark.parametrize("which", ["usual", "troubled", "wordy"])
def test_the_page_is_one_page_and_its_words_stay_on_it(which: str) -> None:
    makers: dict[str, Callable[[], Calibration]] = {
        "usual": usual, "troubled": troubled, "wordy": _wordy,
    }  # fmt: skip
    page = calibration_card(makers[which]())
    assert 25.4 * page.get_figheight() < A4_MM
    finish_layout(page)
    page.canvas.draw()
    boxes = [text.get_window_extent() for text in page.axes[6].texts]
    assert min(box.y0 for box in boxes) > page.texts[1].get_window_extent().y1
    assert max(box.x1 for box in boxes) < page.bbox.x1
    assert min(axes.get_window_extent().height for axes in page.axes[:6]) > 18.0 / 25.4 * page.dpi
