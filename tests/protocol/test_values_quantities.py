from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.grammar import validated
from labpipe.protocol.values import SI_UNITS, QuantityText, parse_whole
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
    Whole,
)
from labpipe.units import si_factor

POSITIVE = {
    "Length": (Length, "53 mm", 0.053),
    "Area": (Area, "5.26 mm^2", 5.26e-6),
    "Duration": (Duration, "0.5 s", 0.5),
    "Speed": (Speed, "0.423 mm/s", 0.000423),
    "Frequency": (Frequency, "10 Hz", 10.0),
    "Compliance": (Compliance, "0.2 um/N", 0.2e-6),
}
OTHERS = {
    "Offset": (Offset, "-0.8 mm", -0.0008),
    "Distance": (Distance, "0 mm", 0.0),
    "Force": (Force, "5 mN", 0.005),
    "Mass": (Mass, "2.7 g", 0.0027),
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


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (
            Length,
            "53",
            "expected a quantity with a unit such as mm, found '53'."
            " Write it with its unit, such as '53 mm'.",
        ),
        (
            Length,
            "53 s",
            "expected a quantity with a unit such as mm, found '53 s'."
            " s is a unit of time. Write it with its unit, such as '53 mm'.",
        ),
        (
            Length,
            None,
            "expected a quantity with a unit such as mm, found nothing."
            " Write it with its unit, such as '53 mm'.",
        ),
        (Mass, "-1 g", "expected a quantity with a unit such as g from 0 g up, found '-1 g'."),
        (
            Offset,
            "1e400 mm",
            "expected a quantity with a unit such as mm that is finite, found '1e400 mm'.",
        ),
        (
            Ratio,
            "5 deg",
            "expected a pure number (also in % or ppm), found '5 deg'. Write it such as '0.2 %'.",
        ),
        (
            Share,
            "0 %",
            "expected a pure number (also in % or ppm) above 0 %, at most 100 %, found '0 %'.",
        ),
        (
            Share,
            "110 %",
            "expected a pure number (also in % or ppm) above 0 %, at most 100 %, found '110 %'.",
        ),
        (
            Compliance,
            "0.2 mm",
            "expected a quantity with a unit such as um/N, found '0.2 mm'."
            " mm is a unit of length. Write it with its unit, such as '0.2 um/N'.",
        ),
        (
            Span,
            "51",
            "expected a span such as '0.1 s', '2 mm' (of travel), '5 %' (of a branch) or"
            " '51 samples', found '51'. Write it with its unit, such as '0.1 s'.",
        ),
        (Span, "0 samples", "expected a span of at least 1 sample, found '0 samples'."),
        (
            Span,
            "120 %",
            "expected a pure number (also in % or ppm) from 0.0001 % up, at most 100 %,"
            " found '120 %'.",
        ),
        (Span, "0 s", "expected a quantity with a unit such as s above 0 s, found '0 s'."),
    ],
)
def test_what_is_refused_is_told(kind: object, text: object, message: str) -> None:
    assert _fault(kind, text).startswith(message)


@pytest.mark.parametrize(
    ("kind", "text", "remedy"),
    [
        (Length, "12,5 mm", "Write it with a decimal point: 12.5 mm."),
        (Length, "2,1 mm", "Write it with a decimal point: 2.1 mm."),
        (Length, "-0,125 mm", "Write it with a decimal point: -0.125 mm."),
        (Length, "1,000 mm", "Write 1000 mm or 1.000 mm, as meant."),
        (Length, "1 000 mm", "without signs between thousands: 1000 mm."),
        (Length, "1'000 mm", "without signs between thousands: 1000 mm."),
        (Length, "1.000,5 mm", "without signs between thousands: 1000.5 mm."),
        (Length, "1,000.5 mm", "without signs between thousands: 1000.5 mm."),
        (Length, "1 000 000,25 mm", "without signs between thousands: 1000000.25 mm."),
        (Length, "85", "Write it with its unit, such as '53 mm'."),
        (Length, "85 kg", "kg is a unit of mass. Write it with its unit, such as '53 mm'."),
        (Length, "85 MM", "labpipe knows no unit 'MM'."),
        (Length, "20 1/m", "1/m is a unit of curvature."),
        (Length, "0 mm", "Correct the number; is its unit right?"),
        (Length, "-5 mm", "Correct the number; is its unit right?"),
        (Force, "5 kg", "kg is a unit of mass: write mass x 9.81 m/s^2 in N, or kgf for kg."),
        (Force, "500 g", "g is a unit of mass: write mass x 9.81 m/s^2 in N, or kgf for kg."),
        (Mass, "5 N", "N is a unit of force."),
        (Ratio, "0,5", "Write it with a decimal point: 0.5."),
        (Ratio, "0,5 %", "Write it with a decimal point: 0.5 %."),
        (Span, "0,1 s", "Write it with a decimal point: 0.1 s."),
        (Span, "0,1 mm", "Write it with a decimal point: 0.1 mm."),
        (Span, "1 kg", "kg is a unit of mass."),
    ],
)
def test_a_remedy_of_what_was_written(kind: object, text: str, remedy: str) -> None:
    assert remedy in _fault(kind, text)


@pytest.mark.parametrize("text", ["three", "2.5", "1", "13", "", True, None, "0x3"])
def test_a_whole_number_in_its_range(text: object) -> None:
    whole = Whole(2, 12)

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
        yield from (QuantityText(each) for each in get_args(kind) if isinstance(each, Quantity))


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


@pytest.mark.parametrize("quantity", SI_UNITS)
def test_every_quantity_has_an_si_unit(quantity: str) -> None:
    assert si_factor(SI_UNITS[quantity], SI_UNITS[quantity]) == 1.0
