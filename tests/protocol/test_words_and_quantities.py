"""Quantities, words and patterns of names."""

from __future__ import annotations

import re
from collections.abc import Iterator
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

POSITIVE = {
    "Length": (Length, "53 mm", 0.053),
    "Area": (Area, "5.26 mm^2", 5.26e-6),
    "Duration": (Duration, "0.5 s", 0.5),
    "Speed": (Speed, "0.423 mm/s", 0.000423),
    "Frequency": (Frequency, "10 Hz", 10.0),
}


OTHERS = {
    "Offset": (Offset, "-0.8 mm", -0.0008),
    "Distance": (Distance, "0 mm", 0.0),
    "Force": (Force, "5 mN", 0.005),
    "Mass": (Mass, "2.7 g", 0.0027),
    "Compliance": (Compliance, "0 um/N", 0.0),
    "Ratio": (Ratio, "0.2 %", 0.002),
    "Ratio in ppm": (Ratio, "500 ppm", 0.0005),
    "bare ratio": (Ratio, "0.5", 0.5),
    "Share": (Share, "10 %", 0.1),
    "the whole as a share": (Share, "1", 1.0),
}


def _parse(kind: Any, text: object) -> object:
    return TypeAdapter(validated(kind)).validate_python(text)


def _fault(kind: Any, text: object) -> str:
    with pytest.raises(ValidationError) as info:
        _parse(kind, text)
    return info.value.errors()[0]["msg"].strip()


@pytest.mark.parametrize("case", [*POSITIVE.values(), *OTHERS.values()], ids=[*POSITIVE, *OTHERS])
def test_a_quantity_becomes_si(case: tuple[object, str, float]) -> None:
    kind, text, value = case

    assert _parse(kind, text) == value


@pytest.mark.parametrize(("kind", "text", "value"), POSITIVE.values(), ids=POSITIVE)
def test_lengths_of_zero_and_below_are_refused(kind: object, text: str, value: float) -> None:
    number, unit = text.split()

    assert f"above 0 {unit}, found '0 {unit}'." in _fault(kind, f"0 {unit}")
    assert f"above 0 {unit}, found '-{number} {unit}'." in _fault(kind, f"-{number} {unit}")


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
    prefix=st.sampled_from(["", "shown"]),
)
def test_a_quantity_written_reads_back_as_the_same_float(
    quantity: QuantityText, number: float, prefix: str
) -> None:
    unit = quantity.of.shown if prefix else quantity.of.unit
    try:
        value = quantity.parse(f"{number!r} {unit}")
    except ValueError:
        value = number * si_factor(unit, quantity.of.unit)
        assert value in (0.0, float("inf")) or value > quantity.of.most
        return

    assert quantity.parse(quantity.written(value)) == value


def test_a_quantity_is_written_as_a_person_would() -> None:
    assert QuantityText(Quantity("m", "mm", "1 mm")).written(0.053) == "53 mm"


def test_a_value_too_large_for_the_unit_of_people_is_written_in_si() -> None:
    assert QuantityText(Quantity("m", "mm", "1 mm")).written(1e308) == "1e+308 m"


@given(st.sampled_from(["5 mm", "-.5e3 s", "+2. N/V", "3 %", "1e-3ppm"]))
def test_the_json_schema_takes_a_number_with_unit(text: str) -> None:
    jsonschema.validate(text, TypeAdapter(validated(Length)).json_schema())


@pytest.mark.parametrize("text", ["mm", "5", 5, "five mm"])
def test_the_json_schema_refuses_what_has_no_unit(text: object) -> None:
    with pytest.raises(jsonschema.ValidationError, match=re.escape(repr(text))):
        jsonschema.validate(text, TypeAdapter(validated(Length)).json_schema())


NAME = TypeAdapter(Annotated[str, file_inside("the folder of the test", "Copy it.")])


@pytest.mark.parametrize("name", ["a.csv", "below/a.csv", "..a.csv", "DAQ\u00a0- \u2026 力.txt"])
def test_a_file_is_in_its_folder_or_below(name: str) -> None:
    assert NAME.validate_python(name) == name


@pytest.mark.parametrize(
    "name", ["../a.csv", "a/../../b", r"a\..\b", "/a.csv", r"C:\a.csv", "C:a.csv"]
)
def test_a_file_elsewhere_is_refused(name: str) -> None:
    with pytest.raises(ValidationError) as info:
        NAME.validate_python(name)
    expected = f"expected a file inside the folder of the test, found {name!r}. Copy it."
    assert info.value.errors()[0]["msg"] == expected


@pytest.mark.parametrize("value", [" ", "", 1, None, "a\0b", "a\nb", "a\ud800"])
def test_what_is_no_name_of_a_file_is_refused(value: object) -> None:
    with pytest.raises(ValidationError, match="expected the name of a file"):
        NAME.validate_python(value)


@pytest.mark.parametrize("name", ["A2-085-1", "0333", "Größe_1", "v1.2+b", "console", "a" * 120])
def test_names_of_tests(name: str) -> None:
    assert is_name_of_a_test(name)
    assert TypeAdapter(FileStem).validate_python(name) == name


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", r"a\b", "a b", "CON", "lpt1.x", "a.", "ö" * 61, "a\n"]
)
def test_what_cannot_be_the_name_of_a_test(name: str) -> None:
    assert not is_name_of_a_test(name)
    with pytest.raises(ValidationError):
        TypeAdapter(FileStem).validate_python(name)


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
    ("{date} {test}", "2026-03-04 T", {"date": "2026-03-04", "test": "T"}),
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
