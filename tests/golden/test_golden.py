"""A number that changes is seen, and what is only worded afresh is not."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.process.run import Task, process
from tests.golden.differences import differences
from tests.golden.documents import json_rows
from tests.golden.rows import Row, read, rows, write

ONE_OF_EACH_KIND = (
    *("wires/A2-085-1", "tensile/pet-tape-1", "tensile/CT-10-1", "tensile/twist-tube-1a"),
    *("tensile/stiff-bar-1", "harness/CWB-1-1", "harness/TWB-B1-12-PVC-1"),
)
ROW = Row("T", "result", "peak_force.1", "ok", "", "N", "3.5", "3.4", "3.6", "0.95", "12")


@pytest.mark.parametrize(
    "changed",
    [
        {"value": "3.50000001"},
        {"lower": "3.39999998"},
        {"upper": ""},
        {"level": "0.9"},
        {"unit": "kN"},
        {"n": "13"},
        {"status": "doubtful"},
        {"codes": "zero_jump"},
    ],
)
def test_each_change_is_a_difference(changed: dict[str, str]) -> None:
    (difference,) = differences([ROW], [replace(ROW, **changed)])
    ((field, new),) = changed.items()
    assert (difference.field, difference.new) == (field, new)


def test_rounding_is_none_and_a_row_may_be_gone_or_new(tmp_path: Path) -> None:
    write(tmp_path / "rows.csv", [ROW])
    assert read(tmp_path / "rows.csv") == [ROW]
    assert not differences([ROW], [replace(ROW, value="3.5000000000001")])
    zero = replace(ROW, lower="0.0")
    assert not differences([zero], [replace(ROW, lower="1e-15")])
    assert differences([zero], [replace(ROW, lower="1e-9")])
    gone, new = differences([ROW], [replace(ROW, name="peak_force.2")])
    assert (gone.row.name, gone.old, gone.new) == ("peak_force.1", "there", "")
    assert (new.row.name, new.old, new.new) == ("peak_force.2", "", "there")


def test_documents_are_kept_without_their_words() -> None:
    document = {"schema": 1, "parts": [{"mean": 2, "words": "two", "code": "few", "x": [1.0, 3.0]}]}
    mean, code, x = json_rows("T", "model", document)
    assert (mean.name, mean.value) == ("parts.0.mean", "2.0")
    assert (code.name, code.status) == ("parts.0.code", "few")
    assert (x.value, x.lower, x.upper, x.n) == ("2.0", "1.0", "3.0", "2")


@pytest.mark.parametrize("name", ONE_OF_EACH_KIND)
def test_numbers_of_the_demo_are_those_that_are_kept(name: str, tmp_path: Path) -> None:
    """Only where the tests of mutants name the folder of the full demo."""
    campaign, test = name.split("/")
    sheet = Path(os.environ.get("LABPIPE_DEMO", "no demo"), name, "test.yaml")
    if not sheet.is_file():
        pytest.skip("LABPIPE_DEMO names no folder with this test")
    kept = [row for row in read(Path(__file__).with_name(f"{campaign}.csv")) if row.test == test]
    assert not differences(
        kept, rows(test, process(Task(sheet, tmp_path / test, figures=False)).folder)
    )
