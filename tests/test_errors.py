from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe import errors
from labpipe.errors import CODES, LabpipeError, ReadError, complaint, nearest
from labpipe.readers.channels import NoChannelError
from labpipe.studies.first_loadings import NotUsableError


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


def every(kind: type[LabpipeError]) -> set[type[LabpipeError]]:
    return {kind}.union(*(every(each) for each in kind.__subclasses__()))


def test_every_error_has_a_code_of_the_list() -> None:
    kinds = every(LabpipeError)
    assert {NoChannelError, NotUsableError} < kinds
    assert {kind.code for kind in kinds} <= CODES.keys()


def test_a_code_passes_from_one_process_to_another() -> None:
    error = pickle.loads(pickle.dumps(ReadError("x", code="missing_export")))
    assert (str(error), error.code) == ("x", "missing_export")
    assert ReadError("x").code == "unreadable_export"


def test_nearest_ignores_case_and_keeps_to_the_most() -> None:
    known = ["Time", "Force", "Displacement", "Forces"]
    assert nearest("FORCE", known, most=2) == ["Force", "Forces"]
    assert nearest("x", []) == []


@pytest.mark.slow
@given(st.text(max_size=10), st.lists(st.text(max_size=10), max_size=8))
def test_nearest_only_sorts(word: str, known: list[str]) -> None:
    found = nearest(word, known)
    assert len(found) == min(5, len(known))
    assert sorted(nearest(word, known, most=99)) == sorted(known)
