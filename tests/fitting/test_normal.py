"""The normal distribution against scipy's."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from labpipe.fitting.normal import log_share_below


def test_log_share_below() -> None:
    x = np.concatenate([np.linspace(-200.0, 40.0, 2401), [-30.0 - 1e-9, -1e6]])
    np.testing.assert_allclose(log_share_below(x), log_ndtr(x), rtol=1e-12, atol=1e-15)


def test_any_shape_and_nan() -> None:
    share = log_share_below(np.array([[np.nan, 0.0]]))
    np.testing.assert_allclose(share, [[np.nan, -np.log(2.0)]], rtol=1e-15)
