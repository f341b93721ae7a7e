"""Slack by toe compensation."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.least_squares import zero_of_line
from labpipe.fits.slack import toe_line
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure
from tests.builders.noise_rows import KINDS, Number, noise_rows, spreads

D = np.linspace(0.0, 0.02, 401)
F = 5000.0 * np.maximum(D - 0.002, 0.0)


def test_foot_of_the_line() -> None:
    region = toe_line(D, F, start_share=0.1, stop_share=0.3)
    assert not isinstance(region, Failure)
    assert zero_of_line(D[region], F[region]) == pytest.approx(0.002, rel=1e-9)


def test_says_why_not() -> None:
    few = toe_line(D[:5], F[:5], start_share=0.1, stop_share=0.3)
    assert few == Failure("too_few_samples", "5 samples, 8 are needed")
    late = toe_line(D[150:], F[150:], start_share=0.1, stop_share=0.3)
    assert late == Failure("not_reached", "the branch begins at 27.5 N, above 10% of 90 N")
    coarse = toe_line(D[::40], F[::40], start_share=0.1, stop_share=0.3)
    assert coarse == Failure("too_few_samples", "2 samples in the linear region, 8 are needed")
    newtons = np.arange(41.0)  # from 4 N to less than 12 N
    assert toe_line(newtons, newtons, start_share=0.1, stop_share=0.3) == slice(4, 12)
    eight = toe_line(newtons[:8], newtons[:8], start_share=0.1, stop_share=0.3)
    assert eight == coarse


def test_the_line_goes_through_the_samples_between_the_shares() -> None:
    """90 N at the most, 0.25 N a sample from 40 on: 9.09 N lie behind 76, 27.09 N behind 148."""
    assert toe_line(D, F, start_share=0.101, stop_share=0.301) == slice(77, 149)
    holes = F.copy()
    holes[100] = np.nan
    region = toe_line(D, holes, start_share=0.101, stop_share=0.301)
    assert isinstance(region, np.ndarray)
    assert region.tolist() == [each for each in range(77, 149) if each != 100]
    flat = np.repeat([0.0, 1.0, 2.0], [10, 20, 10])
    steps = toe_line(np.zeros(40), flat, start_share=0.1, stop_share=0.9)
    assert steps == Failure("not_rising", "the force does not rise in the linear region")


@pytest.mark.parametrize("kind", KINDS)
def test_slack_of_replicates_scatters_as_tests_do(kind: str) -> None:
    shape = (200, len(D))
    force = F + noise_rows(kind, 0.1, shape, seed=1)

    def decide(d: Floats, f: Floats) -> Number:
        region = toe_line(d, f, start_share=0.1, stop_share=0.3)
        assert not isinstance(region, Failure)
        return lambda d, f: zero_of_line(d[..., region], f[..., region])

    tests, replicates = spreads(decide, D + np.zeros(shape), force)
    assert replicates == pytest.approx(tests, rel=0.2)
    if kind == "white":
        # By hand: 0.1 N over 5000 N/m, at 3.6 mm before the middle of 72 samples of 0.05 mm.
        lever = (D[76:148] - D[76:148].mean()) ** 2
        at = D[76:148].mean() - 0.002
        assert replicates == pytest.approx(2e-5 * np.sqrt(1 / 72 + at**2 / lever.sum()), rel=0.15)
