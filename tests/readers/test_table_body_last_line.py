from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.readers.table_body import Body, whole_lines


def is_whole(text: str) -> bool:
    data = text.encode()
    end, notes = whole_lines(Body(data, ("Time", "Load"), (0, 1), 3, ","))
    assert end == len(data) or data[:end].endswith(b"\n")
    return not notes


@pytest.mark.parametrize("last", ["3", "3,", "3,4.", "3,4.2", "3,4.25e", "3,x"])
def test_a_cut_last_line(last: str) -> None:
    assert not is_whole(f"1,2.25\n2,3.25\n{last}")


@pytest.mark.parametrize("last", ["3,4.25", "3,400", "3,4.25\n", "3,4.2,", "\r", ""])
def test_a_whole_last_line(last: str) -> None:
    assert is_whole(f"1,2.25\n2,3.25\n{last}")


def test_a_cut_exponent() -> None:
    assert not is_whole("1,2.25E-02\n2,3.25E-0")
    assert not is_whole("1,2.25E-02\n2,3.25")
    assert is_whole("1,2.25E-02\n2,3.25E-01")


def test_zeros_at_the_end_that_are_not_written() -> None:
    """A file whose numbers have now this many digits and now that may end in a short one."""
    assert is_whole("1,2.25\n2,3.5\n3,3.125\n4,5.5")
    assert is_whole("1,2.25\n2,3\n3,3.125\n4,5")
    assert not is_whole("1,2.25\n2,3.5\n3,3.125\n4,5")


def test_small_numbers_above_do_not_vouch_for_a_cut_one() -> None:
    """Five digits each: 359.3 has few decimals, and 0.0 would be a number that was cut."""
    assert not is_whole("1,359.35\n2,0.0022123\n3,0.0022456\n4,0.00")


@given(seed=st.integers(0, 999), keep=st.integers(1, 300))
def test_a_resaved_file_loses_nothing(seed: int, keep: int) -> None:
    """Numbers written as short as they are, the last one no shorter than many others."""
    values = np.random.default_rng(seed).integers(0, 10_000, keep + 30) / 100.0
    shortest = values[np.argmin([len(f"{each:g}") for each in values[:-1]])]
    values[-1] = shortest
    values[-2] = shortest
    text = "\n".join(f"{i},{each:g}" for i, each in enumerate(values))
    assert is_whole(text)


def test_line_number_of_what_was_left_out() -> None:
    _, (note,) = whole_lines(Body(b"1,2\n2,3\n3", ("a", "b"), (0, 1), 7, ","))
    assert (note.code, note.severity.value) == ("truncated", "warning")
    assert note.message == "the last line (9) is incomplete and was left out"
