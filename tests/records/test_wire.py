from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire import AUTO_LAYOUT, WireLayout, WireSpec
from tests.builders.measured_bending import some_bending
from tests.builders.wire_tables import wire_table

SPEC = WireSpec("W", 1.6e-3, (1, 6), (0.32e-3,) * 2, (0.2,), 0.3e-3)


def test_a_silent_sheet_means_annealed_copper_in_a_soft_tube() -> None:
    assert (SPEC.conductor_modulus, SPEC.copper_k, SPEC.copper_n) == (110e9, 530e6, 0.44)
    assert (SPEC.insulation_modulus, SPEC.poisson, SPEC.length) == (1e9, 0.34, 0.085)
    assert (SPEC.friction_strand, SPEC.friction_insulation, SPEC.radial_force) == (0.21, 0.1, 0.15)
    assert (SPEC.tension, SPEC.orientation, SPEC.largest_curvature) == (0.0, 0.0, None)
    assert SPEC.layout == AUTO_LAYOUT


@pytest.mark.parametrize(
    ("onsets", "first", "last"),
    [
        ([0.01, 0.03], 0.01, 0.03),
        ([0.01, 1e9], 0.01, 0.01),
        ([0.0], "at once", "at once"),
        ([0.0, 0.03], "at once", 0.03),
        ([np.inf], "beyond", "beyond"),
        ([], "beyond", "beyond"),
    ],
)
def test_slip_at_once_is_told_from_slip_beyond_the_range(
    onsets: list[float], first: float | str, last: float | str
) -> None:
    table = replace(wire_table("A2"), slip_onsets=np.array(onsets, dtype=np.float64))
    assert (table.find_slip_onset(0), table.find_slip_onset(-1)) == (first, last)
    assert table.slips_immediately == (0.0 in onsets)


def test_a_single_strand_has_nothing_to_slip_on() -> None:
    table = wire_table("A2")
    one = np.zeros(1)
    layout = WireLayout("hexagonal", one, one, np.array([0]), one + 1e-3, 1e-3, 2e-3)
    assert replace(table, layout=layout, slip_onsets=np.zeros(0)).find_slip_onset(0) == "none"


def test_noise_of_a_cloud_holds_what_the_shape_may_be() -> None:
    cloud = some_bending().cloud
    drawn = np.full((6, 3), 3.0)
    for systematic, noise in ((4.0 * np.sqrt(3.0), 5.0), (np.nan, 3.0)):
        both = replace(
            cloud, curvature_error=drawn, curvature_systematic=np.full((6, 3), systematic)
        )
        assert both.total_error == pytest.approx(np.full((6, 3), noise))
