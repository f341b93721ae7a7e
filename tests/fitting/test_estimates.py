from __future__ import annotations

from labpipe.fitting.estimates import Estimate, Failure


def test_they_are_values() -> None:
    assert Estimate(1.0, 0.1, 5) == Estimate(1.0, 0.1, 5)
    assert Failure("gap", "3 samples") != Failure("gap", "4 samples")
