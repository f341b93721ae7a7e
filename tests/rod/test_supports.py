"""Cells between clamps."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.line import Line
from labpipe.rod.supports import END_SHARE, supports_of
from tests.builders.rods import linear_section, straight_line


def uneven() -> Line:
    plain = straight_line(1.0, 4, linear_section())
    lengths = np.array([0.1, 0.2, 0.3, 0.4])
    return Line(lengths, plain.section, plain.positions, plain.frames, np.arange(9.0).reshape(3, 3))


def test_a_free_line_has_cells_at_its_inner_nodes() -> None:
    supports = supports_of(uneven(), ((0, False), (4, False)))
    assert supports.nodes.tolist() == [1, 2, 3]
    assert supports.lengths == pytest.approx([0.15, 0.25, 0.35])
    assert supports.sides[0] == pytest.approx([0.05 / 0.15, 0.1 / 0.15])
    assert supports.held.tolist() == [0, 4]
    assert len(supports.ends) == 0


def test_clamps_part_cells() -> None:
    supports = supports_of(uneven(), ((2, True), (0, True)))
    assert supports.nodes.tolist() == [0, 1, 2, 2, 3]
    assert supports.before.tolist() == [-2, 0, 1, -1, 2]
    assert supports.behind.tolist() == [0, 1, -1, 2, 3]
    assert supports.lengths == pytest.approx([0.05, 0.15, 0.1, 0.15, 0.35])
    assert supports.natural[0].tolist() == [0.0, 1.0, 2.0]  # of its neighbour
    assert supports.ends.tolist() == [0, 1, 2]
    assert supports.own == pytest.approx([1.0 - END_SHARE] * 3)


def test_an_element_between_two_clamps_has_a_share_of_both() -> None:
    supports = supports_of(uneven(), ((1, True), (2, True)))
    at = supports.ends.tolist().index(1)
    assert supports.own[at] == pytest.approx(1.0 - 2.0 * END_SHARE)
    assert sorted(supports.lent[supports.lent[:, 0] == at, 1].tolist()) == [0, 1]


def test_cells_make_up_the_line_between_clamps() -> None:
    line = uneven()
    assert supports_of(line, ((0, True), (4, True))).lengths.sum() == pytest.approx(line.length)
    open_ends = supports_of(line, ()).lengths.sum()
    assert open_ends == pytest.approx(line.length - 0.5 * (0.1 + 0.4))
