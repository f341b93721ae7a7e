"""A number that changes is seen, and what is only worded afresh is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.golden.differences import differences
from tests.golden.documents import json_rows
from tests.golden.rows import Row, codes, read, write
from tests.golden.widths import changed_statuses, paired, table

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
    (found,) = differences([ROW], [replace(ROW, **changed)])
    ((field, new),) = changed.items()
    assert (found.field, found.new) == (field, new)


def test_rounding_is_none() -> None:
    assert not differences([ROW], [replace(ROW, value="3.5000000000001")])


def test_a_bound_at_zero_has_a_floor() -> None:
    assert not differences([replace(ROW, lower="0.0")], [replace(ROW, lower="1e-15")])
    assert differences([replace(ROW, lower="0.0")], [replace(ROW, lower="1e-9")])


def test_results_that_are_gone_and_new() -> None:
    other = replace(ROW, name="peak_force.2")
    gone, new = differences([ROW], [other])
    assert (gone.row.name, gone.new) == ("peak_force.1", "")
    assert (new.row.name, new.old) == ("peak_force.2", "")


def test_codes_without_their_sentences() -> None:
    said = ("no_break", "partial_cycle", "no_break")
    listed = [{"code": each, "message": "worded afresh"} for each in said]
    assert codes(listed) == "no_break partial_cycle"
    assert codes([]) == ""


def test_documents_are_kept_without_their_words() -> None:
    document = {"schema": 1, "parts": [{"mean": 2, "words": "two", "code": "few", "x": [1.0, 3.0]}]}
    mean, code, x = json_rows("T", "model", document)
    assert (mean.name, mean.value) == ("parts.0.mean", "2.0")
    assert (code.name, code.status) == ("parts.0.code", "few")
    assert (x.value, x.lower, x.upper, x.n) == ("2.0", "1.0", "3.0", "2")


def test_rows_are_read_as_written(tmp_path: Path) -> None:
    write(tmp_path / "rows.csv", [ROW])
    assert read(tmp_path / "rows.csv") == [ROW]


def test_widths_old_and_new() -> None:
    """Widths 0.2 -> 0.1 and 0.2 -> 0.4: ratios 0.5 and 2, their median 1.25; medians 0.2, 0.25."""
    whole = Row("T", "test", "wire")
    second = replace(ROW, name="peak_force.2")
    new = [replace(ROW, lower="3.45", upper="3.55"), replace(second, lower="3.3", upper="3.7")]
    pairs = paired([whole, ROW, second], [whole, *new])
    *_, line = table(pairs)
    assert line == "| wire | peak_force | N | 2 | 0.2 | 0.25 | 1.25 | 0.50 to 2.00 |"
    assert list(changed_statuses(pairs)) == ["0 of 2 results have another status or other codes"]


def test_statuses_that_changed() -> None:
    doubted = replace(ROW, status="doubtful", codes="few_pieces")
    other = replace(ROW, test="U", status="failed", codes="gap", value="", lower="", upper="")
    pairs = paired([ROW, other], [doubted])
    _, first, second = changed_statuses(pairs)
    assert first.split() == ["1", "peak_force:", "ok", "->", "doubtful", "few_pieces", "[T]"]
    assert second.split() == ["1", "peak_force:", "failed", "gap", "->", "none", "[U]"]
    assert [line.count("0.2") for line in table(pairs)] == [0, 0, 2]
