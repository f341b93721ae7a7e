"""Quantities, words and patterns of names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Annotated, Any, get_args

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.grammar import validated
from labpipe.protocol.name_patterns import parse_name_pattern
from labpipe.protocol.values import (
    FileStem,
    QuantityText,
    file_inside,
    is_name_of_a_test,
    parse_whole,
)
from labpipe.records.declarations import (
    Area,
    Compliance,
    Distance,
    Duration,
    Force,
    Frequency,
    Length,
    Mass,
    Offset,
    Quantity,
    Ratio,
    Share,
    Span,
    Speed,
    WholeNumber,
)
from labpipe.units import si_factor


def _parse(kind: Any, text: object) -> object:
    return TypeAdapter(validated(kind)).validate_python(text)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (Length, "53 mm", 0.053),
        (Area, "5.26 mm^2", 5.26e-6),
        (Duration, "0.5 s", 0.5),
        (Speed, "0.423 mm/s", 0.000423),
        (Frequency, "10 Hz", 10.0),
        (Offset, "-0.8 mm", -0.0008),
        (Distance, "0 mm", 0.0),
        (Force, "5 mN", 0.005),
        (Mass, "2.7 g", 0.0027),
        (Compliance, "0 um/N", 0.0),
        (Ratio, "0.2 %", 0.002),
        (Ratio, "500 ppm", 0.0005),
        (Ratio, "0.5", 0.5),
        (Share, "10 %", 0.1),
        (Share, "1", 1.0),
    ],
)
def test_a_quantity_becomes_si(kind: object, text: str, value: float) -> None:
    assert _parse(kind, text) == value


@pytest.mark.parametrize(
    ("kind", "unit"),
    [(Length, "mm"), (Area, "mm^2"), (Duration, "s"), (Speed, "mm/s"), (Frequency, "Hz")],
)
@pytest.mark.parametrize("number", ["0", "-5"])
def test_what_must_be_above_zero(kind: object, unit: str, number: str) -> None:
    with pytest.raises(ValidationError, match=rf"above 0 {re.escape(f'{unit}, found')} '{number} "):
        _parse(kind, f"{number} {unit}")


@pytest.mark.parametrize("text", ["three", "2.5", "1", "13", "", True, None, "0x3"])
def test_a_whole_number_in_its_range(text: object) -> None:
    whole = WholeNumber(2, 12)

    with pytest.raises(ValueError, match="expected a whole number from 2 to 12, found "):
        parse_whole(whole, text)
    assert parse_whole(whole, "2") == parse_whole(whole, 2) == 2


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("0.1 s", Span("time", 0.1)),
        ("20 ms", Span("time", 0.02)),
        ("2 mm", Span("travel", 0.002)),
        ("5 %", Span("branch", 0.05)),
        ("51 samples", Span("samples", 51.0)),
    ],
)
def test_a_span_in_its_four_ways(text: str, span: Span) -> None:
    adapter = TypeAdapter(validated(Span))

    assert adapter.validate_python(text) == span
    assert adapter.validate_python(adapter.dump_python(span)) == span
    assert adapter.validate_python(span) is span


KINDS = (
    *(Length, Offset, Distance, Area, Duration, Force, Compliance),
    *(Mass, Speed, Frequency, Ratio, Share),
)


def _quantities() -> Iterator[QuantityText]:
    for kind in KINDS:
        yield from (QuantityText(arg) for arg in get_args(kind) if isinstance(arg, Quantity))


@given(
    quantity=st.sampled_from(list(_quantities())),
    number=st.floats(min_value=1e-300, max_value=1e308),
    is_shown=st.booleans(),
)
def test_a_quantity_written_reads_back_as_the_same_float(
    quantity: QuantityText, number: float, is_shown: bool
) -> None:
    unit = quantity.of.shown if is_shown else quantity.of.unit
    try:
        value = quantity.parse(f"{number!r} {unit}")
    except ValueError:
        value = number * si_factor(unit, quantity.of.unit)
        assert value in (0.0, float("inf")) or value > quantity.of.most
        return

    assert quantity.parse(quantity.written(value)) == value


@pytest.mark.parametrize(("value", "text"), [(0.053, "53 mm"), (1e308, "1e+308 m")])
def test_a_quantity_is_written_as_a_person_would(value: float, text: str) -> None:
    """In SI where it is too large for the unit of people."""
    assert QuantityText(Quantity("m", "mm", "1 mm")).written(value) == text


@pytest.mark.parametrize("text", ["5 mm", "-.5e3 s", "+2. N/V", "3 %", "1e-3ppm"])
@pytest.mark.parametrize("wrong", ["mm", "5", 5, "five mm"])
def test_the_json_schema_takes_a_number_with_unit(text: str, wrong: object) -> None:
    checker = jsonschema.Draft202012Validator(TypeAdapter(validated(Length)).json_schema())
    assert checker.is_valid(text)
    assert not checker.is_valid(wrong)


NAME = TypeAdapter(Annotated[str, file_inside("the folder of the test", "Copy it.")])
ELSEWHERE = "expected a file inside the folder of the test, found .* Copy it"
UPWARDS = ["../a.csv", "a/../../b", r"a\..\b", "/a.csv", r"C:\a.csv", "C:a.csv"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        *((name, "") for name in ("a.csv", "below/a.csv", "..a.csv", "DAQ\u00a0- \u2026 力.txt")),
        *((name, ELSEWHERE) for name in UPWARDS),
        *((name, "the name of a file") for name in (" ", "", 1, None, "a\0b", "a\nb", "a\ud800")),
    ],
)
def test_a_file_is_in_its_folder_or_below(name: object, message: str) -> None:
    if not message:
        assert NAME.validate_python(name) == name
        return
    with pytest.raises(ValidationError, match=message):
        NAME.validate_python(name)


NAMES = ["A2-085-1", "0333", "Größe_1", "v1.2+b", "console", "a" * 120]
NO_NAMES = ["", ".", "..", "../x", "a/b", r"a\b", "a b", "CON", "lpt1.x", "a.", "ö" * 61, "a\n"]


@pytest.mark.parametrize(
    ("name", "is_name"), [*((name, True) for name in NAMES), *((name, False) for name in NO_NAMES)]
)
def test_names_of_tests(name: str, is_name: bool) -> None:
    assert is_name_of_a_test(name) is is_name
    with nullcontext() if is_name else pytest.raises(ValidationError):
        assert TypeAdapter(FileStem).validate_python(name) == name


MATCHES = [
    (
        "{type}-{length mm}-{sample}.mat",
        "A2-085-1.mat",
        {"type": "A2", "length": "85 mm", "sample": "1"},
    ),
    ("{type}-{sample}.csv", "TWB-B1-19-PVC-2.CSV", {"type": "TWB-B1-19-PVC", "sample": "2"}),
    ("{test}/DAQ* (Timed).txt", "T1/DAQ- Crosshead, … - (Timed).txt", {"test": "T1"}),
    ("{type}/{type}_{sample} *", "A/A_2 take.csv", {"type": "A", "sample": "2"}),
    ("{date}_{test}", "20260304_T", {"date": "2026-03-04", "test": "T"}),
    ("{outer_diameter in}x{test}", "0,5xT", {"outer_diameter": "0.5 in", "test": "T"}),
    ("{labels.batch}.{test}", "b.c.T", {"labels.batch": "b.c", "test": "T"}),
    ("a.b{test}", "axbT", None),
    ("{type}/{type}_{sample}", "A/B_2", None),
    ("{test}.mat", "a/b.mat", None),
    ("{test}.mat", "x" * 301 + ".mat", None),
    ("{length mm}.mat", "long.mat", None),
]


@pytest.mark.parametrize(("pattern", "name", "fields"), MATCHES)
def test_names_are_taken_apart(pattern: str, name: str, fields: dict[str, str] | None) -> None:
    assert parse_name_pattern(pattern).match(name) == fields


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("{typ}-1", "one of {test}, {type}, "),
        ("{length}-1", "a dimension with its unit such as {length mm}"),
        ("{length N}-1", "a dimension with a unit of length, such as {length mm}"),
        ("{type mm}", "one of {test}"),
        ("a{", "one of {test}"),
        ("a}b", "one of {test}"),
        ("{}", "one of {test}"),
        ("x" * 301, "a pattern of at most 300 letters"),
    ],
)
def test_what_is_no_pattern(pattern: str, expected: str) -> None:
    with pytest.raises(ValueError, match=re.escape(expected)):
        parse_name_pattern(pattern)


def test_the_name_of_a_test_ends_behind_the_last_field() -> None:
    pattern = parse_name_pattern("in/{type}-{sample}_force.mat")
    assert pattern.stem("in/A2-1_force.mat") == "A2-1"
    assert parse_name_pattern("*.mat").stem("in/x.mat") == "x.mat"


@given(st.text(min_size=1, max_size=40))
def test_every_sign_stands_for_itself(text: str) -> None:
    bare = re.sub(r"[{}*/\\]", "", text) or "x"
    found = parse_name_pattern(bare + "{test}").match(bare + "T")
    assert found == {"test": "T"}
