"""Format the texts of reports: labels of results, units, counts and rounded numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from labpipe.protocol.grammar import SI_UNITS
from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.records.result import Result
from labpipe.results import KINDS
from labpipe.statistics.lots import FORCE_LIMIT
from labpipe.units import get_conversion_factor

if TYPE_CHECKING:
    from labpipe.records.group import Group, GroupNumber
    from labpipe.records.quality import QualityNote, Reason


class Scale(NamedTuple):
    """Display unit of a quantity.

    Parameters
    ----------
    factor : factor from SI to the unit
    unit : name of the unit, such as ``mm``; empty for a pure number
    """

    factor: float
    unit: str

    def label(self, quantity: str) -> str:
        """Return the label of an axis or a column, such as ``Displacement (mm)``."""
        return f"{quantity} ({self.unit})" if self.unit else quantity


LENGTH_SCALE, FORCE_SCALE = Scale(1e3, "mm"), Scale(1.0, "N")
"""Display units of lengths and forces of wires and harnesses."""

_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)
"""Pattern of a character that `replace_unprintable` replaces."""


def replace_unprintable(text: str) -> str:
    """Replace control characters, surrogates and bidirectional formatting characters with U+FFFD.

    Parameters
    ----------
    text : any text; tabs and line ends are kept
    """
    return _UNPRINTABLE.sub("\ufffd", text)


def shorten(text: str, max_length: int) -> str:
    """Shorten a long text by replacing its middle with an ellipsis.

    Parameters
    ----------
    text : name or other text
    max_length : largest number of characters of the result, at least 1

    Examples
    --------
    >>> shorten("TWB-B1-19-PVC-half-lap", 12)
    'TWB-B1…f-lap'
    """
    if len(text) <= max_length:
        return text
    tail_length = (max_length - 1) // 2
    return f"{text[: max_length - 1 - tail_length]}…{text[len(text) - tail_length :]}"


def format_percent(ratio: float, digits: int = 2) -> str:
    """Format a ratio in per cent with significant digits, such as ``12 %`` or ``1200 %``."""
    return f"{float(f'{100.0 * ratio:.{digits}g}'):g} %"  # 1.2e+03 becomes 1200


def format_count(count: int, noun: str) -> str:
    """Format a count with its noun, such as ``1 sample`` or ``3 samples``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def describe_counts(group: Group) -> str:
    """Describe a group by its numbers of samples and spools: ``6 samples from 2 spools``."""
    spools = {sample.specimen.spool for sample in group.samples}
    return f"{format_count(len(group.samples), 'sample')} from {format_count(len(spools), 'spool')}"


_RESULT_LABELS: Mapping[str, str] = {
    **{output.name: output.label for kind in KINDS for output in kind.outputs if output.label},
    "bending_stiffness": "Bending stiffness",
    "stiffness": "Stiffness",
    "stiffness_first": "Stiffness, first region",
    "stiffness_second": "Stiffness, second region",
    "modulus_thin_wall": "Modulus, thin wall",
    "modulus_annulus": "Modulus, annulus",
    "proof_stress_0_2": "Proof stress, 0.2 %",
    "proof_stress_1": "Proof stress, 1 %",
}
"""Labels of results: those of the kinds of results, and of names in the shipped protocols."""
_QUANTITIES = {unit: quantity for quantity, unit in SI_UNITS.items()} | {"m": "displacement"}
"""Quantity whose display unit applies to results with an SI unit, keyed by this unit."""
_PER_PEAK_SUFFIX = "_per_peak_force"
"""End of the names of results that are divided by the peak force."""
_STIFFNESS_AT_CURVATURE = re.compile(r"(bending_stiffness)_at_(\d+)")
"""Pattern of the name of a stiffness at a curvature, 1/m, in the shipped protocols."""
_SLIP_RESULTS = ("slip_position", "slip_drop")
"""Names of results that are numbered by slip, not by cycle."""
_DEFAULT_DIGITS = 4
"""Significant digits of a number without an interval."""
SUPERSCRIPTS = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
"""Superscript of each digit and of the minus sign, for `str.translate`."""


def format_label(name: str) -> str:
    """Format the label of a result.

    Parameters
    ----------
    name : name in snake case; the number of a cycle or a slip may follow after a dot

    Returns
    -------
    The label. That of an unknown name consists of the words of the name.

    Examples
    --------
    >>> format_label("peak_force.2")
    'Peak force, cycle 2'
    >>> format_label("stiffness_first_per_peak_force")
    'Stiffness, first region, per peak force'
    >>> format_label("bending_stiffness_at_3")
    'Bending stiffness at 3 1/m'
    >>> format_label("slip_drop.1")
    'Force lost in slip 1'
    """
    stem, _, suffix = name.partition(".")
    if stem.endswith(_PER_PEAK_SUFFIX):
        stem_label = f"{format_label(stem.removesuffix(_PER_PEAK_SUFFIX))}, per peak force"
    elif match := _STIFFNESS_AT_CURVATURE.fullmatch(stem):
        stem_label = f"{format_label(match[1])} at {match[2]} 1/m"
    else:
        stem_label = _RESULT_LABELS.get(stem) or stem.replace("_", " ").capitalize()
    if not suffix:
        return stem_label
    return f"{stem_label} {suffix}" if stem in _SLIP_RESULTS else f"{stem_label}, cycle {suffix}"


_RESULT_NAME = re.compile(r"(?<![\w./-])[a-z]+(?:_[a-z0-9]+)+(?:\.\d+)?(?![\w/]|\.\w)")
"""Pattern of a word in a sentence that may be the name of a result."""
_PROTOCOL_PREFIXES = ("stiffness_", "modulus_")
"""Beginnings of names of results whose ends a protocol chooses."""


def replace_names(sentence: str) -> str:
    """Replace the names of results in a sentence by their labels.

    Parameters
    ----------
    sentence : any sentence; file names and dotted keys of a protocol are kept

    Examples
    --------
    >>> replace_names("no modulus, as stiffness_second failed")
    'no modulus, as stiffness, second region failed'
    """

    def replace_name(match: re.Match[str]) -> str:
        stem = match[0].partition(".")[0].removesuffix(_PER_PEAK_SUFFIX)
        if stem not in _RESULT_LABELS and not stem.startswith(_PROTOCOL_PREFIXES):
            return match[0]
        text = format_label(match[0])
        return text if match.start() == 0 else text[0].lower() + text[1:]

    return _RESULT_NAME.sub(replace_name, sentence)


def make_sentence(message: str) -> str:
    """Make a sentence of a message: capital letter, full stop, labels of results for their names.

    Examples
    --------
    >>> make_sentence("the branch ends at 4.2 mm")
    'The branch ends at 4.2 mm.'
    """
    text = replace_names(message)
    full_stop = "" if not text or text.endswith((".", "?", "!")) else "."
    return text[:1].upper() + text[1:] + full_stop


def join_sentences(reasons: Iterable[Reason | QualityNote | None]) -> str:
    """Join the sentences of reasons or notes, each once; None is skipped."""
    return " ".join(dict.fromkeys(make_sentence(reason.message) for reason in reasons if reason))


def is_main(name: str) -> bool:
    """Return whether a result describes the specimen, and not a slip, the clocks or a limit."""
    return not name.startswith(("slip_", "clock_", FORCE_LIMIT))


def is_first_cycle(name: str) -> bool:
    """Return whether a result belongs to the first cycle or to no particular cycle."""
    return name.partition(".")[2] in {"", "1"}


def list_key_numbers(group: Group) -> list[GroupNumber]:
    """List the numbers of the first cycle of a group, except those that the rig sets."""
    measured_numbers = (number for number in group.numbers if not number.is_set_by_rig)
    return [number for number in measured_numbers if is_first_cycle(number.name)]


def choose_unit(name: str, unit: str, display: Mapping[str, str]) -> Scale:
    """Choose the display unit of a result.

    Parameters
    ----------
    name : name of the result; may be empty
    unit : SI unit of the result
    display : display unit of each quantity, keyed by quantity

    Returns
    -------
    Factor from SI to the display unit, and the name of the unit, not typeset. Without a display
    unit, the SI unit is returned. The drift of clocks is in ppm.
    """
    if name == "clock_drift":
        return Scale(1e6, "ppm")
    display_unit = display.get(_QUANTITIES.get(unit, ""))
    if display_unit is None:
        return Scale(1.0, unit)
    return Scale(1.0 / get_conversion_factor(display_unit, unit), display_unit)


def get_display(group: Group) -> Mapping[str, str]:
    """Get the display units of a group, which are those of its first sample."""
    return group.samples[0].display if group.samples else {}


def choose_scale(name: str, unit: str, display: Mapping[str, str]) -> Scale:
    """Choose the display unit of a result as `choose_unit` does, with a typeset name."""
    scale = choose_unit(name, unit, display)
    return scale._replace(unit=typeset_unit(scale.unit))


def choose_number_scale(group: Group, number: GroupNumber) -> Scale:
    """Choose the display unit of a number in its group, with a typeset name."""
    return choose_scale(number.name, number.unit, get_display(group))


def get_scale(display: Mapping[str, str], quantity: str) -> Scale:
    """Get the display unit of a quantity.

    Parameters
    ----------
    display : display unit of each quantity, keyed by quantity
    quantity : name of the quantity, such as ``displacement``, ``force``, ``time`` or ``moment``

    Returns
    -------
    Factor from SI to the display unit, and the typeset name of the unit. Without a display unit,
    the SI unit is returned.

    Raises
    ------
    KeyError
        If the quantity is unknown.
    """
    unit = display.get(quantity, SI_UNITS[quantity])
    return Scale(1.0 / get_conversion_factor(unit, SI_UNITS[quantity]), typeset_unit(unit))


def get_scales(display: Mapping[str, str], *quantities: str) -> list[Scale]:
    """Get the display units of several quantities with `get_scale`."""
    return [get_scale(display, quantity) for quantity in quantities]


def typeset_unit(unit: str) -> str:
    """Typeset a unit, such as ``N*mm^2`` as N·mm²; empty for a pure number.

    Examples
    --------
    >>> typeset_unit("N*mm^2")
    'N·mm²'
    >>> typeset_unit("um/N")
    'µm/N'
    >>> typeset_unit("1")
    ''
    """
    text = re.sub(r"\^(-?\d+)", lambda match: match[1].translate(SUPERSCRIPTS), unit)
    text = re.sub(r"\bu(?=[a-zA-Z])", "\u00b5", text)
    return "" if unit == "1" else text.replace("*", "·")


def format_heading(name: str, scale: Scale) -> str:
    """Format the label of a result with its unit in brackets, for a column or an axis."""
    return scale.label(format_label(name))


@dataclass(frozen=True, slots=True)
class FormattedNumber:
    """Texts of a number, of its interval and of its estimate.

    Parameters
    ----------
    value : text of the number
    lower, upper : texts of the ends of its interval; empty without an interval
    estimate : text of an estimate that differs from the number; empty if there is none
    """

    value: str
    lower: str = ""
    upper: str = ""
    estimate: str = ""

    @property
    def interval(self) -> str:
        """Estimate, if any, and interval, such as ``46.3 to 58.3``; empty without an interval."""
        estimate_text = f"estimate {self.estimate}, " if self.estimate else ""
        return f"{estimate_text}{self.lower} to {self.upper}" if self.lower else ""

    @property
    def text(self) -> str:
        """Number and interval in one line."""
        return f"{self.value} ({self.interval})" if self.lower else self.value


def format_number(
    value: float,
    interval: Interval | None,
    factor: float = 1.0,
    *,
    digits: int = _DEFAULT_DIGITS,
    estimate: float | None = None,
) -> FormattedNumber:
    """Format a number with as many digits as its interval supports.

    Parameters
    ----------
    value : number, SI; the text of a number that is not finite is a dash
    interval : interval of the number, SI; None without an interval
    factor : factor from SI to the display unit
    digits : significant digits of a number without an interval, or with an interval of zero width
    estimate : estimate that differs from the value, SI; None if there is none

    Returns
    -------
    The texts of all numbers, which are rounded to the second significant digit of the half-width of
    the interval [1]_. Without an interval, the number has `digits` significant digits.

    References
    ----------
    .. [1] JCGM 100:2008, Guide to the expression of uncertainty in measurement, 7.2.6.

    Examples
    --------
    >>> format_number(0.052284, Interval(0.046271, 0.058296), 1e3)
    FormattedNumber(value='52.3', lower='46.3', upper='58.3', estimate='')
    >>> format_number(1234.567, None).value
    '1235'
    """
    last_place = compute_last_place(value, interval, factor, digits)
    if not math.isfinite(value):
        return FormattedNumber("\u2013")
    numbers = [value] if interval is None else [value, interval.lower, interval.upper]
    numbers += [] if estimate is None else [estimate]
    return FormattedNumber(*_round_together([factor * number for number in numbers], last_place))


def compute_last_place(
    value: float, interval: Interval | None, factor: float = 1.0, digits: int = _DEFAULT_DIGITS
) -> int:
    """Compute the power of ten of the last digit that a formatted number shows.

    Parameters
    ----------
    value : number, SI
    interval : interval of the number, SI; None without an interval
    factor : factor from SI to the display unit
    digits : significant digits of a number without an interval, or with an interval of zero width

    Examples
    --------
    >>> compute_last_place(0.052284, Interval(0.046271, 0.058296), 1e3)
    -1
    """
    if interval is None:
        return _compute_digit_place(abs(factor * value), digits)
    numbers = [factor * number for number in (value, interval.lower, interval.upper)]
    half_width = (max(numbers[1:]) - min(numbers[1:])) / 2.0
    if not all(map(math.isfinite, numbers)) or not half_width > 0.0:
        largest = max(map(abs, filter(math.isfinite, numbers)), default=0.0)
        return _compute_digit_place(largest, digits)
    return _compute_digit_place(half_width, 2)


def _compute_digit_place(magnitude: float, digits: int) -> int:
    """Compute the power of ten of the last significant digit of a number that is not negative."""
    if magnitude == 0.0 or not math.isfinite(magnitude):
        return -digits
    # the number is rounded first: 9.96 has the text 10 with two digits, not 10.0
    exponent = int(f"{magnitude:.{digits - 1}e}".partition("e")[2])
    return exponent - digits + 1


def _round_together(numbers: Sequence[float], last_place: int) -> list[str]:
    """Format numbers to the same last place; very large or small ones have a common factor."""
    min_plain, max_plain = 1e-3, 1e6  # range of the largest number for texts without a factor
    largest = max(map(abs, numbers))
    if min_plain <= largest < max_plain or largest == 0.0 or not math.isfinite(largest):
        return [_round_to_place(number, last_place) for number in numbers]
    power = math.floor(math.log10(largest))
    factor_text = f" \u00d7 10{str(power).translate(SUPERSCRIPTS)}"
    texts = (_round_to_place(number / 10.0**power, last_place - power) for number in numbers)
    return [text + factor_text for text in texts]


def _round_to_place(number: float, last_place: int) -> str:
    """Format a number down to a power of ten, such as ``52.3`` for the power -1."""
    # + 0.0 removes the sign of a zero
    return f"{round(number, -last_place) + 0.0:.{max(-last_place, 0)}f}"


def format_with_interval(
    value: float, interval: Interval | None, factor: float = 1.0, *, estimate: float | None = None
) -> str:
    """Format a number with its interval in one line.

    Parameters
    ----------
    value : number, SI
    interval : interval of the number, SI; None without an interval
    factor : factor from SI to the display unit
    estimate : estimate that differs from the value, SI; None if there is none

    Returns
    -------
    ``value ± half-width`` if there is no estimate and the distances of the value from the two ends
    of the interval differ by at most a tenth; otherwise ``value (lower to upper)``. Without an
    interval, the text is the value.

    Examples
    --------
    >>> format_with_interval(0.052284, Interval(0.046271, 0.058296), 1e3)
    '52.3 ± 6.0'
    >>> format_with_interval(1.26, Interval(1.15, 1.44))
    '1.26 (1.15 to 1.44)'
    """
    max_asymmetry = 0.1  # largest difference of the two distances, relative to the longer one
    texts = format_number(value, interval, factor, estimate=estimate)
    if interval is None or not texts.lower:
        return texts.value
    distances = interval.upper - value, value - interval.lower
    longest, difference = max(distances), abs(distances[0] - distances[1])
    if estimate is not None or not isfinite(longest) or difference > max_asymmetry * longest:
        return f"{texts.value} ({texts.interval})"
    half_width = float(f"{abs(factor) * longest:.1e}")  # two significant digits
    numbers = [factor * number for number in (value, interval.lower, interval.upper)]
    last_place = compute_last_place(value, interval, factor)
    value_text, *_, half_text = _round_together([*numbers, half_width], last_place)
    value_text, times_sign, power = value_text.partition(" \u00d7 ")
    text = f"{value_text} \u00b1 {half_text.removesuffix(times_sign + power)}"
    return f"({text}){times_sign}{power}" if times_sign else text


def format_mean(mean: MeanInterval, factor: float = 1.0) -> str:
    """Format a mean with its interval as `format_with_interval` does.

    Parameters
    ----------
    mean : mean with its interval, SI
    factor : factor from SI to the display unit
    """
    return format_with_interval(mean.mean, mean.interval, factor, estimate=mean.distinct_estimate)


def format_result(result: Result, factor: float = 1.0) -> str:
    """Format a result with its interval as `format_with_interval` does; a dash without a value.

    Parameters
    ----------
    result : result, SI
    factor : factor from SI to the display unit
    """
    if result.value is None:
        return "\u2013"
    estimate = result.distinct_estimate
    return format_with_interval(result.value, result.interval, factor, estimate=estimate)
