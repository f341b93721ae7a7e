from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.plays import LinearLaw
from labpipe.records.curve import PointFlag
from tests.builders.bent_tests import RESTING, bending_test, pulled

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
