"""The grammar of a comparison: a curve from elsewhere, of which wire, in which columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from labpipe.errors import Fault
from labpipe.protocol.block import Block
from labpipe.protocol.faults import error_of
from labpipe.protocol.words import Text, file_inside
from labpipe.records.setting_types import Length
from labpipe.units import si_factor


def _unit_like(si_unit: str, example: str) -> Callable[[object], str]:
    def check(value: object) -> str:
        try:
            si_factor(str(value), si_unit)
        except ValueError as error:
            raise error_of(expected=f"a unit such as {example}", found=value) from error
        return str(value)

    return check


def _sign(value: object) -> int:
    if str(value) not in ("1", "+1", "-1"):
        raise error_of(expected="1 or -1", found=value)
    return int(str(value))


COPY_IT = "Copy the curve into the folder of the plan and name it from there."

LengthUnit = Annotated[str, BeforeValidator(_unit_like("m", "mm")), Field(examples=["mm"])]
ForceUnit = Annotated[str, BeforeValidator(_unit_like("N", "N")), Field(examples=["N"])]
Sign = Annotated[int, BeforeValidator(_sign), WithJsonSchema({"enum": [1, -1]})]


class _Column(Block):
    """Where one of two quantities stands."""

    column: Text | None = Field(
        None, description="Its name, or its number counted from 1; else 'deflection' or 'force'"
    )
    sign: Sign = Field(1, description="-1 where the file counts against the direction of bending")


class DeflectionColumn(_Column):
    """The deflection of the tip."""

    unit: LengthUnit | None = Field(None, description="Where the heading does not say it")


class ForceColumn(_Column):
    """The force at the tip."""

    unit: ForceUnit | None = Field(None, description="Where the heading does not say it")


class Comparison(Block):
    """A curve from elsewhere: finite elements, a digitised figure, another lab."""

    name: Text
    file: Annotated[str, file_inside("the folder of the plan", COPY_IT)] = Field(
        description="csv or xlsx in the folder of the plan, or below it"
    )
    wire: Text = Field(description="Wire of the sheet that it is of")
    length: Length = Field(description="Free length")
    load: Literal["as tested", "normal"] = Field(
        "as tested",
        description="as tested: pulled by the string of the tests; normal: a force that stays "
        "normal to the undeformed axis, as in most finite-element models",
    )
    deflection: DeflectionColumn = DeflectionColumn()
    force: ForceColumn = ForceColumn()
    because: Text = Field(description="Where it comes from")


def same_names(comparisons: object) -> list[Fault]:
    """Find comparisons that are called as an earlier one.

    Parameters
    ----------
    comparisons : as written in the plan
    """
    first: dict[str, int] = {}
    faults = []
    for number, each in enumerate(comparisons if isinstance(comparisons, list) else []):
        name = each.get("name") if isinstance(each, Mapping) else None
        if not isinstance(name, str):
            continue
        if name in first:
            found = f"{name!r}, as comparison {first[name] + 1}"
            path = ("comparisons", number, "name")
            faults.append(Fault(path, "a name of its own", found, "Call it something else."))
        first.setdefault(name, number)
    return faults
