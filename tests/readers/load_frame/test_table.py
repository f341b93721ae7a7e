from __future__ import annotations

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.table import (
    Table,
    choose_part,
    preamble,
    time_column,
    unique_names,
    wanted_columns,
    without_codes,
)


def test_preamble() -> None:
    rows = [
        ["Date: 7/3/2025 12:23"],
        ["General : Label", "a b", "mm", ""],
        ["C:\\x"],
        [""],
        ["Form:"],
    ]
    rows += [["Method", "1"], ["Method", "2"]]
    assert preamble(rows) == {
        "Date": "7/3/2025 12:23",
        "General : Label": "a b mm",
        "lines": ["C:\\x"],
        "Form": "",
        "Method": ["1", "2"],
    }


def test_the_most_wanted_time_counts() -> None:
    card = shipped_cards()["mts-testsuite"]
    assert time_column(["Video Time", "Running Time", "Time"], card) == 2
    assert time_column(["Video Time", "Load"], card) is None


def test_names_are_made_unique() -> None:
    assert unique_names(["F", "", "F"]) == ["F [1]", "column 2", "F [2]"]


def test_time_comes_with_what_is_asked_for() -> None:
    card = shipped_cards()["mts-testsuite"]
    assert wanted_columns(["Time", "Load", "Crosshead"], card, ["Load"], "a") == [0, 1]


def test_codes_of_missing_values() -> None:
    table = Table("", ("F",), ("N",), {0: np.array([1.0, -1e6])})
    values = without_codes(table, shipped_cards()["catman"]).columns[0]
    np.testing.assert_array_equal(values, [1.0, np.nan])
    assert without_codes(table, shipped_cards()["dion"]) is table


def test_a_hint_for_spreadsheets_is_no_word_of_the_export() -> None:
    assert preamble([["sep=", ""], ["Date: 1"]]) == {"Date": "1"}


def test_parts() -> None:
    tables = [Table(part, (), (), {}, also=f"Values {part}") for part in ("A", "B")]
    assert choose_part(tables, None, "a") == tuple(tables)
    assert choose_part(tables, "Values B", "a") == (tables[1],)
    with pytest.raises(
        ReadError, match=r"a, part 'C': .* Leave `part` out: the export does not na"
    ):
        choose_part([Table("", (), (), {})], "C", "a")
