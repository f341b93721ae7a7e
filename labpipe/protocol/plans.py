"""The grammar of a calibration plan: which parameters are free, and which curves are compared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from labpipe.errors import Fault
from labpipe.protocol.faults import Values, error_of, list_in, same_names
from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import Version
from labpipe.protocol.values import Remark, Text, file_inside
from labpipe.records.declarations import Length, Quantity, WholeNumber
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
Sign = Annotated[Literal[1, -1], BeforeValidator(_sign)]


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


Friction = Annotated[float, Quantity("N", "N", "0.05 N", above=0.0)]
Modulus = Annotated[float, Quantity("Pa", "MPa", "1000 MPa", above=0.0)]
Scale = Annotated[float, Quantity("1", "1", "1", above=0.0)]
Scatter = Annotated[float, Quantity("1", "%", "3 %", minimum=0.0, maximum=0.5)]
Factor = Annotated[float, Quantity("1", "1", "1.5", above=1.0)]

_NEEDS_VALUE = "Add the value that it has, or that the prior lies about."


class _Parameter(Block):
    """How one parameter enters."""

    enters: Literal["free", "fixed", "prior"] = Field(
        "free", description="fitted; held at its value; fitted with a log-normal prior about it"
    )
    factor: Factor | None = Field(
        None, description="Of a prior: 95 % between value / factor and value x factor"
    )
    because: Remark = Field("", description="Where a prior or a fixed value comes from")

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Ask of a prior what it needs, and of the others that they do not have it."""
        enters = data.get("enters", "free")
        if enters in ("fixed", "prior") and data.get("value") is None:
            yield Fault((), f"a value of what is {enters}", "none", _NEEDS_VALUE)
        if enters in ("fixed", "prior") and not data.get("because"):
            remedy = "Say where the number comes from, in 'because'."
            yield Fault((), f"a source of what is {enters}", "none", remedy)
        if enters == "prior" and data.get("factor") is None:
            remedy = "Give a factor, such as 1.5."
            yield Fault((), "the width of a prior", "none", remedy)
        if enters in ("free", "fixed") and data.get("factor") is not None:
            remedy = "Write 'enters: prior', or take 'factor' away."
            yield Fault(("factor",), "no factor", "one without a prior", remedy, "key")


class RadialFriction(_Parameter):
    """phi = F_rad (mu_s + mu_p)."""

    value: Friction | None = None


class InsulationModulus(_Parameter):
    """E of the insulation."""

    value: Modulus | None = None


class CopperScale(_Parameter):
    """Factor on the strength of the copper."""

    value: Scale | None = None


class Parameters(Block):
    """All that is calibrated."""

    radial_friction: RadialFriction = RadialFriction()
    insulation_modulus: InsulationModulus = InsulationModulus()
    copper_scale: CopperScale = CopperScale()


class CalibrationPlan(Block):
    """What is asked of a calibration."""

    version: Version
    wire: Text | None = Field(
        None, description="Specimen type whose tests calibrate; the others are predicted"
    )
    parameters: Parameters = Parameters()
    scatter: Scatter | None = Field(
        None, description="Standard deviation between samples, where it is known"
    )
    points: Annotated[int, WholeNumber(20, 5000)] = Field(272, description="Points of each curve")
    up_to: Length | None = Field(None, description="Largest deflection that is used")
    comparisons: tuple[Comparison, ...] = Field(
        (), description="Curves from elsewhere that tests and model are compared with"
    )

    @classmethod
    def between(cls, data: Values) -> Iterable[Fault]:
        """Ask each comparison for a name of its own."""
        return same_names(list_in(data, "comparisons"), "comparisons", "comparison")
