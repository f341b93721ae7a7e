from __future__ import annotations

import pytest

from labpipe.errors import Fault
from labpipe.protocol.faults import did_you_mean, one_of, raised, shown


def test_valid_words_come_nearest_first_and_not_all_of_many() -> None:
    assert one_of("bet", ["alpha", "beta"]) == "'beta', 'alpha'"
    assert one_of("c3", [f"c{i}" for i in range(9)]).startswith("'c3', ")
    assert one_of("c3", [f"c{i}" for i in range(9)]).endswith(", ...")


def test_no_word_is_offered_where_none_is_valid() -> None:
    assert did_you_mean("a", []) == ""
    assert did_you_mean("alfa", ["beta", "alpha"]) == "Did you mean 'alpha'?"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "nothing"),
        ({}, "an empty block"),
        ({"a": 1}, "a block of keys"),
        ([], "an empty list"),
        (("a",), "a list"),
        (5, "'5'"),
        ("5 mm", "'5 mm'"),
    ],
)
def test_a_value_in_a_message(value: object, words: str) -> None:
    assert shown(value) == words


def test_several_faults_in_one_error() -> None:
    error = raised([Fault(("a",), "x", "y"), Fault(("b", 0), "x", "z", "Do.", "key")], None)

    assert [line["loc"] for line in error.errors()] == [("a",), ("b", 0)]
    assert error.errors()[1]["msg"] == "expected x, found z. Do."
