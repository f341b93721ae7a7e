from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe import units
from labpipe.units import parse_quantity, si_factor


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
        ("3 N*mm^2", "N*m^2", 3e-6),
        ("3 N·mm²".replace("²", "^2"), "N*m^2", 3e-6),
        (3, "1", 3.0),
        ("7", "1", 7.0),
    ],
)
def test_quantities(text: object, unit: str, value: float) -> None:
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-11)


@pytest.mark.parametrize(
    ("text", "unit", "said"),
    [
        ("53", "m", "expected a unit of the dimension of m, found none in '53'"),
        (53, "m", "expected a unit of the dimension of m, found none in 53"),
        ("53 s", "m", "expected a unit of the dimension of m, found 's'"),
        ("53 blobs", "m", "expected a unit such as m, found 'blobs'"),
        ("53 mm", "N", "expected a unit of the dimension of N, found 'mm'"),
        ("mm", "m", "expected a number with a unit such as \"1 m\", found 'mm'"),
        ("", "m", "expected a number with a unit such as \"1 m\", found ''"),
        (True, "1", 'expected a number with a unit such as "1 1", found True'),
        ("1e999 m", "m", "expected a number that is finite, found '1e999 m'"),
        ("1e307 kHz", "1/s", "expected a number that is finite, found '1e307 kHz'"),
        ("1 mm**9**9**9", "m", "expected a unit such as m, found 'mm**9**9**9'"),
        ("1 mm^9^9^9", "m", "expected a unit such as m, found 'mm^9^9^9'"),
        ("1 m**(9)**9", "m", "expected a unit such as m, found 'm**(9)**9'"),
        ("1 m^999999", "m", "expected a unit such as m, found 'm^999999'"),
        ("nan m", "m", "expected a number with a unit such as \"1 m\", found 'nan m'"),
        ("1 m)", "m", "expected a unit such as m"),
        ("2,1 mm", "m", "expected a unit such as m, found ',1 mm'"),
        ("0,1 s", "s", "expected a unit such as s, found ',1 s'"),
        ("3 1 mm", "m", "expected a unit such as m, found '1 mm'"),
        ("5 s,", "s", "expected a unit such as s, found 's,'"),
        ("1" + 200_000 * " " + "x", "m", "expected a unit such as m, found 'x'"),
        (200_000 * "1" + "\nx\n", "m", "expected a unit such as m, found 'x'"),
        ("1 " + 100_000 * "m*", "m", "expected a unit such as m, found 'm*m*m*"),
    ],
)
def test_refusals(text: object, unit: str, said: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  the text is compared as a whole
        parse_quantity(text, unit)
    assert str(caught.value).startswith(said)


@given(st.floats(-1e6, 1e6).map(lambda number: float(f"{number:.9g}")))
def test_a_number_in_si_comes_back_as_it_was(number: float) -> None:
    assert parse_quantity(f"{number!r} m", "m") == number
    assert parse_quantity(f"{number!r} mm", "m") == pytest.approx(1e-3 * number, rel=1e-11)


def test_quick_ways_agree_with_the_registry() -> None:
    """The table of frequent units, and the list of coherent ones, against pint itself."""
    registry = units._registry()

    def factor(unit: str, si_unit: str) -> float:
        parsed = [registry.parse_units(units._spelt(each)) for each in (unit, si_unit)]
        return float(registry.Quantity(1.0, parsed[0]).to(parsed[1]).magnitude)

    for (unit, si_unit), quick in units._PLAIN.items():
        assert factor(unit, si_unit) == pytest.approx(quick, rel=1e-12), (unit, si_unit)
    for unit in (*units._SI, *units._COHERENT):
        for other in units._SI:
            same = registry.parse_units(units._spelt(unit)).is_compatible_with(
                registry.parse_units(units._spelt(other))
            )
            if same:
                assert si_factor(unit, other) == pytest.approx(factor(unit, other), rel=1e-12)
            else:
                with pytest.raises(ValueError, match="expected a unit of the dimension of"):
                    si_factor(unit, other)
