from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.bending.bent_frames import BendingErrors
from labpipe.bending.law_table import ROWS, STATIONS, bending_cloud
from labpipe.law.plays import LinearLaw
from tests.builders.bent_tests import bending_test, pulled

STIFFNESS = 5e-3
SHAPES = pulled(LinearLaw(STIFFNESS), travel=0.05, frames=101)
TEST = bending_test(SHAPES)


def test_rows_and_places() -> None:
    cloud = bending_cloud(TEST)
    assert cloud.frames_per_mean == 2
    assert cloud.curvature.shape == (ROWS, STATIONS)
    assert set(cloud.branch.tolist()) == {0}
    assert set(cloud.cycle.tolist()) == {1}


def test_an_elastic_wire_has_one_stiffness_everywhere() -> None:
    cloud = bending_cloud(TEST)
    inner = np.s_[:, 2:-4]  # a polynomial is poor at its ends, and at the tip there is no moment
    bent = np.abs(cloud.curvature[inner]) > 2.0
    ratio = (cloud.moment[inner] / cloud.curvature[inner])[bent]
    assert ratio == pytest.approx(STIFFNESS, rel=0.02)


def test_at_rest_the_counterweight_bends_it_down() -> None:
    at_rest = bending_cloud(TEST).moment_at_rest
    assert at_rest[0] == pytest.approx(-0.0265 * 0.085, rel=1e-3)
    assert at_rest[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_noise_of_curvatures_is_as_stated() -> None:
    exact = bending_cloud(TEST)
    clouds = [bending_cloud(bending_test(SHAPES, noise=2e-5, seed=seed)) for seed in range(12)]
    off = np.stack([(cloud.curvature - exact.curvature) for cloud in clouds])
    ratio = off[..., :-1] / np.stack([cloud.curvature_error for cloud in clouds])[..., :-1]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.1)


def test_errors_of_moments_add_up() -> None:
    errors = BendingErrors(force_noise=0.0, force_zero=0.0, force_scale=0.01, offset=0.0)
    scaled = bending_cloud(replace(TEST, errors=errors))
    assert scaled.moment_error == pytest.approx(np.abs(0.01 * scaled.moment), abs=1e-9)
    zero = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, force_zero=1e-3)))
    assert zero.moment_error[0, 0] == pytest.approx(0.085e-3, rel=0.01)
    place = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, offset=1e-4)))
    assert place.moment_error[-1] == pytest.approx(1e-4 * place.force[-1])
    centre = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, centre=1e-4)))
    lean = float(np.sin(SHAPES[-1].angle[-1]))  # an axis that lies lower moves the tip by so much
    assert lean > 0.5
    assert centre.moment_error[-1] == pytest.approx(1e-4 * lean * centre.force[-1], rel=0.02)


def test_a_shape_without_spare_markers_has_no_second_opinion() -> None:
    cloud = bending_cloud(bending_test(SHAPES[:20], terms=11))
    assert np.isnan(cloud.curvature_systematic).all()
    assert cloud.noise.shape == cloud.curvature.shape
