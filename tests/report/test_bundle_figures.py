"""The figure of a bundle: what is drawn, not how."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from labpipe.report.bundle_figures import (
    bundle_figure,
    plot_bounds,
    plot_bundle_section,
    save_bundle_figure,
)
from labpipe.wire.bundle_model import bundle_model
from tests.builders.bundles import bundle, example_wires

MIXED = bundle_model(
    bundle(("B1", 4), ("B2", 3), arrangement="asymmetric", conduit_bore=4e-3), example_wires()
)
ALIKE = bundle_model(bundle(("B1", 7)), example_wires())


def test_section_in_mm() -> None:
    axes = Figure().subplots()
    plot_bundle_section(MIXED, axes)
    circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert [circle.radius for circle in circles] == pytest.approx([0.55] * 4 + [0.625] * 3 + [2.0])
    first = np.array([circle.center for circle in circles[:7]])
    assert first == pytest.approx(1e3 * np.column_stack([MIXED.layout.x, MIXED.layout.y]))
    assert circles[-1].center == pytest.approx(1e3 * np.array(MIXED.middle))
    assert axes.get_xlabel() == "x (mm)"
    assert axes.get_ylabel() == "y, direction of bending (mm)"
    low, high = axes.get_xlim()
    assert low <= -2.0 <= 2.0 <= high


def test_arms_lie_along_the_principal_axes() -> None:
    axes = Figure().subplots()
    plot_bundle_section(MIXED, axes)
    stiffest = axes.lines[0]
    across, up = np.diff(stiffest.get_xdata())[0], np.diff(stiffest.get_ydata())[0]
    turn = np.arctan2(up, across) - MIXED.principal_angle
    assert np.sin(turn) == pytest.approx(0.0, abs=1e-9)
    centre = axes.lines[2]
    at = np.ravel([centre.get_xdata(), centre.get_ydata()])
    assert at == pytest.approx(1e3 * np.array(MIXED.neutral))


def test_bounds_in_n_mm() -> None:
    axes = Figure().subplots()
    plot_bounds(MIXED, axes)
    low, high, slip, slip_lighter, stick, stick_lighter = axes.lines
    for sure, lighter, moment, doubtful in (
        (slip, slip_lighter, MIXED.moment_slip[1:], MIXED.is_doubtful[1:]),
        (stick, stick_lighter, MIXED.moment_stick[1:], MIXED.is_doubtful_stick[1:]),
    ):
        assert sure.get_ydata() == pytest.approx(1e3 * moment[~doubtful])
        assert np.asarray(lighter.get_ydata())[1:] == pytest.approx(1e3 * moment[doubtful])
        assert (sure.get_alpha(), lighter.get_alpha()) == (1.0, 0.35)
    assert low.get_ydata() == pytest.approx(1e3 * MIXED.low * MIXED.curvature[1:])
    assert high.get_ydata() == pytest.approx(1e3 * MIXED.high * MIXED.curvature[1:])
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_ylabel() == "Bending moment (N·mm)"
    assert axes.get_xlim() == (MIXED.curvature[1], MIXED.curvature[-1])


def words(page: Figure) -> str:
    legend = [text.get_text() for text in page.legends[0].get_texts()]
    return "\n".join([*(text.get_text().replace("\n", " ") for text in page.texts), *legend])


def test_words_of_the_page() -> None:
    said = words(bundle_figure(MIXED))
    assert "4 B1 + 3 B2  ·  bundle model  ·  asymmetric  ·  packing fraction 0.60 in 4 mm" in said
    assert "bore of the conduit" in said
    assert "stiffest direction" in said
    assert "Copper that is stretched yields" in said
    alike = words(bundle_figure(ALIKE))
    assert "y and x: all directions are alike" in alike
    assert "alike in all directions" in alike
    assert "packing fraction" not in alike


def test_both_files(tmp_path: Path) -> None:
    files = save_bundle_figure(MIXED, tmp_path / "figures")
    assert [file.name for file in files] == ["bundle.svg"]
    assert all(file.stat().st_size > 1000 for file in files)
