from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, get_args

import pytest

from labpipe.records import declarations
from labpipe.records.declarations import (
    ChannelName,
    Output,
    Quantity,
    StiffnessName,
    defaults_of,
    existing_in,
)
from labpipe.units import parse_quantity, si_factor

QUANTITIES = {
    name: marker
    for name, kind in vars(declarations).items()
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """A kind of result."""

    of: Annotated[StiffnessName, "Name of a stiffness above"] = "stiffness"
    channel: ChannelName
    name: str = "ratio"


def test_what_a_kind_of_result_is_called_and_rests_on() -> None:
    assert existing_in(Ratio, "stiffness") == ("of",)
    assert existing_in(Ratio, "channel") == ("channel",)
    assert defaults_of(Ratio) == {"of": "stiffness", "name": "ratio"}
    assert Output("{of}_{name}", "1").name_in(Ratio, {"name": "x"}) == "stiffness_x"
    assert Output("{name}", "1", first=2).name_in(Ratio, {"name": 3}) == "3.2"
