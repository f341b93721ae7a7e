from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.law.plays import make_elastic_law
from labpipe.records.curve import PointFlag
from labpipe.results.bending import compute_prop_force
from labpipe.results.measured_law import TipPull, average_frames, evaluate_curves
from tests.builders.bent_tests import (
    HEAVY,
    LENGTH,
    RESTING,
    STRING,
    WEIGHT,
    bending_test,
    lifted,
    pulled,
)

TEST = bending_test(pulled(make_elastic_law(5e-3), travel=0.02, frames=12), noise=1e-5)


def test_at_rest_it_is_known_from_all_frames_that_show_all_markers() -> None:
    standing = TEST.specimen_at_rest
    assert standing.n_frames == RESTING
    assert standing.markers == pytest.approx(TEST.shape.positions[:RESTING, 1:-1].mean(axis=0))
    assert standing.marker_noise == pytest.approx(1e-5, rel=0.35)
    assert standing.finer_series.shape == (1, 3, 8)
    full = bending_test(pulled(make_elastic_law(5e-3), travel=0.01, frames=4), terms=11)
    assert np.isnan(full.specimen_at_rest.marker_noise), (
        "as many coefficients as markers leave none to try"
    )


def test_frames_without_force_or_without_all_markers_are_left_out() -> None:
    force, flags = TEST.force.copy(), TEST.shape.flags.copy()
    force[RESTING : RESTING + 4] = np.nan
    frames = replace(TEST, force=force).fit_means(TEST.branch, frames_per_mean=2)
    assert len(frames.force) == 4
    with pytest.raises(ValueError, match="expected means with a shape and a force, found none"):
        replace(TEST, force=np.full_like(force, np.nan)).fit_means(TEST.branch, frames_per_mean=2)
    flags[:RESTING, 2] = PointFlag.FILLED
    with pytest.raises(ValueError, match="frames at rest that show all markers, found 0"):
        _ = replace(TEST, shape=replace(TEST.shape, flags=flags)).specimen_at_rest


SHAPES = pulled(make_elastic_law(5e-3), travel=0.05, frames=24)


TEST_MOMENTS = bending_test(SHAPES)


@pytest.mark.parametrize(
    ("pull", "tension", "tip", "force"),
    [
        (TipPull(0.5, 0.03, 0.03, 0.08), 0.0, 0.08, (0.0, 0.0)),  # it carries the weight
        (TipPull(0.5, 0.03, 0.03, 0.08), 2.0, 0.08, (0.0, 2.0)),
        (TipPull(0.5, 0.0, 0.0, 0.08), 2.0, 0.05, (0.12, 2.0 * np.sqrt(1.0 - 0.06**2))),
        (TipPull(0.5, 0.0, 0.0, 0.08), 2.0, -0.45, (np.nan, np.nan)),  # it does not reach
        (TipPull(None, 0.0, 0.0, 0.08), 2.0, 0.02, (0.0, 2.0)),
    ],
)
def test_the_pull_of_a_string_by_hand(
    pull: TipPull, tension: float, tip: float, force: tuple[float, float]
) -> None:
    pulling = pull.compute_force(np.array([tension]), np.array([tip]))[0]
    assert pulling[1] == pytest.approx(force[1], nan_ok=True)
    assert np.isnan(force[0]) or pulling[0] == pytest.approx(force[0])


def test_moments_of_a_wire_with_weight_are_those_of_the_mechanics() -> None:
    shapes = lifted(make_elastic_law(5e-3), travel=0.05, frames=24)
    held = compute_prop_force(HEAVY, LENGTH)
    assert shapes[0].tension == pytest.approx(WEIGHT + held, rel=1e-5)
    pull = TipPull(STRING, WEIGHT, WEIGHT + held, LENGTH, HEAVY)
    test, last = bending_test(shapes, pull=pull), shapes[-1]
    frame = len(test.shape.time) - 1
    coefficients = test.shape.coefficients[frame][None]
    moments = test.compute_moments(coefficients, test.force[-1:], last.arc_length)[0]
    assert moments == pytest.approx(last.moment, abs=2e-4 * last.moment[0])
    rest = test.compute_moments(test.specimen_at_rest.coefficients, np.zeros(1), np.zeros(1))[0, 0]
    assert rest == pytest.approx(-HEAVY * LENGTH**2 / 8.0, rel=1e-3)


def test_curvatures_of_an_exact_shape() -> None:
    """Seven coefficients follow an elastic wire to 2 % of its largest curvature."""
    last = SHAPES[-1]
    missing = np.full_like(TEST_MOMENTS.shape.coefficients[-1], np.nan)
    coefficients = np.stack([TEST_MOMENTS.shape.coefficients[-1], missing])
    at = evaluate_curves(coefficients, LENGTH, last.arc_length)
    assert at.curvature[0] == pytest.approx(last.curvature, abs=0.02 * last.curvature.max())
    assert at.angle[0] == pytest.approx(last.angle, abs=2e-3)
    assert np.isnan(at.curvature[1]).all()


def test_noise_of_curvature_is_as_stated() -> None:
    """Of all markers, and without the fourth; without all but two it is not known."""
    test = TEST_MOMENTS
    markers, places = TEST_MOMENTS.shape.positions[-1, 1:-1], np.linspace(0.0, LENGTH, 18)
    still = evaluate_curves(test.fit_curves(markers[None]).coefficients, LENGTH, places)
    noise, rng = 3e-6, np.random.default_rng(5)
    shaken = markers + noise * rng.standard_normal((2000, *markers.shape))
    for lost in ([], [3]):
        shaken[:, lost] = np.nan
        gain = test.compute_curvature_gain(shaken[:1], still, places)[0]
        spread = evaluate_curves(
            test.fit_curves(shaken).coefficients, LENGTH, places
        ).curvature.std(axis=0)
        assert spread[:-1] == pytest.approx(noise * gain[:-1], rel=0.06)
        assert gain[-1] == pytest.approx(0.0, abs=1e-3 * gain.max())  # no moment at the free tip
    shaken[:, 2:] = np.nan
    assert np.isnan(test.compute_curvature_gain(shaken[:1], still, places)).all()


def test_means_stay_within_a_branch_and_leave_out_what_was_hardly_measured() -> None:
    shape, frames = TEST_MOMENTS.shape, len(TEST_MOMENTS.shape.time)
    flags = shape.flags.copy()
    flags[RESTING + 1 : RESTING + 3, 3] = flags[RESTING + 1, 4] = PointFlag.FILLED
    branch = np.where(np.arange(frames) < RESTING, -1, 0)
    branch[RESTING + 9 :] = 1
    rows, markers = average_frames(replace(shape, flags=flags), branch, frames_per_mean=4)
    assert branch[rows[:, 0]].tolist() == [0, 0, 1, 1, 1]
    assert rows[0].tolist() == list(range(RESTING, RESTING + 4))
    assert np.isnan(markers[0, 2]).all()
    for number in (0, 3):
        assert markers[0, number] == pytest.approx(
            shape.positions[rows[0], number + 1].mean(axis=0)
        )
    assert np.isfinite(markers[1:]).all()
    assert len(average_frames(shape, np.full(frames, -1), frames_per_mean=4)[0]) == 0
    means = TEST_MOMENTS.fit_means(branch, frames_per_mean=4)
    assert means.branch.tolist() == [0, 0, 1, 1, 1]
    assert means.time[0] == pytest.approx(shape.time[rows[0]].mean())
    assert means.force[0] == pytest.approx(TEST_MOMENTS.force[rows[0]].mean())
