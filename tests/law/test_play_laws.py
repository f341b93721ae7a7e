from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.law.play_fits import concave_law, fit_plays, polygon_law, stick_slip_law
from labpipe.law.plays import (
    LinearLaw,
    MomentLaw,
    PlayLaw,
    first_curvature,
    require_within,
    respond,
    virgin_plays,
)
from labpipe.records.arrays import Floats
from tests.builders.bilinear_laws import bilinear_law, complementary_energy

WIRE = stick_slip_law(
    stick_stiffness=5e-3,
    stick_moment=0.002,
    slip_stiffness=5e-3,
    reference_moment=0.05,
    hardening=0.5,
    last_moment=0.2,
)


def drive(law: MomentLaw, moments: list[float]) -> Floats:
    """Curvatures of one station that is taken through the moments one after the other."""
    plays, curvatures = virgin_plays(law, 1), []
    for moment in moments:
        answer = respond(law, np.array([moment]), plays)
        plays = answer.plays
        curvatures.append(float(answer.curvature[0]))
    return np.array(curvatures)


def test_linear_law_is_moment_over_stiffness_and_forgets() -> None:
    assert drive(LinearLaw(4e-3), [0.02, -0.04, 0.0]) == pytest.approx([5.0, -10.0, 0.0])


def test_bilinear_law_breaks_then_unloads_with_the_first_stiffness() -> None:
    law = bilinear_law(2.0, 0.5, 1.0)
    loaded = 0.5 + 1.0 / 0.5
    assert drive(law, [1.0, 2.0, 1.0, 0.0]) == pytest.approx(
        [0.5, loaded, loaded - 0.5, loaded - 1.0]
    )


def test_bilinear_law_yields_backwards_after_twice_the_break_moment() -> None:
    law = bilinear_law(2.0, 0.5, 1.0)
    peak, elastic, beyond = drive(law, [3.0, 1.0, 0.0])
    assert peak - elastic == pytest.approx(2.0 / 2.0)
    assert elastic - beyond == pytest.approx(1.0 / 0.5)


@given(
    st.floats(0.01, 0.2), st.floats(-1.0, 1.0).filter(lambda x: abs(x) > 1e-3), st.integers(1, 4)
)
def test_masing_a_reversal_repeats_first_loading_at_twice_the_scale(
    peak: float, share: float, n: int
) -> None:
    back = peak - 2.0 * peak * abs(share)
    reached, returned = drive(WIRE, [peak, back])
    first = drive(WIRE, [peak * abs(share)])[0]
    assert reached - returned == pytest.approx(2.0 * first, rel=1e-9, abs=1e-12)
    loops = drive(WIRE, [peak, *([back, peak] * n)])
    assert loops[-1] == pytest.approx(loops[0], rel=1e-9)


@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=6), st.floats(-0.2, 0.2))
def test_rate_independent_halfway_stops_change_nothing(way: list[float], goal: float) -> None:
    halfway = 0.5 * (way[-1] + goal)
    straight = drive(WIRE, [*way, goal])[-1]
    assert drive(WIRE, [*way, halfway, goal])[-1] == pytest.approx(straight, rel=1e-9, abs=1e-12)


@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=6))
def test_compliance_is_the_slope_of_the_step(way: list[float]) -> None:
    plays = virgin_plays(WIRE, 1)
    for moment in way[:-1]:
        plays = respond(WIRE, np.array([moment]), plays).plays
    at, tiny = np.array([way[-1]]), 1e-9
    here = respond(WIRE, at, plays)
    sides = [
        float((respond(WIRE, at + h, plays).curvature - here.curvature)[0] / h)
        for h in (tiny, -tiny)
    ]
    assert min(sides) * 0.999 <= float(here.compliance[0]) <= max(sides) * 1.001


def test_unloading_starts_with_the_first_stiffness_and_leaves_curvature() -> None:
    peak, little, empty = drive(WIRE, [0.1, 0.0970, 0.0])
    assert (0.1 - 0.0970) / (peak - little) == pytest.approx(5e-3, rel=1e-9)
    assert empty > 0.1 * peak


def test_closed_loop_dissipates() -> None:
    down, up = np.linspace(0.1, -0.1, 401), np.linspace(-0.1, 0.1, 401)
    moments = np.concatenate([np.linspace(0, 0.1, 201), down, up])
    curvature = drive(WIRE, list(moments))
    loop = slice(200, None)
    assert np.trapezoid(moments[loop], curvature[loop]) > 0.05 * 0.1 * curvature[200]


def test_complementary_energy_is_the_integral_of_curvature() -> None:
    moments = np.linspace(0.0, 0.15, 20_001)
    curvature = respond(WIRE, moments, virgin_plays(WIRE, len(moments))).curvature
    area = np.trapezoid(curvature, moments)
    assert float(complementary_energy(WIRE, np.array(0.15))) == pytest.approx(area, rel=1e-6)


def test_nan_stays_with_its_station() -> None:
    answer = respond(WIRE, np.array([0.1, np.nan]), virgin_plays(WIRE, 2))
    assert np.isfinite(answer.curvature[0])
    assert np.isnan(answer.curvature[1])


@pytest.mark.parametrize("stiffness", [0.0, -1.0, np.nan, np.inf])
def test_stiffness_out_of_range(stiffness: float) -> None:
    with pytest.raises(ValueError, match=r"stiffness=.*: allowed are finite numbers > 0"):
        LinearLaw(stiffness)


def test_a_law_may_end() -> None:
    law = PlayLaw(2.0, np.array([1.0]), np.array([0.5]), 3.0)
    require_within(law, np.array([-3.0, 3.0]), "bending")
    require_within(LinearLaw(2.0), np.array([1e9]), "bending")
    require_within(bilinear_law(2.0, 1.0, 1.0), np.array([1e9]), "bending")
    said = r"^bending: the wire would be bent to 3.5 1/m, and its law ends at 2.5 1/m$"
    with pytest.raises(ValueError, match=said):
        require_within(law, np.array([1.0, -4.0]), "bending")
    for last in (0.0, np.nan):
        with pytest.raises(ValueError, match=rf"^largest_moment={last}: allowed are numbers > 0$"):
            PlayLaw(2.0, np.array([1.0]), np.array([0.5]), last)


def test_first_curvature_is_that_of_the_plays() -> None:
    moment = np.linspace(0.0, 0.2, 50)
    plays = respond(WIRE, moment, virgin_plays(WIRE, 50)).curvature
    assert first_curvature(WIRE, moment) == pytest.approx(plays, rel=1e-12)


def test_play_law_refuses_negative_compliance() -> None:
    with pytest.raises(ValueError, match=r"compliances=.*allowed are finite numbers >= 0"):
        PlayLaw(1.0, np.array([1.0]), np.array([-0.1]))


@pytest.mark.parametrize("widths", [[0.0, 1.0], [2.0, 1.0], [1.0, 1.0]])
def test_play_law_refuses_disordered_half_widths(widths: list[float]) -> None:
    with pytest.raises(ValueError, match=r"half_widths=.*positive, increasing"):
        PlayLaw(1.0, np.array(widths), np.array([1.0, 1.0]))


def test_fitted_plays_meet_the_law_at_every_corner() -> None:
    corners = np.append(WIRE.half_widths, 0.2)
    curvature = respond(WIRE, corners, virgin_plays(WIRE, len(corners))).curvature
    wanted = corners / 5e-3 + 10.0 * ((corners - 0.002) / 0.05) ** 2
    np.testing.assert_allclose(curvature, wanted, rtol=1e-12)


def test_fitted_plays_are_near_the_law_between_corners() -> None:
    moments = np.linspace(0.0, 0.2, 1001)
    curvature = respond(WIRE, moments, virgin_plays(WIRE, 1001)).curvature
    wanted = moments / 5e-3 + 10.0 * (np.maximum(moments - 0.002, 0.0) / 0.05) ** 2
    assert np.max(np.abs(curvature - wanted)) < 2e-3 * wanted[-1]


def test_fit_refuses_a_law_that_softens() -> None:
    with pytest.raises(ValueError, match="curvature softens"):
        fit_plays(
            lambda moment: moment * (2.0 - moment),
            stiffness=0.5,
            first_moment=0.1,
            last_moment=3.0,
            n_plays=10,
        )


@pytest.mark.parametrize(("last", "number"), [(0.1, 10), (0.05, 10), (3.0, 0)])
def test_fit_refuses_plays_that_make_no_row(last: float, number: int) -> None:
    said = rf"last_moment={last}, n_plays={number}: allowed are numbers > first_moment=0.1 and >= 1"
    with pytest.raises(ValueError, match=said):
        fit_plays(
            lambda moment: moment / 0.5,
            stiffness=0.5,
            first_moment=0.1,
            last_moment=last,
            n_plays=number,
        )


def test_fit_refuses_a_curvature_that_stands() -> None:
    with pytest.raises(ValueError, match="curvature softens"):
        fit_plays(
            lambda moment: np.full_like(moment, 0.2),
            stiffness=0.5,
            first_moment=0.1,
            last_moment=3.0,
            n_plays=10,
        )


def test_fit_refuses_a_law_that_stiffens() -> None:
    with pytest.raises(ValueError, match=r"curvature stiffens at moment="):
        fit_plays(np.sqrt, stiffness=1.0, first_moment=0.1, last_moment=2.0, n_plays=10)


def test_fit_refuses_an_empty_range() -> None:
    with pytest.raises(ValueError, match=r"last_moment=0.1, n_plays=3: allowed are"):
        fit_plays(np.square, stiffness=1.0, first_moment=0.1, last_moment=0.1, n_plays=3)


@pytest.mark.parametrize("hardening", [0.0, 1.0])
def test_hardening_out_of_range(hardening: float) -> None:
    with pytest.raises(ValueError, match=r"hardening=.*between 0 and 1"):
        stick_slip_law(
            stick_stiffness=1.0,
            stick_moment=0.1,
            slip_stiffness=1.0,
            reference_moment=1.0,
            hardening=hardening,
            last_moment=2.0,
        )


def test_plays_of_a_polygon_by_hand() -> None:
    """Slopes of 4, 2 and 1 N m^2: compliances grow from 1/4 by 1/4 and 1/2."""
    law = polygon_law(np.array([1.0, 2.0, 4.0]), np.array([4.0, 6.0, 8.0]))
    assert (law.stiffness, law.largest_moment) == (4.0, 8.0)
    assert law.half_widths.tolist() == [4.0, 6.0]
    assert law.compliances == pytest.approx([0.25, 0.5])


def test_the_curvature_at_which_a_soft_law_softens_is_said() -> None:
    with pytest.raises(ValueError, match=r"softens before curvature=3 1/m"):
        polygon_law(np.array([1.0, 2.0, 3.0]), np.array([1e-3, 1.5e-3, 1.4e-3]))


def test_a_stiffening_law_is_bridged_by_one_percent_at_most() -> None:
    """From (1, 4) to (3, 7) the bridge passes 5.5 N m at 2 1/m."""
    curvature = np.array([1.0, 2.0, 3.0])
    law = concave_law(curvature, np.array([4.0, 5.45, 7.0]))
    assert law.half_widths.tolist() == [4.0]
    assert law.compliances == pytest.approx([1.0 / 1.5 - 1.0 / 4.0])
    with pytest.raises(ValueError, match=r"curvature=2 1/m: .* is 10 % above it, allowed is 1 %"):
        concave_law(curvature, np.array([4.0, 5.0, 7.0]))
