"""Convert quantities in texts and files to coherent SI units.

All quantities in labpipe are in s, m, kg, N, Pa, J, V, K, rad, or products of their powers.
"""

from __future__ import annotations

import re
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pint

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2 (CGPM 1901)."""

# This list has only the units of a test lab. Pint loads it in a millisecond, and its default list
# in several hundred. In this list, "ft" is a foot; in the default list it could be a femtotonne.
_DEFINITIONS = """
milli- = 1e-3 = m-
micro- = 1e-6 = µ- = u-
centi- = 1e-2 = c-
deca- = 1e1 = da-
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-
meter = [length] = m = metre = meters = metres
second = [time] = s = sec = seconds = Sec
gram = [mass] = g
radian = [] = rad
volt = [potential] = V
kelvin = [temperature] = K
degree = 0.017453292519943295 * radian = deg = °
percent = 0.01 = % = percent
ppm = 1e-6
minute = 60 * second = min
hour = 3600 * second = h
day = 86400 * second = d
hertz = 1 / second = Hz
newton = kilogram * meter / second ** 2 = N
pascal = newton / meter ** 2 = Pa
joule = newton * meter = J
inch = 0.0254 * meter = in
foot = 0.3048 * meter = ft
pound_force = 4.4482216152605 * newton = lbf
kilogram_force = 9.80665 * newton = kgf = kp
gram_force = 9.80665e-3 * newton = gf
newton_meter = newton * meter = Nm
newton_millimeter = 1e-3 * newton * meter = Nmm
psi = 6894.757293168361 * pascal
frame = [] = frame
"""


class DimensionError(ValueError):
    """Error of a unit whose dimension differs from the expected one."""


class NotFiniteError(ValueError):
    """Error of a value that is too large for a float."""


# These frequent conversions do not need pint, which takes longer to load than a file takes to read.
# A test compares this table with pint.
_COMMON_FACTORS = {
    ("mm", "m"): 1e-3,
    ("cm", "m"): 1e-2,
    ("um", "m"): 1e-6,
    ("mm^2", "m^2"): 1e-6,
    ("N/mm", "N/m"): 1e3,
    ("um/N", "m/N"): 1e-6,
    ("N*mm", "N*m"): 1e-3,
    ("N*mm^2", "N*m^2"): 1e-6,
    ("m", "mm"): 1e3,
    ("ms", "s"): 1e-3,
    ("mN", "N"): 1e-3,
    ("kN", "N"): 1e3,
    ("lbf", "N"): 4.4482216152605,
    ("in", "m"): 0.0254,
    ("sec", "s"): 1.0,
    ("min", "s"): 60.0,
    ("h", "s"): 3600.0,
    ("µm", "m"): 1e-6,
    ("kPa", "Pa"): 1e3,
    ("GPa", "Pa"): 1e9,
    ("mm/mm", "1"): 1.0,
    ("MPa", "Pa"): 1e6,
    ("N", "mN"): 1e3,
    ("mm/s", "m/s"): 1e-3,
    ("um/s", "m/s"): 1e-6,
    ("g", "kg"): 1e-3,
    ("g/m", "kg/m"): 1e-3,
    ("J", "mJ"): 1e3,
    ("mJ", "J"): 1e-3,
    ("%", "1"): 1e-2,
    ("ppm", "1"): 1e-6,
    ("", "1"): 1.0,
    ("kHz", "1/s"): 1e3,
    ("Hz", "1/s"): 1.0,
    ("1/s", "Hz"): 1.0,
    ("rad", "1"): 1.0,
    ("1", "rad"): 1.0,
    ("J", "N*m"): 1.0,
    ("N*m", "J"): 1.0,
    ("N/V", "N/V"): 1.0,
    ("N/V", "N/(V)"): 1.0,
}
_COHERENT_UNITS = {
    *("1", "m", "s", "kg", "K", "rad", "V", "m^2", "1/m", "m/s", "1/s", "Hz", "kg/m"),
    *("N", "J", "Pa", "N/m", "m/N", "N*m", "N*m^2"),
}
"""Coherent SI units. Two of them convert to each other only if `_COMMON_FACTORS` has the pair."""

_COHERENT_EQUIVALENTS = {
    unit: (factor, coherent_unit)
    for (unit, coherent_unit), factor in _COMMON_FACTORS.items()
    if coherent_unit in _COHERENT_UNITS and unit not in _COHERENT_UNITS
}
"""Factor to a coherent unit, and that unit, keyed by common unit.

A conversion of a common unit to a coherent unit of another dimension is refused without pint.
"""

_STACKED_POWER = re.compile(r"(\*\*|\^)[-+\s(]*\d[\d.)\s]*(\*\*|\^)|(\*\*|\^)[-+\s(]*\d{3,}")
"""A power of a power, or an exponent of three digits or more; neither occurs in a unit."""
_INVALID_UNIT = re.compile(r"[^\w%°(]|(?!1\s*/)\d|.{100}|.*,", re.DOTALL)
"""A text with an invalid first character, 100 characters or more, or a comma (ignored by pint)."""
_QUANTITY = re.compile(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*+(.*)")
"""A number with a decimal point, and the text of its unit, which may be empty."""


@cache
def _make_registry() -> pint.UnitRegistry[float]:
    """Make the registry of pint for the units of `_DEFINITIONS`."""
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(
        None, preprocessors=[lambda text: text.replace("%", " percent ")]
    )
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


@cache
def get_conversion_factor(unit: str, target_unit: str) -> float:
    """Return the factor that converts a value from `unit` to `target_unit`.

    Parameters
    ----------
    unit : unit as a person or a program writes it, such as ``mm`` or ``N/V``
    target_unit : unit of the converted value, usually coherent SI; ``1`` for a pure number

    Returns
    -------
    Value in `target_unit` of one `unit`.

    Raises
    ------
    ValueError
        If a unit is unknown; a `DimensionError` if the two units differ in dimension.

    Examples
    --------
    >>> get_conversion_factor("mm", "m")
    0.001
    """
    if unit == target_unit and unit in _COHERENT_UNITS:
        return 1.0
    if (unit, target_unit) in _COMMON_FACTORS:
        return _COMMON_FACTORS[unit, target_unit]
    if target_unit in _COHERENT_UNITS and unit in _COHERENT_UNITS | _COHERENT_EQUIVALENTS.keys():
        factor, coherent_unit = _COHERENT_EQUIVALENTS.get(unit, (1.0, unit))
        if coherent_unit == target_unit or (coherent_unit, target_unit) in _COMMON_FACTORS:
            return factor * get_conversion_factor(coherent_unit, target_unit)
        raise DimensionError(_describe_dimension_error(unit, target_unit))
    message = f"expected a unit such as {target_unit}, found {unit!r}"
    if _INVALID_UNIT.match(unit) or _STACKED_POWER.search(unit):  # 9**9**9 has 369 693 100 digits
        raise ValueError(message)
    import pint

    registry = _make_registry()
    try:
        quantity = registry.Quantity(1.0, registry.parse_units(_format_for_pint(unit)))
        return float(quantity.to(registry.parse_units(_format_for_pint(target_unit))).magnitude)
    except pint.DimensionalityError as error:
        raise DimensionError(_describe_dimension_error(unit, target_unit)) from error
    except Exception as error:  # pint raises a dozen kinds of error for a text that is no unit
        raise ValueError(message) from error


def _describe_dimension_error(unit: str, expected_unit: str) -> str:
    """Describe a unit whose dimension differs from that of the expected unit."""
    return f"expected a unit of the dimension of {expected_unit}, found {unit!r}"


def _format_for_pint(unit: str) -> str:
    """Format a unit with the characters that pint expects for powers, products and micro."""
    text = unit.replace("²", "^2").replace("³", "^3").replace("μ", "µ")  # Greek mu to micro
    return "" if text in {"", "1"} else text.replace("·", "*").replace("^", "**")


def parse_count(text: str) -> int | None:
    """Parse a count, such as the number of rows in a header.

    Parameters
    ----------
    text : text that should have decimal digits only

    Returns
    -------
    The count; None for any other text, or for more than 18 digits.

    Examples
    --------
    >>> parse_count("2701"), parse_count("2701.0"), parse_count(5000 * "9")
    (2701, None, None)
    """
    max_digits = 18
    return int(text) if text.isdecimal() and len(text) <= max_digits else None


def parse_quantity(text: object, si_unit: str) -> float:
    """Parse a quantity with its unit, such as ``53 mm``, and convert it to SI.

    Parameters
    ----------
    text : number and unit; a pure number (`si_unit` ``1``) needs no unit
    si_unit : coherent SI unit of the returned value

    Returns
    -------
    The value in `si_unit`.

    Raises
    ------
    ValueError
        If the unit is missing or unknown, or the text is not a quantity; a `DimensionError` if the
        unit has another dimension, a `NotFiniteError` if the value is too large for a float.

    Examples
    --------
    >>> parse_quantity("53 mm", "m")
    0.053
    >>> parse_quantity("-0.21082 N/V", "N/V")
    -0.21082
    """
    match = _QUANTITY.fullmatch(str(text).strip())
    if match is None or isinstance(text, bool):
        message = f'expected a number with a unit such as "1 {si_unit}", found {text!r}'
        raise ValueError(message)
    number_text, unit = match.groups()
    if not unit and si_unit != "1":
        message = f"expected a unit of the dimension of {si_unit}, found none in {text!r}"
        raise ValueError(message)
    # 9 mm is 0.009 m, not 0.009000000000000001.
    value = float(f"{float(number_text) * get_conversion_factor(unit or '1', si_unit):.12g}")
    if not isfinite(value):
        message = f"expected a number that is finite, found {text!r}"
        raise NotFiniteError(message)
    return value
