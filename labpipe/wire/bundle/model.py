"""The model of a bundle: what bounds its bending, from the laws of its wires and where they lie."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.bundle import Bundle, BundleLayout, BundleModel
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireTable
from labpipe.wire.bundle.arrangement import arrange
from labpipe.wire.bundle.packing_fraction import fits, packing_fraction
from labpipe.wire.bundle.stiffness import (
    Sticking,
    common_curvature,
    slipping_moment,
    sticking,
)
from labpipe.wire.bundle.stretching import largest_stretch, stretching_moment
from labpipe.wire.bundle.tightening import holding_circle

_OTHER_DIAMETER = 0.05
"""Of a diameter: how far the test sheet may be from the wire sheet without a note."""
_MOSTLY_STRETCHED = 2.0
"""Of the stiffness of wires that slip: above it, more than half is stretching."""
_OBLIQUE = 0.01
"""Of the stiffness along y: what a bundle may lose by moving aside without a note."""


def bundle_model(bundle: Bundle, tables: Mapping[str, WireTable], *, seed: int = 0) -> BundleModel:
    """Work out between what bounds the bending of a bundle lies.

    Parameters
    ----------
    bundle : its diameters, where it states them, go before those of the wires' tables
    tables : law of each type of wire
    seed : of what the layout leaves to chance

    Returns
    -------
    The model. Notes: ``diameter_differs``, ``range_shortened``, ``oblique_axes``,
    ``copper_yields``.

    Raises
    ------
    ValueError
        If a type of wire has no table, stated positions overlap or are not one for each wire, or
        the wires as they lie do not fit the conduit.

    Notes
    -----
    low = sum of the wires' slip stiffnesses (copper that yields brings the moments below it),
    free = sum of their stick stiffnesses, high = free + sum EA (y - y0)^2, with y0 the centroid of
    the axial stiffnesses. The moments hold on first loading: the sum of the wires' laws M(kappa),
    without and with the moment of their stretching and shortening, in which copper yields (see
    `wire.bundle.stretching`). What bending and stretching of one wire do to each other is left out.
    Friction between wires, and tape that gives, leave a bundle between the two.
    """
    kinds = [_table(wire.type, tables) for wire in bundle.wires]
    counts = [wire.number for wire in bundle.wires]
    diameters = [
        wire.diameter or 2.0 * table.layout.wire_radius
        for wire, table in zip(bundle.wires, kinds, strict=True)
    ]
    axial = np.array([table.axial_stiffness for table in kinds])
    layout = arrange(bundle, diameters, axial.tolist(), seed=seed)
    own = np.array([table.stick_stiffness for table in kinds])
    stuck = sticking(layout.x, layout.y, own[layout.kind], axial[layout.kind])
    curvature, notes = _curvature(kinds, layout)
    slip = slipping_moment(curvature, kinds, counts)
    stick = slip + stretching_moment(curvature, layout.y, layout.kind, kinds)
    free = float(own[layout.kind].sum())
    high = float(stuck.tensor[1, 1])
    middle, smallest = _holding(bundle, layout)
    bore = bundle.conduit_bore
    return BundleModel(
        bundle=bundle,
        layout=layout,
        low=float(np.dot(counts, [table.slip_stiffness for table in kinds])),
        free=free,
        high=high,
        tensor=stuck.tensor,
        principal=stuck.principal,
        principal_angle=stuck.angle,
        neutral=stuck.neutral,
        axial_stiffness=float(axial[layout.kind].sum()),
        smallest_bore=smallest,
        middle=middle,
        packing_fraction=None if bore is None else packing_fraction(layout.diameter, bore),
        curvature=curvature,
        moment_slip=slip,
        moment_stick=stick,
        notes=(
            *_other_diameters(bundle, kinds),
            *notes,
            *_oblique(stuck),
            *_yielding(high, free, curvature, stick),
        ),
    )


def _table(type_: str, tables: Mapping[str, WireTable]) -> WireTable:
    if type_ not in tables:
        known = ", ".join(tables) or "none"
        message = f"the wire type {type_!r} has no law: there are those of {known}"
        raise ValueError(message)
    return tables[type_]


def _holding(bundle: Bundle, layout: BundleLayout) -> tuple[tuple[float, float], float]:
    """Centre and diameter of the circle that holds the wires, if it fits the conduit."""
    centres = np.column_stack([layout.x, layout.y])
    middle, radius = holding_circle(centres, layout.diameter)
    smallest = 2.0 * radius
    bore = bundle.conduit_bore
    if bore is not None and not fits(smallest, bore):
        message = (
            f"the {bundle.number} wires as they lie need a bore of {1e3 * smallest:.4g} mm, "
            f"the conduit has {1e3 * bore:.4g} mm "
            f"(packing fraction {packing_fraction(layout.diameter, bore):.3g})"
        )
        raise ValueError(message)
    return (float(middle[0]), float(middle[1])), smallest


def _other_diameters(bundle: Bundle, kinds: Sequence[WireTable]) -> Iterator[QualityNote]:
    for wire, table in zip(bundle.wires, kinds, strict=True):
        known = 2.0 * table.layout.wire_radius
        if wire.diameter and abs(wire.diameter - known) > _OTHER_DIAMETER * known:
            message = (
                f"{wire.type}: the bundle says {1e3 * wire.diameter:.4g} mm over the insulation, "
                f"which places the wires; the law is that of a wire of {1e3 * known:.4g} mm"
            )
            yield QualityNote("diameter_differs", Severity.WARNING, "bundle", message)


def _curvature(
    kinds: Sequence[WireTable], layout: BundleLayout
) -> tuple[Floats, tuple[QualityNote, ...]]:
    """Curvatures that all laws know, and a note where one of them goes further."""
    curvature = common_curvature(kinds)
    depth = float(np.ptp(layout.y))
    known = min(largest_stretch(table) for table in kinds) / depth if depth else np.inf
    if known < curvature[-1]:
        curvature = np.append(curvature[curvature < known], known)
        why = f"sticking wires {1e3 * depth:.3g} mm apart reach the last strain of a stress table"
    else:
        why = "the shortest of the wires' laws ends"
    longest = max(kinds, key=lambda table: float(table.curvature[-1]))
    if longest.curvature[-1] <= curvature[-1]:
        return curvature, ()
    message = (
        f"moments are told up to {curvature[-1]:.4g} 1/m, where {why}; the law of {longest.name} "
        f"goes to {longest.curvature[-1]:.4g} 1/m"
    )
    return curvature, (QualityNote("range_shortened", Severity.INFO, "bundle", message),)


def _oblique(stuck: Sticking) -> Iterator[QualityNote]:
    (across, mixed), (_, along) = stuck.tensor
    lost = mixed**2 / (across * along)
    if lost > _OBLIQUE:
        message = (
            f"the principal axes are oblique ({np.degrees(stuck.angle):.3g} deg from x to the "
            f"stiffest direction): bent along y, a sticking bundle that may move aside is "
            f"{100.0 * lost:.2g} % less stiff than the {_stiffness(along)} of one kept in its "
            f"plane"
        )
        yield QualityNote("oblique_axes", Severity.INFO, "bundle", message)


def _yielding(high: float, free: float, curvature: Floats, stick: Floats) -> Iterator[QualityNote]:
    """Say where a sticking bundle whose wires are stretched has half its first stiffness."""
    if high < _MOSTLY_STRETCHED * free:  # what it loses then are strands that slip
        return
    below = np.flatnonzero(stick[1:] < 0.5 * high * curvature[1:]) + 1
    if len(below):
        message = (
            f"copper that is stretched yields: a sticking bundle, bent along y, has less than half "
            f"of its {_stiffness(high)} beyond {curvature[below[0]]:.3g} 1/m"
        )
        yield QualityNote("copper_yields", Severity.INFO, "bundle", message)


def _stiffness(value: float) -> str:
    """A stiffness as the lines of a bundle have it, four digits and never a power of ten."""
    return f"{float(f'{1e6 * value:.4g}'):.10g} N mm^2"
