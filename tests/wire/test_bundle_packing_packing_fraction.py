"""How full a conduit is."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.bundle_packing import bore_for, choose_bore, fits, packing_fraction

SEVEN = np.full(7, 1e-3)


def test_fraction_is_of_areas() -> None:
    wires, bore = 7 * np.pi * 0.5e-3**2, np.pi * 1.5e-3**2
    assert packing_fraction(SEVEN, 3e-3) == pytest.approx(wires / bore)


def test_bore_for_a_fraction_and_back() -> None:
    mixed = np.array([1.1e-3] * 10 + [1.25e-3] * 9)
    assert packing_fraction(mixed, bore_for(mixed)) == pytest.approx(0.7)
    assert bore_for(SEVEN, 7.0 / 9.0) == pytest.approx(3e-3)


def test_the_bore_nearest_to_the_wanted_fraction() -> None:
    assert choose_bore(SEVEN, (2.9e-3, 3.2e-3, 3.6e-3), smallest=3e-3) == 3.2e-3
    assert choose_bore(SEVEN, (3.6e-3, 9e-3), smallest=3e-3) == 3.6e-3
    assert choose_bore(SEVEN, (3e-3,), smallest=3e-3) == 3e-3


def test_no_bore_is_wide_enough() -> None:
    with pytest.raises(
        ValueError,
        match=r"^the narrowest arrangement found needs a bore of 3 mm, and the conduits have 2\.5, "
        r"2\.9 mm$",
    ):
        choose_bore(SEVEN, (2.5e-3, 2.9e-3), smallest=3e-3)


def test_fits_to_rounding() -> None:
    assert fits(3e-3 * (1.0 + 1e-12), 3e-3)
    assert not fits(3.001e-3, 3e-3)


@pytest.mark.parametrize("call", [lambda: packing_fraction(SEVEN, 0.0), lambda: bore_for(SEVEN, 0)])
def test_numbers_that_are_none(call: object) -> None:
    with pytest.raises(ValueError, match=r"(bore|fraction)=0"):
        call()  # type: ignore[operator]
