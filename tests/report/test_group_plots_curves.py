from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.report.figure_page import style
from labpipe.report.group_plots import draw_curves, draw_scaled, plot_band, plot_samples, seen
from labpipe.statistics.mean_curves import without_band
from tests.builders.campaigns import build_group, build_sample, six_samples, troubled_samples


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def labels(page: Figure) -> list[str]:
    return [text.get_text() for legend in page.legends for text in legend.get_texts()]


def curves(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.lines if line.get_marker() == "None"]


def test_samples_mean_and_bands_in_display_units() -> None:
    group = build_group("A", six_samples())
    page = draw_curves(group)
    axes = page.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Displacement (mm)", "Force (N)")
    assert labels(page) == [
        "spool s1", "spool s2", "mean of 6 samples", "95 % band, point by point",
        "95 % band, whole curve", "failure",
    ]  # fmt: skip
    lines = curves(axes)
    assert len(lines) == 6 + 1 + 2
    assert lines[6][-1] == pytest.approx(group.band.mean[-1])
    assert lines[7][-1] == pytest.approx(group.band.lower_all[-1])
    assert len(axes.collections) == 1
    assert sum(line.get_marker() == "x" for line in axes.lines) == 6


def test_later_cycles_are_faint() -> None:
    axes = Figure().subplots()
    plot_samples(build_group("A", six_samples(cycles=3)), axes)
    faint = [line for line in axes.lines if line.get_alpha() is not None]
    assert len(faint) == 6 * (2 + 2)
    two = six_samples(cycles=2)
    assert "unloading, later cycles" in labels(draw_curves(build_group("A", two)))
    once = [replace(sample, loading=sample.loading[:1]) for sample in two]
    assert "unloading" in labels(draw_curves(build_group("A", once)))
    pulled = [replace(sample, unloading=()) for sample in two]
    assert "later cycles" in labels(draw_curves(build_group("A", pulled)))


def test_one_sample_has_no_band_and_the_figure_says_so() -> None:
    page = draw_curves(build_group("A", [build_sample("s1", "a")]))
    assert labels(page) == ["spool s1", "failure"]
    assert page.texts[1].get_text() == "No band: One sample has no spread to make a band of."


@pytest.mark.parametrize(
    ("samples", "sentence"),
    [([], "No sample in this group."), ([troubled_samples()[4]], "No sample has a curve.")],
)
def test_nothing_to_draw_is_said(samples: list, sentence: str) -> None:  # type: ignore[type-arg]
    page = draw_curves(build_group("A", samples))
    assert [text.get_text() for text in page.axes[0].texts] == [sentence]


def test_scaled_curves_end_at_their_share_of_the_peak_force() -> None:
    page = draw_scaled(build_group("A", six_samples(cycles=2)))
    axes = page.axes[0]
    assert axes.get_ylabel() == "Force / peak force"
    lines = curves(axes)
    assert len(lines) == 6 + 3
    assert all(0.9 < line[-1] < 1.1 for line in lines[:7])


def test_a_sample_without_peak_force_is_not_scaled() -> None:
    samples = six_samples()
    samples[0] = replace(samples[0], results=())
    axes = Figure().subplots()
    plot_samples(build_group("A", six_samples()), axes, is_scaled=True)
    group = replace(build_group("A", six_samples()), samples=tuple(samples))
    axes = Figure().subplots()
    plot_samples(group, axes, is_scaled=True)
    assert np.isnan(curves(axes)[0]).all()
    assert not np.isnan(curves(axes)[1]).any()


def test_a_band_far_wider_than_the_curves_is_cut_by_the_axis() -> None:
    group = build_group("A", six_samples())
    wide = replace(group.band, upper_all=group.band.mean + 1e4, lower_all=group.band.mean - 1e4)
    axes = Figure().subplots()
    plot_samples(group, axes)
    plot_band(group, wide, axes)
    assert axes.get_ylim()[1] < 2 * group.band.mean.max()
    assert axes.get_ylim()[0] > -group.band.mean.max()


def test_few_curves_have_intervals_at_three_displacements_and_no_band() -> None:
    group = build_group("A", six_samples())
    few = without_band(replace(group.band, n=3))
    page = draw_curves(replace(group, band=few))
    said = page.texts[1].get_text().replace("\n", " ")
    assert said.startswith("3 samples are too few for a band, which needs 6;")
    assert "95 % interval of the mean" in labels(page)
    assert not [each for each in labels(page) if "band" in each]
    axes = page.axes[0]
    assert not axes.collections
    marks = [line for line in axes.lines if len(np.asarray(line.get_xdata())) == 2]
    assert len(marks) == 3
    for line, at in zip(marks, few.marks, strict=True):
        ends = np.asarray(line.get_ydata(), float)
        np.testing.assert_allclose(ends, [group.band.lower[at], group.band.upper[at]])


def test_two_curves_are_shown_without_an_interval() -> None:
    group = build_group("A", six_samples())
    page = draw_curves(replace(group, band=without_band(replace(group.band, n=2))))
    said = page.texts[1].get_text()
    assert said == "Two samples are too few for any band; the samples are shown."
    assert not [each for each in labels(page) if "95 %" in each]


def test_the_axis_follows_curves_and_pointwise_band() -> None:
    group = build_group("A", six_samples())
    wide = replace(group.band, upper_all=group.band.mean + 90.0, lower_all=group.band.mean - 90.0)
    low, high = seen(group, wide)
    peaks = [float(sample.loading[0].force.max()) for sample in group.samples]
    assert max(peaks) < high < 1.1 * max(*peaks, group.band.upper.max())
    near = replace(group.band, upper_all=group.band.upper + 9.0, lower_all=group.band.lower - 9.0)
    assert seen(group, near)[1] > near.upper_all.max()
    assert seen(group, near)[0] < near.lower_all.min() < low


def test_what_is_seen_without_a_curve() -> None:
    group = build_group("A", [])
    assert np.isfinite(seen(group, group.band)).all()
