"""Quantities, words and patterns of names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Annotated, Any, get_args

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.grammar import (
    FileStem,
    QuantityText,
    build_path_validator,
    build_pydantic_type,
    is_test_name,
    parse_whole_number,
)
from labpipe.protocol.sheet_grammar import parse_name_pattern
from labpipe.records.declarations import (
    Area,
    Compliance,
    Distance,
    Duration,
    Force,
    Fraction,
    Frequency,
    Length,
    Mass,
    Offset,
    Quantity,
    Ratio,
    Span,
    Speed,
    WholeNumber,
)
from labpipe.units import get_conversion_factor
from tests.approved import Approve


def _parse(kind: Any, text: object) -> object:
    return TypeAdapter(build_pydantic_type(kind)).validate_python(text)


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
        (Fraction, "10 %", 0.1),
        (Fraction, "1", 1.0),
    ],
)
def test_a_quantity_becomes_si(kind: object, text: str, value: float) -> None:
    assert _parse(kind, text) == value


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
    adapter = TypeAdapter(build_pydantic_type(Span))

    assert adapter.validate_python(text) == span
    assert adapter.validate_python(adapter.dump_python(span)) == span
    assert adapter.validate_python(span) is span


KINDS = (
    *(Length, Offset, Distance, Area, Duration, Force, Compliance),
    *(Mass, Speed, Frequency, Ratio, Fraction),
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
    unit = quantity.quantity.display_unit if is_shown else quantity.quantity.unit
    try:
        value = quantity.parse(f"{number!r} {unit}")
    except ValueError:
        value = number * get_conversion_factor(unit, quantity.quantity.unit)
        assert value in (0.0, float("inf")) or value > quantity.quantity.maximum
        return

    assert quantity.parse(quantity.format(value)) == value


def test_a_quantity_is_written_as_a_person_would() -> None:
    """In SI where it is too large for the unit of people."""
    length = QuantityText(Quantity("m", "mm", "1 mm"))
    assert [length.format(value) for value in (0.053, 1e308)] == ["53 mm", "1e+308 m"]


@pytest.mark.parametrize("text", ["5 mm", "-.5e3 s", "+2. N/V", "3 %", "1e-3ppm"])
@pytest.mark.parametrize("wrong", ["mm", "5", 5, "five mm"])
def test_the_json_schema_takes_a_number_with_unit(text: str, wrong: object) -> None:
    checker = jsonschema.Draft202012Validator(
        TypeAdapter(build_pydantic_type(Length)).json_schema()
    )
    assert checker.is_valid(text)
    assert not checker.is_valid(wrong)


NAME = TypeAdapter(Annotated[str, build_path_validator("the folder of the test", "export")])
ELSEWHERE = "expected a file inside the folder of the test, found .* Copy the export"
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
    assert is_test_name(name) is is_name
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
    ("{length um}_{test}", "1234567.8_T", {"length": "1234567.8 um", "test": "T"}),
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


def test_the_name_of_a_test_ends_behind_the_last_field() -> None:
    assert parse_name_pattern("in/{type}-{sample}_f.mat").get_stem("in/A2-1_f.mat") == "A2-1"
    assert parse_name_pattern("*.mat").get_stem("in/x.mat") == "x.mat"


NO_PATTERNS = ["{typ}-1", "{length}-1", "{length N}-1", "{type mm}", "a{", "a}b", "{}", "x" * 301]


def test_what_is_refused(approved: Approve) -> None:
    """Patterns, and texts that are no whole number from 2 to 12."""
    calls: list[tuple[Callable[..., object], tuple[object, ...]]]
    calls = [(parse_name_pattern, (pattern,)) for pattern in NO_PATTERNS]
    numbers: tuple[object, ...] = ("three", "2.5", "1", "13", "", True, None, "0x3")
    calls += [(parse_whole_number, (WholeNumber(2, 12), text)) for text in numbers]
    messages = []
    for parse, given_to_it in calls:
        with pytest.raises(ValueError) as refused:  # noqa: PT011  the text is approved
            parse(*given_to_it)
        messages.append(refused.value)
    approved(messages)
    assert [parse_whole_number(WholeNumber(2, 12), text) for text in ("2", 2)] == [2, 2]


@given(st.text(min_size=1, max_size=40))
def test_every_sign_stands_for_itself(text: str) -> None:
    literal = re.sub(r"[{}*/\\]", "", text) or "x"
    matched = parse_name_pattern(literal + "{test}").match(literal + "T")
    assert matched == {"test": "T"}
