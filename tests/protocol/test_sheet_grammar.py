"""Test sheets and the bundles in them, in blocks and in words."""

from __future__ import annotations

from datetime import date
from itertools import combinations
from math import cos, pi, sin

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from labpipe.errors import ProtocolError, UsageError
from labpipe.protocol.load import checked
from labpipe.protocol.sheet_grammar import SheetBundle, TestSheet, bundle_in_words, write_test_sheet
from labpipe.protocol.sheet_grammar import test_sheet_faults as sheet_faults
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import Specimen

SHEET = """\
test: A2-085-1
protocol: wire
specimen: {type: A2, spool: A2-s1, sample: 01, length: 80 mm, width: 2 mm}
files: {force: force.mat}
"""


def test_a_sheet_holds_what_was_written() -> None:
    sheet = checked(TestSheet, parse_yaml(SHEET + "date: 2026-03-04\n", "x"))

    assert (sheet.test, sheet.specimen.sample, sheet.date) == ("A2-085-1", "01", date(2026, 3, 4))
    assert sheet.specimen.dimensions == {"length": 0.080, "width": 0.002}
    assert (sheet.operator, sheet.overrides) == ("", {})


def test_a_specimen_may_be_a_bundle_and_have_labels() -> None:
    more = "width: 2 mm, span: 6 in, bundle: {wires: 7 B1}, labels: {cured: 24 h, lot: 07}"
    sheet = checked(TestSheet, parse_yaml(SHEET.replace("width: 2 mm", more), "x"))

    assert sheet.specimen.record == Specimen(
        "A2",
        "A2-s1",
        "01",
        {"length": 0.080, "width": 0.002, "span": 0.1524},
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
        write_test_sheet(DATA)
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

    sheet = checked(TestSheet, parse_yaml(write_test_sheet(data), "x"))

    assert (sheet.protocol, sheet.specimen.sample) == (protocol, sample)
    assert sheet.overrides["rig.cycles"].value == value


def test_what_is_wrong_is_found_before_writing() -> None:
    assert sheet_faults(DATA) == []
    (fault,) = sheet_faults(DATA | {"date": "yesterday"})
    assert (fault.path, fault.found) == (("date",), "'yesterday'")


BUNDLE_SHEET = """\
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
    return BUNDLE_SHEET.format(bundle.strip().replace("\n", "\n    "))


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


def test_words_of_a_bundle() -> None:
    wires = (BundleWire("B1", 10), BundleWire("B2", 9, 1.25e-3))
    found = bundle_in_words("10 B1 + 9 B2 (1.25 mm)", arrangement="symmetric")
    assert found == Bundle(wires, "symmetric")
    assert bundle_in_words("7 B1") == Bundle((BundleWire("B1", 7),))


def test_an_arrangement_that_there_is_not() -> None:
    said = r"^3 B1 \+ 4 B2, arrangement: expected .*'packed'.*, found 'round'\. "
    with pytest.raises(UsageError, match=said):
        bundle_in_words("3 B1 + 4 B2", arrangement="round")
    with pytest.raises(UsageError, match=r"^7 B1, arrangement: expected 'packed' for wires of one"):
        bundle_in_words("7 B1", arrangement="symmetric")
