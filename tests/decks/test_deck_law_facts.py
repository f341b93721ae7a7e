from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe import __version__
from labpipe.decks import deck_law as deck_facts
from labpipe.decks.deck_law import linear_range, skew_excess
from labpipe.records.wire import WireTable
from tests.builders.stranded_wires import wire
from tests.builders.wire_tables import wire_table


def table_of(curvature: list[float], moment: list[float]) -> WireTable:
    zeros = np.zeros(len(curvature))
    return replace(
        wire_table(),
        curvature=np.array(curvature),
        moment=np.array(moment),
        stick=zeros,
        slip=zeros,
        bending=zeros,
        plastic=zeros,
        insulation=zeros,
        tangent_stiffness=zeros,
        secant_stiffness=zeros,
        lowest_moment=zeros,
        highest_moment=zeros,
    )


def test_every_deck_says_name_version_units_range_and_law() -> None:
    said = " ".join(deck_facts.facts(wire_table("A2"), "A2"))
    assert f"Wire A2, made by labpipe {__version__}." in said
    assert "curvature from 0 to 125 1/m (bending radius 0.008 m and more)" in said
    assert "Beyond this range the deck is not valid." in said
    assert "Units: m, N, kg, s, rad" in said
    assert "first loading" in said


def test_a_linear_law_is_good_up_to_the_point_where_it_is_off_by_the_tolerance() -> None:
    table = table_of([0.0, 1.0, 2.0], [0.0, 1.0, 1.5])
    # kappa = 1.05 (0.5 + 0.5 kappa)
    assert linear_range(table, 1.0) == pytest.approx((0.0, 0.525 / 0.475))
    # 0.97 kappa = 1.05 (0.5 + 0.5 kappa): it starts below the law and leaves above it
    assert linear_range(table, 0.97) == pytest.approx((0.0, 0.525 / (0.97 - 0.525)))


def test_a_softer_linear_law_is_good_on_a_stretch() -> None:
    table = table_of([0.0, 1.0, 2.0, 9.0], [0.0, 1.0, 1.5, 5.0])
    # 0.8 kappa = (1 -+ 0.05) (0.5 + 0.5 kappa)
    first, last = linear_range(table, 0.8) or (0.0, 0.0)
    assert first == pytest.approx(0.475 / (0.8 - 0.475))
    assert last == pytest.approx(0.525 / (0.8 - 0.525))


def test_a_linear_law_may_leave_below() -> None:
    table = table_of([0.0, 1.0, 2.0], [0.0, 1.0, 3.0])
    # 0.98 kappa = 0.95 (-1 + 2 kappa)
    assert linear_range(table, 0.98) == pytest.approx((0.0, 0.95 / (1.9 - 0.98)))


def test_a_linear_law_may_be_good_throughout_or_nowhere() -> None:
    table = table_of([0.0, 1.0, 2.0], [0.0, 1.0, 2.0])
    assert linear_range(table, 1.04) == (0.0, 2.0)
    assert linear_range(table, 1.06) is None


def test_a_stretch_between_two_points_is_found() -> None:
    table = table_of([0.0, 1.0, 9.0], [0.0, 1.0, 1.08])
    first, last = linear_range(table, 0.5) or (0.0, 0.0)
    assert 1.0 < first < last < 9.0
    for at, ratio in ((first, 0.95), (last, 1.05)):
        assert 0.5 * at / (0.99 + 0.01 * at) == pytest.approx(ratio)


@pytest.mark.parametrize("name", ["A1", "A3", "C5"])
@pytest.mark.parametrize("curvature", [0.0, 20.0])
def test_at_the_ends_of_the_range_a_wire_is_off_by_five_per_cent(
    name: str, curvature: float
) -> None:
    table = wire_table(name)
    stiffness = float(np.interp(curvature, table.curvature, table.secant_stiffness))
    first, last = linear_range(table, stiffness) or (0.0, 0.0)
    assert first <= curvature < last
    for at, ratio in ((first, 0.95), (last, 1.05)):
        moment = float(np.interp(at, table.curvature, table.moment))
        inside_table = 0.0 < at < table.curvature[-1]
        assert not inside_table or stiffness * at / moment == pytest.approx(ratio, rel=1e-9)


def test_bending_askew_of_a_linear_law_is_right() -> None:
    assert skew_excess(table_of([0.0, 1.0, 2.0], [0.0, 1.0, 2.0])) == pytest.approx(0.0, abs=1e-12)


def test_bending_askew_of_a_plateau_is_too_stiff_by_root_two() -> None:
    curvature = [0.0, 1e-3, 10.0]
    excess = skew_excess(table_of(curvature, [0.0, 1.0, 1.0 + 1e-9]))
    assert excess == pytest.approx(np.sqrt(2.0) - 1.0, rel=1e-6)


def test_area_and_second_moment_are_those_of_the_section() -> None:
    table, section = wire_table("A2"), wire("A2")
    assert section.insulation is not None
    tube = np.pi * (0.8e-3**2 - 0.5e-3**2)
    strands = 7 * np.pi / 4.0 * 0.32e-3**2
    assert deck_facts.solid_area(table) == pytest.approx(strands + tube)
    # six strands around one: 7 pi d^4 / 64 + 6 A d^2 / 2
    own = 7 * np.pi / 64.0 * 0.32e-3**4 + 3.0 * np.pi / 4.0 * 0.32e-3**4
    ring = np.pi / 4.0 * (0.8e-3**4 - 0.5e-3**4)
    assert deck_facts.second_moment(table) == pytest.approx(own + ring)
