"""The growing slider against fibres of a round strand that harden in the same way.

The judge integrates stress over 2000 fibres; each has its own plastic strain and limit, or follows
Masing's rule. It shares no code with the package.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import (
    GrowingSlider,
    SliderLaw,
    compute_first_loading,
    make_growing_slider,
    make_unbent_history,
    slide,
    slide_vector,
)
from labpipe.records.arrays import Floats

MODULUS, STRENGTH, EXPONENT, DIAMETER = 110e9, 530e6, 0.44, 0.32e-3
STRESS: Floats = np.geomspace(1e5, 900e6, 9000)
STRAIN: Floats = STRESS / MODULUS + (STRESS / STRENGTH) ** (1.0 / EXPONENT)
FIBRES = 2000
HEIGHT: Floats = (np.arange(FIBRES) + 0.5) / FIBRES * DIAMETER / 2.0
WEIGHT: Floats = 2.0 * np.sqrt((DIAMETER / 2.0) ** 2 - HEIGHT**2) * DIAMETER / FIBRES


def first_loading(curvature: Floats, heights: slice = slice(None)) -> Floats:
    """Moment of the strand, or of a lamina of it, N m."""
    height, weight = HEIGHT[heights], WEIGHT[heights]
    stress = np.interp(np.outer(curvature, height), np.append(0.0, STRAIN), np.append(0.0, STRESS))
    return np.asarray(stress @ (weight * height))


def isotropic(path: Floats) -> Floats:
    """Moments along a path of curvatures of a strand that hardens isotropically."""
    plastic, slid, moments = np.zeros(FIBRES), np.zeros(FIBRES), []
    grid = np.append(0.0, np.maximum.accumulate(STRAIN - STRESS / MODULUS))
    limits = np.append(STRESS[0], STRESS)
    for curvature in path:
        trial = MODULUS * (HEIGHT * curvature - plastic)
        is_sliding = np.abs(trial) > np.interp(slid, grid, limits)
        total = np.abs(trial) + MODULUS * slid
        new_slid = np.where(is_sliding, np.interp(total, limits + MODULUS * grid, grid), slid)
        plastic, slid = plastic + (new_slid - slid) * np.sign(trial), new_slid
        moments.append(np.sum(WEIGHT * HEIGHT * MODULUS * (HEIGHT * curvature - plastic)))
    return np.array(moments)


def masing(path: Floats) -> Floats:
    """Moments up to the largest curvature of a path and down from it, by Masing's rule."""
    top = int(np.argmax(path))
    down = first_loading(path[top : top + 1]) - 2.0 * first_loading(0.5 * (path[top] - path[top:]))
    return np.append(first_loading(path[:top]), down)


def law_of(bends: float, share: float, laminae: int = 1) -> SliderLaw:
    """The strand as sliders: a share that grows in laminae, the rest by Masing's rule."""
    curvature = bends * np.geomspace(1e-4, 8.0, 320)
    moment, ends = first_loading(curvature), np.linspace(0, FIBRES, laminae + 1).astype(int)
    parts = np.stack([first_loading(curvature, slice(a, b)) for a, b in pairwise(ends)])
    parts *= moment / parts.sum(axis=0)
    growing = tuple(make_growing_slider(curvature, part, share) for part in parts)
    slopes = (1.0 - share) * np.diff(moment, prepend=0.0) / np.diff(curvature, prepend=0.0)
    falls = -np.diff(slopes)
    keeps = falls > 0.0
    return SliderLaw(
        float(slopes[-1]), falls[keeps], curvature[:-1][keeps], 0.0, bends, growing_sliders=growing
    )


def moments_of(law: SliderLaw, path: Floats) -> Floats:
    rests, moments = make_unbent_history(law, 1), []
    for curvature in path:
        step = slide(law, np.array([curvature]), rests)
        rests = step.history
        moments.append(float(step.moment[0]))
    return np.array(moments)


def path_of(*ends: float) -> Floats:
    """Curvatures from zero to each end in turn."""
    return np.concatenate([np.linspace(a, b, 200)[1:] for a, b in pairwise((0.0, *ends))])


@pytest.mark.parametrize("share", [0.0001, 0.35, 0.65, 1.0])
@pytest.mark.parametrize("bends", [5.0, 37.5])
def test_one_slider_unloads_as_fibres_do(bends: float, share: float) -> None:
    path = path_of(bends, 0.0)
    fibres = (1.0 - share) * masing(path) + share * isotropic(path)
    moments = moments_of(law_of(bends, share), path)
    loaded = fibres > 0.0
    assert np.abs(moments - fibres)[loaded].max() <= 0.007 * fibres.max()


@pytest.mark.parametrize(("laminae", "limit"), [(1, 0.13), (6, 0.015)])
def test_laminae_follow_loops(laminae: int, limit: float) -> None:
    path = path_of(12.0, 0.0, 12.0, -6.0, 12.0)
    fibres = isotropic(path)
    moments = moments_of(law_of(12.0, 1.0, laminae), path)
    assert np.abs(moments - fibres).max() <= limit * fibres.max()


def test_first_loading_is_that_of_the_curve_for_every_share() -> None:
    curvature = np.linspace(0.0, 20.0, 400)[1:]
    laws = [law_of(20.0, share) for share in (0.2, 0.7, 1.0)]
    first, *others = (compute_first_loading(law, curvature) for law in laws)
    for moment in others:
        assert np.abs(moment - first).max() <= 1e-12 * first.max()
    assert moments_of(laws[0], curvature) == pytest.approx(first, rel=1e-9)


def test_vectors_in_one_plane_are_scalars_and_turn_with_it() -> None:
    law, path, turn = law_of(12.0, 0.65, 2), path_of(12.0, -6.0, 3.0), 0.7
    plane = np.array([np.cos(turn), np.sin(turn)])
    rests, expected = make_unbent_history(law, 1, is_vector=True), moments_of(law, path)
    for curvature, moment in zip(path, expected, strict=True):
        step = slide_vector(law, curvature * plane[None], rests)
        assert step.moment[0] == pytest.approx(moment * plane, abs=1e-9 * expected.max())
        rests = step.history


def test_stiffness_is_the_derivative_of_the_step() -> None:
    law = law_of(12.0, 0.5, 2)
    rests = slide_vector(
        law, np.array([[8.0, 3.0]]), make_unbent_history(law, 1, is_vector=True)
    ).history
    for curvature in (np.array([9.0, 5.0]), np.array([2.0, -3.0])):
        step = slide_vector(law, curvature[None], rests)
        for axis in range(2):
            ahead = curvature + 1e-6 * np.eye(2)[axis]
            change = slide_vector(law, ahead[None], rests).moment - step.moment
            assert change[0] / 1e-6 == pytest.approx(step.stiffness[0][:, axis], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("share", [0.0, -0.1, 1.1, np.nan])
def test_a_share_outside_of_zero_to_one_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="share"):
        make_growing_slider(np.array([1.0, 2.0]), np.array([1.0, 1.5]), share)


def test_limits_that_fall_are_refused() -> None:
    with pytest.raises(ValueError, match="limits"):
        GrowingSlider(1.0, np.array([0.0, 1.0]), np.array([2.0, 1.0]))
