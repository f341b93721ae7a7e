from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import FittedLine
from labpipe.report.figure_page import style
from labpipe.report.group_plots import draw_lines, has_lines
from tests.builders.campaigns import build_group, build_sample, six_samples


def test_lines_over_their_windows_with_the_mean_slopes() -> None:
    group = build_group("A", six_samples())
    with style():
        page = draw_lines(group)
    lines = [line for line in page.axes[0].lines if len(np.asarray(line.get_xdata())) == 2]
    assert len(lines) == 12
    assert np.asarray(lines[0].get_xdata()) == pytest.approx([2.0, 8.0])
    first = group.samples[0].lines[0]
    ends = [first.level, first.level + first.slope * 0.006]
    assert np.asarray(lines[0].get_ydata()) == pytest.approx(ends)
    words = [text.get_text() for text in page.legends[0].get_texts()]
    assert words[0].startswith("Stiffness, first region: 5.0 (")
    assert words[0].endswith(" N/mm, mean of 2 spool means")
    assert words[1].endswith(" N/mm, mean of 6 samples")
    assert page.axes[0].get_xlim()[1] < 1.6 * 20.0


def test_segments_are_dotted_and_a_line_without_a_number_keeps_its_name() -> None:
    segment = FittedLine("segment_stiffness_first", 5000.0, 0.0, 0.0, 0.01)
    sample = replace(build_sample("s1", "a"), lines=(segment,))
    with style():
        page = draw_lines(build_group("A", [sample]))
    drawn = page.axes[0].lines[-1]
    assert (drawn.get_color(), drawn.get_linestyle()) == ("black", "--")
    words = [text.get_text() for text in page.legends[0].get_texts()]
    assert words == ["Stiffness, first fitted segment"]


def test_groups_without_lines() -> None:
    assert not has_lines(build_group("A", [replace(build_sample("s1", "a"), lines=())]))
    assert not has_lines(build_group("A", []))
