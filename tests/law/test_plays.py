"""Moment-curvature laws: first loading, Masing loops, refusal of what cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.law.play_fits import stick_slip_law
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
