"""Moment-curvature laws of plays, and what laws of all forms refuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.mechanics.law.plays import (
    PlayLaw,
    compute_first_curvature,
    make_elastic_law,
    make_polygon_law,
    make_stick_slip_law,
    require_within,
)
from labpipe.mechanics.law.sliders import SliderLaw, fit_directions, fit_sliders, make_linear_law
from labpipe.mechanics.law.thinning import make_concave_law, thin_law
from labpipe.records.arrays import Floats
from tests.approved import Approve
from tests.builders.bilinear_laws import bilinear_law


def stick_slip(hardening: float = 0.5, last_moment: float = 0.2, n_plays: int = 40) -> PlayLaw:
    return make_stick_slip_law(
        stick_stiffness=5e-3,
        stick_moment=0.002,
        slip_stiffness=5e-3,
        reference_moment=0.05,
        hardening=hardening,
        last_moment=last_moment,
        n_plays=n_plays,
    )


WIRE = stick_slip()


def drive(law: PlayLaw, moments: list[float]) -> Floats:
    """Curvatures of one station that is taken through the moments one after the other."""
    plays, curvatures = law.make_unbent_history(1), []
    for moment in moments:
        answer = law.respond(np.array([moment]), plays)
        plays = answer.history
        curvatures.append(float(answer.curvature[0]))
    return np.array(curvatures)


def test_bilinear_law_breaks_then_unloads_with_the_first_stiffness() -> None:
    law = bilinear_law(2.0, 0.5, 1.0)
    loaded = 0.5 + 1.0 / 0.5
    assert drive(make_elastic_law(4e-3), [0.02, -0.04, 0.0]) == pytest.approx([5.0, -10.0, 0.0])
    assert drive(law, [1.0, 2.0, 1.0, 0.0]) == pytest.approx(
        [0.5, loaded, loaded - 0.5, loaded - 1.0]
    )


@given(
    st.floats(0.01, 0.2), st.floats(-1.0, 1.0).filter(lambda x: abs(x) > 1e-3), st.integers(1, 4)
)
def test_masing_a_reversal_repeats_first_loading_at_twice_the_scale(
    peak: float, share: float, n: int
) -> None:
    turn = peak - 2.0 * peak * abs(share)
    reached, returned = drive(WIRE, [peak, turn])
    first = drive(WIRE, [peak * abs(share)])[0]
    assert reached - returned == pytest.approx(2.0 * first, rel=1e-9, abs=1e-12)
    loops = drive(WIRE, [peak, *([turn, peak] * n)])
    assert loops[-1] == pytest.approx(loops[0], rel=1e-9)


@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=6), st.floats(-0.2, 0.2))
def test_rate_independent_halfway_stops_change_nothing(way: list[float], goal: float) -> None:
    halfway = 0.5 * (way[-1] + goal)
    direct = drive(WIRE, [*way, goal])[-1]
    assert drive(WIRE, [*way, halfway, goal])[-1] == pytest.approx(direct, rel=1e-9, abs=1e-12)


@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=6))
def test_compliance_is_the_slope_of_the_step(way: list[float]) -> None:
    plays = WIRE.make_unbent_history(1)
    for moment in way[:-1]:
        plays = WIRE.respond(np.array([moment]), plays).history
    moments, tiny = np.array([way[-1]]), 1e-9
    response = WIRE.respond(moments, plays)
    sides = [
        float((WIRE.respond(moments + h, plays).curvature - response.curvature)[0] / h)
        for h in (tiny, -tiny)
    ]
    assert min(sides) * 0.999 <= float(response.compliance[0]) <= max(sides) * 1.001


def test_nan_stays_with_its_station() -> None:
    answer = WIRE.respond(np.array([0.1, np.nan]), WIRE.make_unbent_history(2))
    assert np.isfinite(answer.curvature[0])
    assert np.isnan(answer.curvature[1])


def test_plays_of_a_polygon_by_hand() -> None:
    """Slopes of 4, 2 and 1 N m^2: compliances grow from 1/4 by 1/4 and 1/2."""
    law = make_polygon_law(np.array([1.0, 2.0, 4.0]), np.array([4.0, 6.0, 8.0]))
    assert (law.stiffness, law.largest_moment) == (4.0, 8.0)
    assert law.half_widths.tolist() == [4.0, 6.0]
    assert law.compliances == pytest.approx([0.25, 0.5])


def test_a_stiffening_law_is_bridged_by_one_percent_at_most() -> None:
    """From (1, 4) to (3, 7) the bridge passes 5.5 N m at 2 1/m."""
    curvature = np.array([1.0, 2.0, 3.0])
    law = make_concave_law(curvature, np.array([4.0, 5.45, 7.0]))
    assert law.half_widths.tolist() == [4.0]
    assert law.compliances == pytest.approx([1.0 / 1.5 - 1.0 / 4.0])


def test_fitted_plays_meet_the_law_at_every_corner_and_are_near_it_between() -> None:
    corners = np.append(WIRE.half_widths, 0.2)
    for moments, close in ((corners, 1e-12), (np.linspace(0.0, 0.2, 1001), 2e-3)):
        curvature = WIRE.respond(moments, WIRE.make_unbent_history(len(moments))).curvature
        assert compute_first_curvature(WIRE, moments) == pytest.approx(curvature, rel=1e-12)
        law = moments / 5e-3 + 10.0 * (np.maximum(moments - 0.002, 0.0) / 0.05) ** 2
        assert curvature == pytest.approx(law, abs=close * law[-1])


CURVATURE: Floats = np.linspace(0.0, 10.0, 401)
LINE: Floats = np.arange(11.0)


def row(*numbers: float) -> Floats:
    return np.array(numbers)


def sliders(n_sliders: int) -> SliderLaw:
    return fit_sliders(CURVATURE, np.sqrt(1.0 + CURVATURE) - 1.0, n_sliders)


CASES: dict[str, list[Callable[[], object]]] = {
    "plays": [
        *(lambda value=value: make_elastic_law(value) for value in (0.0, np.nan, np.inf)),
        lambda: PlayLaw(1.0, row(1.0), row(-0.1)),
        lambda: PlayLaw(1.0, row(0, 1), row(1, 1)),
        lambda: PlayLaw(1.0, row(1, 1), row(1, 1)),
        *(lambda last=last: PlayLaw(2.0, row(1.0), row(0.5), last) for last in (0.0, np.nan)),
        lambda: require_within(PlayLaw(2.0, row(1.0), row(0.5), 3.0), row(1.0, -4.0), "bending"),
        lambda: stick_slip(hardening=0.0),
        lambda: stick_slip(hardening=1.0),
        lambda: stick_slip(last_moment=0.001),
        lambda: stick_slip(n_plays=0),
        lambda: make_polygon_law(row(1.0, 2.0, 3.0), row(1e-3, 1.5e-3, 1.4e-3)),
        lambda: make_polygon_law(row(1.0, 2.0, 3.0), row(1.0, 3.0, 3.5)),
        lambda: make_concave_law(row(1.0, 2.0, 3.0), row(4.0, 5.0, 7.0)),
        lambda: make_concave_law(row(1.0, 2.0, 3.0), row(1.0, 1.5, 1.495)),
    ],
    "sliders": [
        lambda: fit_sliders(LINE, np.where(LINE > 6.0, 5.0, LINE), 4),
        lambda: fit_sliders(LINE, LINE**2, 4),
        lambda: fit_sliders(row(0, 1, 2), row(0, 1), 4),
        lambda: SliderLaw(1.0, row(1), row(1), 5.0, 5.0),
        lambda: SliderLaw(1.0, row(1), row(1), 0.1, np.nan),
        lambda: sliders(0),
        lambda: sliders(65),
        lambda: SliderLaw(-1.0, row(1), row(1), 0.1, 10.0),
        lambda: SliderLaw(1.0, row(0), row(1), 0.1, 10.0),
        lambda: SliderLaw(1.0, row(1, 1), row(2, 1), 0.1, 10.0),
        lambda: fit_directions(make_linear_law(1.0, 10.0), 1),
        lambda: fit_directions(make_linear_law(1.0, 10.0), 2, max_sliders=0),
    ],
    "points": [
        lambda: thin_law(row(0, 1), row(0, 1), max_points=1),
        lambda: thin_law(row(0), row(0), max_points=2),
        lambda: thin_law(row(0, 1), row(0), max_points=2),
        lambda: thin_law(row(0, np.nan), row(0, 1), max_points=2),
        lambda: thin_law(row(1, 2), row(1, 2), max_points=2),
        lambda: thin_law(row(0, 2, 1), row(0, 1, 2), max_points=2),
        lambda: thin_law(row(0, 1, 2.5), row(0, 1, 0.9), max_points=2),
    ],
}


@pytest.mark.parametrize("subject", CASES)
def test_refusals(subject: str, approved: Approve) -> None:
    messages = []
    for call in CASES[subject]:
        with pytest.raises(ValueError) as refusal:  # noqa: PT011
            call()
        messages.append(str(refusal.value))
    approved(messages)
