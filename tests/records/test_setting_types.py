from __future__ import annotations

from typing import get_args

import pytest

from labpipe.records import setting_types
from labpipe.records.setting_types import Quantity
from labpipe.units import parse_quantity, si_factor

QUANTITIES = {
    name: marker
    for name, kind in vars(setting_types).items()
    for marker in get_args(kind)[1:]
    if isinstance(marker, Quantity)
}


def test_there_are_some() -> None:
    assert {"Length", "Force", "Duration", "Share"} <= set(QUANTITIES)


@pytest.mark.parametrize("quantity", QUANTITIES.values(), ids=QUANTITIES)
def test_the_example_is_in_the_range_and_the_shown_unit_fits(quantity: Quantity) -> None:
    example = parse_quantity(quantity.example, quantity.unit)

    assert si_factor(quantity.shown, quantity.unit) > 0.0
    assert quantity.least <= example <= quantity.most
    assert quantity.above is None or example > quantity.above
