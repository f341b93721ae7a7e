from __future__ import annotations

from collections.abc import Mapping

import pytest

from labpipe.process.recorded_facts import (
    FOLDER,
    Fact,
    agreed,
    day_in,
    days_in_name,
    facts_of_export,
    facts_of_folder,
)
from labpipe.records.recording import Recording


def facts(metadata: Mapping[str, object], name: str = "x.csv") -> dict[str, str]:
    return {
        each.key: each.value for each in facts_of_export(name, Recording("r", metadata=metadata))
    }


@pytest.mark.parametrize(
    ("written", "day"),
    {
        "2026-03-04 10.05.00.000 AM": "2026-03-04",
        "20.02.2008": "2008-02-20",
        "10/26/2022 1:02:25 PM": "2022-10-26",
        "26/10/2022 13:02": "2022-10-26",
        "7/3/2025 12:23:28 PM": "2025-07-03",
        "7/7/2025": "2025-07-07",
        "7/3/2025 12:23": "",
        "31/31/2025": "",
        "43173.4": "",
    }.items(),
)
def test_a_day_is_read_where_its_order_is_plain(written: str, day: str) -> None:
    assert day_in(written) == day


def test_no_day_of_a_calendar_is_none() -> None:
    assert days_in_name("2026-02-30.csv") == []
    assert days_in_name("120260304.csv") == []


def test_the_day_of_the_export_counts_before_that_of_its_name() -> None:
    assert facts({"Date": "27.02.2015"}, "2026-01-01.csv") == {"date": "2015-02-27"}
    assert facts({}, "2026-01-01.csv") == {"date": "2026-01-01"}
    assert facts({"Date/heure": "43173.4"}, "2026-01-01.csv") == {"date": "2026-01-01"}
    assert facts({}, "take.csv") == {}


def test_what_programs_say_of_operator_and_specimen() -> None:
    control = {"Description": {"General": {"User": "jk", "DateTime": "x"}}, "date": "2026-03-04"}
    assert facts(control) == {"date": "2026-03-04", "operator": "jk"}
    bluehill = {
        "Specimen properties : Length": "50 mm",
        "Specimen properties : Width": "wide",
        "General : Specimen number (included)": "7",
    }
    assert facts(bluehill) == {"length": "50 mm", "specimen": "7"}
    assert facts({"Operator": "<None>", "Test Run": "A2-085-1"}) == {"take": "A2-085-1"}


@pytest.mark.parametrize(
    ("name", "said"),
    {
        "A2-085-1": {"type": "A2", "length": "85 mm", "sample": "1"},
        "TWB-B1-19-PVC-2": {"type": "TWB-B1-19-PVC", "sample": "2"},
        "twist-tube-1a": {"type": "twist-tube", "sample": "1a"},
        "CT_10_3": {"type": "CT_10", "sample": "3"},
        "2026-03-04": {},
        "Test Run 4 10-23-2023 6 43 09 PM": {},
        "specimen": {},
    }.items(),
)
def test_the_pattern_of_a_lab(name: str, said: dict[str, str]) -> None:
    assert {each.key: each.value for each in facts_of_folder(name)} == said


def test_what_all_say_is_taken_and_what_is_said_twice_is_left_open() -> None:
    both = agreed(
        [
            Fact("date", "2026-03-04", "a.mat"),
            Fact("date", "", "b.csv", "3/4/2026"),
            Fact("date", "2026-03-04", "take.csv"),
            Fact("operator", "jk", "a.mat"),
            Fact("operator", "vl", "take.csv"),
            Fact("type", "A2", FOLDER),
        ]
    )

    assert both.facts["date"].where == "a.mat and take.csv"
    assert list(both.facts) == ["date", "type"]
    assert both.open == ("operator: jk in a.mat, vl in take.csv; left out, write the right one",)


def test_a_day_that_can_be_read_two_ways_is_left_open() -> None:
    found = agreed([Fact("date", "", "b.csv", "3/4/2026")])
    said = "date: '3/4/2026' in b.csv can be read day first or month first; left out"
    assert (dict(found.facts), found.open) == ({}, (said,))
