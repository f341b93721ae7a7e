from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.drawn import DrawnLaw, DrawnShapes
from labpipe.records.group import Group
from labpipe.report.figure_page import style
from labpipe.report.group_figures import drawings
from labpipe.report.group_shapes import (
    draw_group_laws,
    draw_group_shapes,
    has_laws,
    has_shapes,
    plot_group_shapes,
    plot_laws,
)
from tests.builders.campaigns import build_group, six_samples

X = np.linspace(0.0, 0.08, 5)
STEPS = np.array([0.00004, 0.01, 0.02])
SHAPES = DrawnShapes(STEPS, np.stack([np.column_stack([X, d * (X / 0.08) ** 2]) for d in STEPS]))
KAPPA = np.array([0.0, 1.0, 10.0])
LAW = DrawnLaw(KAPPA, 3e-4 * KAPPA, 2.9e-4 * KAPPA, 3.1e-4 * KAPPA)


def bent(count: int = 6) -> Group:
    samples = [replace(each, shapes=SHAPES, law=LAW) for each in six_samples()[:count]]
    return build_group("A", samples)


def test_every_sample_is_drawn_at_every_step() -> None:
    axes = Figure().subplots()
    with style():
        plot_group_shapes(bent(), axes)
    lines = [line for line in axes.lines if line.get_marker() == "None"]
    assert len(lines) == 6 * 3 == len(axes.lines) / 2
    assert len({line.get_color() for line in lines}) == 3
    assert len({line.get_linestyle() for line in lines}) == 2  # of two spools
    np.testing.assert_allclose(np.asarray(lines[2].get_ydata())[-1], 20.0)
    assert axes.get_xlabel() == "Along the undeformed axis (mm)"


def test_steps_and_spools_stand_in_the_key() -> None:
    with style():
        page = draw_group_shapes(bent())
    words = [text.get_text() for text in page.legends[0].get_texts()]
    assert words == ["0.0 mm", "10.0 mm", "20.0 mm", "spool s1", "spool s2"]


def test_points_that_no_camera_saw_leave_a_gap() -> None:
    positions = SHAPES.positions.copy()
    positions[:, 2] = np.nan
    sample = replace(six_samples()[0], shapes=DrawnShapes(STEPS, positions))
    axes = Figure().subplots()
    with style():
        plot_group_shapes(build_group("A", [sample, *six_samples()[1:]]), axes)
    assert {len(np.asarray(line.get_xdata())) for line in axes.lines} == {4}


@pytest.mark.parametrize(("count", "bands"), [(3, 3), (6, 0)])
def test_laws_with_bands_where_they_can_be_told_apart(count: int, bands: int) -> None:
    axes = Figure().subplots()
    with style():
        plot_laws(bent(count), axes)
    assert len(axes.lines) == count
    assert len(axes.collections) == bands
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata()), LAW.moment)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Curvature (1/m)", "Bending moment (N·m)")


def test_a_group_without_cameras_says_so_and_lists_neither() -> None:
    group = build_group("A", six_samples())
    assert not has_shapes(group)
    assert not has_laws(group)
    assert {each.name for each in drawings(group)}.isdisjoint({"shapes", "moment"})
    assert {"shapes", "moment"} <= {each.name for each in drawings(bent())}
    with style():
        pages = [draw_group_shapes(group), draw_group_laws(group)]
    said = [page.axes[0].texts[0].get_text().replace("\n", " ") for page in pages]
    assert said == [
        "No camera saw the shape of any sample.",
        "Moment against curvature was measured of no sample.",
    ]
