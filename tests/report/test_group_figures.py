"""Figures of a group: curves, slips, lines, numbers, shapes, and the words on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import FigureLaw, FigureShapes, FittedLine
from labpipe.records.group import Group, Outlier
from labpipe.report.group_plots import list_group_figures, make_file_plots
from labpipe.report.page_tables import make_stems
from labpipe.report.plot_records import Page
from labpipe.statistics.groups import reduce_band
from tests.approved import Approve
from tests.builders.campaigns import build_group, build_sample, six_samples, troubled_samples
from tests.report.figure_words import all_words


def test_figures_that_a_group_has_data_for() -> None:
    bare = [replace(build_sample("s1", "a"), lines=())]
    three = ["curves", "scaled", "numbers"]
    for group, names in (
        (build_group("A", six_samples()), three),
        (bent(), [*three, "shapes", "moment"]),
        (build_group("A", bare, scaled=False), ["curves"]),
        (build_group("A", [], scaled=False), ["curves"]),
    ):
        assert sorted(drawing.name for drawing in list_group_figures(group)) == sorted(names)


def test_file_names() -> None:
    assert make_stems(["A2 85 mm", "a2/85/mm", "\u00b5"]) == ["a2-85-mm", "a2-85-mm-2", "group"]
    assert make_stems(["A" * 200])[0] == "a" * 60


def test_rows_are_samples_spool_means_and_the_mean() -> None:
    group = build_group("A", troubled_samples())
    number = group.numbers[1]
    plot = make_file_plots(group)["numbers"][1]
    assert plot.y.row_names == (
        "tt-s1a", "tt-s1b", "tt-s1c", "mean of s1",
        "tt-s2a", "tt-s2b", "tt-s2c", "mean of s2", "mean",
    )  # fmt: skip
    dots = {float(line.y[0]): line for line in plot.lines if not line.look.startswith("interval")}
    assert dots[0].look == "doubtful c0"
    assert -5.0 not in dots  # it has no number
    assert number.mean is not None
    assert dots[-8.0].x == pytest.approx(number.mean.chosen.mean)


X = np.linspace(0.0, 0.08, 5)
STEPS = np.array([0.00004, 0.01, 0.02])
SHAPES = FigureShapes(STEPS, np.stack([np.column_stack([X, d * (X / 0.08) ** 2]) for d in STEPS]))
KAPPA = np.array([0.0, 1.0, 10.0])
LAW = FigureLaw(KAPPA, 3e-4 * KAPPA, 2.9e-4 * KAPPA, 3.1e-4 * KAPPA)


def bent(count: int = 6) -> Group:
    samples = six_samples()[:count]
    return build_group("A", [replace(sample, shapes=SHAPES, law=LAW) for sample in samples])


def test_words(approved: Approve) -> None:
    two_cycles = six_samples(cycles=2)
    samples = {
        "two cycles": two_cycles,
        "one loading": [replace(sample, loading=sample.loading[:1]) for sample in two_cycles],
        "no unloading": [replace(sample, unloading=()) for sample in two_cycles],
        "one sample": [build_sample("s1", "a")],
        "no sample": [],
        "no curve": [troubled_samples()[4]],
    }
    group, troubled = build_group("A", six_samples()), build_group("A", troubled_samples())
    outlier = Outlier("tt-s1c", 5400.0, "Grubbs' test", 0.01)
    number = replace(group.numbers[1], outliers=(outlier,))
    segment = FittedLine("segment_stiffness_first", 5000.0, 0.0, 0.0, 0.01)
    segments = build_group("A", [replace(build_sample("s1", "a"), lines=(segment,))])
    two, three = (reduce_band(replace(group.band, n=count)) for count in (2, 3))
    groups = {name: build_group("A", chosen) for name, chosen in samples.items()}
    drawn = {f"{name}: curves": figure("curves", chosen) for name, chosen in groups.items()}
    drawn |= {f"six samples: {name}": figure(name, bent()) for name in make_file_plots(bent())}
    drawn |= {
        "three curves": figure("curves", replace(group, band=three)),
        "two curves": figure("curves", replace(group, band=two)),
        "numbers, one doubtful": figure("numbers", troubled),
        "numbers, an outlier": figure("numbers", replace(group, numbers=(number,))),
        "segments": figure("curves", segments),
        "laws of three": figure("moment", bent(3)),
    }
    approved(all_words(drawn))


def figure(name: str, group: Group) -> Page:
    """Find a figure of a group by its name."""
    return next(page for page in list_group_figures(group) if page.name == name)
