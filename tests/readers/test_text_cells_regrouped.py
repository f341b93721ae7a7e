from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from labpipe.readers.text_cells import is_grouped, regrouped_at
from labpipe.records.arrays import Floats


def lost(curve: Floats, decimals: list[int]) -> Floats:
    """A curve written with so many decimals, and without its decimal signs."""
    return np.array([float(f"{y:.{d}f}".replace(".", "")) for y, d in zip(curve, decimals)])  # noqa: B905


def test_the_example_of_the_format() -> None:
    assert regrouped_at(np.array([999.0, 1063.0, 1110797.0, 1162.0])) == (1, 2)
    assert regrouped_at(np.array([935.0, np.nan, 1063.0, np.nan, 1110797.0, 1162.0])) == (2, 4)
    assert regrouped_at(np.array([1110797.0, 1115.0, 1120334.0])) == (0, 1)
    assert regrouped_at(np.array([0.5, 801.0, 1063.0, 1.11, 1110797.0, 1162.0])) == (2, 4)


@given(
    start=st.floats(0.1, 50.0),
    step=st.floats(1e-4, 0.05),
    seed=st.integers(0, 2**32 - 1),
    down=st.booleans(),
)
def test_a_curve_that_lost_its_signs_is_found(
    start: float, step: float, seed: int, down: bool
) -> None:
    """Three decimals or six, as zeros at the end were left out, in any mixture."""
    curve = start + step * np.arange(300.0)
    chance = np.random.default_rng(seed)
    curve = (-curve if down else curve)[chance.integers(0, 200) :]
    decimals = chance.choice([3, 6], len(curve), p=[0.9, 0.1])
    decimals[[10, 11, 12]] = [3, 6, 3]
    written = lost(np.round(curve, 6) + 1e-6, list(decimals))
    assert regrouped_at(written) is not None


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(1.0, 1e7), spikes=st.integers(0, 5))
def test_spikes_in_numbers_with_decimals_are_none(seed: int, size: float, spikes: int) -> None:
    chance = np.random.default_rng(seed)
    values: Floats = np.round(chance.standard_normal(400).cumsum(), 3)
    values[chance.integers(0, 400, spikes)] *= size
    values[0] = 0.5
    assert regrouped_at(values) is None


@given(
    seed=st.integers(0, 2**32 - 1),
    level=st.floats(100.0, 1e6),
    size=st.floats(2.0, 1e7),
    digits=st.integers(3, 6),
)
def test_spikes_in_numbers_with_few_digits_are_none(
    seed: int, level: float, size: float, digits: int
) -> None:
    """Numbers as %g writes them are whole where they are large, and some are in between.

    Only of a spike of just a thousand could nobody tell that no sign was lost.
    """
    assume(not any(0.5 < size / factor < 2.0 for factor in (1e3, 1e6)))
    chance = np.random.default_rng(seed)
    values = level * (1.0 + 0.3 * chance.standard_normal(400).cumsum() / 20.0)
    values[chance.integers(0, 400, 3)] *= size
    written = np.array([float(f"{value:.{digits}g}") for value in values])
    assert regrouped_at(written) is None


@given(seed=st.integers(0, 2**32 - 1), top=st.sampled_from([2047, 32767, 65535, 8388607]))
def test_an_overflow_of_a_counter_is_none(seed: int, top: int) -> None:
    """Counts about a level, and one at the end of their range."""
    chance = np.random.default_rng(seed)
    level = int(chance.choice([7, 20, 300, 5000]))
    counts = np.asarray(level + chance.integers(-3, 4, 400), dtype=np.float64)
    counts[chance.integers(1, 399)] = top
    assert regrouped_at(counts) is None


@pytest.mark.parametrize(
    "values",
    [
        np.arange(1.0, 5000.0),
        np.zeros(50),
        np.array([1.0, 1000.0] * 20),
        np.array([500.0, 500000.0] * 20),
        np.array([3.0, 3001.0, 3.0] * 5),
        np.array([1025.0, 1049601.0, 1025.0]),
        np.array([200.0, 200123.0, 400123.0, 900.0]),
        np.array([5.0, 5123.0]),
        np.full(20, np.nan),
        np.array([1063.0] * 30 + [1110797.0] * 30 + [1162.0]),
    ],
)
def test_other_whole_numbers_are_none(values: Floats) -> None:
    """Counters, codes, bits, steps that stay, numbers too few or too far apart."""
    assert regrouped_at(values) is None


def test_two_signs_between_thousands() -> None:
    assert all(map(is_grouped, ("1,110,797", "-1.110.797")))
    assert not any(map(is_grouped, ("1,063", "1,110.797", "1110797", "1,11,797")))
