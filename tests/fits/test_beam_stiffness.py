"""Bending stiffness of beams."""

from __future__ import annotations

import pytest

from labpipe.fits.beam_stiffness import beam_factor


@pytest.mark.parametrize(("support", "divisor"), [("cantilever", 3.0), ("three-point", 48.0)])
def test_textbook(support: str, divisor: float) -> None:
    """A beam of known EI: K = divisor x EI / L^3."""
    bending, length = 0.12, 0.1143
    stiffness = divisor * bending / length**3
    assert stiffness * beam_factor(length, support) == pytest.approx(bending, rel=1e-12)


def test_wrong_words_and_lengths() -> None:
    with pytest.raises(ValueError, match="a support out of cantilever, three-point, found 'wall'"):
        beam_factor(0.1, "wall")
    with pytest.raises(ValueError, match=r"expected a length above 0, found length=0.0"):
        beam_factor(0.0, "cantilever")
