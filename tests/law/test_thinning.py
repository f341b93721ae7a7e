from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.law.thinning import thin
from labpipe.records.arrays import Floats
from tests.builders.wire_tables import wire_table

ROUNDING = 1e-12


def worst(x: Floats, y: Floats, curvature: Floats, moment: Floats, between: int = 7) -> float:
    """Largest relative distance of two polygons, looked for also between the points."""
    fine = np.concatenate([np.linspace(a, b, between) for a, b in pairwise(curvature)])
    law = np.interp(fine, curvature, moment)
    lines = np.interp(fine, x, y)
    return float(np.max(np.abs(lines - law)[law > 0.0] / law[law > 0.0]))


def by_trying_all(curvature: Floats, moment: Floats, most: int) -> float:
    inner = range(1, len(curvature) - 1)
    choices = (
        [0, *some, len(curvature) - 1]
        for count in range(most - 1)
        for some in combinations(inner, count)
    )
    return min(worst(curvature[c], moment[c], curvature, moment, 2) for c in choices)


def concave(count: int, seed: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    slopes = np.sort(rng.uniform(0.05, 1.0, count - 1))[::-1]
    steps = 10.0 ** rng.uniform(-2.0, 0.5, count - 1)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    return x, np.concatenate([[0.0], np.cumsum(slopes * steps)])


positive = st.floats(1e-3, 1e3)
laws = st.lists(st.tuples(positive, positive), min_size=1, max_size=40).map(
    lambda steps: (
        np.concatenate([[0.0], np.cumsum([across for across, _ in steps])]),
        np.concatenate([[0.0], np.cumsum([up for _, up in steps])]),
    )
)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("most", [2, 3, 4, 6])
def test_no_other_choice_has_a_smaller_error(seed: int, most: int) -> None:
    curvature, moment = concave(9, seed)
    thinned = thin(curvature, moment, most=most)
    assert len(thinned.curvature) <= most
    # the search stops at a millionth of the error
    assert thinned.error == pytest.approx(by_trying_all(curvature, moment, most), rel=2e-6)


@given(law=laws, most=st.integers(2, 25))
def test_the_stated_error_is_true_and_slopes_fall(law: tuple[Floats, Floats], most: int) -> None:
    curvature, moment = law
    thinned = thin(curvature, moment, most=most)
    x, y = thinned.curvature, thinned.moment
    assert 2 <= len(x) <= most
    assert (x[0], y[0], x[-1], y[-1]) == (0.0, 0.0, curvature[-1], moment[-1])
    assert set(zip(x, y, strict=True)) <= set(zip(curvature, moment, strict=True))
    slopes = np.diff(y) / np.diff(x)
    assert np.all(slopes[1:] < slopes[:-1])
    assert np.all(slopes[1:] < slopes[0])
    assert worst(x, y, curvature, moment) == pytest.approx(thinned.error, rel=1e-9, abs=ROUNDING)


def test_more_points_never_lose() -> None:
    table = wire_table("A3")
    errors = [thin(table.curvature, table.moment, most=most).error for most in range(2, 40)]
    assert np.all(np.diff(errors) <= 0.0)


def test_a_law_of_few_corners_stays_as_it_is() -> None:
    curvature, moment = concave(6, 1)
    thinned = thin(curvature, moment, most=6)
    assert thinned.error == 0.0
    assert np.array_equal(thinned.curvature, curvature)
    assert np.array_equal(thinned.moment, moment)


def test_points_on_a_straight_line_are_not_needed() -> None:
    curvature = np.linspace(0.0, 1.0, 50)
    thinned = thin(curvature, 3e-3 * curvature, most=20)
    assert thinned.curvature.tolist() == [0.0, 1.0]
    assert thinned.error < 1e-14


def test_twenty_points_hold_a_wire_within_a_quarter_of_a_per_cent() -> None:
    for name in ("A1", "A2", "A3", "C5"):
        table = wire_table(name)
        assert thin(table.curvature, table.moment, most=21).error < 0.0025


def test_what_a_law_that_stiffens_loses_is_stated() -> None:
    curvature, moment = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0])
    thinned = thin(curvature, moment, most=3)
    assert thinned.curvature.tolist() == [0.0, 2.0]
    assert thinned.error == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("curvature", "moment", "most", "message"),
    [
        ([0.0, 1.0], [0.0, 1.0], 1, r"most=1: allowed are numbers of points >= 2"),
        ([0.0], [0.0], 2, r"1 curvatures and 1 moments: .* at least 2"),
        ([0.0, 1.0], [0.0], 2, r"2 curvatures and 1 moments"),
        ([0.0, np.nan], [0.0, 1.0], 2, r"point 2 of the law is not finite"),
        ([1.0, 2.0], [1.0, 2.0], 2, r"does not go from zero"),
        ([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], 2, r"does not go from zero"),
        ([0.0, 1.0, 2.5], [0.0, 1.0, 0.9], 2, r"softens before curvature=2\.5 1/m"),
    ],
)
def test_refused(curvature: list[float], moment: list[float], most: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        thin(np.array(curvature), np.array(moment), most=most)
