from __future__ import annotations

import numpy as np

from labpipe.statistics.mean_curves import block_means


def test_block_means() -> None:
    assert block_means(np.arange(6.0), 3).tolist() == [0.5, 2.5, 4.5]
    assert block_means(np.arange(7.0), 3).tolist() == [0.5, 2.5, 5.0]
    assert block_means(np.arange(4.0), 9).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert block_means(np.zeros(0), 9).tolist() == []
    assert np.isnan(block_means(np.array([1.0, np.nan, 2.0, 4.0]), 2)).tolist() == [True, False]
