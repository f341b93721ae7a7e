from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.report.page_plots import (
    FULL,
    Axis,
    Line,
    Plot,
    axis_over,
    even,
    spark,
    steps_of,
    strip,
    svg,
    tick_words,
    ticks,
)

X, Y = Axis("Displacement", "mm", 0.0, 10.0), Axis("Force", "N", -1.0, 9.0)


def points(path: str, x: Axis, y: Axis) -> list[Floats]:
    """What a browser makes of a path: its strokes, in the units of the axes."""
    strokes = []
    for stroke in filter(None, re.split("M", path.rstrip("z"))):
        first, _, rest = stroke.partition("l")
        numbers = [float(each) for each in re.findall(r"-?\d+", f"{first} {rest}")]
        steps = np.reshape(numbers, (-1, 2)).cumsum(axis=0) / FULL
        across = x.low + steps[:, 0] * (x.high - x.low)
        strokes.append(np.column_stack([across, y.high - steps[:, 1] * (y.high - y.low)]))
    return strokes


def test_a_line_is_what_its_steps_say_to_sixteen_bit() -> None:
    noise = np.random.default_rng(7)
    x, y = np.sort(noise.uniform(0, 10, 120)), noise.uniform(-1, 9, 120)
    y[40] = np.nan
    first, second = points(steps_of(Line("curve", x, y), X, Y), X, Y)
    np.testing.assert_allclose(first, np.column_stack([x, y])[:40], atol=10 / FULL)
    np.testing.assert_allclose(second, np.column_stack([x, y])[41:], atol=10 / FULL)


def test_a_lone_point_is_a_dot_and_nothing_is_nothing() -> None:
    at = np.array([5.0, np.nan])
    assert steps_of(Line("slip", at, at), X, Y) == f"M{FULL / 2:.0f} 26214h0"
    none = np.empty(0)
    assert steps_of(Line("band", none, none, is_closed=True), X, Y) == ""


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.7, 12.0), (1e-5, 3e-5), (4e7, 5e7)])
def test_ticks_are_round_few_and_inside(low: float, high: float) -> None:
    values = ticks(Axis("", "", low, high), 6)
    assert 3 <= len(values) <= 7
    assert low <= values[0] * (1 + 1e-9) + 1e-12
    assert values[-1] <= high * (1 + 1e-9)
    steps = np.diff(values)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert len(set(tick_words(values))) == len(values)


def test_an_axis_shows_all_that_is_finite() -> None:
    axis = axis_over("Force", "N", [np.array([1.0, np.nan, 3.0]), np.empty(0)], room=0.1)
    assert [axis.low, axis.high] == pytest.approx([0.8, 3.2])
    flat = axis_over("Force", "N", [np.array([2.0])])
    assert flat.low < 2.0 < flat.high
    assert axis_over("", "", []).high > 0.0


def test_a_plot_is_well_formed_and_its_words_are_text() -> None:
    line = Line("curve c0", np.array([0.0, 10.0]), np.array([0.0, 8.0]), test=3, group='a"b')
    plot = Plot("curves", "g", "<b>", "", Axis('"mm" <', "mm", 0.0, 10.0), Y, [line])
    root = ElementTree.fromstring(str(svg(plot)))
    assert root.get("aria-label") == "<b>"
    (area,) = (each for each in root.iter() if each.get("class") == "area")
    assert [area.get(f"data-{name}") for name in ("x0", "x1", "y0", "y1")] == [
        "0", "10", "-1", "9",
    ]  # fmt: skip
    assert area.get("data-x-name") == '"mm" <'
    (path,) = area
    assert (path.get("data-t"), path.get("data-group")) == ("3", 'a"b')


def test_strips_and_sparks() -> None:
    drawn = str(strip((0.0, 10.0), Interval(2.0, 4.0), 3.0, [1.0, float("nan")]))
    assert 'd="M24 6H48"' in drawn
    assert 'd="M36 6h0"' in drawn
    assert 'd="M12 12h0"' in drawn
    none = str(strip((1.0, 1.0), None, float("nan")))
    assert "<path" not in none
    x = np.linspace(0, 1, 5)
    assert str(spark([(x, x)])).count("<path") == 1
    assert even(200, Axis("", "mm", 0, 100), Axis("", "mm", 0, 25)) == 50
