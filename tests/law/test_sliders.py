"""A law as sliders, in a plane and in space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from labpipe.law.plays import respond, virgin_plays
from labpipe.law.sliders import (
    SliderLaw,
    as_plays,
    fit_sliders,
    linear_moment_law,
    slide,
    slide_vector,
    slider_moment,
    slip_moments,
    virgin_rests,
)
from labpipe.records.arrays import Floats
from tests.builders.wire_tables import wire_table

LAW = SliderLaw(2.0, np.array([6.0, 3.0, 1.0]), np.array([0.5, 2.0, 4.0]), 0.1, 10.0)
CURVATURE = np.linspace(0.0, 10.0, 401)


def root(curvature: Floats) -> Floats:
    """A smooth concave law."""
    return 1e-3 * ((1.0 + curvature) ** 0.4 - 1.0 + 0.1 * curvature)


def test_first_loading_by_hand() -> None:
    bent = np.array([0.25, 1.0, 3.0, 5.0, -1.0])
    by_hand = [
        0.25 * 12.0,
        2.0 + 3.0 + 3.0 + 1.0,
        6.0 + 3.0 + 6.0 + 3.0,
        10.0 + 3.0 + 6.0 + 4.0,
        -9.0,
    ]
    assert slider_moment(LAW, bent) == pytest.approx(by_hand)
    assert LAW.first_stiffness == 12.0
    assert slip_moments(LAW).tolist() == [3.0, 6.0, 4.0]


def test_a_loop_by_hand() -> None:
    """To 3 1/m and back: everything holds at first, the first slider lets go after 1 1/m."""
    top = slide(LAW, np.array([3.0]), virgin_rests(LAW, 1))
    assert top.moment == pytest.approx(18.0)
    assert top.stiffness == pytest.approx(3.0)
    back = slide(LAW, np.array([2.5]), top.rests)
    assert back.moment == pytest.approx(18.0 - 0.5 * 12.0)
    assert back.stiffness == pytest.approx(12.0)
    further = slide(LAW, np.array([1.0]), back.rests)
    assert further.moment == pytest.approx(18.0 - 2.0 * 2.0 - 1.0 * 6.0 - 2.0 * 3.0 - 2.0 * 1.0)
    again = slide(LAW, np.array([3.0]), further.rests)
    assert again.moment == pytest.approx(18.0)  # loops close


@settings(max_examples=30, deadline=None)
@given(turns=st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=6))
def test_masing_against_plays(turns: list[float]) -> None:
    """The dual form: what the sliders answer bends the plays by what bent the sliders."""
    plays = as_plays(LAW)
    rests, history = virgin_rests(LAW, 1), virgin_plays(plays, 1)
    for turn in turns:
        found = slide(LAW, np.array([turn]), rests)
        answer = respond(plays, found.moment, history)
        assert answer.curvature == pytest.approx(turn, abs=1e-9)
        rests, history = found.rests, answer.plays


def test_work_over_a_loop_is_lost_by_the_sliders() -> None:
    """Each slider that is pulled through loses 4 K kappa_j (kappa_max - kappa_j)."""
    path = 3.0 * np.sin(np.linspace(0.5 * np.pi, 2.5 * np.pi, 20001))
    rests = slide(LAW, np.array([3.0]), virgin_rests(LAW, 1)).rests
    moments = []
    for bent in path:
        found = slide(LAW, np.array([bent]), rests)
        rests = found.rests
        moments.append(float(found.moment[0]))
    lost = sum(4.0 * k * y * max(3.0 - y, 0.0) for k, y in ((6.0, 0.5), (3.0, 2.0), (1.0, 4.0)))
    assert np.trapezoid(moments, path) == pytest.approx(lost, rel=1e-4)


@settings(max_examples=20, deadline=None)
@given(turn=st.floats(-np.pi, np.pi), turns=st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=4))
def test_vector_sliders_in_a_plane_are_plain_ones(turn: float, turns: list[float]) -> None:
    towards = np.array([np.cos(turn), np.sin(turn)])
    plain, vector = virgin_rests(LAW, 1), virgin_rests(LAW, 1, is_vector=True)
    for bent in turns:
        one = slide(LAW, np.array([bent]), plain)
        two = slide_vector(LAW, bent * towards[None], vector)
        assert two.moment[0] == pytest.approx(one.moment[0] * towards, abs=1e-9)
        plain, vector = one.rests, two.rests


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_tangent_against_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rests = slide_vector(LAW, rng.normal(scale=3.0, size=(1, 2)), np.zeros((1, 3, 2))).rests
    bent = rng.normal(scale=3.0, size=(1, 2))
    found = slide_vector(LAW, bent, rests).stiffness[0]
    step = 1e-6
    for axis in range(2):
        off = step * np.eye(2)[axis]
        up, down = (slide_vector(LAW, bent + way * off, rests).moment[0] for way in (1.0, -1.0))
        assert found[:, axis] == pytest.approx((up - down) / (2.0 * step), abs=2e-5)
    assert found == pytest.approx(found.T)
    assert np.all(np.linalg.eigvalsh(found) >= LAW.stiffness - 1e-12)


def test_a_closed_path_in_space_loses_work_and_never_gains_any() -> None:
    angle = np.linspace(0.0, 4.0 * np.pi, 4001)
    path = np.column_stack([3.0 * np.cos(angle), 3.0 * np.sin(angle)])
    rests = slide_vector(LAW, path[:1], virgin_rests(LAW, 1, is_vector=True)).rests
    moments = []
    for bent in path:
        found = slide_vector(LAW, bent[None], rests)
        rests = found.rests
        moments.append(found.moment[0])
    steps = np.diff(path, axis=0)
    work = np.cumsum(np.sum(0.5 * (np.array(moments)[1:] + np.array(moments)[:-1]) * steps, axis=1))
    second = work[-1] - work[len(work) // 2 - 1]
    # On a circle of radius r a slider follows all along at the distance kappa_j, on a circle of
    # radius sqrt(r^2 - kappa_j^2), and loses K kappa_j times its way.
    lost = sum(2.0 * np.pi * k * y * np.sqrt(9.0 - y**2) for k, y in ((6.0, 0.5), (3.0, 2.0)))
    assert second == pytest.approx(lost, rel=2e-3)


@pytest.mark.parametrize("number", [4, 8, 12])
def test_errors_of_a_smooth_law(number: int) -> None:
    law = fit_sliders(CURVATURE, root(CURVATURE), number, first=0.1)
    fine = np.linspace(0.1, 10.0, 5000)
    off = slider_moment(law, fine) / np.interp(fine, CURVATURE, root(CURVATURE)) - 1.0
    assert np.max(np.abs(off)) == pytest.approx(law.error, rel=1e-3)
    assert len(law.stiffnesses) == number
    assert off.max() == pytest.approx(-off.min(), rel=1e-3)  # as much above as below


@pytest.mark.slow
@pytest.mark.parametrize(("number", "most"), [(4, 0.03), (8, 0.008), (12, 0.004)])
@pytest.mark.parametrize("name", ["A2", "A3", "C5"])
def test_example_wires_against_least_squares_on_a_grid(name: str, number: int, most: float) -> None:
    """Non-negative least squares with as many sliders as it likes, thinned to as many as here."""
    table = wire_table(name)
    law = fit_sliders(table.curvature, table.moment, number)
    assert law.error < most
    x, y = table.curvature[1:], table.moment[1:]
    grid = np.geomspace(x[0], x[-1], 200)[:-1]
    for _ in range(200):
        columns = np.column_stack([x, np.minimum(x[:, None], grid)]) / y[:, None]
        found = nnls(columns, np.ones(len(x)))[0]
        used = found[1:] > 0.0
        if used.all() and len(grid) <= number:
            break
        grid = grid[used] if not used.all() else np.delete(grid, np.argmin(found[1:] * grid))
    off = float(np.max(np.abs(columns @ found - 1.0)))
    assert law.error < off


def test_a_law_with_fewer_corners_is_met() -> None:
    x = np.array([0.0, 1.0, 3.0, 10.0])
    law = fit_sliders(x, np.array([0.0, 3.0, 5.0, 6.0]), 8)
    assert len(law.stiffnesses) == 2
    assert law.error < 1e-12
    assert law.slip_curvatures.tolist() == [1.0, 3.0]


def test_a_constant_stiffness_has_no_sliders() -> None:
    law = linear_moment_law(0.5, 10.0)
    assert slider_moment(law, np.array([2.0])).tolist() == [1.0]
    found = slide(law, np.array([2.0]), virgin_rests(law, 1))
    assert (found.moment.tolist(), found.stiffness.tolist()) == ([1.0], [0.5])
    answer = respond(as_plays(law), np.array([1.0]), virgin_plays(as_plays(law), 1))
    assert answer.curvature == pytest.approx(2.0)


def test_a_law_that_softens_or_stiffens() -> None:
    x = np.linspace(0.0, 10.0, 11)
    with pytest.raises(ValueError, match=r"^the law softens before curvature=7 1/m: allowed is a"):
        fit_sliders(x, np.where(x > 6.0, 5.0, x), 4)
    with pytest.raises(
        ValueError,
        match=r"^the law stiffens at curvature=1 1/m: a law that never does is 9e\+02 % above it, "
        r"allowed is 1 %$",
    ):
        fit_sliders(x, x**2, 4)


@pytest.mark.parametrize(
    ("first", "last", "said"),
    [
        (5.0, 5.0, r"^first=5\.0, last=5\.0: allowed is a range of curvatures above zero$"),
        (0.1, 20.0, r"^last=20 1/m: the law ends at 10 1/m$"),
        (0.1, np.nan, r"allowed is a range of curvatures above zero$"),
    ],
)
def test_a_range_of_zero_or_beyond_the_law(first: float, last: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fit_sliders(CURVATURE, root(CURVATURE), 4, first=first, last=last)


def test_fewer_sliders_than_the_loss_allows() -> None:
    table = wire_table("A2")
    with pytest.raises(
        ValueError,
        match=r"^4 sliders lose 1\.\d+ % of the moment, allowed is 0\.5 %: 9 are enough$",
    ):
        fit_sliders(table.curvature, table.moment, 4, allowed=0.005)
    assert fit_sliders(table.curvature, table.moment, 9, allowed=0.005).error <= 0.005
    with pytest.raises(ValueError, match=r"allowed is 0\.0001 %: 64 are not enough$"):
        fit_sliders(table.curvature, table.moment, 4, allowed=1e-6)


@pytest.mark.parametrize("number", [0, 65])
def test_number_of_sliders(number: int) -> None:
    with pytest.raises(ValueError, match=rf"^n_sliders={number}: allowed are numbers from 1 to 64"):
        fit_sliders(CURVATURE, root(CURVATURE), number)


def test_points_that_do_not_fit_together() -> None:
    with pytest.raises(ValueError, match=r"^3 curvatures and 2 moments: allowed are as many of"):
        fit_sliders(np.arange(3.0), np.arange(2.0), 4)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((-1.0, [1.0], [1.0]), r"^stiffness=-1\.0: allowed are finite numbers >= 0$"),
        ((1.0, [0.0], [1.0]), r"^stiffnesses=\[0\.0\]: allowed are finite numbers > 0$"),
        ((1.0, [1.0, 1.0], [2.0, 1.0]), r"^slip_curvatures=\[2\.0, 1\.0\]: allowed are positive"),
    ],
)
def test_sliders_that_cannot_be(numbers: tuple[float, list[float], list[float]], said: str) -> None:
    stiffness, stiffnesses, slips = numbers
    with pytest.raises(ValueError, match=said):
        SliderLaw(stiffness, np.array(stiffnesses), np.array(slips), 0.1, 10.0)
