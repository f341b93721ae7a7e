from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.measured_bending import some_bending


def test_arrays_are_frozen() -> None:
    bending = some_bending()
    assert bending.law is not None
    for array in (bending.cloud.curvature, bending.cloud.branch, bending.law.is_known):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_every_mean_has_its_numbers() -> None:
    cloud, two = some_bending().cloud, np.zeros(2, dtype=np.int64)
    with pytest.raises(ValueError, match=r"expected branch of shape \(6,\), found \(2,\)"):
        replace(cloud, branch=two)
    with pytest.raises(ValueError, match=r"expected cycle of shape \(6,\), found \(2,\)"):
        replace(cloud, cycle=two)


def test_every_place_has_its_curvature() -> None:
    cloud = some_bending().cloud
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(6, 3\)"):
        replace(cloud, curvature=np.zeros((6, 2)))


def test_every_point_is_known_or_not() -> None:
    law = some_bending().law
    assert law is not None
    with pytest.raises(ValueError, match=r"expected is_known of shape \(5,\), found \(1,\)"):
        replace(law, is_known=np.array([True]))


def test_noise_of_a_cloud_holds_what_the_shape_may_be() -> None:
    cloud = some_bending().cloud
    both = replace(
        cloud,
        curvature_error=np.full((6, 3), 3.0),
        curvature_systematic=np.full((6, 3), 4.0 * np.sqrt(3.0)),
    )
    assert both.noise == pytest.approx(np.full((6, 3), 5.0))
    unknown = replace(both, curvature_systematic=np.full((6, 3), np.nan))
    assert unknown.noise == pytest.approx(np.full((6, 3), 3.0))
