"""The Jacobian of the cantilever is exact."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.plays import LinearLaw, virgin_plays
from labpipe.wire.newton import (
    Condition,
    DeadLoad,
    EndLoad,
    Pull,
    Unknowns,
    _linearise,
    _Problem,
    chebyshev_stations,
    solve,
)

CONDITIONS = [
    DeadLoad(np.array([0.3, 1.7])),
    EndLoad(0.4),
    Pull(np.array([1.0, 8.0]), 7.6, 0.2),
]


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: type(c).__name__)
def test_jacobian_against_central_differences(condition: Condition) -> None:
    n, law, h = 12, LinearLaw(1.0), 1e-6
    stations = chebyshev_stations(n)
    beyond = 0.8 * (1.0 - stations.position)
    problem = _Problem(law, virgin_plays(law, n), condition, stations, beyond)
    moment, load = 1.2 * (1.0 - stations.position), 0.9
    exact = _linearise(problem, moment, load).jacobian
    for column in range(n + 1):
        step = h * (np.arange(n + 1) == column)
        ahead = _linearise(problem, moment + step[:n], load + step[n]).residual
        behind = _linearise(problem, moment - step[:n], load - step[n]).residual
        np.testing.assert_allclose(exact[:, column], (ahead - behind) / (2 * h), atol=1e-7)


def test_no_equilibrium_is_none() -> None:
    law = LinearLaw(1.0)
    start = Unknowns(np.zeros(12), 0.0)
    assert solve(law, virgin_plays(law, 12), 1.0, EndLoad(1.5), start) is None


def test_nan_is_none() -> None:
    law = LinearLaw(1.0)
    start = Unknowns(np.full(12, np.nan), 0.0)
    assert solve(law, virgin_plays(law, 12), 1.0, EndLoad(0.1), start) is None
