"""Which marker a chain of tracklets is."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.marker_names import Naming, is_unlabelled, name_chains
from labpipe.markers.tracklets import Links, Tracklets


@pytest.mark.parametrize(
    "name", ["Unlabeled 12", "Unlabeled:108", "unlabelled", "Take:Unlabeled 4"]
)
def test_names_the_program_gave_for_want_of_better(name: str) -> None:
    assert is_unlabelled(name)


@pytest.mark.parametrize("name", ["M1", "SA-low:Marker1", "tip (Unlabeled 3)"])
def test_names_that_mean_something(name: str) -> None:
    assert not is_unlabelled(name)


def name(pieces: list[tuple[int, int, int, int]], names: tuple[str, ...]) -> Naming:
    """Pieces as chain, column, start, stop; 100 frames at 50 per second, columns 0.1 m apart."""
    chain, column, start, stop = np.array(pieces).T
    relative = np.zeros((100, len(names), 3))
    relative[..., 0] = 0.1 * np.arange(len(names))
    tracklets = Tracklets(column, start, stop)
    links = Links(chain, np.full(len(chain), -1), ())
    time = np.arange(100) / 50
    return name_chains(
        names, tracklets, links, relative=relative, time=time, settled=0.2, apart=0.004
    )


def test_the_first_settled_label_names_the_chain() -> None:
    found = name([(0, 0, 0, 5), (0, 1, 5, 30), (0, 2, 30, 100)], ("A", "B", "C"))
    assert list(found.markers) == [1]


def test_without_a_settled_label_the_longest_counts() -> None:
    found = name([(0, 0, 0, 5), (0, 1, 5, 14), (0, 2, 14, 100)], ("A", "B", "Unlabeled 1"))
    assert list(found.markers) == [1]


def test_a_chain_without_a_name_is_left_over() -> None:
    found = name([(0, 0, 0, 100), (1, 1, 0, 50)], ("A", "Unlabeled 1"))
    assert list(found.markers) == [0]
    assert [chain.stop for chain in found.leftover] == [50]


def test_the_longer_of_two_keeps_the_name_and_the_other_goes_to_the_free_marker() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (0, 1, 30, 100), (2, 0, 40, 100)]
    found = name(pieces, ("A", "B"))
    assert [chain.start for chain in found.markers[1]] == [0, 40]
    assert [label for label, _ in found.eliminated] == [1]


def test_with_two_free_markers_nothing_is_decided() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (3, 2, 0, 30), (0, 1, 30, 100), (2, 0, 40, 100)]
    found = name(pieces, ("A", "B", "C"))
    assert found.eliminated == ()
    assert [chain.start for chain in found.doubtful] == [40]


def test_a_glitch_is_no_marker() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (0, 1, 30, 100), (2, 0, 40, 45)]
    found = name(pieces, ("A", "B"))
    assert found.eliminated == ()
    assert found.doubtful == ()
    assert [chain.start for chain in found.leftover] == [40]
