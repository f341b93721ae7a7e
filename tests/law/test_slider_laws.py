"""Sliders in a plane, in space and in a few directions, and laws of few points."""

from __future__ import annotations

from itertools import combinations, pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.mechanics.law.loss_card import DEFAULT_SLIDERS, fit_wire_sliders, make_table_card
from labpipe.mechanics.law.sliders import (
    ROTATIONS,
    SliderLaw,
    average_rotations,
    compute_first_loading,
    convert_to_plays,
    fit_directions,
    fit_sliders,
    make_linear_law,
    make_unbent_history,
    slide,
    slide_vector,
)
from labpipe.mechanics.law.thinning import thin_law
from labpipe.records.arrays import Floats
from tests.builders.wire_tables import wire_table

LAW = SliderLaw(2.0, np.array([6.0, 3.0, 1.0]), np.array([0.5, 2.0, 4.0]), 0.1, 10.0)


CURVATURE = np.linspace(0.0, 10.0, 401)


def smooth(curvature: Floats) -> Floats:
    """A smooth concave law."""
    return 1e-3 * ((1.0 + curvature) ** 0.4 - 1.0 + 0.1 * curvature)


def test_first_loading_by_hand() -> None:
    by_hand = [0.25 * 12.0, 2.0 + 3.0 + 3.0 + 1.0, 6.0 + 3.0 + 6.0 + 3.0, 10.0 + 3.0 + 6.0 + 4.0]
    bent = np.array([0.25, 1.0, 3.0, 5.0])
    assert compute_first_loading(LAW, bent) == pytest.approx(by_hand)
    assert compute_first_loading(LAW, -bent) == pytest.approx(-np.array(by_hand))
    assert LAW.first_stiffness == 12.0


def test_a_loop_by_hand() -> None:
    """To 3 1/m and back: everything holds at first, the first slider lets go after 1 1/m."""
    rests = make_unbent_history(LAW, 1)
    for bent, moment, stiffness in (
        (3.0, 18.0, 3.0),
        (2.5, 18.0 - 0.5 * 12.0, 12.0),
        (1.0, 18.0 - 2.0 * 2.0 - 1.0 * 6.0 - 2.0 * 3.0 - 2.0 * 1.0, 6.0),
        (2.9, 18.0 - 0.1 * 6.0, 6.0),  # loops close
    ):
        answer = slide(LAW, np.array([bent]), rests)
        assert (answer.moment[0], answer.stiffness[0]) == pytest.approx((moment, stiffness))
        rests = answer.history


@settings(max_examples=30, deadline=None)
@given(turns=st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=6))
def test_masing_against_plays(turns: list[float]) -> None:
    """The dual form: what the sliders answer bends the plays by what bent the sliders."""
    plays = convert_to_plays(LAW)
    rests, history = make_unbent_history(LAW, 1), plays.make_unbent_history(1)
    for turn in turns:
        response = slide(LAW, np.array([turn]), rests)
        answer = plays.respond(response.moment, history)
        assert answer.curvature == pytest.approx(turn, abs=1e-9)
        rests, history = response.history, answer.history


@settings(max_examples=20, deadline=None)
@given(turn=st.floats(-np.pi, np.pi), turns=st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=4))
def test_vector_sliders_in_a_plane_are_plain_ones(turn: float, turns: list[float]) -> None:
    towards = np.array([np.cos(turn), np.sin(turn)])
    scalar, vector = make_unbent_history(LAW, 1), make_unbent_history(LAW, 1, is_vector=True)
    for bent in turns:
        planar = slide(LAW, np.array([bent]), scalar)
        spatial = slide_vector(LAW, bent * towards[None], vector)
        assert spatial.moment[0] == pytest.approx(planar.moment[0] * towards, abs=1e-9)
        scalar, vector = planar.history, spatial.history


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_tangent_against_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rests = slide_vector(LAW, rng.normal(scale=3.0, size=(1, 2)), np.zeros((1, 3, 2))).history
    bent = rng.normal(scale=3.0, size=(1, 2))
    stiffness = slide_vector(LAW, bent, rests).stiffness[0]
    step = 1e-6
    for axis in range(2):
        h = step * np.eye(2)[axis]
        up, down = (slide_vector(LAW, bent + sign * h, rests).moment[0] for sign in (1.0, -1.0))
        assert stiffness[:, axis] == pytest.approx((up - down) / (2.0 * step), abs=2e-5)
    assert stiffness == pytest.approx(stiffness.T)
    assert np.all(np.linalg.eigvalsh(stiffness) >= LAW.spring_stiffness - 1e-12)


def test_a_closed_path_in_space_loses_work_and_never_gains_any() -> None:
    angle = np.linspace(0.0, 4.0 * np.pi, 2401)
    path = np.column_stack([3.0 * np.cos(angle), 3.0 * np.sin(angle)])
    rests = slide_vector(LAW, path[:1], make_unbent_history(LAW, 1, is_vector=True)).history
    moments = []
    for bent in path:
        response = slide_vector(LAW, bent[None], rests)
        rests = response.history
        moments.append(response.moment[0])
    steps = np.diff(path, axis=0)
    work = np.cumsum(np.sum(0.5 * (np.array(moments)[1:] + np.array(moments)[:-1]) * steps, axis=1))
    second = work[-1] - work[len(work) // 2 - 1]
    # On a circle of radius r a slider follows all along at the distance kappa_j, on a circle of
    # radius sqrt(r^2 - kappa_j^2), and loses K kappa_j times its way.
    lost = sum(2.0 * np.pi * k * y * np.sqrt(9.0 - y**2) for k, y in ((6.0, 0.5), (3.0, 2.0)))
    assert second == pytest.approx(lost, rel=2e-3)


@pytest.mark.parametrize("number", [4, 12])
def test_errors_of_a_smooth_law(number: int) -> None:
    law = fit_sliders(CURVATURE, smooth(CURVATURE), number)
    fine = np.linspace(CURVATURE[1], 10.0, 5000)
    errors = compute_first_loading(law, fine) / np.interp(fine, CURVATURE, smooth(CURVATURE)) - 1.0
    assert np.max(np.abs(errors)) == pytest.approx(law.error, rel=1e-3)
    assert len(law.slider_stiffnesses) == number
    assert errors.max() == pytest.approx(-errors.min(), rel=1e-3)  # as much above as below


def test_a_law_with_fewer_corners_is_met() -> None:
    x = np.array([0.0, 1.0, 3.0, 10.0])
    law = fit_sliders(x, np.array([0.0, 3.0, 5.0, 6.0]), 8)
    assert len(law.slider_stiffnesses) == 2
    assert law.error < 1e-12
    assert law.slip_curvatures.tolist() == [1.0, 3.0]


def test_a_constant_stiffness_has_no_sliders() -> None:
    law = make_linear_law(0.5, 10.0)
    assert compute_first_loading(law, np.array([2.0])).tolist() == [1.0]
    response = slide(law, np.array([2.0]), make_unbent_history(law, 1))
    assert (response.moment.tolist(), response.stiffness.tolist()) == ([1.0], [0.5])
    plays = convert_to_plays(law)
    answer = plays.respond(np.array([1.0]), plays.make_unbent_history(1))
    assert answer.curvature == pytest.approx(2.0)


def test_a_spring_and_one_slider_that_slides_all_along() -> None:
    """Four directions: the moment of sliders that all slide goes from 0.98 to 1.05 of the mean."""
    law = SliderLaw(0.0, np.array([1.0]), np.array([1.0]), 50.0, 100.0)
    fitted = fit_directions(law, 4)
    moments = fitted.slider_stiffnesses * fitted.slip_curvatures
    extremes = moments.sum() * np.array(
        [1.0 + 2.0**0.5, 2.0 / np.cos(np.pi / 8.0) * (0.5 + 0.5**0.5)]
    )
    assert fitted.error == pytest.approx(np.max(np.abs(extremes - 1.0)))
    assert fitted.compute_unit_vectors(0.5)[0] == pytest.approx(
        [np.cos(np.pi / 8.0), np.sin(np.pi / 8.0)]
    )
    assert moments.sum() == pytest.approx(np.pi / 8.0, rel=0.03)  # pi K kappa_j / 2 D
    spring = fit_directions(SliderLaw(0.5, np.zeros(0), np.zeros(0), 0.0, 10.0), 3)
    assert max(spring.error, spring.transverse_ratio) < 1e-12
    assert spring.spring_stiffness == pytest.approx(2.0 * 0.5 / 3.0)


@pytest.mark.parametrize("name", ["A2", "C5"])
def test_errors_by_the_sliders_themselves(name: str) -> None:
    """A node, and the mean of four that are turned: each direction by its own planar sliders."""
    table = wire_table(name)
    law = fit_sliders(table.curvature, table.moment, 8)
    node = fit_directions(law, 4)
    turned = average_rotations(law, node)
    assert len(node.slider_stiffnesses) <= 16
    assert turned.n_directions == 16
    assert turned.error < node.error < 0.06
    assert turned.transverse_ratio < 0.2 * node.transverse_ratio
    stiffnesses = node.slider_stiffnesses
    flat = SliderLaw(node.spring_stiffness, stiffnesses, node.slip_curvatures, 0.1, 10.0)
    for stated, shares in ((node, (0.0,)), (turned, ROTATIONS)):
        for angle, size in product((0.0, 0.2, np.pi / 8.0, 1.0, 1.5), (0.2, 5.0, 40.0)):
            towards = np.array([np.cos(angle), np.sin(angle)])
            moment = np.zeros(2)
            for share in shares:
                normals = node.compute_unit_vectors(share)
                step = slide(flat, size * normals @ towards, np.zeros((4, len(stiffnesses))))
                moment += step.moment @ normals / len(shares)
            expected = compute_first_loading(law, np.array([size]))[0]
            assert moment @ towards == pytest.approx(expected, rel=1.05 * stated.error)
            aside = abs(moment[1] * towards[0] - moment[0] * towards[1])
            assert aside <= 1.1 * stated.transverse_ratio * expected + 1e-12


def test_sliders_follow_the_table_and_their_card_says_how_well() -> None:
    table = wire_table("A2")
    law, bent = fit_wire_sliders(table), table.curvature[1:]
    errors = np.abs(compute_first_loading(law, bent) / table.moment[1:] - 1.0)
    assert len(law.slider_stiffnesses) == DEFAULT_SLIDERS
    assert float(errors.max()) == pytest.approx(
        dict(make_table_card(table).slider_errors)[DEFAULT_SLIDERS], rel=1e-6
    )
    assert fit_wire_sliders(table) is law  # fitted once


def find_error(x: Floats, y: Floats, curvature: Floats, moment: Floats, between: int = 7) -> float:
    """Largest relative distance of two polygons, looked for also between the points."""
    fine = np.concatenate([np.linspace(a, b, between) for a, b in pairwise(curvature)])
    law = np.interp(fine, curvature, moment)
    lines = np.interp(fine, x, y)
    return float(np.max(np.abs(lines - law)[law > 0.0] / law[law > 0.0]))


def by_trying_all(curvature: Floats, moment: Floats, max_points: int) -> float:
    inner = range(1, len(curvature) - 1)
    choices = (
        [0, *chosen, len(curvature) - 1]
        for count in range(max_points - 1)
        for chosen in combinations(inner, count)
    )
    return min(find_error(curvature[c], moment[c], curvature, moment, 2) for c in choices)


def concave(count: int, seed: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    slopes = np.sort(rng.uniform(0.05, 1.0, count - 1))[::-1]
    steps = 10.0 ** rng.uniform(-2.0, 0.5, count - 1)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    return x, np.concatenate([[0.0], np.cumsum(slopes * steps)])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("most", [2, 3, 6])
def test_no_other_choice_has_a_smaller_error(seed: int, most: int) -> None:
    curvature, moment = concave(9, seed)
    thinned = thin_law(curvature, moment, max_points=most)
    assert len(thinned.curvature) <= most
    # the search stops at a millionth of the error
    assert thinned.error == pytest.approx(by_trying_all(curvature, moment, most), rel=2e-6)


def test_few_points() -> None:
    """Of few corners all are kept, of a straight law two; one that stiffens is bridged."""
    corners, straight = concave(6, 1), (np.linspace(0.0, 1.0, 50), np.linspace(0.0, 3e-3, 50))
    for points, kept, error in (
        (corners, corners[0].tolist(), 0.0),
        (straight, [0.0, 1.0], 0.0),
        ((np.arange(3.0), np.array([0.0, 1.0, 3.0])), [0.0, 2.0], 0.5),
    ):
        thinned = thin_law(*points, max_points=6)
        assert thinned.curvature.tolist() == kept
        assert thinned.error == pytest.approx(error, abs=1e-14)


STEPS = st.lists(st.tuples(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3)), min_size=1, max_size=40)


@given(steps=STEPS, most=st.integers(2, 25))
def test_the_stated_error_is_true_and_slopes_fall(
    steps: list[tuple[float, float]], most: int
) -> None:
    curvature, moment = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)]).T
    thinned = thin_law(curvature, moment, max_points=most)
    x, y = thinned.curvature, thinned.moment
    assert 2 <= len(x) <= most
    assert (x[0], y[0], x[-1], y[-1]) == (0.0, 0.0, curvature[-1], moment[-1])
    assert set(zip(x, y, strict=True)) <= set(zip(curvature, moment, strict=True))
    slopes = np.diff(y) / np.diff(x)
    assert np.all(slopes[1:] < slopes[:-1])
    assert find_error(x, y, curvature, moment) == pytest.approx(thinned.error, rel=1e-9, abs=1e-12)
