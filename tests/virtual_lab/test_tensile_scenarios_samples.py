"""One sample of each kind is what the source describes."""

from __future__ import annotations

import pytest

from labpipe.virtual_lab.observations import observe
from labpipe.virtual_lab.tensile_scenarios import (
    GIVE,
    TABLE_2_3,
    corrugated_tube,
    pet_tape,
    stiff_bar,
    twist_tube,
)


@pytest.mark.parametrize("sample", TABLE_2_3)
def test_twist_tubes_have_the_stiffness_of_table_2_3(sample: str) -> None:
    truth = observe(twist_tube(sample, peak_force=400.0), 1).truth
    assert truth.peak_force == pytest.approx(400.0, rel=1e-6)
    found = truth.stiffness_first / truth.peak_force, truth.stiffness_second / truth.peak_force
    assert found == pytest.approx(TABLE_2_3[sample], rel=1e-6)


def test_names_and_spools() -> None:
    tests = [corrugated_tube("CT-10-slit-2"), twist_tube("2b"), pet_tape("3"), pet_tape("4")]
    assert [(each.specimen_type, each.spool, each.sample) for each in tests] == [
        ("CT-10-slit", "CT-10-slit-s1", "2"),
        ("twist-tube-10", "twist-tube-s2", "2b"),
        ("pet-tape", "pet-tape-s1", "3"),
        ("pet-tape", "pet-tape-s2", "4"),
    ]


def test_forces_grow_by_their_factor() -> None:
    one, two = (observe(corrugated_tube("CT-7-1", factor=factor), 1).truth for factor in (1.0, 1.2))
    assert two.peak_force == pytest.approx(1.2 * one.peak_force)


def test_the_bar_gives_as_the_frame_does() -> None:
    """Its own stretch is 3 % of what the crosshead travels."""
    truth = observe(stiff_bar(), 1).truth
    assert 1.0 / truth.stiffness_first == pytest.approx(1.03 * GIVE, rel=0.01)
