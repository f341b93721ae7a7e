from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.drawn import DrawnLaw, DrawnShapes


def test_shapes_and_laws_have_one_length_throughout() -> None:
    shapes = DrawnShapes(np.zeros(2), np.zeros((2, 5, 2)))
    assert not shapes.positions.flags.writeable
    with pytest.raises(ValueError, match=r"expected positions of shape"):
        DrawnShapes(np.zeros(3), np.zeros((2, 5, 2)))
    with pytest.raises(ValueError, match=r"expected moment_upper of shape"):
        DrawnLaw(np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(3))
