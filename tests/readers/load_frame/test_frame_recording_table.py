from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.column_titles import Header
from labpipe.readers.load_frame.frame_recording import (
    Table,
    choose_part,
    preamble,
    time_column,
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
    assert time_column(["Video Time", "Running Time", "Time"], ["sec"] * 3, card) == 2
    assert time_column(["Video Time", "Load"], ["", "N"], card) is None
    dated = replace(card, words=("Time",))
    assert time_column(["Time", "Running Time"], ["", "sec"], dated) == 1
    assert time_column(["Time", "Load"], ["sec", "N"], dated) is None


@pytest.mark.parametrize(
    ("names", "units", "found"),
    [
        (["_Load", "_Time"], ["N", "sec"], 1),
        (["_Video Time", "_Time", "_Load"], ["sec", "sec", "N"], 1),
        (["Load", "Ch 1 Time"], ["N", "sec"], 1),
        (["Load", "C_1_Temps"], ["N", "s"], 1),
        (["Load", "Tempo di prova"], ["N", "s"], 1),
        (["Load", "Prüfzeit bis Bruch"], ["N", "s"], 1),
        (["Load", "Time to break"], ["N", "mm"], None),
        (["Load", "Hold Time", "Dwell Time"], ["N", "s", "s"], None),
        (["Load", "Temperature"], ["N", "s"], None),
    ],
)
def test_time_under_other_names(names: list[str], units: list[str], found: int | None) -> None:
    assert time_column(names, units, shipped_cards()["mts-testsuite"]) == found


def test_time_comes_with_what_is_asked_for() -> None:
    card = shipped_cards()["mts-testsuite"]
    header = Header(("Time", "Load", "Crosshead"), ("sec", "N", "mm"), 2, [])
    assert wanted_columns(header, card, ["Load"], "a") == [0, 1]


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
