from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe import errors
from labpipe.errors import (
    CODES,
    LabpipeError,
    ReadError,
    choose_error_code,
    describe_system_error,
    format_error,
    sort_by_likeness,
)
from labpipe.mechanics.studies.first_loadings import NotUsableError
from labpipe.readers.channels import NoChannelError


def test_grammar() -> None:
    for place, where in (("line 7", "a.csv, line 7"), ("", "a.csv")):
        text = format_error(
            "a.csv", place, expected="a row", found="none", remedy="Export it again."
        )
        assert text == f"{where}: expected a row, found none. Export it again."


@pytest.mark.parametrize(
    "name", ["UsageError", "ReadError", "ProtocolError", "ProcessingError", "StoreError"]
)
def test_one_tree(name: str) -> None:
    assert issubclass(getattr(errors, name), LabpipeError)
    assert not issubclass(LabpipeError, ValueError)


def every(kind: type[LabpipeError]) -> set[type[LabpipeError]]:
    return {kind}.union(*(every(subclass) for subclass in kind.__subclasses__()))


def test_every_error_has_a_code_of_the_list() -> None:
    kinds = every(LabpipeError)
    assert {NoChannelError, NotUsableError} < kinds
    assert {kind.code for kind in kinds} <= CODES.keys()


def test_a_code_passes_from_one_process_to_another() -> None:
    error = pickle.loads(pickle.dumps(ReadError("x", code="missing_export")))
    assert (str(error), error.code) == ("x", "missing_export")
    assert ReadError("x").code == "unreadable_export"


NO_SEGMENT = "_special_ufuncs.so: failed to map segment from shared object"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ReadError("x", code="missing_export"), "missing_export"),
        (MemoryError(), "out_of_memory"),
        (ImportError(NO_SEGMENT), "out_of_memory"),
        (OSError(12, "Cannot allocate memory"), "out_of_memory"),
        (RuntimeError("can't start new thread"), "out_of_memory"),
        (OSError(36, "File name too long", "xxx"), "system_refused"),
        (UnicodeEncodeError("ascii", "a/\xfc", 2, 3, "ordinal not in range"), "system_refused"),
        (ImportError("No module named 'x'"), "fault_of_labpipe"),
        (ValueError(NO_SEGMENT), "fault_of_labpipe"),
    ],
)
def test_the_code_of_an_error(error: Exception, code: str) -> None:
    assert choose_error_code(error) == code
    assert code in CODES


def test_a_name_that_the_system_cannot_write() -> None:
    said = describe_system_error(
        UnicodeEncodeError("ascii", "a/\xfc", 2, 3, "ordinal not in range")
    )
    assert said.startswith("'a/\xfc': expected names that this system can write, whose encoding is")
    assert r"ascii, found '\xfc'. Choose a locale of UTF-8" in said


def test_nearest_ignores_case_and_keeps_to_the_most() -> None:
    known = ["Time", "Force", "Displacement", "Forces"]
    assert sort_by_likeness("FORCE", known, limit=2) == ["Force", "Forces"]
    assert sort_by_likeness("x", []) == []


@pytest.mark.slow
@given(st.text(max_size=10), st.lists(st.text(max_size=10), max_size=8))
def test_nearest_only_sorts(word: str, known: list[str]) -> None:
    found = sort_by_likeness(word, known)
    assert len(found) == min(5, len(known))
    assert sorted(sort_by_likeness(word, known, limit=99)) == sorted(known)
