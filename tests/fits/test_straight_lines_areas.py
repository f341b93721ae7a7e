"""Areas of sections."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.straight_lines import annulus_area, rectangle_area, thin_wall_area


def test_areas() -> None:
    assert rectangle_area(0.01879, 0.28e-3) == pytest.approx(5.2612e-6)
    assert annulus_area(0.0141, 0.0107) == pytest.approx(np.pi * 0.0062 * 2 * 0.0017)
    assert thin_wall_area(0.0141, 0.00027) == pytest.approx(np.pi * 0.01383 * 0.00027)
