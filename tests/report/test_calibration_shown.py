from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.report.calibration_shown import BentShape, CalibrationReport
from tests.report.builders_calibrations import group, report, usual


def test_predictions_of_the_tests_that_the_calibration_rests_on() -> None:
    found = report().predictions
    assert list(found) == [0.085, 0.12]
    assert found[0.12] is report().groups[1].prediction
    without = replace(group(), prediction=None)
    assert CalibrationReport(usual(), (without, group("A1"))).predictions == {}


def test_shapes_are_points_in_a_plane() -> None:
    empty = np.zeros((0, 2))
    with pytest.raises(ValueError, match=r"expected an array of shape \(None, 2\), found \(4, 3\)"):
        BentShape(0.01, np.zeros((4, 3)), empty, empty)
    assert not BentShape(0.01, empty, empty, empty).model.flags.writeable
