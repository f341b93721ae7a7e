from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import CurveMatch, ExternalCurve


def test_arrays_are_read_only_and_of_one_length() -> None:
    curve = ExternalCurve("fe", "fe.csv", "A2", 0.085, np.arange(3.0), np.arange(3.0))
    for values in (curve.deflection, curve.force, CurveMatch(np.zeros(3), None).reference):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    with pytest.raises(ValueError, match="shape"):
        ExternalCurve("fe", "fe.csv", "A2", 0.085, np.arange(3.0), np.arange(4.0))
