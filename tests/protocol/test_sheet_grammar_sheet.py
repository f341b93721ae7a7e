from __future__ import annotations

from datetime import date

import pytest
from pydantic import ValidationError

from labpipe.errors import ProtocolError
from labpipe.protocol.load import checked
from labpipe.protocol.sheet_grammar import TestSheet
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


def test_no_length_is_no_dimension() -> None:
    sheet = checked(TestSheet, parse_yaml(SHEET.replace("length: 80 mm, width: 2 mm", ""), "x"))

    assert sheet.specimen.dimensions == {}


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


def test_a_plain_specimen_is_no_bundle() -> None:
    for blank in ("", ", bundle: , labels: "):
        record = checked(
            TestSheet, parse_yaml(SHEET.replace(", width: 2 mm", blank), "x")
        ).specimen.record
        assert record == Specimen("A2", "A2-s1", "01", {"length": 0.080})


INSIDE = (
    "expected a file inside the folder of the test, found {}."
    " Copy the export into the folder of the test and name it from there."
)


@pytest.mark.parametrize(
    "name", ["../a.mat", "/etc/a.mat", "b/../../a.mat", "C:\\a.mat", "..\\a.mat", "\\\\host\\a"]
)
def test_a_path_that_leaves_the_folder_is_refused(name: str) -> None:
    with pytest.raises(ProtocolError) as info:
        checked(TestSheet, parse_yaml(SHEET.replace("force.mat", name), "x"))
    assert str(info.value) == f"x, line 4, column 16 (files.force): {INSIDE.format(repr(name))}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "force.mat",
            "[a.mat, ../b.mat]",
            f"x, line 4, column 24 (files.force.1): {INSIDE.format(repr('../b.mat'))}",
        ),
        (
            "force.mat",
            "' '",
            "x, line 4, column 16 (files.force): expected the name of a file, found ' '.",
        ),
        (
            "{force: force.mat}",
            "{}",
            "x, line 4, column 8 (files): expected at least one entry, found an empty block.",
        ),
        (
            "{force: ",
            "{forse: ",
            "x, line 4, column 9 (files.forse): expected one of 'force', 'frame', 'markers',"
            " found 'forse'. Did you mean 'force'?",
        ),
        (
            "length: 80",
            "lenght: 80",
            "x, line 3, column 48 (specimen.lenght): expected a known key, or the name of a"
            " dimension in small letters, found 'lenght'. Did you mean 'length'?",
        ),
        (
            "width:",
            "Width:",
            "x, line 3, column 63 (specimen.Width): expected a known key, or the name of a"
            " dimension in small letters, found 'Width'. Write it as 'width'.",
        ),
        (
            "spool: A2-s1",
            "spol: A2-s1",
            "x, line 3, column 22 (specimen.spol): expected a known key, or the name of a dimension"
            " in small letters, found 'spol'. Did you mean 'spool'?",
        ),
        (
            "width: 2 mm",
            "colour: red",
            "x, line 3, column 63 (specimen.colour): expected a dimension, which is a length with"
            " its unit such as '2 mm', found 'red'. Write other words on the specimen as 'labels:"
            " {colour: red}'.",
        ),
        (
            "width: 2 mm",
            "weight: 3 g",
            "x, line 3, column 63 (specimen.weight): expected a dimension, which is a length with"
            " its unit such as '2 mm', found '3 g'. Write other words on the specimen as 'labels:"
            " {weight: 3 g}'.",
        ),
        (
            "width: 2 mm",
            "width: 2",
            "x, line 3, column 70 (specimen.width): expected a quantity with a unit such as mm,"
            " found '2'. Write it with its unit, such as '53 mm'.",
        ),
        (
            "width: 2 mm",
            "labels: {Cured: 24 h}",
            "x, line 3, column 79 (specimen.labels.Cured): expected a name of small letters,"
            " digits and '_', a letter first, found 'Cured'.",
        ),
        (
            "width: 2 mm",
            "labels: {spool: s2}",
            "x, line 3, column 72 (specimen.labels.spool): expected a label that is not called"
            " like a key of 'specimen', found 'spool'. Write it one level up, or rename it.",
        ),
        (
            "width: 2 mm",
            "labels: [cured]",
            "x, line 3, column 71 (specimen.labels): expected a block of keys with values, found"
            " a list.",
        ),
        (
            "width: 2 mm",
            "labels: {cured: }",
            "x, line 3, column 78 (specimen.labels.cured): expected text, found nothing.",
        ),
        (
            "width: 2 mm",
            "bundle: 7 B1",
            "x, line 3, column 71 (specimen.bundle): expected a block of keys with values, found"
            " '7 B1'.",
        ),
        (
            "protocol: wire\n",
            "protocol: wire\ndate: 4.3.2026\n",
            "x, line 3, column 7 (date): expected a date such as 2026-03-04, found '4.3.2026'.",
        ),
        (
            "protocol: wire\n",
            "protocol: wire\noverrides: {a.b: {value: 1}}\n",
            "x, line 3, column 18 (overrides.a.b): expected the key 'because', found no such key."
            " Add the key 'because'.",
        ),
    ],
)
def test_what_is_wrong_is_told(old: str, new: str, message: str) -> None:
    with pytest.raises(ProtocolError) as info:
        checked(TestSheet, parse_yaml(SHEET.replace(old, new), "x"))
    assert message in str(info.value).splitlines()


def test_a_specimen_that_is_no_block() -> None:
    with pytest.raises(ValidationError, match="expected a block of keys with values, found 'A2'"):
        TestSheet.model_validate(
            {"test": "a", "protocol": "b", "specimen": "A2", "files": {"force": "a"}}
        )


def test_a_date_may_be_one_already_or_none() -> None:
    data = {
        "test": "a",
        "protocol": "b",
        "specimen": {"type": "A", "spool": "s", "sample": 1},
        "files": {"force": "a"},
    }

    assert TestSheet.model_validate(data | {"date": date(2026, 3, 4)}).date == date(2026, 3, 4)
    assert TestSheet.model_validate(data | {"date": None}).date is None


def test_keys_left_blank_say_nothing() -> None:
    sheet = checked(TestSheet, parse_yaml(SHEET + "date:\noperator:\noverrides:\n", "x"))

    assert (sheet.date, sheet.operator, sheet.overrides) == (None, "", {})
