"""Bundles in words."""

from __future__ import annotations

import pytest

from labpipe.errors import UsageError
from labpipe.protocol.sheet_grammar import bundle_in_words
from labpipe.records.harness_bundle import Bundle, BundleWire


def test_words_of_a_bundle() -> None:
    wires = (BundleWire("B1", 10), BundleWire("B2", 9, 1.25e-3))
    found = bundle_in_words("10 B1 + 9 B2 (1.25 mm)", arrangement="symmetric")
    assert found == Bundle(wires, "symmetric")
    assert bundle_in_words("7 B1") == Bundle((BundleWire("B1", 7),))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("B1", r"""^B1: expected wires by type, .*, found 'B1'\. Write it like "10 B1 \+ 9"""),
        ("7 B1 + 3 B1", r": expected each type once, found .*\. Add the numbers of 'B1'"),
        ("0 B1", r"^0 B1: expected a whole number from 1 to 1000, found '0'\. Write it like"),
        ("7 B1 (thick)", r"^7 B1 \(thick\): expected a quantity with a unit .*, found 'thick'\."),
    ],
)  # fmt: skip
def test_words_that_are_no_bundle(words: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        bundle_in_words(words)


def test_an_arrangement_that_there_is_not() -> None:
    said = r"^3 B1 \+ 4 B2, arrangement: expected .*'packed'.*, found 'round'\. "
    with pytest.raises(UsageError, match=said):
        bundle_in_words("3 B1 + 4 B2", arrangement="round")
    with pytest.raises(UsageError, match=r"^7 B1, arrangement: expected 'packed' for wires of one"):
        bundle_in_words("7 B1", arrangement="symmetric")
