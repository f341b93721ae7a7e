from __future__ import annotations

import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe import units
from labpipe.units import get_conversion_factor, parse_quantity
from tests.approved import Approve


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("53 mm", "m", 0.053),
        ("0.423 mm/s", "m/s", 4.23e-4),
        ("-0.21082 N/V", "N/V", -0.21082),
        ("10 kHz", "1/s", 1e4),
        ("2.7 g", "kg", 2.7e-3),
        ("0.2 %", "1", 2e-3),
        ("500 ppm", "1", 5e-4),
        ("90 deg", "rad", 1.5707963267948966),
        ("  1e-3  m ", "m", 1e-3),
        (".5N", "N", 0.5),
        ("4 in", "m", 0.1016),
        ("2 ft", "m", 0.6096),
        ("3 daN", "N", 30.0),
        ("5 cN", "N", 0.05),
        ("200 gf", "N", 1.96133),
        ("2 kp", "N", 19.6133),
        ("3 N*mm^2", "N*m^2", 3e-6),
        ("3 N·mm²".replace("²", "^2"), "N*m^2", 3e-6),
        (3, "1", 3.0),
        ("7", "1", 7.0),
    ],
)
def test_quantities(text: object, unit: str, value: float) -> None:
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-11)


REFUSED: dict[str, list[object]] = {
    "m": [
        *("53", 53, "53 s", "53 blobs", "mm", "", "1e999 m", "1 mm**9**9**9", "1 mm^9^9^9"),
        *("1 m**(9)**9", "1 m^999999", "nan m", "1 m)", "2,1 mm", "3 1 mm"),
        *("1" + 200_000 * " " + "x", 200_000 * "1" + "\nx\n", "1 " + 100_000 * "m*"),
    ],
    "N": ["53 mm"],
    "1": [True],
    "1/s": ["1e307 kHz"],
    "s": ["0,1 s", "5 s,"],
}


def test_refusals(approved: Approve) -> None:
    messages = []
    for unit, texts in REFUSED.items():
        for text in texts:
            with pytest.raises(ValueError) as refused:  # noqa: PT011  the text is approved
                parse_quantity(text, unit)
            messages.append(f"{str(text)[:20]!r}: {str(refused.value)[:120]}")
    approved(messages)


@given(st.floats(-1e6, 1e6).map(lambda number: float(f"{number:.9g}")))
def test_a_number_in_si_comes_back_as_it_was(number: float) -> None:
    assert parse_quantity(f"{number!r} m", "m") == number
    assert parse_quantity(f"{number!r} mm", "m") == pytest.approx(1e-3 * number, rel=1e-11)


def test_quick_ways_agree_with_the_registry() -> None:
    """The table of frequent units, and the list of coherent ones, against pint itself."""
    registry = units._make_registry()

    def parse(unit: str) -> pint.Unit:
        return registry.parse_units(units._format_for_pint(unit))

    def factor(unit: str, si_unit: str) -> float:
        return float(registry.Quantity(1.0, parse(unit)).to(parse(si_unit)).magnitude)

    for (unit, si_unit), quick in units._COMMON_FACTORS.items():
        assert factor(unit, si_unit) == pytest.approx(quick, rel=1e-12), (unit, si_unit)
    for unit in (*units._COHERENT_UNITS, *units._COHERENT_EQUIVALENTS):
        for other in units._COHERENT_UNITS:
            if parse(unit).is_compatible_with(parse(other)):
                expected = pytest.approx(factor(unit, other), rel=1e-12)
                assert get_conversion_factor(unit, other) == expected
            else:
                with pytest.raises(ValueError, match="expected a unit of the dimension of"):
                    get_conversion_factor(unit, other)
