from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.bending.bent_frames import (
    TipPull,
    curvature_gain,
    curves_at,
    held_at_rest,
    marker_layout,
    mean_frames,
    moments,
)
from labpipe.law.plays import LinearLaw
from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag
from tests.builders.bent_tests import (
    HEAVY,
    HEIGHT,
    LENGTH,
    RESTING,
    STRING,
    WEIGHT,
    bending_test,
    lifted,
    pulled,
)

TEST = bending_test(pulled(LinearLaw(5e-3), travel=0.02, frames=12), noise=1e-5)


def test_at_rest_it_is_known_from_all_frames_that_show_all_markers() -> None:
    standing = TEST.standing
    assert standing.frames == RESTING
    assert standing.markers == pytest.approx(TEST.shape.positions[:RESTING, 1:-1].mean(axis=0))
    assert standing.noise == pytest.approx(1e-5, rel=0.35)
    assert standing.finer.shape == (1, 3, 8)


def test_a_rest_without_whole_frames_is_told() -> None:
    flags = TEST.shape.flags.copy()
    flags[:RESTING, 2] = PointFlag.FILLED
    blind = replace(TEST, shape=replace(TEST.shape, flags=flags))
    with pytest.raises(ValueError, match="frames at rest that show all markers, found 0"):
        _ = blind.standing


def test_frames_without_force_are_left_out() -> None:
    force = TEST.force.copy()
    force[RESTING : RESTING + 4] = np.nan
    frames = replace(TEST, force=force).frames(TEST.branch, per_mean=2)
    assert len(frames.means.force) == 4
    with pytest.raises(ValueError, match="expected means with a shape and a force, found none"):
        replace(TEST, force=np.full_like(force, np.nan)).frames(TEST.branch, per_mean=2)


def test_as_many_coefficients_as_markers_leave_none_to_try() -> None:
    shapes = pulled(LinearLaw(5e-3), travel=0.01, frames=4)
    full = bending_test(shapes, terms=11)
    assert full.frames(full.branch, per_mean=1).finer is None
    assert np.isnan(full.standing.noise)


def test_no_moment_at_the_tip() -> None:
    frames = TEST.frames(TEST.branch, per_mean=1)
    places = np.array([0.0, TEST.layout.length])
    found = TEST.moments(frames.coefficients, frames.means.force, places)
    assert found[:, 1] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(found[:, 0]) > -1e-5).all()


PLACES: Floats = np.linspace(0.0, LENGTH, 18)


SHAPES = pulled(LinearLaw(5e-3), travel=0.05, frames=24)


TEST_MOMENTS = bending_test(SHAPES)


def test_a_vertical_string_pulls_across_and_carries_the_weight() -> None:
    pull = TipPull(string=0.5, weight=0.03, tension_at_rest=0.03, anchor=0.08)
    force = pull.force(np.array([0.0, 2.0]), np.array([0.08, 0.08]))
    assert force == pytest.approx(np.array([[0.0, 0.0], [0.0, 2.0]]))


def test_a_string_leans_towards_its_anchor() -> None:
    pull = TipPull(string=0.5, weight=0.0, tension_at_rest=0.0, anchor=0.08)
    force = pull.force(np.array([2.0]), np.array([0.05]))
    assert force[0] == pytest.approx([2.0 * 0.06, 2.0 * np.sqrt(1.0 - 0.06**2)])


def test_a_string_that_does_not_reach() -> None:
    pull = TipPull(string=0.5, weight=0.0, tension_at_rest=0.0, anchor=0.08)
    force = pull.force(np.array([2.0, 2.0]), np.array([0.08, -0.45]))
    assert np.isnan(force[:, 1]).tolist() == [False, True]


def test_without_a_string_the_force_is_normal_to_the_axis() -> None:
    force = TipPull(None, 0.0, 0.0, 0.08).force(np.array([2.0]), np.array([0.02]))
    assert force == pytest.approx(np.array([[0.0, 2.0]]))


def test_the_force_at_the_tip_is_that_of_the_mechanics() -> None:
    last = SHAPES[-1]
    pull = TipPull(STRING, WEIGHT, 0.0, LENGTH)
    force = pull.force(np.array([last.tension]), last.x[-1:])
    assert force[0] == pytest.approx(last.force, abs=1e-6)


def test_moments_of_a_wire_with_weight_are_those_of_the_mechanics() -> None:
    shapes = lifted(LinearLaw(5e-3), travel=0.05, frames=24)
    held = held_at_rest(HEAVY, LENGTH)
    assert shapes[0].tension == pytest.approx(WEIGHT + held, rel=1e-5)
    pull = TipPull(STRING, WEIGHT, WEIGHT + held, LENGTH, HEAVY)
    test, last = bending_test(shapes, pull=pull), shapes[-1]
    frame = len(test.shape.time) - 1
    coefficients = test.shape.coefficients[frame][None]
    found = test.moments(coefficients, test.force[-1:], last.arc_length)[0]
    assert found == pytest.approx(last.moment, abs=2e-4 * last.moment[0])
    rest = test.moments(test.standing.coefficients, np.zeros(1), np.zeros(1))[0, 0]
    assert rest == pytest.approx(-HEAVY * LENGTH**2 / 8.0, rel=1e-3)


def test_moments_are_those_of_the_mechanics() -> None:
    frame = len(TEST_MOMENTS.shape.time) - 1
    coefficients = TEST_MOMENTS.shape.coefficients[frame][None]
    at = curves_at(coefficients, LENGTH, SHAPES[-1].arc_length)
    tip = curves_at(coefficients, LENGTH, np.array([LENGTH]))
    found = moments(at, tip, SHAPES[-1].force[None])[0]
    assert found == pytest.approx(SHAPES[-1].moment, abs=2e-5)


def test_curvatures_of_an_exact_shape() -> None:
    """Seven coefficients follow an elastic wire to 2 % of its largest curvature."""
    at = curves_at(TEST_MOMENTS.shape.coefficients[-1][None], LENGTH, PLACES)
    true = np.interp(PLACES, SHAPES[-1].arc_length, SHAPES[-1].curvature)
    assert at.curvature[0] == pytest.approx(true, abs=0.02 * true.max())
    assert at.angle[0] == pytest.approx(
        np.interp(PLACES, SHAPES[-1].arc_length, SHAPES[-1].angle), abs=2e-3
    )


def test_missing_frames_stay_missing() -> None:
    at = curves_at(np.full((1, 3, 7), np.nan), LENGTH, PLACES)
    assert np.isnan(at.curvature).all()


def test_noise_of_curvature_is_as_stated() -> None:
    layout = marker_layout(TEST_MOMENTS.shape, centre_offset=HEIGHT, free_tip=True)
    markers = TEST_MOMENTS.shape.positions[-1, 1:-1]
    noise, rng = 3e-6, np.random.default_rng(5)
    shaken = markers + noise * rng.standard_normal((4000, *markers.shape))
    shaken[2000:, 3] = np.nan
    at = curves_at(layout.fit(shaken).coefficients, LENGTH, PLACES)
    still = curves_at(layout.fit(markers[None]).coefficients, LENGTH, PLACES)
    for part, pattern in ((slice(0, 2000), shaken[:1]), (slice(2000, 4000), shaken[-1:])):
        gain = curvature_gain(layout, pattern, still, PLACES)[0]
        spread = at.curvature[part].std(axis=0)
        assert spread[:-1] == pytest.approx(noise * gain[:-1], rel=0.06)
        assert gain[-1] == pytest.approx(0.0, abs=1e-3 * gain.max())  # no moment at the free tip


def test_too_few_markers_have_no_noise() -> None:
    layout = marker_layout(TEST_MOMENTS.shape, centre_offset=HEIGHT, free_tip=True)
    markers = TEST_MOMENTS.shape.positions[-1:, 1:-1].copy()
    markers[0, 2:] = np.nan
    still = curves_at(TEST_MOMENTS.shape.coefficients[-1][None], LENGTH, PLACES)
    assert np.isnan(curvature_gain(layout, markers, still, PLACES)).all()


def test_a_layout_needs_a_curve() -> None:
    lost = replace(
        TEST_MOMENTS.shape, coefficients=np.full_like(TEST_MOMENTS.shape.coefficients, np.nan)
    )
    with pytest.raises(ValueError, match="expected a frame with a fitted curve, found none"):
        marker_layout(lost, centre_offset=HEIGHT, free_tip=True)


def test_means_stay_within_a_branch_and_leave_out_what_was_not_measured() -> None:
    shape, frames = TEST_MOMENTS.shape, len(TEST_MOMENTS.shape.time)
    flags = shape.flags.copy()
    flags[RESTING + 1, 3] = PointFlag.FILLED
    branch = np.where(np.arange(frames) < RESTING, -1, 0)
    branch[RESTING + 9 :] = 1
    means = mean_frames(replace(shape, flags=flags), TEST_MOMENTS.force, branch, per_mean=4)
    assert means.branch.tolist() == [0, 0, 1, 1, 1]
    first = slice(RESTING, RESTING + 4)
    assert means.time[0] == pytest.approx(shape.time[first].mean())
    assert means.force[0] == pytest.approx(TEST_MOMENTS.force[first].mean())
    assert np.isnan(means.markers[0, 2]).all()
    assert means.markers[0, 0] == pytest.approx(shape.positions[first, 1].mean(axis=0))
    assert np.isfinite(means.markers[1:]).all()
    assert len(mean_frames(shape, TEST_MOMENTS.force, np.full(frames, -1), per_mean=4).time) == 0
    assert means.part(means.branch == 1).time.tolist() == means.time[2:].tolist()
