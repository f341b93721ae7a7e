"""What steps, kinds of results and export formats are declared to be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, get_args

import pytest

from labpipe.records import declarations
from labpipe.records.declarations import (
    STEPS,
    ChannelName,
    Output,
    Quantity,
    StiffnessName,
    Zero,
    get_defaults,
    list_references,
)
from labpipe.units import get_conversion_factor, parse_quantity

QUANTITIES = {
    name: marker
    for name, kind in vars(declarations).items()
    for marker in get_args(kind)[1:]
    if isinstance(marker, Quantity)
}


@pytest.mark.parametrize("quantity", QUANTITIES.values(), ids=QUANTITIES)
def test_the_example_is_in_the_range_and_the_shown_unit_fits(quantity: Quantity) -> None:
    example = parse_quantity(quantity.example, quantity.unit)

    assert get_conversion_factor(quantity.display_unit, quantity.unit) > 0.0
    assert quantity.minimum <= example <= quantity.maximum
    assert quantity.lower_bound is None or example > quantity.lower_bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """A kind of result."""

    of: Annotated[StiffnessName, "Name of a stiffness above"] = "stiffness"
    channel: ChannelName
    name: str = "ratio"


def test_what_a_kind_of_result_is_called_and_rests_on() -> None:
    assert list_references(Ratio, "stiffness") == ("of",)
    assert list_references(Ratio, "channel") == ("channel",)
    assert get_defaults(Ratio) == {"of": "stiffness", "name": "ratio"}
    assert Output("{of}_{name}", "1").format_name(Ratio, {"name": "x"}) == "stiffness_x"
    assert Output("{name}", "1", first=2).format_name(Ratio, {"name": 3}) == "3.2"


def test_a_step_knows_its_place_which_is_no_setting() -> None:
    step = Zero(channel="force", over=2.0)
    third = step.with_index(2)
    assert (step.key, third.key) == ("steps.0", "steps.2")
    assert third == step


def test_what_a_step_comes_after_is_a_step() -> None:
    befores = {kind.required_step for kind in STEPS.values() if kind.required_step}
    assert befores <= set(STEPS)
    assert all(kind.uses_markers for kind in STEPS.values() if kind.required_step)
