"""Bundles between their bounds: wires that slip on each other under tape and conduit.

A wire at the distance y from the neutral axis is pulled along by its neighbours until friction lets
go, as the wires of a strand are in Papailiou (On the bending stiffness of transmission line
conductors, IEEE Trans. Power Delivery 12 (1997) 1576) and in Foti and Martinelli (An analytical
approach to model the hysteretic bending behavior of spiral strands, Appl. Math. Modelling 40 (2016)
6451): a Coulomb slider in series with a spring for every wire, all of them side by side. Contacts
between insulated wires are far from rigid, so that the spring is a share of the wire's axial
stiffness. They are not all alike, either: part of them holds on, by the tape's glue and by pressure
that grows as the bundle bends, until the tape slides on the wires:

    M(kappa) = sum M_i(kappa) + c (1 - h) sum EA_i |y_i| min(|y_i| kappa, r kappa_s)
                              + c h sum EA_i y_i^2 min(kappa, kappa_t)

r is the root of the mean square of y. c (share before slip), kappa_s (first slip) and kappa_t (the
tape slides) are read off the first loading: its stiffness up to the kink, the kink, the start of
the plateau. One parameter is fitted: h, the share that is still held after the kink. With h = 0
and kappa_s = 0 this is the lower bound of `wire.bundle_model`; with c = h = 1, its upper bound
before copper yields. Unloading and all later cycles follow by Masing's rule, without another
parameter: Coulomb sliders side by side are plays one after the other (`law.plays`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from labpipe.law.play_fits import concave_law
from labpipe.law.plays import PlayLaw
from labpipe.records.arrays import Flags, Floats
from labpipe.records.harness_bundle import BundleLoop, BundleModel, FrictionFit
from labpipe.records.wire import WireTable
from labpipe.wire.end_load_path import end_load_path

_CORNERS = 40
_FIRST = 1e-2
"""1/m: the first corner of the wires' own law."""
_ON_AXIS = 1e-6
"""Of a diameter: wires as near to the neutral axis have no lever."""
_STATIONS = 16
_HELD = 2e-3
"""To which the share that is held is found."""
_MOST_ALIKE = 0.98
"""Correlation of neighbouring points."""


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of a bundle, see the formula of this module.

    Parameters
    ----------
    composite_share : c, from 0 to 1
    slip_curvature : kappa_s, 1/m, > 0
    slide_curvature : kappa_t, 1/m, > 0, may be infinite
    held : h, from 0 to 1

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    composite_share: float
    slip_curvature: float
    slide_curvature: float
    held: float

    def __post_init__(self) -> None:
        for name in ("composite_share", "held"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                message = f"{name}={getattr(self, name)!r}: allowed are numbers from 0 to 1"
                raise ValueError(message)
        for name in ("slip_curvature", "slide_curvature"):
            if not getattr(self, name) > 0.0:
                message = f"{name}={getattr(self, name)!r}: allowed are numbers > 0"
                raise ValueError(message)


def friction_moment(
    curvature: Floats, model: BundleModel, tables: Sequence[WireTable], friction: Friction
) -> Floats:
    """Moment of first loading of a bundle with friction, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0 to the end of the model's own
    model : of the bundle, bent along y
    tables : of its kinds of wire, in their order
    friction : between the wires

    Returns
    -------
    Shape (n,): between the model's `moment_slip` and that of wires that stick and do not yield.
    """
    distance, stiffness = _levers(model, tables)
    mean = float(np.sqrt(np.mean(distance**2)))
    slip = friction.slip_curvature * mean / distance
    sliding = np.minimum(curvature[:, None], slip) @ (stiffness * distance**2)
    gluing = np.minimum(curvature, friction.slide_curvature) * float(stiffness @ distance**2)
    share, held = friction.composite_share, friction.held
    own = np.interp(curvature, model.curvature, model.moment_slip)
    return np.asarray(own + share * ((1.0 - held) * sliding + held * gluing))


def friction_law(model: BundleModel, tables: Sequence[WireTable], friction: Friction) -> PlayLaw:
    """The law of a bundle with friction, with its loops (Masing's rule).

    Parameters
    ----------
    model, tables, friction : as for `friction_moment`

    Returns
    -------
    A polygon with a corner wherever a wire or the tape lets go; it ends where the shortest of the
    wires' laws does.
    """
    last = float(model.curvature[-1])
    distance, _ = _levers(model, tables)
    mean = float(np.sqrt(np.mean(distance**2)))
    corners = np.concatenate(
        [
            np.geomspace(min(_FIRST, last / 2.0), last, _CORNERS),
            friction.slip_curvature * mean / distance,
            [friction.slide_curvature],
        ]
    )
    curvature = np.unique(corners[corners <= last])
    return concave_law(curvature, friction_moment(curvature, model, tables, friction))


def _levers(model: BundleModel, tables: Sequence[WireTable]) -> tuple[Floats, Floats]:
    """Distance from the neutral axis, m, and axial stiffness, N, of the wires that have a lever."""
    axial = np.array([table.axial_stiffness for table in tables])[model.layout.kind]
    distance = np.abs(model.layout.y - model.neutral[1])
    use = distance > _ON_AXIS * model.layout.diameter.max()
    if not np.any(use):
        message = "no wire lies off the neutral axis: friction between wires bends nothing"
        raise ValueError(message)
    return distance[use], axial[use]


def fit_friction(model: BundleModel, tables: Sequence[WireTable], loop: BundleLoop) -> FrictionFit:
    """Fit the share that is still held after slip, and predict what was not fitted.

    Parameters
    ----------
    model, tables : of the bundle
    loop : its cycles. The first cycle is fitted; of a single cycle, its loading

    Returns
    -------
    The fit, with the cycles that were left out predicted.

    Raises
    ------
    ValueError
        If no wire lies off the neutral axis, the bundle is softer than its wires alone, the loop
        has one branch only, or the wires would be bent beyond their laws.

    Notes
    -----
    Least squares of the force, with `wire.end_load_path` as the cantilever. What the bundle cannot
    do is push: less than nothing counts as nothing (a string is slack, a span is left), which is
    below zero by what holds the weight at rest.
    The interval of the share is what the fitted points allow: the sum of squares rises by t^2 of
    the mean square, neighbouring points that are off alike counting for less (first-order
    correlation). What the model lacks is in it as far as it looks like slow noise; what the share
    is worth is the error of the cycles left out.
    """
    share = _composite_share(model, loop)
    per_deflection = 3.0 / loop.length**2
    is_held_out = loop.branch > (1 if loop.branch.max(initial=0) > 1 else 0)
    if not np.any(is_held_out):
        message = "the bundle was bent and not let go: a loop needs loading and unloading"
        raise ValueError(message)

    def friction(held: float) -> Friction:
        slide = per_deflection * loop.slide
        return Friction(share, per_deflection * loop.kink[0], slide, held)

    def loads(held: float, count: int | None = None) -> Floats | None:
        """Predicted forces; None where the wires would be bent beyond their laws."""
        law = friction_law(model, tables, friction(held))
        path = end_load_path(
            *(law, loop.length, loop.deflection[:count]),
            n_stations=_STATIONS,
            self_weight=loop.self_weight,
        )
        whole = len(path.load) == len(loop.deflection[:count])
        at_rest = 0.0 if path.rest is None else float(path.rest.force[1])
        return np.maximum(path.load, -at_rest) if whole else None

    def predicted(held: float, count: int | None = None) -> Floats:
        found = loads(held, count)
        if found is None:
            message = "the bundle was bent further than the laws of its wires go"
            raise ValueError(message)
        return found

    count = int(np.argmax(is_held_out))

    def off(held: float) -> Floats:
        return np.asarray(predicted(held, count) - loop.force[:count])

    found = minimize_scalar(
        lambda held: float(np.sum(off(held) ** 2)),
        bounds=(0.0, 1.0),
        method="bounded",
        options={"xatol": _HELD},
    )
    held = float(found.x)
    limit = _allowed(off(held))

    def is_out(share: float) -> bool:
        path = loads(share, count)
        return path is None or float(np.sum((path - loop.force[:count]) ** 2)) > limit

    ends = _end(is_out, held, 0.0), _end(is_out, held, 1.0)
    return _judged(friction(held), ends, loop, predicted(held), is_held_out)


def _composite_share(model: BundleModel, loop: BundleLoop) -> float:
    """Share of the wires' axial stiffness that the stiffness up to the kink tells."""
    deflection, force = loop.kink
    stiffness = force * loop.length**3 / (3.0 * deflection)
    if not stiffness > model.free:
        message = (
            f"up to the kink the bundle has a bending stiffness of {1e6 * stiffness:.4g} N mm^2, "
            f"its wires that slip have {1e6 * model.free:.4g} N mm^2: there is no friction to fit"
        )
        raise ValueError(message)
    return min((stiffness - model.free) / (model.high - model.free), 1.0)


def _allowed(off: Floats) -> float:
    """Sum of squares up to which a share is in the 95 % interval, N^2."""
    least = float(off @ off)
    alike = float(off[1:] @ off[:-1]) / least if least > 0.0 else 0.0
    alike = min(max(alike, 0.0), _MOST_ALIKE)
    freedom = max(len(off) * (1.0 - alike) / (1.0 + alike) - 1.0, 1.0)
    return least * (1.0 + float(stdtrit(freedom, 0.975)) ** 2 / freedom)


def _end(is_out: Callable[[float], bool], inside: float, bound: float) -> float:
    """Where shares begin to be out on the way to a bound, by halves; the bound if they are not."""
    if not is_out(bound):
        return bound
    outside = bound
    while abs(outside - inside) > _HELD:
        middle = 0.5 * (inside + outside)
        if is_out(middle):
            outside = middle
        else:
            inside = middle
    return outside


def _judged(
    friction: Friction,
    ends: tuple[float, float],
    loop: BundleLoop,
    predicted: Floats,
    is_held_out: Flags,
) -> FrictionFit:
    off = (predicted - loop.force) / float(loop.force.max())
    over = is_held_out if loop.branch.max() > 1 else np.ones_like(is_held_out)
    return FrictionFit(
        composite_share=friction.composite_share,
        slip_curvature=friction.slip_curvature,
        slide_curvature=friction.slide_curvature,
        held=friction.held,
        held_lower=ends[0],
        held_upper=ends[1],
        loop=loop,
        predicted=predicted,
        is_held_out=is_held_out,
        error_fitted=float(np.sqrt(np.mean(off[~is_held_out] ** 2))),
        error_held_out=float(np.sqrt(np.mean(off[is_held_out] ** 2))),
        loss=float(np.trapezoid(loop.force[over], loop.deflection[over])),
        predicted_loss=float(np.trapezoid(predicted[over], loop.deflection[over])),
    )
