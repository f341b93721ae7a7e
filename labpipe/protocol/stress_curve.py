"""The grammar of a stress table that a wire sheet names: a row per point of the curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from labpipe.errors import Fault
from labpipe.protocol.grammar import Block
from labpipe.protocol.wire_rows import Column, Curve

FIRST_SLOPES = {"stress_table": (1e9, 1e12), "insulation_table": (1e5, 1e10)}
"""Slopes (Pa) between which the first one is, of strands and insulation by the column that names
the table: a wrong unit of strain or stress is outside."""


class StressPoint(Block):
    """One point of a measured stress-strain curve."""

    strain: Annotated[float, Column("", 0.0, 0.6)]
    stress_mpa: Annotated[float, Column("MPa", 0.0, 1e5)]


def curve_fault(points: Sequence[StressPoint], column: str) -> tuple[int, Fault] | None:
    """Find the first point that makes no curve: strains grow, stresses never fall, nor stiffen.

    Parameters
    ----------
    points : in the order of the table; one at zero may come first
    column : of the wire sheet that names the table

    Returns
    -------
    Number of the point, counted from 0, and what is wrong with it.
    """
    last, first_slope = (0.0, 0.0), 0.0
    for number, point in enumerate(points):
        current = (point.strain, point.stress_mpa)
        if number == 0 and not any(current):
            continue
        if wrong := _step_fault(last, current, first_slope):
            return number, wrong
        first_slope = first_slope or (current[1] - last[1]) / (current[0] - last[0])
        last = current
    if not first_slope:
        return 0, Fault((), "a point beyond zero", "none", "Fill in the table.")
    low, high = FIRST_SLOPES[column]
    if low <= first_slope * 1e6 <= high:
        return None
    expected = f"a first slope of {low / 1e9:g} to {high / 1e9:g} GPa"
    remedy = "Give the strain as a plain number, not in per cent, and the stress in MPa."
    first = next(number for number, point in enumerate(points) if point.strain)
    return first, Fault((), expected, f"{first_slope / 1e3:.4g} GPa", remedy)


def _step_fault(
    last: tuple[float, float], current: tuple[float, float], first_slope: float
) -> Fault | None:
    """Return what is wrong with a point behind another one, both of strain and stress in MPa."""
    # Share of the first slope.
    rounding = 1e-6
    remedy = "Put the rows in order and correct them."
    step, rise = current[0] - last[0], current[1] - last[1]
    if step <= 0.0:
        return Fault((), f"a strain above {last[0]:g}", f"{current[0]:g}", remedy)
    if rise < 0.0 or not (rise or first_slope):
        expected = f"a stress of {last[1]:g} MPa or more, and more than zero"
        return Fault((), expected, f"{current[1]:g} MPa", remedy)
    if first_slope and rise / step > first_slope * (1.0 + rounding):
        expected = f"a slope up to the first, {first_slope / 1e3:.4g} GPa"
        return Fault((), expected, f"{rise / step / 1e3:.4g} GPa", remedy)
    return None


def curve_of(points: Sequence[StressPoint]) -> Curve:
    """Return the strains and stresses (Pa) beyond zero."""
    stress = StressPoint.model_fields["stress_mpa"].metadata[0].in_si
    beyond = [point for point in points if point.strain > 0.0]
    return tuple(point.strain for point in beyond), tuple(
        stress(point.stress_mpa) for point in beyond
    )
