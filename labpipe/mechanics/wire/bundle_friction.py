"""Bundles between their bounds: wires that slip on each other under tape and conduit.

A wire at the distance y from the neutral axis is pulled along by its neighbours until it slips,
as the wires of a strand are in Papailiou (On the bending stiffness of transmission line
conductors, IEEE Trans. Power Delivery 12 (1997) 1576) and in Foti and Martinelli (An analytical
approach to model the hysteretic bending behavior of spiral strands, Appl. Math. Modelling 40 (2016)
6451): a Coulomb slider in series with a spring for every wire, all of them side by side. Contacts
between insulated wires are far from rigid, so that the spring is a share of the wire's axial
stiffness. Contacts differ: part of them hold, by the tape's glue and by pressure that grows with
bending, until the tape slides on the wires:

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

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.records.arrays import Flags, Floats
from labpipe.records.harness_bundle import BundleLoop, BundleModel, FrictionFit
from labpipe.records.wire import WireTable

_HELD_TOLERANCE = 2e-3


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
                message = f"{name}={getattr(self, name)!r}: must be from 0 to 1"
                raise ValueError(message)
        for name in ("slip_curvature", "slide_curvature"):
            if not getattr(self, name) > 0.0:
                message = f"{name}={getattr(self, name)!r}: must be > 0"
                raise ValueError(message)


def compute_friction_moment(
    curvature: Floats, model: BundleModel, tables: Sequence[WireTable], friction: Friction
) -> Floats:
    """Return the moment of first loading of a bundle with friction, N m.

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
    distance, stiffness = _wire_levers(model, tables)
    mean = float(np.sqrt(np.mean(distance**2)))
    slip = friction.slip_curvature * mean / distance
    sliding = np.minimum(curvature[:, None], slip) @ (stiffness * distance**2)
    gluing = np.minimum(curvature, friction.slide_curvature) * float(stiffness @ distance**2)
    share, held_share = friction.composite_share, friction.held
    wire_moment = np.interp(curvature, model.curvature, model.moment_slip)
    return np.asarray(wire_moment + share * ((1.0 - held_share) * sliding + held_share * gluing))


def fit_friction_law(
    model: BundleModel, tables: Sequence[WireTable], friction: Friction
) -> PlayLaw:
    """Fit plays to a bundle with friction; its loops follow Masing's rule.

    Parameters
    ----------
    model, tables, friction : as for `compute_friction_moment`

    Returns
    -------
    A polygon with a corner wherever a wire or the tape slips; it ends with the shortest of the
    wires' laws.
    """
    n_corners = 40
    first_corner = 1e-2  # 1/m
    last = float(model.curvature[-1])
    distance, _ = _wire_levers(model, tables)
    mean = float(np.sqrt(np.mean(distance**2)))
    corners = np.concatenate(
        [
            np.geomspace(min(first_corner, last / 2.0), last, n_corners),
            friction.slip_curvature * mean / distance,
            [friction.slide_curvature],
        ]
    )
    curvature = np.unique(corners[corners <= last])
    return make_concave_law(curvature, compute_friction_moment(curvature, model, tables, friction))


def _wire_levers(model: BundleModel, tables: Sequence[WireTable]) -> tuple[Floats, Floats]:
    """Return distance from the neutral axis, m, and axial stiffness, N, of wires off the axis."""
    min_lever_diameters = 1e-6  # wires nearer to the neutral axis have no lever
    axial = np.array([table.axial_stiffness for table in tables])[model.layout.kind]
    distance = np.abs(model.layout.y - model.neutral[1])
    use = distance > min_lever_diameters * model.layout.diameter.max()
    if not np.any(use):
        message = "all wires lie on the neutral axis: friction between wires has no moment"
        raise ValueError(message)
    return distance[use], axial[use]


def fit_friction(model: BundleModel, tables: Sequence[WireTable], loop: BundleLoop) -> FrictionFit:
    """Fit the share that is still held after slip, and predict the cycles that were not fitted.

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
    Least squares of the force, with `wire.end_load_path` as the cantilever. The bundle cannot
    push: negative total forces count as zero (a string is slack, a span is left), which is below
    the zeroed force by the force that holds the weight at rest.
    The interval of the share follows from the sum of squares, which rises by t^2 of the mean
    square, with the degrees of freedom reduced for first-order correlation of neighbouring
    residuals. Errors of the model count as slow noise; the error of the cycles left out validates
    the share.
    """
    n_stations = 16
    share = _composite_share(model, loop)
    per_deflection = 3.0 / loop.length**2
    is_held_out = loop.branch > (1 if loop.branch.max(initial=0) > 1 else 0)
    if not np.any(is_held_out):
        message = "the loop has no unloading branch: a loop needs loading and unloading"
        raise ValueError(message)

    def friction(held: float) -> Friction:
        slide = per_deflection * loop.slide
        return Friction(share, per_deflection * loop.kink[0], slide, held)

    def loads(held: float, count: int | None = None) -> Floats | None:
        """Return predicted forces, or None where the wires would be bent beyond their laws."""
        law = fit_friction_law(model, tables, friction(held))
        path = compute_end_load_path(
            *(law, loop.length, loop.deflection[:count]),
            n_stations=n_stations,
            self_weight=loop.self_weight,
        )
        is_complete = len(path.load) == len(loop.deflection[:count])
        at_rest = 0.0 if path.rest is None else float(path.rest.force[1])
        return np.maximum(path.load, -at_rest) if is_complete else None

    def predicted(held: float, count: int | None = None) -> Floats:
        forces = loads(held, count)
        if forces is None:
            message = "the bundle was bent beyond the laws of its wires"
            raise ValueError(message)
        return forces

    count = int(np.argmax(is_held_out))

    def residuals(held: float) -> Floats:
        return np.asarray(predicted(held, count) - loop.force[:count])

    optimum = minimize_scalar(
        lambda held: float(np.sum(residuals(held) ** 2)),
        bounds=(0.0, 1.0),
        method="bounded",
        options={"xatol": _HELD_TOLERANCE},
    )
    held = float(optimum.x)
    limit = _interval_sum_of_squares(residuals(held))

    def is_out(share: float) -> bool:
        path = loads(share, count)
        return path is None or float(np.sum((path - loop.force[:count]) ** 2)) > limit

    ends = _interval_end(is_out, held, 0.0), _interval_end(is_out, held, 1.0)
    return _friction_fit(friction(held), ends, loop, predicted(held), is_held_out)


def _composite_share(model: BundleModel, loop: BundleLoop) -> float:
    """Return the share of the wires' axial stiffness that is active up to the kink."""
    deflection, force = loop.kink
    stiffness = force * loop.length**3 / (3.0 * deflection)
    if not stiffness > model.free:
        message = (
            f"up to the kink the bundle has a bending stiffness of {1e6 * stiffness:.4g} N mm^2, "
            f"its wires that slip have {1e6 * model.free:.4g} N mm^2: there is no friction to fit"
        )
        raise ValueError(message)
    return min((stiffness - model.free) / (model.high - model.free), 1.0)


def _interval_sum_of_squares(residuals: Floats) -> float:
    """Return the sum of squares at the ends of the 95 % interval, N^2."""
    max_correlation = 0.98  # of neighbouring points
    least = float(residuals @ residuals)
    correlation = float(residuals[1:] @ residuals[:-1]) / least if least > 0.0 else 0.0
    correlation = min(max(correlation, 0.0), max_correlation)
    freedom = max(len(residuals) * (1.0 - correlation) / (1.0 + correlation) - 1.0, 1.0)
    return least * (1.0 + float(stdtrit(freedom, 0.975)) ** 2 / freedom)


def _interval_end(is_out: Callable[[float], bool], inside: float, bound: float) -> float:
    """Find the end of the interval towards a bound by bisection."""
    if not is_out(bound):
        return bound
    outside = bound
    while abs(outside - inside) > _HELD_TOLERANCE:
        middle = 0.5 * (inside + outside)
        if is_out(middle):
            outside = middle
        else:
            inside = middle
    return outside


def _friction_fit(
    friction: Friction,
    ends: tuple[float, float],
    loop: BundleLoop,
    predicted: Floats,
    is_held_out: Flags,
) -> FrictionFit:
    error = (predicted - loop.force) / float(loop.force.max())
    loss_points = is_held_out if loop.branch.max() > 1 else np.ones_like(is_held_out)
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
        error_fitted=float(np.sqrt(np.mean(error[~is_held_out] ** 2))),
        error_held_out=float(np.sqrt(np.mean(error[is_held_out] ** 2))),
        loss=float(np.trapezoid(loop.force[loss_points], loop.deflection[loss_points])),
        predicted_loss=float(np.trapezoid(predicted[loss_points], loop.deflection[loss_points])),
    )
