from __future__ import annotations

from typing import Literal

import pytest
from pydantic import Field, ValidationError

from labpipe.protocol.block import Block
from labpipe.protocol.faults import Fault, error_of, faults_of


class Inner(Block):
    kind: Literal["inner"]
    width: str
    depth: str | None = None


class Outer(Block):
    inner: Inner
    words: tuple[str, ...] = Field((), alias="terms")
    nothing: str | None

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        return [Fault(("terms",), "no terms", "some")] if "terms" in dict(data or {}) else []  # type: ignore[call-overload]


def _faults(data: object) -> list[tuple[object, ...]]:
    with pytest.raises(ValidationError) as info:
        Outer.model_validate(data)
    faults = faults_of(info.value, data=data, keys=())
    return [(each.path, each.expected, each.found, each.remedy, each.at) for each in faults]


def test_faults_at_all_levels_come_together_in_our_words() -> None:
    data = {"inner": {"kind": "iner", "withd": "1"}, "terms": ["a"], "nothing": None}

    assert _faults(data) == [
        (("inner", "kind"), "one of 'inner'", "'iner'", "Did you mean 'inner'?", "value"),
        (("inner",), "the key 'width'", "no such key", "Add the key 'width'.", "value"),
        (
            ("inner", "withd"),
            "one of the keys 'width', 'kind', 'depth'",
            "'withd'",
            "Did you mean 'width'?",
            "key",
        ),
        (("terms",), "no terms", "some", "", "value"),
    ]


def test_a_fault_between_parts_is_not_told_where_the_part_itself_is_wrong() -> None:
    data = {"inner": {"kind": "inner", "width": "1"}, "terms": "a", "nothing": None}

    assert _faults(data) == [(("terms",), "a list", "'a'", "", "value")]


def test_a_block_that_is_no_block() -> None:
    assert _faults(None) == [((), "a block of keys with values", "nothing", "", "value")]
    assert _faults(["a"])[0][2] == "a list"


def test_what_nobody_said_is_not_written_but_what_must_be_said_is() -> None:
    outer = Outer.model_validate({"inner": {"kind": "inner", "width": "1"}, "nothing": None})

    assert outer.model_dump(by_alias=True) == {
        "inner": {"kind": "inner", "width": "1"},
        "terms": (),
        "nothing": None,
    }


def test_a_block_is_frozen() -> None:
    inner = Inner(kind="inner", width="1")

    with pytest.raises(ValidationError, match="frozen"):
        inner.width = "2"  # type: ignore[misc]


def test_the_error_of_a_validator_reads_like_a_message() -> None:
    assert error_of(expected="a", found={}, remedy="Do.").message() == (
        "expected a, found an empty block. Do."
    )
