from __future__ import annotations

from itertools import combinations
from math import cos, pi, sin
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from labpipe.errors import ProtocolError
from labpipe.protocol.load import checked
from labpipe.protocol.sheet_grammar import SheetBundle, TestSheet
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire

SHEET = """\
test: b1
protocol: taped-bundle
specimen:
  type: TWB
  spool: s1
  sample: 1
  bundle:
    {}
files: {{force: force.mat}}
"""
TAPED = """\
wires: {B1: 10, B2: {number: 9, diameter: 1.6 mm}}
number: 19
arrangement: asymmetric
tape: PVC
taping: half-lap
conduit: corrugated-tube
conduit_bore: 10.7 mm
"""


def sheet_of(bundle: str) -> str:
    return SHEET.format(bundle.strip().replace("\n", "\n    "))


def bundle_of(bundle: str) -> Bundle:
    record = checked(TestSheet, parse_yaml(sheet_of(bundle), "x")).specimen.record.bundle
    assert record is not None
    return record


def told(bundle: str) -> list[str]:
    """Give the lines of the error of a bundle, without line, column and the keys around it."""
    with pytest.raises(ProtocolError) as info:
        checked(TestSheet, parse_yaml(sheet_of(bundle), "x"))
    lines = str(info.value).splitlines()
    assert all("(specimen.bundle" in line for line in lines)
    return [line.split("(specimen.bundle")[1].lstrip(".") for line in lines]


def test_a_bundle_holds_what_was_written() -> None:
    assert bundle_of(TAPED) == Bundle(
        wires=(BundleWire("B1", 10), BundleWire("B2", 9, 0.0016)),
        arrangement="asymmetric",
        tape="PVC",
        taping="half-lap",
        conduit="corrugated-tube",
        conduit_bore=0.0107,
    )
    assert bundle_of("wires: {B1: 7}") == Bundle((BundleWire("B1", 7),))


def test_blank_keys_say_nothing() -> None:
    blank = "wires: {B1: 7}\nnumber:\npositions:\nconduit_bore:\n"

    assert bundle_of(blank) == Bundle((BundleWire("B1", 7),))


def test_wires_in_words_are_those_of_a_block() -> None:
    words = bundle_of("wires: 10 B1 + 9 B2 (1.6 mm)")

    assert words == bundle_of("wires: {B1: 10, B2: {number: 9, diameter: 1.6 mm}}")
    assert bundle_of(f"wires: {words.composition}").composition == words.composition


@given(
    st.dictionaries(st.from_regex(r"[A-Z][A-Za-z0-9.-]{0,8}", fullmatch=True), st.integers(1, 99))
)
def test_a_composition_in_words_is_read_back(numbers: dict[str, int]) -> None:
    bundle = Bundle(tuple(BundleWire(kind, number) for kind, number in numbers.items()))
    if numbers:
        assert SheetBundle.model_validate({"wires": bundle.composition}).record == bundle


def test_the_words_are_those_of_the_record() -> None:
    fields = SheetBundle.model_fields

    assert get_args(fields["arrangement"].annotation) == ARRANGEMENTS
    assert get_args(fields["taping"].annotation) == TAPINGS


HEXAGON = [(0.0, 0.0), *((cos(k * pi / 3), sin(k * pi / 3)) for k in range(6))]


def positions(scale: float) -> str:
    """Write seven positions, a hexagon around its middle; `scale` is the distance in mm."""
    places = (f"[{x * scale:.6f} mm, {y * scale:.6f} mm]" for x, y in HEXAGON)
    return f"positions: [{', '.join(places)}]"


SEVEN = "wires: {B1: {number: 4, diameter: 1.6 mm}, B2: {number: 3, diameter: 1.6 mm}}\n"


def test_positions_may_touch_and_give_way_a_little() -> None:
    for scale in (1.6, 1.5841):
        places = bundle_of(SEVEN + positions(scale)).positions
        assert places[1] == pytest.approx((scale * 1e-3, 0.0))
        assert len(places) == 7
        assert min(
            (x - u) ** 2 + (y - v) ** 2 for (x, y), (u, v) in combinations(places, 2)
        ) == pytest.approx((scale * 1e-3) ** 2, rel=1e-5)


def test_positions_that_overlap_name_both_wires() -> None:
    lines = told(SEVEN + positions(1.58))

    assert lines[0] == (
        "positions.1): expected wires beside each other, found wire 2 (B1) 0.02 mm inside"
        " wire 1 (B1). Check both positions and the diameters."
    )
    assert lines[-1].startswith("positions.6): ")
    assert "found wire 7 (B2) 0.02 mm inside wire 1 (B1)" in lines[-1]
    assert len(lines) == 6


@pytest.mark.parametrize(
    ("bundle", "message"),
    [
        (
            TAPED.replace("19", "18"),
            "number): expected 19, the number of the wires (10 B1 + 9 B2), found '18'."
            " Correct one of the two.",
        ),
        (
            TAPED.replace("number: 19", "number: many"),
            "number): expected a whole number from 1 to 100000, found 'many'.",
        ),
        (
            TAPED.replace("asymmetric", "asymetric"),
            "arrangement): expected one of 'asymmetric', 'symmetric', 'packed', found"
            " 'asymetric'. Did you mean 'asymmetric'?",
        ),
        (
            TAPED.replace("half-lap", "halflap"),
            "taping): expected one of 'half-lap', 'coarse', 'none', found 'halflap'."
            " Did you mean 'half-lap'?",
        ),
        (
            TAPED.replace("B1: 10", "B1: ten"),
            "wires.B1): expected a whole number from 1 to 1000, found 'ten'.",
        ),
        (
            TAPED.replace("1.6 mm", "1.6"),
            "wires.B2.diameter): expected a quantity with a unit such as mm, found '1.6'."
            " Write it with its unit, such as '53 mm'.",
        ),
        (
            TAPED.replace("diameter", "diametr"),
            "wires.B2.diametr): expected one of the keys 'diameter', 'number', found 'diametr'."
            " Did you mean 'diameter'?",
        ),
        (
            "wires: [B1, B2]",
            "wires): expected a block of keys with values, found a list.",
        ),
        (
            "wires: {}",
            "wires): expected at least one entry, found an empty block.",
        ),
        (
            "wires: 10 B1, 9 B2",
            "wires): expected wires by type, such as {B1: 10, B2: 9} or '10 B1 + 9 B2', found"
            " '10 B1, 9 B2'.",
        ),
        (
            "wires: 10 B1 + nine B2",
            "wires): expected wires by type, such as {B1: 10, B2: 9} or '10 B1 + 9 B2', found"
            " '10 B1 + nine B2'.",
        ),
        (
            "wires: B1",
            "wires): expected wires by type, such as {B1: 10, B2: 9} or '10 B1 + 9 B2', found"
            " 'B1'.",
        ),
        (
            "wires: 10 B1 + 9 B1",
            "wires): expected each type once, found '10 B1 + 9 B1'. Add the numbers of 'B1'.",
        ),
        (
            "wires: {B1: 7}\narrangement: symmetric",
            "arrangement): expected 'packed' for wires of one type, found 'symmetric'."
            " Only wires of different types can be spread one way or another: leave it out.",
        ),
        (
            SEVEN + "positions: [[0 mm, 0 mm], [2 mm, 0 mm]]",
            "positions): expected 7 positions, one per wire, found 2."
            " List one [x, y] for every wire, in the order of 'wires'.",
        ),
        (
            "wires: {B1: 1, B2: {number: 1, diameter: 1.6 mm}}\n"
            "positions: [[0 mm, 0 mm], [2 mm, 0 mm]]",
            "positions): expected positions of wires whose diameters are given, found none for"
            " 'B1'. Write it like {B1: {number: 10, diameter: 1.1 mm}}.",
        ),
        (
            "wires: {B1: 1}\npositions: [[0 mm, 0 mm, 0 mm]]",
            "positions.0): expected a list of two lengths, such as [0 mm, 1.2 mm], found a list.",
        ),
        (
            "wires: {B1: 1}\npositions: [0 mm]",
            "positions.0): expected a list of two lengths, such as [0 mm, 1.2 mm], found '0 mm'.",
        ),
        (
            "wires: {B1: 1}\npositions: [[0 mm, 1]]",
            "positions.0.1): expected a quantity with a unit such as mm, found '1'."
            " Write it with its unit, such as '0.8 mm'.",
        ),
        (
            "wires: {B1: 7}\ntaping: coarse",
            "taping): expected 'none' where there is no tape, found 'coarse'."
            " Write what tape it is, such as 'tape: PVC', or 'tape: unknown'.",
        ),
        (
            "wires: {B1: 7}\ntape: PET",
            "tape): expected 'none' where 'taping' is 'none', found 'PET'."
            " Write how it is wound: 'taping: half-lap' or 'taping: coarse'.",
        ),
        (
            "wires: {B1: 7}\nconduit_bore: 10.7 mm",
            "conduit_bore): expected no bore where there is no conduit, found '10.7 mm'."
            " Write what conduit it is, or leave the bore out.",
        ),
        (
            SEVEN + "conduit: tube\nconduit_bore: 4.4 mm",
            "conduit_bore): expected at least 4.445 mm, so that the wires find room, found"
            " 4.4 mm. Check the bore, the diameters and the number of wires.",
        ),
        (
            "wires: {B1: {number: 1, diameter: 3 mm}}\nconduit: tube\nconduit_bore: 2.9 mm",
            "conduit_bore): expected at least 3 mm, so that the wires find room, found 2.9 mm."
            " Check the bore, the diameters and the number of wires.",
        ),
        ("tape: none", "): expected the key 'wires', found no such key. Add the key 'wires'."),
    ],
)
def test_what_is_wrong_is_told(bundle: str, message: str) -> None:
    assert message in told(bundle)


def test_a_bore_that_holds_the_wires_and_one_of_wires_of_unknown_size() -> None:
    tube = "conduit: tube\nconduit_bore: 4.45 mm"

    assert bundle_of(SEVEN + tube).conduit_bore == pytest.approx(0.00445)
    assert bundle_of("wires: {B1: 70}\n" + tube).conduit_bore == pytest.approx(0.00445)
    alone = "wires: {B1: {number: 1, diameter: 4.45 mm}}\n"
    assert bundle_of(alone + tube).number == 1


def test_faults_of_wires_do_not_hide_the_others_or_make_new_ones() -> None:
    bundle = "wires: {B1: ten}\nnumber: 19\narrangement: symmetric\npositions: [[1 mm, 2 mm]]\n"

    assert [line.split(")")[0] for line in told(bundle + "tape: PVC\n")] == ["wires.B1", "tape"]
    assert [line.split(")")[0] for line in told(bundle + "conduit: a\nconduit_bore: 1 mm\n")] == [
        "wires.B1"
    ]


words = st.sampled_from(
    ["7 B1", "7", "B1", "none", "symmetric", "half-lap", "1.6 mm", "[", "1e99 mm", ""]
)
anything = st.recursive(
    words | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=6,
)
keys = st.sampled_from(["number", "diameter", *SheetBundle.model_fields])


def kinds_of_fault(bundle: object) -> set[str]:
    try:
        SheetBundle.model_validate(bundle)
    except ValidationError as error:
        return {line["type"] for line in error.errors()}
    return set()


@given(st.dictionaries(keys, anything | st.dictionaries(words, st.just("7")), max_size=6))
def test_whatever_is_written_is_taken_or_told_in_our_words(bundle: dict[str, object]) -> None:
    assert kinds_of_fault(bundle) <= {"labpipe"}
