"""The grammar of a calibration: which wire, what is free, which curves it is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from labpipe.errors import Fault
from labpipe.protocol.block import Block
from labpipe.protocol.comparison_plan import Comparison, same_names
from labpipe.protocol.schema import known_version
from labpipe.protocol.words import Remark, Text
from labpipe.records.setting_types import Length, Quantity, Whole

Friction = Annotated[float, Quantity("N", "N", "0.05 N", above=0.0)]
Modulus = Annotated[float, Quantity("Pa", "MPa", "1000 MPa", above=0.0)]
Scale = Annotated[float, Quantity("1", "1", "1", above=0.0)]
Scatter = Annotated[float, Quantity("1", "%", "3 %", least=0.0, most=0.5)]
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
    def between(cls, data: object) -> list[Fault]:
        """Ask of a prior what it needs, and of the others that they do not have it."""
        if not isinstance(data, Mapping):
            return []
        enters = data.get("enters", "free")
        faults = []
        if enters in ("fixed", "prior") and data.get("value") is None:
            faults.append(Fault((), f"a value of what is {enters}", "none", _NEEDS_VALUE))
        if enters in ("fixed", "prior") and not data.get("because"):
            remedy = "Say where the number comes from, in 'because'."
            faults.append(Fault((), f"a source of what is {enters}", "none", remedy))
        if enters == "prior" and data.get("factor") is None:
            remedy = "Give a factor, such as 1.5."
            faults.append(Fault((), "the width of a prior", "none", remedy))
        if enters in ("free", "fixed") and data.get("factor") is not None:
            remedy = "Write 'enters: prior', or take 'factor' away."
            faults.append(Fault(("factor",), "no factor", "one without a prior", remedy, "key"))
        return faults


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

    version: Annotated[Literal[1], BeforeValidator(known_version), WithJsonSchema({"const": 1})]
    wire: Text | None = Field(
        None, description="Specimen type whose tests calibrate; the others are predicted"
    )
    method: Literal["likelihood", "source"] = Field(
        "likelihood",
        description="source: beside it, the source's three friction numbers and one stiffness",
    )
    parameters: Parameters = Parameters()
    scatter: Scatter | None = Field(
        None, description="Standard deviation between samples, where it is known"
    )
    points: Annotated[int, Whole(20, 5000)] = Field(272, description="Points of each curve")
    up_to: Length | None = Field(None, description="Largest deflection that is looked at")
    comparisons: tuple[Comparison, ...] = Field(
        (), description="Curves from elsewhere that tests and model are compared with"
    )

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Ask each comparison for a name of its own."""
        return same_names(data.get("comparisons") if isinstance(data, Mapping) else None)
