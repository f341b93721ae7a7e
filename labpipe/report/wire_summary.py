"""What a summary of wires says of each: one row of numbers, in the units of its headings."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Ints
from labpipe.records.wire import WireTable
from labpipe.report.sheets import Value
from labpipe.report.thinning import bends
from labpipe.report.wire_look import CURVATURE, FORCE, LENGTH, MOMENT, STIFFNESS, bent, warnings_of

DEFLECTIONS = (5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3)
"""Tip deflections at which the end load is told, m."""
_AREA = LENGTH.factor**2


class Column(NamedTuple):
    """A column of the summary.

    Parameters
    ----------
    heading : with the unit
    value : of a wire; None where there is no such number
    """

    heading: str
    value: Callable[[WireTable], Value]


def _of_layers(table: WireTable, sign: str) -> str:
    return f" {sign} ".join(str(count) for count in table.spec.layer_counts)


def _lay_angles(table: WireTable) -> str:
    return "; ".join(f"{angle:.4g}" for angle in np.degrees(table.spec.lay_angles))


def _area(table: WireTable) -> float:
    return _AREA * float(np.sum(np.pi / 4.0 * table.layout.diameter**2))


def _onset(table: WireTable, which: int) -> float | str:
    """First or last onset of slip within the range, or the word for it."""
    onset = table.slip_onset(which)
    return onset if isinstance(onset, str) else CURVATURE.factor * onset


def orientation_spread(table: WireTable) -> float | None:
    """Largest difference of the moments of all orientations, in per cent of the moment.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    None where the table has no curvature but zero.
    """
    use = bent(table)
    if not use.any():
        return None
    apart = (table.highest_moment - table.lowest_moment)[use] / table.moment[use]
    return 100.0 * float(np.max(apart))


def force_at(table: WireTable, deflection: float) -> float | None:
    """End load at a tip deflection, N, by straight lines between the points of the curve.

    Parameters
    ----------
    table : of the wire
    deflection : m

    Returns
    -------
    None beyond the end of the curve, and where there is none.
    """
    if not len(table.tip_deflection) or deflection > table.tip_deflection[-1]:
        return None
    return FORCE.factor * float(np.interp(deflection, table.tip_deflection, table.tip_force))


def shown_rows(table: WireTable, most: int) -> Ints:
    """Number the rows of the law that a sheet of limited length shows.

    Parameters
    ----------
    table : of the wire
    most : rows, at least 2

    Returns
    -------
    Sorted row numbers: zero curvature, and of the others those that keep the shape of the law in
    logarithms, so that its first slips count as much as its end; all if there are not more.

    Notes
    -----
    See `labpipe.report.thinning.bends`.
    """
    count = len(table.curvature)
    use = np.flatnonzero(bent(table) & (table.moment > 0.0))
    if count <= most or not len(use):
        return np.arange(count, dtype=np.int64)
    across, up = np.log(table.curvature[use]), np.log(table.moment[use])
    kept = use[bends(across, up, points=most - 1, tolerance=0.0)]
    return np.union1d([0], kept).astype(np.int64)


def row_error(table: WireTable, rows: Ints) -> float:
    """Largest error of straight lines between some rows of the law, in per cent of the moment.

    Parameters
    ----------
    table : of the wire
    rows : numbers of the rows
    """
    use = bent(table)
    lines = np.interp(table.curvature, table.curvature[rows], table.moment[rows])
    apart = np.abs(lines - table.moment)[use] / np.abs(table.moment[use])
    return 100.0 * float(np.max(apart, initial=0.0))


def _force_column(deflection: float) -> Column:
    heading = f"end load at {LENGTH.factor * deflection:g} {LENGTH.unit} ({FORCE.unit})"
    return Column(heading, lambda table: force_at(table, deflection))


SUMMARY = (
    Column("strands", lambda table: len(table.layout.layer)),
    Column("layers", lambda table: _of_layers(table, "+")),
    Column("lay angles (deg)", _lay_angles),
    Column("layout", lambda table: table.layout.kind),
    Column("wire diameter (mm)", lambda table: 2.0 * LENGTH.factor * table.layout.wire_radius),
    Column("bore diameter (mm)", lambda table: 2.0 * LENGTH.factor * table.layout.bore_radius),
    Column("thinnest strand (mm)", lambda table: LENGTH.factor * min(table.layout.diameter)),
    Column("thickest strand (mm)", lambda table: LENGTH.factor * max(table.layout.diameter)),
    Column("conductor area (mm²)", _area),
    Column("stick stiffness (N·mm²)", lambda table: STIFFNESS.factor * table.stick_stiffness),
    Column("slip stiffness (N·mm²)", lambda table: STIFFNESS.factor * table.slip_stiffness),
    Column("first slip (1/m)", lambda table: _onset(table, 0)),
    Column("last slip (1/m)", lambda table: _onset(table, -1)),
    Column("range, curvature (1/m)", lambda table: CURVATURE.factor * float(table.curvature[-1])),
    Column("range, bending radius (mm)", lambda table: LENGTH.factor / float(table.curvature[-1])),
    Column("moment at the end (N·mm)", lambda table: MOMENT.factor * float(table.moment[-1])),
    Column(
        "secant stiffness at the end (N·mm²)",
        lambda table: STIFFNESS.factor * float(table.secant_stiffness[-1]),
    ),
    Column(
        "tangent stiffness at the end (N·mm²)",
        lambda table: STIFFNESS.factor * float(table.tangent_stiffness[-1]),
    ),
    Column("spread over orientations, largest (%)", orientation_spread),
    Column("axial stiffness (N)", lambda table: table.axial_stiffness),
    Column(
        "torsional stiffness (N·mm²/rad)",
        lambda table: STIFFNESS.factor * table.torsional_stiffness,
    ),
    Column("cantilever length (mm)", lambda table: LENGTH.factor * table.spec.length),
    *(_force_column(deflection) for deflection in DEFLECTIONS),
    Column("warnings", warnings_of),
    Column("defaults taken", lambda table: "; ".join(table.spec.defaults.values())),
)
"""What stands in the row of a wire, behind its name."""
