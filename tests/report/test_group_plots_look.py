from __future__ import annotations

import numpy as np
import pytest
from matplotlib.lines import Line2D

from labpipe.report.figure_page import WIDTH, style
from labpipe.report.group_plots import (
    POINTS,
    count_words,
    finite_end,
    first_loading,
    group_page,
    group_scale,
    spool_looks,
    thin,
    value_of,
)
from tests.builders.campaigns import build_group, build_sample, six_samples, troubled_samples


def test_spools_differ_in_colour_and_in_dash() -> None:
    samples = [build_sample(f"s{number}", "a") for number in range(4)]
    with style():
        looks = spool_looks(build_group("A", samples))
    assert list(looks) == ["s0", "s1", "s2", "s3"]
    assert len({look.colour for look in looks.values()}) == 4
    assert len({str(look.dash) for look in looks.values()}) == 4


def test_words_and_units() -> None:
    group = build_group("A", six_samples())
    assert count_words(group) == "6 samples from 2 spools"
    assert count_words(build_group("A", [build_sample("s1", "a")])) == "1 sample from 1 spool"
    assert group_scale(group, "displacement").label("Displacement") == "Displacement (mm)"


def test_thin_curves_keep_their_ends_and_peak() -> None:
    curve = build_sample("s1", "a").loading[0]
    x, y = thin(curve, curve.force)
    assert len(x) <= POINTS
    assert (x[0], x[-1]) == (curve.displacement[0], curve.displacement[-1])
    assert y.max() == curve.force.max()


def test_values_of_samples() -> None:
    samples = troubled_samples()
    assert value_of(samples[4], "stiffness_first") is None
    assert value_of(samples[0], "unheard_of") is None
    assert first_loading(samples[4]) is None
    assert finite_end(np.array([1.0, np.nan])) == 1.0
    assert finite_end(np.array([np.nan])) == 0.0


def test_page_has_room_for_key_and_footnote() -> None:
    keys = [Line2D([], [], label=f"spool {number}") for number in range(7)]
    with style():
        page = group_page(build_group("A", six_samples()), keys, height_mm=60.0, note="word " * 40)
    assert page.get_size_inches()[0] == pytest.approx(WIDTH / 25.4)
    assert page.get_size_inches()[1] * 25.4 > 60.0 + 3 * 4.0 + 2 * 3.0
    assert page.texts[0].get_text() == "A  \u00b7  twist-tube  \u00b7  6 samples from 2 spools"
