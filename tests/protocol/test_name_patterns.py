from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.protocol.name_patterns import parse_name_pattern

MATCHES = [
    (
        "{type}-{length mm}-{sample}.mat",
        "A2-085-1.mat",
        {"type": "A2", "length": "85 mm", "sample": "1"},
    ),
    ("{type}-{sample}.csv", "TWB-B1-19-PVC-2.CSV", {"type": "TWB-B1-19-PVC", "sample": "2"}),
    ("{test}/DAQ* (Timed).txt", "T1/DAQ- Crosshead, … - (Timed).txt", {"test": "T1"}),
    ("{type}/{type}_{sample} *", "A/A_2 take.csv", {"type": "A", "sample": "2"}),
    ("{date}_{test}", "20260304_T", {"date": "2026-03-04", "test": "T"}),
    ("{date} {test}", "2026-03-04 T", {"date": "2026-03-04", "test": "T"}),
    ("{outer_diameter in}x{test}", "0,5xT", {"outer_diameter": "0.5 in", "test": "T"}),
    ("{labels.batch}.{test}", "b.c.T", {"labels.batch": "b.c", "test": "T"}),
    ("a.b{test}", "axbT", None),
    ("{type}/{type}_{sample}", "A/B_2", None),
    ("{test}.mat", "a/b.mat", None),
    ("{test}.mat", "x" * 301 + ".mat", None),
    ("{length mm}.mat", "long.mat", None),
]


@pytest.mark.parametrize(("pattern", "name", "fields"), MATCHES)
def test_names_are_taken_apart(pattern: str, name: str, fields: dict[str, str] | None) -> None:
    assert parse_name_pattern(pattern).match(name) == fields


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("{typ}-1", "one of {test}, {type}, "),
        ("{length}-1", "a dimension with its unit such as {length mm}"),
        ("{length N}-1", "a dimension with a unit of length, such as {length mm}"),
        ("{type mm}", "one of {test}"),
        ("a{", "one of {test}"),
        ("a}b", "one of {test}"),
        ("{}", "one of {test}"),
        ("x" * 301, "a pattern of at most 300 letters"),
    ],
)
def test_what_is_no_pattern(pattern: str, expected: str) -> None:
    with pytest.raises(ValueError, match=re.escape(expected)):
        parse_name_pattern(pattern)


def test_the_name_of_a_test_ends_behind_the_last_field() -> None:
    pattern = parse_name_pattern("in/{type}-{sample}_force.mat")
    assert pattern.stem("in/A2-1_force.mat") == "A2-1"
    assert parse_name_pattern("*.mat").stem("in/x.mat") == "x.mat"


@given(st.text(min_size=1, max_size=40))
def test_every_sign_stands_for_itself(text: str) -> None:
    bare = re.sub(r"[{}*/\\]", "", text) or "x"
    found = parse_name_pattern(bare + "{test}").match(bare + "T")
    assert found == {"test": "T"}
