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
from labpipe.wire.bundle.tightening import holding_circle

YIELD_STRAIN = 1e-3
"""Strain along a wire beyond which its copper yields so far that an elastic one no longer says
what a sticking bundle does."""
_OTHER_DIAMETER = 0.05
"""Of a diameter: how far the test sheet may be from the wire sheet without a note."""
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
    ``elastic_limit``.

    Raises
    ------
    ValueError
        If a type of wire has no table, stated positions overlap or are not one for each wire, or
        the wires as they lie do not fit the conduit.

    Notes
    -----
    low = sum of the wires' slip stiffnesses, free = sum of their stick stiffnesses,
    high = free + sum EA (y - y0)^2, with y0 the centroid of the axial stiffnesses. The moments hold
    on first loading: sum of the wires' laws M(kappa), without and with kappa sum EA (y - y0)^2.
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
    curvature = common_curvature(kinds)
    slip = slipping_moment(curvature, kinds, counts)
    free = float(own[layout.kind].sum())
    high = float(stuck.tensor[1, 1])
    smallest = _smallest_bore(bundle, layout)
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
        packing_fraction=None if bore is None else packing_fraction(layout.diameter, bore),
        curvature=curvature,
        moment_slip=slip,
        moment_stick=slip + (high - free) * curvature,
        notes=(
            *_other_diameters(bundle, kinds),
            *_shortened(kinds, curvature),
            *_oblique(stuck),
            *_elastic(layout, stuck),
        ),
    )


def _table(type_: str, tables: Mapping[str, WireTable]) -> WireTable:
    if type_ not in tables:
        known = ", ".join(tables) or "none"
        message = f"the wire type {type_!r} has no law: there are those of {known}"
        raise ValueError(message)
    return tables[type_]


def _smallest_bore(bundle: Bundle, layout: BundleLayout) -> float:
    """Diameter of the circle that holds the wires, if it fits the conduit."""
    centres = np.column_stack([layout.x, layout.y])
    smallest = 2.0 * holding_circle(centres, layout.diameter)[1]
    bore = bundle.conduit_bore
    if bore is not None and not fits(smallest, bore):
        message = (
            f"the {bundle.number} wires as they lie need a bore of {1e3 * smallest:.4g} mm, "
            f"the conduit has {1e3 * bore:.4g} mm "
            f"(packing fraction {packing_fraction(layout.diameter, bore):.3g})"
        )
        raise ValueError(message)
    return smallest


def _other_diameters(bundle: Bundle, kinds: Sequence[WireTable]) -> Iterator[QualityNote]:
    for wire, table in zip(bundle.wires, kinds, strict=True):
        known = 2.0 * table.layout.wire_radius
        if wire.diameter and abs(wire.diameter - known) > _OTHER_DIAMETER * known:
            message = (
                f"{wire.type}: the bundle says {1e3 * wire.diameter:.4g} mm over the insulation, "
                f"which places the wires; the law is that of a wire of {1e3 * known:.4g} mm"
            )
            yield _note("diameter_differs", message, Severity.WARNING)


def _shortened(kinds: Sequence[WireTable], curvature: Floats) -> Iterator[QualityNote]:
    longest = max(kinds, key=lambda table: float(table.curvature[-1]))
    if longest.curvature[-1] > curvature[-1]:
        message = (
            f"moments are told up to {curvature[-1]:.4g} 1/m, where the shortest of the wires' laws"
            f" ends; that of {longest.name} goes to {longest.curvature[-1]:.4g} 1/m"
        )
        yield _note("range_shortened", message)


def _oblique(stuck: Sticking) -> Iterator[QualityNote]:
    (across, mixed), (_, along) = stuck.tensor
    lost = mixed**2 / (across * along)
    if lost > _OBLIQUE:
        message = (
            f"the principal axes are oblique ({np.degrees(stuck.angle):.3g} deg from x to the "
            f"stiffest direction): bent along y, a sticking bundle that may move aside is "
            f"{100.0 * lost:.2g} % less stiff than the {1e6 * along:.4g} N mm^2 of one kept in its "
            f"plane"
        )
        yield _note("oblique_axes", message)


def _elastic(layout: BundleLayout, stuck: Sticking) -> Iterator[QualityNote]:
    farthest = float(np.max(np.abs(layout.y - stuck.neutral[1])))
    if farthest > 0.0:
        message = (
            f"sticking wires are taken as elastic along their axes: the outermost, "
            f"{1e3 * farthest:.3g} mm from the neutral axis, is strained by {YIELD_STRAIN:.1%} at "
            f"{YIELD_STRAIN / farthest:.3g} 1/m; beyond, copper that yields leaves a sticking "
            f"bundle below this bound"
        )
        yield _note("elastic_limit", message)


def _note(code: str, message: str, severity: Severity = Severity.INFO) -> QualityNote:
    return QualityNote(code, severity, "bundle", message)
