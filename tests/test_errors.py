from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe import errors
from labpipe.errors import LabpipeError, complaint, nearest


def test_grammar() -> None:
    said = complaint("a.csv", "line 7", expected="a row", found="none", remedy="Export it again.")
    assert said == "a.csv, line 7: expected a row, found none. Export it again."


def test_no_place() -> None:
    said = complaint("a.csv", "", expected="a row", found="none", remedy="Export it again.")
    assert said == "a.csv: expected a row, found none. Export it again."


@pytest.mark.parametrize(
    "name", ["UsageError", "ReadError", "ProtocolError", "ProcessingError", "StoreError"]
)
def test_one_tree(name: str) -> None:
    assert issubclass(getattr(errors, name), LabpipeError)
    assert not issubclass(LabpipeError, ValueError)


def test_nearest_ignores_case_and_keeps_to_the_most() -> None:
    known = ["Time", "Force", "Displacement", "Forces"]
    assert nearest("FORCE", known, most=2) == ["Force", "Forces"]
    assert nearest("x", []) == []


@given(st.text(max_size=10), st.lists(st.text(max_size=10), max_size=8))
def test_nearest_only_sorts(word: str, known: list[str]) -> None:
    found = nearest(word, known)
    assert len(found) == min(5, len(known))
    assert sorted(nearest(word, known, most=99)) == sorted(known)
