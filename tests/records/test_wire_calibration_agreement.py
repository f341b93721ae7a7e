from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import CurveAgreement, Prediction

TWO = np.zeros(2)


def test_arrays_are_frozen_and_of_one_length() -> None:
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(2,\), found \(3,\)"):
        Prediction(TWO, TWO, TWO, TWO, TWO, np.zeros(3))
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(2,\), found \(3,\)"):
        CurveAgreement("t", "s", 1.0, TWO, TWO, np.zeros(3), 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    predicted = Prediction(np.array([1.0, 2.0]), TWO, TWO, TWO, TWO, TWO)
    with pytest.raises(ValueError, match="read-only"):
        predicted.deflection[0] = 3.0
