"""Synthetic groups and campaigns, as the statistics hand them to the report.

Everything in them is made up; means and intervals are right for the values, bands are plausible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import FittedLine, Interval, Slip, SlipDecision
from labpipe.records.group import (
    Campaign,
    Contrast,
    Difference,
    Group,
    GroupNumber,
    MeanInterval,
    Outlier,
    Sample,
    SampleCurve,
    Verdict,
)
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Specimen, Status
from labpipe.statistics import groups

DISPLAY = {"displacement": "mm", "force": "N", "stiffness": "N/mm", "energy": "J"}


END = 0.040


def bilinear(displacement: Floats, scale: float = 1.0) -> Floats:
    """Force, N: 5 N/mm up to 10 mm, 2.8 N/mm beyond."""
    bent: Floats = scale * (
        5000 * np.minimum(displacement, 0.01) + 2800 * np.maximum(displacement - 0.01, 0)
    )
    return bent


def build_sample(
    spool: str, sample: str, *, scale: float = 1.0, slips: int = 0, cycles: int = 1, seed: int = 0
) -> Sample:
    """One sample; every slip loses 6 N and is repaired."""
    noise = np.random.default_rng(seed)
    x = np.linspace(0.0, END, 400)
    force = bilinear(x, scale) + noise.normal(0, 0.4, len(x))
    ledger = tuple(
        Slip(
            at, 6.0, Interval(at - 1e-5, at + 1e-5), Interval(5.5, 6.5), SlipDecision.REPAIRED, 0, 1
        )
        for at in 0.012 + 0.009 * np.arange(slips)
    )
    lost = sum((np.where(x > slip.position, slip.drop, 0.0) for slip in ledger), np.zeros_like(x))
    test = f"tt-{spool}{sample}"
    loading = tuple(
        SampleCurve(x, force * 0.98**n, force * 0.98**n - lost, n + 1) for n in range(cycles)
    )
    unloading = tuple(
        SampleCurve(x[120:], force[120:] - 14, force[120:] - 14, n + 1) for n in range(cycles - 1)
    )
    return Sample(
        test,
        Specimen("twist-tube-10", spool, sample, {"length": 0.075}),
        "twist-tube",
        loading,
        unloading,
        build_results(scale, noise),
        ledger,
        build_lines(scale),
        (QualityNote("smoothed", Severity.INFO, "force", "Moving average over 5 samples."),),
        DISPLAY,
        f"processed/synthetic/{test}/result.h5",
    )


LINE = "straight line over 2 mm to 8 mm; interval from the long-run variance of the residuals"
RESULTS: tuple[tuple[str, float, str, float, str], ...] = (
    ("peak_force.1", 134, "N", 0.002, "parabola through the top of the curve"),
    ("stiffness_first", 5000, "N/m", 0.004, LINE),
    ("stiffness_second", 2800, "N/m", 0.006, LINE),
    ("stiffness_first_per_peak_force", 5000 / 134, "1/m", 0.004, "stiffness over peak force"),
    ("break_point", 0.010, "m", 0.01, "two-segment least squares, all break points scanned"),
    ("failure_displacement", END, "m", 0.001, "last point before the force is lost"),
    ("failure_force", 134, "N", 0.002, "force at the last point before it is lost"),
)
"""Name, value, unit, standard error as a share, method."""


def build_results(scale: float, noise: np.random.Generator) -> tuple[Result, ...]:
    results = []
    for name, number, unit, error, method in RESULTS:
        value = number * (scale if unit in {"N", "N/m"} else 1.0) * (1 + noise.normal(0, 0.01))
        half = 1.96 * error * value
        ends = Interval(value - half, value + half)
        results.append(Result(name, value, unit, ends, method=method, n=200))
    return tuple(results)


def build_lines(scale: float) -> tuple[FittedLine, ...]:
    return (
        FittedLine("stiffness_first", 5000 * scale, 10 * scale, 0.002, 0.008),
        FittedLine("stiffness_second", 2800 * scale, 50 * scale, 0.010, 0.020),
    )


def build_group(name: str, samples: Sequence[Sample], *, scaled: bool = True) -> Group:
    return groups.build_group(name, "twist-tube", samples, scaled=scaled)


def build_number(name: str, samples: Sequence[Sample]) -> GroupNumber:
    numbers = build_group("", samples, scaled=False).numbers
    return next(number for number in numbers if number.name == name)


def six_samples(*, slips: int = 1, cycles: int = 1) -> list[Sample]:
    return [
        build_sample(
            spool, sample, scale=scale + step * number,
            slips=slips if sample == "b" else 0, cycles=cycles, seed=number,
        )
        for spool, scale, step in (("s1", 1.0, 0.01), ("s2", 1.02, -0.01))
        for number, sample in enumerate("abc")
    ]  # fmt: skip


def troubled_samples() -> list[Sample]:
    """Six samples: one doubtful result, one failed, a warning, an aborted test without a curve."""
    samples = six_samples()
    first = list(samples[0].results)
    first[1] = replace(
        first[1], status=Status.DOUBTFUL, reasons=(Reason("slip_in_window", "a slip at 5.2 mm."),)
    )
    samples[0] = replace(samples[0], results=tuple(first))
    reasons = (Reason("too_few_samples", "3 samples where 8 are needed."),)
    nothing = tuple(
        Result(result.name, None, result.unit, status=Status.FAILED, reasons=reasons)
        for result in samples[4].results
    )
    note = QualityNote("aborted", Severity.ERROR, "frame", "The export ends after 3 rows.")
    samples[4] = replace(
        samples[4], results=nothing, loading=(), lines=(), slips=(), quality=(note,)
    )
    return samples


def build_campaign() -> Campaign:
    """Everything that a report can have to show."""
    first = build_group("twist-tube-10", troubled_samples())
    numbers = list(first.numbers)
    odd = Outlier("tt-s1c", 5400.0, "Grubbs' test", 0.013)
    numbers[1] = replace(numbers[1], outliers=(odd,))
    first = replace(first, numbers=tuple(numbers))
    lone = build_group("twist-tube-7", [build_sample("s9", "a", scale=0.7)], scaled=False)
    empty = build_group("twist-tube-5", [])
    return Campaign(
        "Synthetic campaign",
        (first, lone, empty),
        (replace(build_difference(), family="", fields={}),),
        {"processed/synthetic/tt-x/result.h5": "result.h5: expected an HDF5 file, found a text."},
        "0.0",
    )


def build_difference() -> Difference:
    """A stiffness that is 28 % lower, with the interval of the share."""
    return Difference(
        name="stiffness_first",
        unit="N/m",
        first="twist-tube-10",
        second="twist-tube-7",
        difference=MeanInterval(-1423.4, Interval(-1602.0, -1244.8), 120.0, 7),
        margin=500.0,
        contrast=Contrast(math.log(0.72), (0.02, 0.02), (6, 3), margin=math.log(1.1), is_log=True),
        p=0.001,
        p_equivalent=0.98,
        family="differences of types",
        n_comparisons=1,
        interval=Interval(-0.31, -0.25),
        verdict=Verdict.DIFFERENT,
        verdict_reason="p = 0.001",
        fields={"type": ("twist-tube-10", "twist-tube-7")},
    )


SPOOLS = {"s1": (58.33, 57.71, 56.28), "s2": (47.09, 48.19, 46.08)}


def stiffness(value: float | None, unit: str = "N/m", **fields: object) -> Result:
    return Result("stiffness", value, unit, **fields)  # type: ignore[arg-type]


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
    return groups.build_group("tube", "tensile", members, scaled=scaled)


def said(group: Group) -> dict[str, str]:
    return {note.code: note.message for note in group.notes}
