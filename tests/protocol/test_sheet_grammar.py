"""Test sheets and the bundles in them, in blocks and in words."""

from __future__ import annotations

from datetime import date
from itertools import combinations
from math import cos, pi, sin

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labpipe.errors import Fault, UsageError
from labpipe.protocol.load import validate_document
from labpipe.protocol.sheet_grammar import SheetBundle, TestSheet, format_test_sheet, parse_bundle
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import Specimen

SHEET = """\
test: A2-085-1
protocol: wire
specimen: {type: A2, spool: A2-s1, sample: 01, length: 80 mm%s}
files: {force: force.mat}
"""


def read(sheet: str) -> TestSheet:
    return validate_document(TestSheet, parse_yaml(sheet, "x"))


def test_a_sheet_holds_what_was_written() -> None:
    sheet = read(SHEET % "" + "date: 2026-03-04\n")
    assert (sheet.test, sheet.specimen.sample, sheet.date) == ("A2-085-1", "01", date(2026, 3, 4))
    assert (sheet.operator, sheet.overrides) == ("", {})
    more = ", span: 6 in, bundle: {wires: 7 B1}, labels: {cured: 24 h, lot: 07}"
    assert read(SHEET % more).specimen.record == Specimen(
        "A2",
        "A2-s1",
        "01",
        {"length": 0.080, "span": 0.1524},
        Bundle((BundleWire("B1", 7),)),
        {"cured": "24 h", "lot": "07"},
    )


DATA: dict[str, object] = {
    "test": "0333",
    "protocol": "wire",
    "specimen": {"type": "A2", "spool": "no", "sample": "01", "length": "80 mm"},
    "date": "2026-03-04",
    "operator": "lab",
    "files": {"force": "a.mat", "markers": ["b.csv", "c.csv"]},
}


def test_a_sheet_is_written_with_comments() -> None:
    assert (
        format_test_sheet(DATA)
        == """\
# One test: what was tested, and which exports belong to it.
test: '0333'
protocol: wire              # name of a protocol, or a path beside this file
specimen:                   # samples are cut from a spool, spools belong to a type
  type: A2
  spool: 'no'
  sample: '01'
  length: 80 mm
date: 2026-03-04
operator: lab
files:                      # role: file in this folder, or a list of the parts of one recording
  force: a.mat
  markers:
  - b.csv
  - c.csv
# overrides:                # values of the protocol that this test changes, and why
#   sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}
"""
    )


TEXTS = st.text(min_size=1, max_size=30)


LINES = st.text(st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp", "Cn")), min_size=1)


@example("a\nb", "0", "0")
@example("0", "0", "\x85")
@example("0", "#: '", "0")
@given(TEXTS, LINES, TEXTS)
def test_a_sheet_written_reads_back(protocol: str, sample: str, value: str) -> None:
    specimen = {"type": "A2", "spool": "s", "sample": sample}
    overrides = {"rig.cycles": {"value": value, "because": "x"}}
    data = DATA | {"protocol": protocol, "specimen": specimen, "overrides": overrides}

    sheet = read(format_test_sheet(data))
    assert (sheet.protocol, sheet.specimen.sample) == (protocol, sample)
    assert sheet.overrides["rig.cycles"].value == value


def test_what_is_wrong_is_found_before_writing() -> None:
    assert TestSheet.read(DATA)[1] == []
    (fault,) = TestSheet.read(DATA | {"date": "yesterday"})[1]
    assert (fault.path, fault.found) == (("date",), "'yesterday'")


def bundle_of(**block: object) -> Bundle:
    return SheetBundle.model_validate(block).record


TAPED = {
    "wires": {"B1": 10, "B2": {"number": 9, "diameter": "1.6 mm"}},
    "number": 19,
    "arrangement": "asymmetric",
    "tape": "PVC",
    "taping": "half-lap",
    "conduit": "corrugated-tube",
    "conduit_bore": "10.7 mm",
}


def test_a_bundle_holds_what_was_written() -> None:
    wires = (BundleWire("B1", 10), BundleWire("B2", 9, 0.0016))
    bundle = Bundle(wires, "asymmetric", (), "PVC", "half-lap", "corrugated-tube", 0.0107)
    assert bundle_of(**TAPED) == bundle
    assert bundle_of(**TAPED | {"wires": "10 B1 + 9 B2 (1.6 mm)"}) == bundle
    assert bundle_of(wires=bundle.composition).composition == bundle.composition
    assert parse_bundle("10 B1 + 9 B2 (1.6 mm)", arrangement="symmetric") == Bundle(
        wires, "symmetric"
    )
    assert parse_bundle("7 B1") == bundle_of(wires={"B1": 7}) == Bundle((BundleWire("B1", 7),))


@pytest.mark.parametrize(
    ("wires", "arrangement", "message"),
    [
        ("3 B1 + 4 B2", "round", r"^3 B1 \+ 4 B2, arrangement: expected .*'packed'.*, found 'ro"),
        ("7 B1", "symmetric", r"^7 B1, arrangement: expected 'packed' for wires of one"),
    ],
)
def test_an_arrangement_that_there_is_not(wires: str, arrangement: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_bundle(wires, arrangement=arrangement)


@given(
    st.dictionaries(st.from_regex(r"[A-Z][A-Za-z0-9.-]{0,8}", fullmatch=True), st.integers(1, 99))
)
def test_a_composition_in_words_is_read_back(numbers: dict[str, int]) -> None:
    bundle = Bundle(tuple(BundleWire(kind, number) for kind, number in numbers.items()))
    if numbers:
        assert SheetBundle.model_validate({"wires": bundle.composition}).record == bundle


SEVEN = {kind: {"number": n, "diameter": "1.6 mm"} for kind, n in (("B1", 4), ("B2", 3))}


@pytest.mark.parametrize("scale", [1.6, 1.5841])
def test_positions_may_touch_and_give_way_a_little(scale: float) -> None:
    """A hexagon around its middle; `scale` is the distance in mm."""
    hexagon = [(0.0, 0.0), *((cos(k * pi / 3), sin(k * pi / 3)) for k in range(6))]
    positions = [[f"{x * scale:.6f} mm", f"{y * scale:.6f} mm"] for x, y in hexagon]
    places = bundle_of(wires=SEVEN, positions=positions).positions
    assert places[1] == pytest.approx((scale * 1e-3, 0.0))
    assert len(places) == 7
    nearest_square = min((x - u) ** 2 + (y - v) ** 2 for (x, y), (u, v) in combinations(places, 2))
    assert nearest_square == pytest.approx((scale * 1e-3) ** 2, rel=1e-5)


@pytest.mark.parametrize("wires", [SEVEN, {"B1": 70}, {"B1": {"number": 1, "diameter": "4.45 mm"}}])
def test_a_bore_that_holds_the_wires(wires: object) -> None:
    bundle = bundle_of(wires=wires, conduit="tube", conduit_bore="4.45 mm")
    assert bundle.conduit_bore == pytest.approx(0.00445)


@pytest.mark.parametrize(
    ("more", "places"),
    [
        ({"tape": "PVC"}, [("wires", "B1", "number"), ("tape",)]),
        ({"conduit": "a", "conduit_bore": "1 mm"}, [("wires", "B1", "number")]),
    ],
)
def test_faults_of_wires_do_not_hide_the_others_or_make_new_ones(
    more: dict[str, str], places: list[tuple[str, ...]]
) -> None:
    wrong = {"wires": {"B1": "ten"}, "number": "19", "arrangement": "symmetric"}
    faults = convert_errors(wrong | {"positions": [["1 mm", "2 mm"]]} | more)
    assert [fault.path for fault in faults] == places


def convert_errors(bundle: object) -> list[Fault]:
    return SheetBundle.read(bundle)[1]


words = st.sampled_from(
    ["7 B1", "7", "B1", "none", "symmetric", "half-lap", "1.6 mm", "[", "1e99 mm", ""]
)


anything = st.recursive(
    words | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=6,
)


keys = st.sampled_from(["number", "diameter", *SheetBundle.model_fields])


@given(st.dictionaries(keys, anything | st.dictionaries(words, st.just("7")), max_size=6))
def test_whatever_is_written_is_taken_or_told_in_our_words(bundle: dict[str, object]) -> None:
    assert not [fault for fault in convert_errors(bundle) if "nput should" in fault.expected]
