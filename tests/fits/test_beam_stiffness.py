"""Bending stiffness of beams."""

from __future__ import annotations

import pytest

from labpipe.fits.beam_stiffness import beam_stiffness
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate


@pytest.mark.parametrize(("support", "divisor"), [("cantilever", 3.0), ("three-point", 48.0)])
def test_textbook(support: str, divisor: float) -> None:
    """A beam of known EI: K = divisor x EI / L^3."""
    bending, length = 0.12, 0.1143
    stiffness = Estimate(divisor * bending / length**3, 0.0, 9)
    found = beam_stiffness(stiffness, length=length, length_error=0.0, support=support)
    assert found.value == pytest.approx(bending, rel=1e-12)
    assert found.error == 0.0


def test_length_counts_three_times_and_the_quantile_is_kept() -> None:
    stiffness = Estimate(100.0, 2.0, 9, Interval(95.0, 105.0))
    found = beam_stiffness(stiffness, length=0.1, length_error=0.0005, support="cantilever")
    assert found.error / found.value == pytest.approx((0.02**2 + 0.015**2) ** 0.5)
    assert found.interval is not None
    assert (found.interval.upper - found.value) / found.error == pytest.approx(2.5)


def test_wrong_words_and_lengths() -> None:
    one = Estimate(1.0, 0.1, 9)
    with pytest.raises(ValueError, match="a support out of cantilever, three-point, found 'wall'"):
        beam_stiffness(one, length=0.1, length_error=0.0, support="wall")
    with pytest.raises(ValueError, match=r"expected a length above 0, found length=0.0"):
        beam_stiffness(one, length=0.0, length_error=0.0, support="cantilever")
