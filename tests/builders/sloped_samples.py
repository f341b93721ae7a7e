"""Synthetic samples whose curve is a straight line, and groups of them."""

from __future__ import annotations

import numpy as np

from labpipe.records.group import Group, Sample, SampleCurve
from labpipe.records.result import Result, Specimen
from labpipe.statistics.groups import build_group

SPOOLS = {"s1": (58.33, 57.71, 56.28), "s2": (47.09, 48.19, 46.08)}


def stiffness(value: float | None, unit: str = "N/m", **said: object) -> Result:
    return Result("stiffness", value, unit, **said)  # type: ignore[arg-type]


def make(spool: str, number: int, slope: float, *, stop: float = 0.02) -> Sample:
    path = np.linspace(0.0, stop, 80)
    curve = SampleCurve(path, slope * path, slope * path)
    peak = Result("peak_force.1", slope * stop, "N")
    return Sample(
        test=f"{spool}-{number}",
        specimen=Specimen("tube", spool, str(number), {"length": 0.3}),
        protocol="tensile",
        loading=(curve,),
        unloading=(),
        results=(stiffness(slope), peak),
    )


def samples() -> list[Sample]:
    return [
        make(spool, number, slope)
        for spool, slopes in SPOOLS.items()
        for number, slope in enumerate(slopes, start=1)
    ]


def built(members: list[Sample], *, scaled: bool = False) -> Group:
    return build_group("tube", "tensile", members, scaled=scaled)


def said(group: Group) -> dict[str, str]:
    return {note.code: note.message for note in group.notes}
