"""How reports write: names in words, units, numbers with the digits that mean something, labels."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from labpipe.records.curve import Interval
from labpipe.records.quality import Severity
from labpipe.records.result import Status, TestResult
from labpipe.results import KINDS
from labpipe.units import si_factor

if TYPE_CHECKING:
    from labpipe.records.group import Group


class Scale(NamedTuple):
    """How a quantity is shown: multiply SI numbers by `factor`, and write `unit`."""

    factor: float
    unit: str

    def label(self, quantity: str) -> str:
        """Word an axis label, such as ``Displacement (mm)``."""
        return f"{quantity} ({self.unit})"


def scale(result: TestResult, quantity: str, si_unit: str) -> Scale:
    """Find the display unit of a quantity; SI where the protocol names none.

    Parameters
    ----------
    result : holds the display units
    quantity : ``displacement``, ``force``, ``time`` ...
    si_unit : its SI unit

    Returns
    -------
    Factor from SI to the display unit, and the unit's name.
    """
    unit = result.display.get(quantity, si_unit)
    return Scale(1.0 / si_factor(unit, si_unit), unit)


def title(result: TestResult) -> str:
    """Test, specimen and protocol in one line."""
    specimen = result.specimen
    what = f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"
    return f"{result.test}  ·  {what}  ·  {result.protocol}"


def footnote(result: TestResult) -> str:
    """How many results are doubtful or failed; empty when all are fine."""
    counts = {
        status: sum(entry.status is status for entry in result.results)
        for status in (Status.DOUBTFUL, Status.FAILED)
    }
    parts = [f"{count} {status}" for status, count in counts.items() if count]
    return f"Of {len(result.results)} results: {', '.join(parts)}." if parts else ""


_NOT_SHOWN = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


def printable(text: str) -> str:
    """Show what no page, workbook or drawing can hold as U+FFFD: control characters and the like.

    What turns the direction of the words behind it counts, too.

    Parameters
    ----------
    text : any; tabs and ends of lines stay
    """
    return _NOT_SHOWN.sub("\ufffd", text)


def shortened(word: str, most: int) -> str:
    """Take the middle out of a name that is too long for its place in a figure.

    Parameters
    ----------
    word : any text
    most : characters that there is room for, 3 at least

    Examples
    --------
    >>> shortened("TWB-B1-19-PVC-half-lap", 12)
    'TWB-B1…f-lap'
    """
    if len(word) <= most:
        return word
    end = (most - 1) // 2
    return f"{word[: most - 1 - end]}…{word[len(word) - end :]}"


def count_of(number: int, noun: str) -> str:
    """A number of things, such as ``1 sample`` or ``3 samples``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def why_missing(result: TestResult, what: str) -> str:
    """Say that a stage of the test is not there, with the first error that the test notes."""
    errors = (note.message for note in result.quality if note.severity is Severity.ERROR)
    return " ".join([f"There is no {what} to draw.", *list(errors)[:1]])


_WORDS: Mapping[str, str] = {
    **{output.name: output.label for kind in KINDS for output in kind.outputs if output.label},
    "bending_stiffness": "Bending stiffness",
    "stiffness": "Stiffness",
    "stiffness_first": "Stiffness, first region",
    "stiffness_second": "Stiffness, second region",
    "modulus_thin_wall": "Modulus, thin wall",
    "modulus_annulus": "Modulus, annulus",
}
"""Names of results in words: as the kinds of results have them, and names that protocols choose."""
_QUANTITIES = {
    "m": "displacement",
    "N": "force",
    "N/m": "stiffness",
    "J": "energy",
    "s": "time",
    "Pa": "pressure",
    "m/N": "compliance",
    "1/m": "curvature",
    "N*m^2": "bending_stiffness",
    "rad": "angle",
}
"""The quantity whose display unit a result of this SI unit takes."""
_PER_PEAK = "_per_peak_force"
_AT_CURVATURE = re.compile(r"(bending_stiffness)_at_(\d+)")
"""What the shipped protocols call a stiffness at a curvature."""
_ONE_BY_ONE = ("slip_position", "slip_drop")
_DIGITS_ALONE = 4
_DIGITS_OF_INTERVAL = 2
_PLAIN = (1e-3, 1e6)
"""Sizes between which a number is written without a power of ten."""
SUPERSCRIPTS = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)


def in_words(name: str) -> str:
    """Word the name of a result for a person.

    Parameters
    ----------
    name : of a result, snake case, with a cycle or a part after a dot

    Returns
    -------
    Words; for a name that is not known here, its own words.

    Examples
    --------
    >>> in_words("peak_force.2")
    'Peak force, cycle 2'
    >>> in_words("stiffness_first_per_peak_force")
    'Stiffness, first region, per peak force'
    >>> in_words("bending_stiffness_at_3")
    'Bending stiffness at 3 1/m'
    >>> in_words("slip_drop.1")
    'Force lost in slip 1'
    """
    stem, _, part = name.partition(".")
    if stem.endswith(_PER_PEAK):
        words = f"{in_words(stem.removesuffix(_PER_PEAK))}, per peak force"
    elif at := _AT_CURVATURE.fullmatch(stem):
        words = f"{in_words(at[1])} at {at[2]} 1/m"
    else:
        words = _WORDS.get(stem) or stem.replace("_", " ").capitalize()
    if not part:
        return words
    return f"{words} {part}" if stem in _ONE_BY_ONE else f"{words}, cycle {part}"


_NAME = re.compile(r"(?<![\w./-])[a-z]+(?:_[a-z0-9]+)+(?:\.\d+)?(?![\w/]|\.\w)")
_OPEN_ENDED = ("stiffness_", "modulus_")
"""Names that a protocol goes on with as it likes."""


def with_names_in_words(sentence: str) -> str:
    """Word the names of results that stand in a sentence.

    Parameters
    ----------
    sentence : names of files and keys of a protocol in it stay as they are

    Examples
    --------
    >>> with_names_in_words("no modulus, as stiffness_second failed")
    'no modulus, as stiffness, second region failed'
    """

    def word(found: re.Match[str]) -> str:
        stem = found[0].partition(".")[0].removesuffix(_PER_PEAK)
        if stem not in _WORDS and not stem.startswith(_OPEN_ENDED):
            return found[0]
        words = in_words(found[0])
        return words if found.start() == 0 else words[0].lower() + words[1:]

    return _NAME.sub(word, sentence)


def is_main(name: str) -> bool:
    """Tell numbers of the specimen from those of a single slip or of the clocks."""
    return not name.startswith(("slip_", "clock_"))


def shown_in(name: str, unit: str, display: Mapping[str, str]) -> Scale:
    """Find factor and unit that a result is shown in.

    Parameters
    ----------
    name, unit : of the result, in SI
    display : display unit by quantity

    Returns
    -------
    Factor from SI to the display unit, and its name; SI where no display unit is known.
    """
    if name == "clock_drift":
        return Scale(1e6, "ppm")
    wanted = display.get(_QUANTITIES.get(unit, ""))
    return Scale(1.0, unit) if wanted is None else Scale(1.0 / si_factor(wanted, unit), wanted)


def display_of(group: Group) -> Mapping[str, str]:
    """Display units of a group: those of its first sample, as all share a protocol."""
    return group.samples[0].display if group.samples else {}


def unit_words(unit: str) -> str:
    """Write a unit for people: ``N*mm^2`` as N·mm², and nothing for a pure number.

    Examples
    --------
    >>> unit_words("N*mm^2")
    'N·mm²'
    >>> unit_words("um/N")
    'µm/N'
    >>> unit_words("1")
    ''
    """
    raised = re.sub(r"\^(-?\d+)", lambda found: found[1].translate(SUPERSCRIPTS), unit)
    raised = re.sub(r"\bu(?=[a-zA-Z])", "\u00b5", raised)
    return "" if unit == "1" else raised.replace("*", "·")


def heading(name: str, unit: str) -> str:
    """Name of a result in words with its unit in brackets, for a column or an axis."""
    words = unit_words(unit)
    return f"{in_words(name)} ({words})" if words else in_words(name)


@dataclass(frozen=True, slots=True)
class Written:
    """A number as text, with the ends of its interval; both empty where it has none.

    The estimate is empty unless it stands apart from the value.
    """

    value: str
    lower: str = ""
    upper: str = ""
    estimate: str = ""

    @property
    def interval(self) -> str:
        """The interval in words, such as ``46.3 to 58.3``; empty where there is none."""
        about = f"estimate {self.estimate}, " if self.estimate else ""
        return f"{about}{self.lower} to {self.upper}" if self.lower else ""

    @property
    def text(self) -> str:
        """Number and interval in one line."""
        return f"{self.value} ({self.interval})" if self.lower else self.value


def write_number(
    value: float,
    interval: Interval | None,
    factor: float = 1.0,
    *,
    digits: int = _DIGITS_ALONE,
    apart: float | None = None,
) -> Written:
    """Write a number with as many digits as its interval supports.

    Parameters
    ----------
    value, interval : in SI; a value that is not finite is written as a dash
    factor : from SI to the display unit
    digits : significant digits of a number without an interval
    apart : estimate that stands apart from the value, in SI; None where the value says it all

    Returns
    -------
    With an interval, all numbers to the second significant digit of half its width
    (the convention of the GUM, 7.2.6); without one, `digits` significant digits.

    Examples
    --------
    >>> write_number(0.052284, Interval(0.046271, 0.058296), 1e3)
    Written(value='52.3', lower='46.3', upper='58.3', estimate='')
    >>> write_number(1234.567, None).value
    '1235'
    """
    place = place_of(value, interval, factor, digits)
    return _written([value, *_ends(interval), *([] if apart is None else [apart])], factor, place)


def place_of(
    value: float, interval: Interval | None, factor: float = 1.0, digits: int = _DIGITS_ALONE
) -> int:
    """Find the power of ten of the last digit that an interval supports; of `digits` without one.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the display unit
    digits : significant digits of a number without an interval

    Examples
    --------
    >>> place_of(0.052284, Interval(0.046271, 0.058296), 1e3)
    -1
    """
    shown = [factor * number for number in (value, *_ends(interval))]
    half = (max(shown[1:]) - min(shown[1:])) / 2.0 if shown[1:] else 0.0
    if not all(map(math.isfinite, shown)) or not half > 0.0:
        return _last_place(max(map(abs, filter(math.isfinite, shown)), default=0.0), digits)
    return _last_place(half, _DIGITS_OF_INTERVAL)


def plain_numbers(
    value: float, interval: Interval | None, factor: float = 1.0, digits: int = _DIGITS_ALONE
) -> Callable[[float], str]:
    """Make what writes a number and the ends of its interval alike, never as a power of ten.

    Parameters
    ----------
    value, interval, factor, digits : as of `place_of`

    Examples
    --------
    >>> shown = plain_numbers(0.052284, Interval(0.046271, 0.058296), 1e3)
    >>> shown(0.052284), shown(0.046271)
    ('52.3', '46.3')
    """
    place = place_of(value, interval, factor, digits)
    return lambda number: rounded(factor * number, place)


def _ends(interval: Interval | None) -> tuple[float, ...]:
    return () if interval is None else (interval.lower, interval.upper)


def _written(numbers: Sequence[float], factor: float, place: int) -> Written:
    """Value, ends and estimate, as many as there are, with a dash for what is not finite."""
    if not math.isfinite(numbers[0]):
        return Written("\u2013")
    return Written(*_alike([factor * number for number in numbers], place))


def _last_place(size: float, digits: int) -> int:
    """Power of ten of the last of so many significant digits."""
    if size == 0.0 or not math.isfinite(size):
        return -digits
    # rounded first: 9.96 to two digits is 10, not 10.0
    exponent = int(f"{size:.{digits - 1}e}".partition("e")[2])
    return exponent - digits + 1


def _alike(numbers: Iterable[float], place: int) -> list[str]:
    """Round numbers to one place, and give them one power of ten if they are far from one."""
    several = list(numbers)
    largest = max(map(abs, several))
    if _PLAIN[0] <= largest < _PLAIN[1] or largest == 0.0 or not math.isfinite(largest):
        return [rounded(number, place) for number in several]
    power = math.floor(math.log10(largest))
    tail = f" \u00d7 10{str(power).translate(SUPERSCRIPTS)}"
    return [rounded(number / 10.0**power, place - power) + tail for number in several]


def rounded(number: float, place: int) -> str:
    """Write a number down to a power of ten, such as ``52.3`` for the place -1."""
    near = round(number, -place)
    return f"{near + 0.0:.{max(-place, 0)}f}"  # + 0.0: no minus zero
