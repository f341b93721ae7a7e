"""Compute bounds of the bending stiffness and moment of a wire bundle, and fit its friction.

Slipping wires bend about their own axes. Sticking wires are one beam: plane sections stay plane,
and a wire at the distance y from the neutral axis is also strained along its axis, by kappa y
(parallel axis theorem). At y = 2 mm and kappa = 0.5 1/m this strain is 0.1 %, well beyond the yield
strain of annealed copper. The neutral axis then moves to where the forces of all wires balance.

Friction between the bounds, under tape and in conduits: a wire at the distance y from the neutral
axis is pulled along by its neighbours until it slips, as a strand in a conductor (Papailiou, IEEE
Trans. Power Delivery 12 (1997) 1576; Foti and Martinelli, Appl. Math. Modelling 40 (2016) 6451).
Each wire is a Coulomb slider in series with a spring; the wires act in parallel. Contacts between
insulated wires are compliant, so the stiffness of the spring is a share of the axial stiffness of
the wire. Some contacts hold until the tape slides, because of adhesive and of pressure that
increases with bending:

    M(kappa) = sum M_i(kappa) + c (1 - h) sum EA_i |y_i| min(|y_i| kappa, r kappa_s)
                              + c h sum EA_i y_i^2 min(kappa, kappa_t)

M_i is the law of wire i, r the root-mean-square distance of the wires off the neutral axis. The
share before slip, c, is obtained from the stiffness of the first loading up to the kink, the
curvature of first slip, kappa_s, from the kink, and that at which the tape slides, kappa_t, from
the start of the plateau. One parameter is fitted: h, the share that is held after the kink. The
moment tends to the lower bound if h = 0 and
kappa_s tends to 0. It is the upper bound before copper yields if c = h = 1 and the tape does not
slide. Unloading and all later cycles follow by Masing's rule, without another parameter: parallel
Coulomb sliders are equivalent to plays in series (`law.plays`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.optimize import bisect, minimize_scalar
from scipy.special import stdtrit

from labpipe.mechanics.law.plays import PlayLaw, require
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.wire.bundle_layout import (
    arrange_wires,
    compute_packing_fraction,
    find_holding_circle,
    fits_bore,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.wire_table import build_wire
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.harness_bundle import (
    Bundle,
    BundleLayout,
    BundleLoop,
    BundleModel,
    BundleWire,
    FrictionFit,
)
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireTable


def compute_bundle_model(bundle: Bundle, tables: Mapping[str, WireTable]) -> BundleModel:
    """Compute the bounds of the bending of a bundle.

    Parameters
    ----------
    bundle : stated diameters override those of the wires' tables
    tables : law of each type of wire

    Returns
    -------
    The model. Notes: ``diameter_differs``, ``range_shortened``, ``oblique_axes``,
    ``copper_yields``, ``insulation_doubtful``.

    Raises
    ------
    ValueError
        If a type of wire has no table or differs from its table by more than a factor of two in
        diameter, stated positions are not one for each wire or overlap by more than 1 % of the
        smaller diameter, or the laid out wires do not fit the conduit.

    Notes
    -----
    low = sum of the wires' slip stiffnesses (yielding copper reduces moments below this bound),
    free = sum of their stick stiffnesses, high = free + sum EA (y - y0)^2, with y0 the centroid of
    the axial stiffnesses. On first loading, `moment_slip` is the sum of the wires' laws, and
    `moment_stick` also has the moment of the axial strains, with yielding of copper (see
    `compute_stretching_moment`). The interaction of bending and stretching in one wire is
    neglected. With friction between wires and compliant tape, a bundle lies between the two.
    """
    missing = [wire.type for wire in bundle.wires if wire.type not in tables]
    require("wire types", missing, f"among {', '.join(tables) or 'none'}", holds=not missing)
    wire_tables = [tables[wire.type] for wire in bundle.wires]
    counts = [wire.number for wire in bundle.wires]
    diameters = list(map(_choose_diameter, bundle.wires, wire_tables))
    axial = np.array([table.axial_stiffness for table in wire_tables])
    layout = arrange_wires(bundle, diameters, axial.tolist())
    stick_stiffness = np.array([table.stick_stiffness for table in wire_tables])
    stuck = compute_sticking(layout.x, layout.y, stick_stiffness[layout.kind], axial[layout.kind])
    curvature, range_notes = _find_common_range(wire_tables, layout)
    slip = compute_slipping_moment(curvature, wire_tables, counts)
    linear_ranges = _find_linear_ranges(wire_tables, layout, stuck.neutral[1])
    middle, smallest = _find_circle(bundle, layout)
    bore = bundle.conduit_bore
    model = BundleModel(
        bundle=bundle,
        layout=layout,
        low=float(np.dot(counts, [table.slip_stiffness for table in wire_tables])),
        free=float(stick_stiffness[layout.kind].sum()),
        high=float(stuck.tensor[1, 1]),
        tensor=stuck.tensor,
        principal=stuck.principal,
        principal_angle=stuck.angle,
        neutral=stuck.neutral,
        axial_stiffness=float(axial[layout.kind].sum()),
        smallest_bore=smallest,
        middle=middle,
        packing_fraction=None if bore is None else compute_packing_fraction(layout.diameter, bore),
        curvature=curvature,
        moment_slip=slip,
        moment_stick=slip
        + compute_stretching_moment(curvature, layout.y, layout.kind, wire_tables),
        doubtful_curvature=linear_ranges[0],
        doubtful_curvature_stick=linear_ranges[1],
    )
    notes = (*_note_diameters(bundle, wire_tables), *range_notes, *_note_law(model))
    return replace(model, notes=notes)


def _choose_diameter(wire: BundleWire, table: WireTable) -> float:
    """Return the diameter over the insulation, m; refuse one that suggests a wrong unit."""
    max_factor = 2.0  # beyond it the two cannot be one wire
    nominal = 2.0 * table.layout.wire_radius
    if wire.diameter is None:
        return nominal
    if not nominal / max_factor <= wire.diameter <= max_factor * nominal:
        message = (
            f"{wire.type}: the bundle has {1e3 * wire.diameter:.4g} mm over the insulation, the "
            f"wire sheet {1e3 * nominal:.4g} mm; the factor must be at most "
            f"{max_factor:g}: check the unit, or leave the diameter out"
        )
        raise ValueError(message)
    return wire.diameter


def _find_circle(bundle: Bundle, layout: BundleLayout) -> tuple[tuple[float, float], float]:
    """Return centre and diameter of the circle around the wires, which must fit the conduit."""
    centres = np.column_stack([layout.x, layout.y])
    middle, radius = find_holding_circle(centres, layout.diameter)
    smallest = 2.0 * radius
    bore = bundle.conduit_bore
    if bore is not None and not fits_bore(smallest, bore):
        message = (
            f"the {bundle.number} wires in this layout need a bore of {1e3 * smallest:.4g} mm, "
            f"the conduit has {1e3 * bore:.4g} mm "
            f"(packing fraction {compute_packing_fraction(layout.diameter, bore):.3g})"
        )
        raise ValueError(message)
    return (float(middle[0]), float(middle[1])), smallest


def _note_diameters(bundle: Bundle, tables: Sequence[WireTable]) -> Iterator[QualityNote]:
    diameter_tolerance = 0.05
    for wire, table in zip(bundle.wires, tables, strict=True):
        nominal = 2.0 * table.layout.wire_radius
        if wire.diameter and abs(wire.diameter - nominal) > diameter_tolerance * nominal:
            yield QualityNote.of(
                "mechanics.wire.diameter_differs",
                "bundle",
                wire=wire.type,
                diameter=1e3 * wire.diameter,
                nominal=1e3 * nominal,
            )


def _find_common_range(
    tables: Sequence[WireTable], layout: BundleLayout
) -> tuple[Floats, tuple[QualityNote, ...]]:
    """Return the curvatures that all laws cover, and a note where one of them goes further.

    The curvatures also end where the stretch of sticking wires reaches the end of a stress table.
    """
    curvature = find_common_curvatures(tables)
    depth = float(np.ptp(layout.y))
    largest_stretch = min(map(find_largest_stretch, tables))
    last_known = largest_stretch / depth if depth else np.inf
    if last_known < curvature[-1]:
        curvature = np.append(curvature[curvature < last_known], last_known)
        reason = f"sticking wires {1e3 * depth:.3g} mm apart reach the end of a table"
    else:
        reason = "the shortest of the wires' laws ends"
    longest = max(tables, key=lambda table: float(table.curvature[-1]))
    if longest.curvature[-1] <= curvature[-1]:
        return curvature, ()
    note = QualityNote.of(
        "mechanics.wire.bundle_range_shortened",
        "bundle",
        end=curvature[-1],
        reason=reason,
        longest=longest.name,
        last=longest.curvature[-1],
    )
    return curvature, (note,)


def _find_linear_ranges(
    tables: Sequence[WireTable], layout: BundleLayout, neutral: float
) -> tuple[float, float]:
    """Return the curvatures up to which insulations are linear, for slipping and sticking wires.

    The rims of sticking wires are strained by the curvature times the height above the neutral axis
    of the bundle (of elastic wires: it moves a little where copper yields).
    """
    slip = np.array([table.doubtful_curvature for table in tables])
    radius = np.array([table.layout.wire_radius for table in tables])
    strain = (slip * radius)[layout.kind]
    height = np.abs(layout.y - neutral) + radius[layout.kind]
    return float(slip.min()), float(np.min(strain / height))


def _note_law(model: BundleModel) -> Iterator[QualityNote]:
    max_lost_share = 0.01  # of the stiffness along y, lost by moving aside
    min_stretching_factor = 2.0  # above it, more than half of the stiffness is stretching
    (across, mixed), (_, along) = model.tensor
    lost = mixed**2 / (across * along)
    if lost > max_lost_share:
        yield QualityNote.of(
            "mechanics.wire.oblique_axes",
            "bundle",
            degrees=np.degrees(model.principal_angle),
            percent=100.0 * lost,
            stiffness=_format_stiffness(along),
        )
    curvature = model.curvature
    below = np.flatnonzero(model.moment_stick[1:] < 0.5 * model.high * curvature[1:]) + 1
    # with less stretching, the stiffness that it loses is that of slipping strands
    if len(below) and model.high >= min_stretching_factor * model.free:
        yield QualityNote.of(
            "mechanics.wire.copper_yields",
            "bundle",
            stiffness=_format_stiffness(model.high),
            curvature=curvature[below[0]],
        )
    slip, stick = model.doubtful_curvature, model.doubtful_curvature_stick
    if curvature[-1] > stick:
        condition = " if wires stick" if slip > stick * (1.0 + _AXIS_TOLERANCE) else ""
        if condition and curvature[-1] > slip:
            condition += f", and beyond {slip:.4g} 1/m if they slip"
        yield QualityNote.of(
            "mechanics.wire.bundle_insulation_doubtful",
            "bundle",
            stick=stick,
            condition=condition,
        )


def _format_stiffness(value: float) -> str:
    """Format a stiffness with four digits and without an exponent."""
    return f"{float(f'{1e6 * value:.4g}'):.10g} N mm^2"


_AXIS_TOLERANCE = 1e-6
"""Relative difference below which stiffnesses or curvatures count as equal; also, in rad, the angle
below which an axis counts as parallel to y."""


@dataclass(frozen=True, slots=True, eq=False)
class Sticking:
    """Bending stiffness of a bundle without slip.

    Parameters
    ----------
    tensor : shape (2, 2), N m^2; the xx part resists bending along x, the yy part along y
    neutral : m, (x, y) where the neutral axes cross: the centroid of the axial stiffnesses
    principal : N m^2, least and largest of all directions
    angle : rad, in (-pi/2, pi/2], from the x axis to the direction of the largest; 0 where all
        directions are equal
    """

    tensor: Floats
    neutral: tuple[float, float]
    principal: tuple[float, float]
    angle: float


def compute_sticking(
    x: Floats, y: Floats, bending_stiffness: Floats, axial_stiffness: Floats
) -> Sticking:
    """Compute the bending stiffness of wires that stick to each other, in all directions.

    Parameters
    ----------
    x, y : shape (wires,), m, centres
    bending_stiffness : shape (wires,), N m^2, of each wire alone, alike in all directions
    axial_stiffness : shape (wires,), N, of each wire alone

    Notes
    -----
    With r = (x, y) from the centroid of the axial stiffnesses, K = sum EI I + sum EA r r^T by the
    parallel axis theorem (Timoshenko, *Strength of Materials I*, 1955, appendix A). Bending along
    the unit vector n requires the moment n^T K n per unit curvature if sideways deflection is
    prevented, and 1 / (n^T K^-1 n) if it is free, which is smaller unless n is a principal
    direction.
    """
    centres = np.column_stack([x, y])
    neutral = np.average(centres, axis=0, weights=axial_stiffness)
    about = centres - neutral
    tensor = np.eye(2) * bending_stiffness.sum() + (axial_stiffness[:, None] * about).T @ about
    (lowest, highest), axes = np.linalg.eigh(tensor)
    angle = 0.0 if highest - lowest <= _AXIS_TOLERANCE * highest else _find_axis_angle(axes[:, 1])
    where = (float(neutral[0]), float(neutral[1]))
    return Sticking(tensor, where, (float(lowest), float(highest)), angle)


def _find_axis_angle(axis: Floats) -> float:
    """Return the angle of an undirected axis, in (-pi/2, pi/2]."""
    angle = float(np.arctan2(axis[1], axis[0]))
    if angle > np.pi / 2.0 + _AXIS_TOLERANCE:
        return angle - np.pi
    return angle + np.pi if angle <= -np.pi / 2.0 + _AXIS_TOLERANCE else angle


def find_common_curvatures(tables: Sequence[WireTable]) -> Floats:
    """Return the curvatures of all tables up to the end of the shortest, 1/m.

    Parameters
    ----------
    tables : at least one
    """
    end = min(float(table.curvature[-1]) for table in tables)
    curvature = np.unique(np.concatenate([table.curvature for table in tables]))
    return np.asarray(curvature[curvature <= end])


def compute_slipping_moment(
    curvature: Floats, tables: Sequence[WireTable], counts: Sequence[int]
) -> Floats:
    """Return the moment of wires that slip without friction, the sum of their laws, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, within the range of every law
    tables, counts : wire types, and how many of each

    Notes
    -----
    Between the points of a table the law is taken as straight.
    """
    laws = [np.interp(curvature, table.curvature, table.moment) for table in tables]
    return np.asarray(np.array(counts, dtype=np.float64) @ np.array(laws))


def compute_bounds_share(value: float, low: float, high: float) -> float:
    """Return the position of a stiffness between the bounds: 0 at the lower, 1 at the upper.

    Parameters
    ----------
    value : N m^2
    low, high : N m^2, 0 < low < high; taken as exact

    Returns
    -------
    The share; below 0 or above 1 where the value lies outside the bounds.

    Raises
    ------
    ValueError
        If the bounds are not 0 < low < high.

    Notes
    -----
    (value - low) / (high - low), which is what layered beams call the degree of composite action
    (their theory: Newmark, Siess and Viest, Proc. Soc. Exp. Stress Anal. 9 (1951) 75).
    """
    require("bounds", (low, high), "above 0 and increasing", holds=0.0 < low < high)
    return (value - low) / (high - low)


def compute_axial_force(table: WireTable, strain: Floats) -> Floats:
    """Return the force along a stretched wire that does not turn about its axis, N.

    Parameters
    ----------
    table : of the wire
    strain : shape (n,), along the wire, not negative; up to `find_largest_stretch`

    Notes
    -----
    sum of A cos(alpha) sigma(strain cos^2(alpha)) over the strands + E A strain of the insulation:
    a helical strand is strained by cos^2(alpha) of the wire's strain and pulls with cos(alpha) of
    its force (Costello, *Theory of Wire Rope*, 1997). Its slope at zero is the axial stiffness of
    the table.
    """
    section = build_wire(table.spec).section
    tube = section.insulation.axial_stiffness if section.insulation else 0.0
    force = tube * strain
    for layer in section.layers:
        cosine = np.cos(layer.lay_angle)
        stress = layer.material.stress(strain * cosine**2)
        force = force + layer.count * layer.area * cosine * stress
    return np.asarray(force)


def find_largest_stretch(table: WireTable) -> float:
    """Return the strain up to which the stress of all strands is known; may be infinite."""
    layers = build_wire(table.spec).section.layers
    strains = [layer.material.largest_strain / np.cos(layer.lay_angle) ** 2 for layer in layers]
    return float(min(strains))


def compute_stretching_moment(
    curvature: Floats, y: Floats, wire_types: Ints, tables: Sequence[WireTable]
) -> Floats:
    """Return the moment of the stretching and shortening of sticking wires, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, not negative
    y : shape (wires,), m, of the centres
    wire_types : shape (wires,), index into the tables
    tables : of the wire types

    Returns
    -------
    Shape (n,): sum of N y, with N the force at the strain kappa (y - y0), equal in tension and
    compression, and y0 where the sum of N is zero. Its slope at zero is sum of EA (y - y0)^2.
    """
    n_points = 600
    decades = 9.0  # below the largest strain; copper is still elastic at the first point
    halvings = 60
    largest_strain = float(np.ptp(y)) * float(np.max(curvature, initial=0.0))
    strain = np.append(0.0, np.geomspace(10.0**-decades, 1.0, n_points) * largest_strain)
    laws = [compute_axial_force(table, strain) for table in tables]

    def forces(neutral: Floats) -> Floats:
        stretch = curvature[:, None] * (y - neutral[:, None])
        force = np.empty_like(stretch)
        for number, law in enumerate(laws):
            strains = stretch[:, wire_types == number]
            force[:, wire_types == number] = np.sign(strains) * np.interp(
                np.abs(strains), strain, law
            )
        return force

    low, high = (np.full(len(curvature), edge) for edge in (y.min(), y.max()))
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        pulls = forces(middle).sum(axis=1) > 0.0  # the neutral axis lies higher
        low, high = np.where(pulls, middle, low), np.where(pulls, high, middle)
    return np.asarray(forces(0.5 * (low + high)) @ y)


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
    """

    composite_share: float
    slip_curvature: float
    slide_curvature: float
    held: float

    def __post_init__(self) -> None:
        curvatures = self.slip_curvature, self.slide_curvature
        require("slip and slide curvature", curvatures, "> 0", holds=min(curvatures) > 0.0)


def compute_friction_moment(
    curvature: Floats, model: BundleModel, tables: Sequence[WireTable], friction: Friction
) -> Floats:
    """Return the moment of first loading of a bundle with friction, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0 to the end of the model's own
    model : of the bundle, bent along y
    tables : of its wire types, in their order
    friction : between the wires

    Returns
    -------
    Shape (n,): between the model's `moment_slip` and that of wires that stick and do not yield.

    Raises
    ------
    ValueError
        If no wire lies off the neutral axis.
    """
    distance, stiffness = _find_levers(model, tables)
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
    """Build the play law of a bundle with friction; its loops follow Masing's rule.

    Parameters
    ----------
    model, tables, friction : as for `compute_friction_moment`

    Returns
    -------
    A piecewise linear law with corners where wires or the tape slip and at curvatures between, up
    to the end of the model.

    Raises
    ------
    ValueError
        If no wire lies off the neutral axis, or as for `make_concave_law`.
    """
    n_corners = 40
    first_corner = 1e-2  # 1/m
    last = float(model.curvature[-1])
    distance, _ = _find_levers(model, tables)
    mean = float(np.sqrt(np.mean(distance**2)))
    even = np.geomspace(min(first_corner, last / 2.0), last, n_corners)
    slips = friction.slip_curvature * mean / distance
    corners = np.concatenate([even, slips, [friction.slide_curvature]])
    curvature = np.unique(corners[corners <= last])
    return make_concave_law(curvature, compute_friction_moment(curvature, model, tables, friction))


def _find_levers(model: BundleModel, tables: Sequence[WireTable]) -> tuple[Floats, Floats]:
    """Return distance from the neutral axis, m, and axial stiffness, N, of wires off the axis.

    Raises
    ------
    ValueError
        If no wire lies off the neutral axis.
    """
    min_lever_diameters = 1e-6  # wires nearer to the neutral axis have no lever
    axial = np.array([table.axial_stiffness for table in tables])[model.layout.kind]
    distance = np.abs(model.layout.y - model.neutral[1])
    has_lever = distance > min_lever_diameters * model.layout.diameter.max()
    if not np.any(has_lever):
        message = "all wires lie on the neutral axis: friction between wires has no moment"
        raise ValueError(message)
    return distance[has_lever], axial[has_lever]


def fit_friction(model: BundleModel, tables: Sequence[WireTable], loop: BundleLoop) -> FrictionFit:
    """Fit the share that is still held after slip, and predict the cycles that were not fitted.

    Parameters
    ----------
    model, tables : of the bundle
    loop : its cycles. The first cycle is fitted; of a single cycle, its loading

    Returns
    -------
    The fit, with predicted forces at all points: those fitted and those left out.

    Raises
    ------
    ValueError
        If no wire lies off the neutral axis, the bundle is not stiffer than its wires alone, the
        loop has one branch only, or the wires would be bent beyond their laws.

    Notes
    -----
    The share is fitted by least squares of the force; `wire.first_loading` models the cantilever.
    Negative total forces are set to zero, because the string is slack or the load has lost contact.
    Measured forces are zeroed at rest, where a force supports the weight; the lower limit of the
    predicted force is minus this force.
    At the ends of the interval of the share, the sum of squares exceeds its minimum by t^2 times
    the mean square, with degrees of freedom reduced for first-order correlation of neighbouring
    residuals. Errors of the model are treated as autocorrelated noise. The error in the cycles that
    were left out validates the share.
    """
    n_stations = 16
    share = _compute_composite_share(model, loop)
    per_deflection = 3.0 / loop.length**2
    is_held_out = loop.branch > (1 if loop.branch.max(initial=0) > 1 else 0)
    if not np.any(is_held_out):
        message = "the loop has no unloading branch: a loop needs loading and unloading"
        raise ValueError(message)

    def friction(held: float) -> Friction:
        slide = per_deflection * loop.slide
        return Friction(share, per_deflection * loop.kink[0], slide, held)

    def predict(held: float, count: int | None = None) -> Floats:
        """Predict forces; NaN from where the wires would be bent beyond their laws."""
        law, deflection = fit_friction_law(model, tables, friction(held)), loop.deflection[:count]
        path = compute_end_load_path(
            law, loop.length, deflection, n_stations=n_stations, self_weight=loop.self_weight
        )
        at_rest = 0.0 if path.rest is None else path.rest.force
        n_missing = len(deflection) - len(path.load)
        return np.pad(np.maximum(path.load, -at_rest), (0, n_missing), constant_values=np.nan)

    count = int(np.argmax(is_held_out))

    def find_residuals(held: float) -> Floats:
        return np.asarray(predict(held, count) - loop.force[:count])

    def sum_squares(held: float) -> float:
        return float(np.sum(find_residuals(held) ** 2))

    optimum = minimize_scalar(
        sum_squares, bounds=(0.0, 1.0), method="bounded", options={"xatol": _HELD_TOLERANCE}
    )
    held = float(optimum.x)
    forces = predict(held)
    if np.isnan(forces).any():
        message = "the bundle was bent beyond the laws of its wires"
        raise ValueError(message)
    limit = _compute_interval_limit(find_residuals(held))

    def excess(share: float) -> float:
        return float(np.nan_to_num(sum_squares(share) - limit, nan=np.inf))

    ends = _find_interval_end(excess, held, 0.0), _find_interval_end(excess, held, 1.0)
    return _make_friction_fit(friction(held), ends, loop, forces, is_held_out)


def _compute_composite_share(model: BundleModel, loop: BundleLoop) -> float:
    """Return the share of the wires' axial stiffness that is active up to the kink, at most 1.

    Raises
    ------
    ValueError
        If the bundle is not stiffer than its wires alone.
    """
    deflection, force = loop.kink
    stiffness = force * loop.length**3 / (3.0 * deflection)
    if not stiffness > model.free:
        message = (
            f"up to the kink the bundle has a bending stiffness of {1e6 * stiffness:.4g} N mm^2, "
            f"its wires that slip have {1e6 * model.free:.4g} N mm^2: there is no friction to fit"
        )
        raise ValueError(message)
    return min((stiffness - model.free) / (model.high - model.free), 1.0)


def _compute_interval_limit(residuals: Floats) -> float:
    """Return the sum of squares at the ends of the 95 % interval, N^2."""
    max_correlation = 0.98  # of neighbouring points
    smallest = float(residuals @ residuals)
    correlation = float(residuals[1:] @ residuals[:-1]) / smallest if smallest > 0.0 else 0.0
    correlation = min(max(correlation, 0.0), max_correlation)
    freedom = max(len(residuals) * (1.0 - correlation) / (1.0 + correlation) - 1.0, 1.0)
    return smallest * (1.0 + float(stdtrit(freedom, 0.975)) ** 2 / freedom)


def _find_interval_end(excess: Callable[[float], float], inside: float, bound: float) -> float:
    """Find the end of the interval towards a bound, where the excess becomes positive."""
    if excess(bound) <= 0.0:
        return bound
    return float(bisect(excess, inside, bound, xtol=_HELD_TOLERANCE))


def _make_friction_fit(
    friction: Friction,
    ends: tuple[float, float],
    loop: BundleLoop,
    predicted: Floats,
    is_held_out: Flags,
) -> FrictionFit:
    error = (predicted - loop.force) / float(loop.force.max())
    loss_points = is_held_out if loop.branch.max() > 1 else np.ones_like(is_held_out)
    return FrictionFit(
        **asdict(friction),
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
