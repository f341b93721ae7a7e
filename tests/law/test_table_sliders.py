"""Sliders of a wire's table."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.sliders import slider_moment
from labpipe.law.table_sliders import SLIDERS, sliders_of, table_card
from tests.builders.wire_tables import wire_table


def test_sliders_follow_the_table_and_their_card_says_how_well() -> None:
    table = wire_table("A2")
    law, bent = sliders_of(table), table.curvature[1:]
    off = np.abs(slider_moment(law, bent) / table.moment[1:] - 1.0)
    assert len(law.stiffnesses) == SLIDERS
    assert float(off.max()) == pytest.approx(dict(table_card(table).sliders)[SLIDERS], rel=1e-6)
    assert len(sliders_of(table, 4).stiffnesses) == 4
    assert sliders_of(table) is sliders_of(table, sliders=SLIDERS)  # fitted once
