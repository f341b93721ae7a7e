from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import (
    PARAMETERS,
    UNITS,
    Profile,
    Separability,
)

TWO = np.zeros(2)


def test_every_parameter_has_a_unit() -> None:
    assert tuple(UNITS) == PARAMETERS


def test_arrays_are_frozen_and_of_one_length() -> None:
    profile = Profile(np.array([1.0, 2.0]), TWO, 3.84, 20.0)
    with pytest.raises(ValueError, match="read-only"):
        profile.value[0] = 3.0
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(3,\), found \(2,\)"):
        Profile(np.zeros(3), TWO, 3.84, 20.0)
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(2, 2\), found \(2,\)"):
        Separability(("a", "b"), TWO, TWO, {}, "")
