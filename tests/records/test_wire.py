from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire import AUTO, LAYOUTS, WireLayout, WireSpec
from tests.builders.wire_tables import wire_table

SPEC = WireSpec("W", 1.6e-3, (1, 6), (0.32e-3,) * 2, (0.2,), 0.3e-3)


def test_a_silent_sheet_means_annealed_copper_in_a_soft_tube() -> None:
    assert (SPEC.conductor_modulus, SPEC.copper_k, SPEC.copper_n) == (110e9, 530e6, 0.44)
    assert (SPEC.insulation_modulus, SPEC.poisson, SPEC.length) == (1e9, 0.34, 0.085)
    assert (SPEC.friction_strand, SPEC.friction_insulation, SPEC.radial_force) == (0.21, 0.1, 0.15)
    assert (SPEC.tension, SPEC.orientation, SPEC.largest_curvature) == (0.0, 0.0, None)
    assert SPEC.layout == AUTO
    assert AUTO in LAYOUTS


def test_arrays_of_a_table_are_frozen_and_of_one_length() -> None:
    table = wire_table("A2")
    for name in ("curvature", "moment", "slip_onsets", "tip_force"):
        assert not getattr(table, name).flags.writeable
    with pytest.raises(ValueError, match=r"expected an array of shape \(\d+,\), found \(3,\)"):
        replace(table, moment=np.zeros(3))
    with pytest.raises(ValueError, match=r"expected an array of shape"):
        replace(table, tip_force=np.zeros(3))


def test_a_layout_has_one_centre_for_each_strand() -> None:
    layer = np.array([0, 1])
    ones = np.ones(2)
    layout = WireLayout("packed", ones, ones, layer, ones, 1e-3, 2e-3)
    assert not layout.x.flags.writeable
    with pytest.raises(ValueError, match=r"expected an array of shape \(2,\), found \(3,\)"):
        WireLayout("packed", np.ones(3), ones, layer, ones, 1e-3, 2e-3)
