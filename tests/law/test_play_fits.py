"""Plays fitted to a smooth law: near it everywhere, on it at the corners, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.play_fits import concave_law, fit_plays, polygon_law, stick_slip_law
from labpipe.law.plays import respond, virgin_plays

WIRE = stick_slip_law(
    stick_stiffness=5e-3,
    stick_moment=0.002,
    slip_stiffness=5e-3,
    reference_moment=0.05,
    hardening=0.5,
    last_moment=0.2,
)


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
