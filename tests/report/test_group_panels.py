from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.drawn import DrawnLaw, DrawnShapes
from labpipe.records.group import Campaign, Group, Sample
from labpipe.report.group_panels import group_panels
from labpipe.report.page_facts import PageTests
from labpipe.report.page_plots import Plot
from tests.builders.campaigns import build_group, build_sample, six_samples


def panels(group: Group, *rejected: Sample) -> dict[str, Plot]:
    campaign = Campaign("S", (group,), rejected_samples=rejected)
    return {plot.kind: plot for plot in group_panels(group, "g", PageTests(campaign, ["g"]))}


def looks(plot: Plot) -> list[str]:
    return [line.look for line in plot.lines]


def test_curves_of_all_samples_with_mean_band_slips_and_failure() -> None:
    plot = panels(build_group("A", six_samples(cycles=2)))["curves"]
    assert looks(plot)[:3] == ["band", "whole", "whole"]
    assert [line.test for line in plot.lines if line.look.startswith("curve")] == [*range(6)]
    assert {"mean", "measured", "slip", "failure", "window"} <= set(looks(plot))
    assert "unloading c0" in looks(plot)
    assert plot.x.label == "Displacement (mm)"
    colours = [line.look for line in plot.lines if line.look.startswith("curve")]
    assert colours == ["curve c0"] * 3 + ["curve c1"] * 3


def test_of_many_samples_the_key_names_the_spools() -> None:
    samples = [build_sample(f"s{n % 2}", str(n), seed=n) for n in range(8)]
    plot = panels(build_group("A", samples))["curves"]
    assert [(key.words, key.value) for key in plot.keys[:2]] == [
        ("spool s0", "c0"), ("spool s1", "c1"),
    ]  # fmt: skip


def test_curves_are_drawn_where_they_are() -> None:
    sample = build_sample("s1", "a")
    plot = panels(build_group("A", [sample], scaled=False))["curves"]
    (line,) = (each for each in plot.lines if each.look == "curve c0")
    assert len(line.x) <= 90
    curve = sample.loading[0]
    force = np.interp(line.x / 1e3, curve.displacement, curve.force)
    np.testing.assert_allclose(line.y, force, atol=1e-9)
    assert "mean" not in looks(plot)


def test_few_samples_have_colours_and_names_of_their_own() -> None:
    plot = panels(build_group("A", six_samples()[:3]))["curves"]
    keys = [key for key in plot.keys if key.attribute == "t"]
    assert [(key.words, key.look) for key in keys] == [
        ("tt-s1a", "curve c0"), ("tt-s1b", "curve c1"), ("tt-s1c", "curve c2"),
    ]  # fmt: skip


def test_a_rejected_test_is_grey() -> None:
    samples = six_samples(slips=0)
    group = replace(build_group("A", samples[1:]), fields={"type": "twist-tube-10"})
    plot = panels(group, samples[0])["curves"]
    (line,) = (each for each in plot.lines if each.look == "rejected")
    assert line.test == 5
    assert any(key.words == "rejected: in no mean" for key in plot.keys)


def test_shapes_have_one_scale_and_laws_their_intervals() -> None:
    rise = np.array([0.0, 0.01, 0.02])
    along = np.linspace(0.0, 0.1, 6)
    places = np.stack([np.stack([along, way * along / 0.1], axis=1) for way in rise])
    law = DrawnLaw(np.array([0.0, 10.0]), *(np.array([0.0, m]) for m in (0.02, 0.018, 0.022)))
    samples = [
        replace(each, shapes=DrawnShapes(rise, places), law=law) for each in six_samples()[:2]
    ]
    found = panels(build_group("A", samples))
    shapes, moment = found["shapes"], found["moment"]
    width, height = shapes.size
    across = (shapes.x.high - shapes.x.low) / width
    assert (shapes.y.high - shapes.y.low) / height == pytest.approx(across)
    assert shapes.caption.startswith("Markers at 0, 10, 20 mm")
    assert np.isnan(shapes.lines[0].x).sum() == 3
    assert looks(moment) == ["band c0", "band c1", "curve c0", "curve c1"]
    assert moment.lines[2].y[-1] == pytest.approx(0.02)


def test_force_over_peak_force() -> None:
    plot = panels(build_group("A", six_samples(slips=0)))["scaled"]
    tops = [np.nanmax(line.y) for line in plot.lines if line.look.startswith("curve")]
    assert tops == pytest.approx([1.0] * 6, abs=0.05)


def test_a_group_without_curves_has_no_plots() -> None:
    assert not panels(build_group("A", []))
    assert not panels(build_group("A", [replace(build_sample("s", "a"), loading=(), lines=())],
                                  scaled=False))  # fmt: skip
