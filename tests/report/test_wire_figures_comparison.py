from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes

from labpipe.report.figure_page import style
from labpipe.report.wire_figures import comparison_figure
from tests.builders.wire_tables import wire_table


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def heights(axes: Axes, number: int) -> np.ndarray:
    return np.asarray(axes.lines[number].get_ydata())


def test_wires_beside_each_other() -> None:
    tables = [wire_table(name) for name in ("A1", "A2", "A3")]
    page = comparison_figure(tables)
    labels = [text.get_text() for text in page.legends[0].get_texts()]
    assert labels == ["A1", "A2", "A3"]
    left, right = page.axes
    for number, table in enumerate(tables):
        sure = int((~table.is_doubtful).sum())
        secant, moment = 1e6 * table.secant_stiffness, 1e3 * table.moment
        np.testing.assert_allclose(heights(left, 2 * number), secant[1:sure])
        np.testing.assert_allclose(heights(left, 2 * number + 1), secant[sure - 1 :])
        np.testing.assert_allclose(heights(right, 2 * number), moment[:sure])
        np.testing.assert_allclose(heights(right, 2 * number + 1), moment[sure - 1 :])
        assert right.lines[2 * number + 1].get_alpha() == 0.35
    assert left.get_xlim()[1] == pytest.approx(tables[0].curvature[-1])
    words = " ".join(page.texts[1].get_text().split())
    assert words.startswith("Each line ends where the range of its law ends, and is lighter where")


@pytest.mark.parametrize("count", [0, 13])
def test_number_of_wires_in_a_comparison(count: int) -> None:
    tables = [wire_table("A1")] * count
    with pytest.raises(ValueError, match=f"{count} wires: allowed are 1 to 12 on a page"):
        comparison_figure(tables)


def test_one_stiff_wire_sets_the_unit_of_all() -> None:
    table = wire_table("A1")
    left = comparison_figure([table, replace(table, stick_stiffness=51.55)]).axes[0]
    assert left.get_ylabel() == "Secant bending stiffness (N·m²)"
    sure = int((~table.is_doubtful).sum())
    np.testing.assert_allclose(heights(left, 0), table.secant_stiffness[1:sure])
