from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.report.figure_page import style
from labpipe.report.wire_figures import cantilever_figure, plot_cantilever
from tests.builders.wire_tables import LENGTH, wire_table
from tests.report.builders_wires import CUT, troubled


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def test_end_load_and_the_lines_of_small_deflections() -> None:
    table = wire_table("A3")
    axes = Figure().subplots()
    plot_cantilever(table, axes)
    stick, slip, curve = (np.asarray(each.get_data()) for each in axes.lines)
    np.testing.assert_allclose(curve, [1e3 * table.tip_deflection, table.tip_force])
    for straight, stiffness in ((stick, table.stick_stiffness), (slip, table.slip_stiffness)):
        slope = 1e3 * straight[1, 1] / straight[0, 1]
        assert slope == pytest.approx(3.0 * stiffness / LENGTH**3)
    assert axes.get_ylim()[1] == pytest.approx(1.08 * table.tip_force.max())
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Tip deflection (mm)", "End load (N)")


def test_figure_says_how_the_wire_is_held() -> None:
    page = cantilever_figure(wire_table("A3"))
    assert page.texts[1].get_text().startswith("Free length 85 mm, first loading; the load stays")
    labels = [text.get_text() for text in page.legends[0].get_texts()]
    assert labels == ["wire model", "straight line, all stick", "straight line, all slip"]


def test_rest_alone_is_no_curve() -> None:
    """A law that stiffens has no cantilever curve beyond rest."""
    table = replace(wire_table("A3"), tip_deflection=np.zeros(1), tip_force=np.zeros(1))
    (said,) = cantilever_figure(table).axes[0].texts
    assert said.get_text() == "There is no cantilever curve to draw."


def test_no_curve_is_said_with_the_reason() -> None:
    page = cantilever_figure(troubled())
    said = page.axes[0].texts[0].get_text()
    assert said == "There is no cantilever curve to draw."
    assert CUT.message in " ".join(page.texts[1].get_text().split(" ")).replace("\n", " ")
