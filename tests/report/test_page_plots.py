"""Plots of a report's page: paths, axes, ticks, and the panels of a group."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.figure_data import DrawnLaw, DrawnShapes
from labpipe.records.group import Campaign, Group, Sample
from labpipe.report.group_panels import group_panels
from labpipe.report.page_facts import PageTests
from labpipe.report.page_plots import (
    FULL,
    Axis,
    Line,
    Plot,
    axis_over,
    equal_scale_height,
    mean_strip,
    path_steps,
    sparkline,
    svg,
    tick_words,
    ticks,
)
from tests.builders.campaigns import build_group, build_sample, six_samples

X, Y = Axis("Displacement", "mm", 0.0, 10.0), Axis("Force", "N", -1.0, 9.0)


def points(path: str, x: Axis, y: Axis) -> list[Floats]:
    """What a browser makes of a path: its strokes, in the units of the axes."""
    strokes = []
    for stroke in filter(None, re.split("M", path.rstrip("z"))):
        numbers = np.array(re.findall(r"-?\d+", stroke), dtype=np.float64)
        steps = np.reshape(numbers, (-1, 2)).cumsum(axis=0) / FULL
        across = x.low + steps[:, 0] * (x.high - x.low)
        strokes.append(np.column_stack([across, y.high - steps[:, 1] * (y.high - y.low)]))
    return strokes


def test_a_line_is_what_its_steps_say_to_sixteen_bit() -> None:
    noise = np.random.default_rng(7)
    x, y = np.sort(noise.uniform(0, 10, 120)), noise.uniform(-1, 9, 120)
    y[40] = np.nan
    first, second = points(path_steps(Line("curve", x, y), X, Y), X, Y)
    np.testing.assert_allclose(first, np.column_stack([x, y])[:40], atol=10 / FULL)
    np.testing.assert_allclose(second, np.column_stack([x, y])[41:], atol=10 / FULL)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.7, 12.0), (1e-5, 3e-5), (4e7, 5e7)])
def test_ticks_are_round_few_and_inside(low: float, high: float) -> None:
    values = ticks(Axis("", "", low, high), 6)
    assert 3 <= len(values) <= 7
    assert low <= values[0] * (1 + 1e-9) + 1e-12
    assert values[-1] <= high * (1 + 1e-9)
    steps = np.diff(values)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert len(set(tick_words(values))) == len(values)


def test_a_plot_is_well_formed_and_its_words_are_text() -> None:
    line = Line("curve c0", np.array([0.0, 10.0]), np.array([0.0, 8.0]), test=3, group='a"b')
    plot = Plot("curves", "g", "<b>", "", Axis('"mm" <', "mm", 0.0, 10.0), Y, [line])
    root = ElementTree.fromstring(str(svg(plot)))
    assert root.get("aria-label") == "<b>"
    (area,) = (element for element in root.iter() if element.get("class") == "area")
    assert [area.get(f"data-{name}") for name in ("x0", "x1", "y0", "y1")] == [
        "0", "10", "-1", "9",
    ]  # fmt: skip
    assert area.get("data-x-name") == '"mm" <'
    (path,) = area
    assert (path.get("data-t"), path.get("data-group")) == ("3", 'a"b')


def panels(group: Group, *rejected: Sample) -> dict[str, Plot]:
    campaign = Campaign("S", (group,), rejected_samples=rejected)
    return {plot.kind: plot for plot in group_panels(group, "g", PageTests(campaign, ["g"]))}


def test_curves_are_drawn_where_they_are() -> None:
    sample = build_sample("s1", "a")
    plot = panels(build_group("A", [sample], scaled=False))["curves"]
    (line,) = (line for line in plot.lines if line.look == "curve c0")
    assert len(line.x) <= 90
    curve = sample.loading[0]
    force = np.interp(line.x / 1e3, curve.displacement, curve.force)
    np.testing.assert_allclose(line.y, force, atol=1e-9)
    assert "mean" not in [line.look for line in plot.lines]


def test_shapes_have_one_scale_and_laws_their_intervals() -> None:
    rise = np.array([0.0, 0.01, 0.02])
    along = np.linspace(0.0, 0.1, 6)
    places = np.stack([np.stack([along, way * along / 0.1], axis=1) for way in rise])
    law = DrawnLaw(np.array([0.0, 10.0]), *(np.array([0.0, m]) for m in (0.02, 0.018, 0.022)))
    samples = [
        replace(sample, shapes=DrawnShapes(rise, places), law=law) for sample in six_samples()[:2]
    ]
    drawn = panels(build_group("A", samples))
    shapes, moment = drawn["shapes"], drawn["moment"]
    width, height = shapes.size
    across = (shapes.x.high - shapes.x.low) / width
    assert (shapes.y.high - shapes.y.low) / height == pytest.approx(across)
    assert shapes.caption.startswith("Markers at 0, 10, 20 mm")
    assert np.isnan(shapes.lines[0].x).sum() == 3
    looks = [line.look for line in moment.lines]
    assert looks == ["band c0", "band c1", "curve c0", "curve c1"]
    assert moment.lines[2].y[-1] == pytest.approx(0.02)


def test_strips_sparks_and_axes() -> None:
    drawn = str(mean_strip((0.0, 10.0), Interval(2.0, 4.0), 3.0, [1.0, float("nan")]))
    for path in ('d="M24 6H48"', 'd="M36 6h0"', 'd="M12 12h0"'):
        assert path in drawn
    assert "<path" not in str(mean_strip((1.0, 1.0), None, float("nan")))
    x = np.linspace(0, 1, 5)
    assert str(sparkline([(x, x)])).count("<path") == 1
    assert equal_scale_height(200, Axis("", "mm", 0, 100), Axis("", "mm", 0, 25)) == 50
    axis = axis_over("Force", "N", [np.array([1.0, np.nan, 3.0]), np.empty(0)], room=0.1)
    assert [axis.low, axis.high] == pytest.approx([0.8, 3.2])
    flat = axis_over("Force", "N", [np.array([2.0])])
    assert flat.low < 2.0 < flat.high
