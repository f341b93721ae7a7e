"""Compute bounds of the bending stiffness and moment of a wire bundle, and fit its friction.

Slipping wires bend about their own axes. Sticking wires are one beam: plane sections stay plane,
and a wire at the distance y from the neutral axis is also strained along its axis, by kappa y
(parallel axis theorem). At y = 2 mm and kappa = 0.5 1/m this strain is 0.1 %, well beyond the yield
strain of annealed copper. When copper yields, the neutral axis moves to the position at which the
axial forces of all wires balance.

Under tape and in conduits, friction leads to a moment between the bounds. The neighbours of a wire
at the distance y from the neutral axis strain the wire until it slips, as a strand in a conductor
[1]_ [2]_. Each wire is a Coulomb slider in series with a spring, and the wires act in parallel.
Contacts between insulated wires are compliant. The stiffness of the spring is therefore a fraction
c of the axial stiffness of the wire. A fraction h of the contacts holds until the tape slides,
because of adhesive and of pressure that increases with bending:

    M(kappa) = sum M_i(kappa) + c (1 - h) sum EA_i |y_i| min(|y_i| kappa, r kappa_s)
                              + c h sum EA_i y_i^2 min(kappa, kappa_t)

M_i is the law of wire i, and EA_i is its axial stiffness. r is the root-mean-square distance of the
wires that are not on the neutral axis. The fraction c is computed from the stiffness of the first
loading up to the kink, the curvature kappa_s of first slip from the kink, and the curvature kappa_t
at which the tape slides from the start of the plateau. The fraction h is fitted. The moment tends
to the lower bound if h = 0 and kappa_s tends to 0. It equals the upper bound, before copper yields,
if c = h = 1 and the tape does not slide. Unloading and all later cycles follow Masing's rule,
without another parameter, because parallel Coulomb sliders are equivalent to plays in series
(`law.plays`).

References
----------
.. [1] K. O. Papailiou, IEEE Trans. Power Delivery 12 (1997) 1576.
.. [2] F. Foti and L. Martinelli, Appl. Math. Modelling 40 (2016) 6451.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.optimize import bisect, minimize_scalar
from scipy.special import stdtrit

from labpipe.mechanics.law.plays import PlayLaw, require
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.wire.bundle_layout import (
    arrange_wires,
    compute_packing_fraction,
    find_enclosing_circle,
    fits_bore,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.wire_table import make_insulation, make_layers
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
    """Compute the bounds of the bending stiffness and moment of a bundle.

    Parameters
    ----------
    bundle : composition of the bundle; stated diameters override those of the tables
    tables : table of each wire type, keyed by the name of the type

    Returns
    -------
    The model. Its notes can be ``diameter_differs``, ``range_shortened``, ``oblique_axes``,
    ``copper_yields`` and ``insulation_doubtful``.

    Raises
    ------
    ValueError
        If a wire type has no table, a stated diameter differs from that of the table by more than a
        factor of two, the wires do not fit the conduit, or for the reasons of `arrange_wires`.

    Notes
    -----
    `low` is the sum of the slip stiffnesses of the wires. Where copper yields, moments are below
    this bound times the curvature. `free` is the sum of the stick stiffnesses. `high` is `free` +
    sum EA (y - y0)^2, where y0 is the height of the centroid of the axial stiffnesses. On first
    loading, `moment_slip` is the sum of the laws of the wires. `moment_stick` also contains the
    moment of the axial strains, with yielding of copper (`compute_stretching_moment`). The
    interaction of bending and stretching in one wire is neglected. With friction between wires and
    compliant tape, the moment of a bundle is between the two moments.
    """
    missing = [wire.type for wire in bundle.wires if wire.type not in tables]
    require("wire types", missing, f"among {', '.join(tables) or 'none'}", holds=not missing)
    wire_tables = [tables[wire.type] for wire in bundle.wires]
    counts = [wire.number for wire in bundle.wires]
    diameters = list(map(_choose_diameter, bundle.wires, wire_tables))
    type_stiffnesses = np.array([table.axial_stiffness for table in wire_tables])
    layout = arrange_wires(bundle, diameters, type_stiffnesses.tolist())
    axial_stiffness = type_stiffnesses[layout.kind]
    own_stiffness = np.array([table.stick_stiffness for table in wire_tables])[layout.kind]
    stick = compute_stick_tensor(layout.x, layout.y, own_stiffness, axial_stiffness)
    curvature, range_notes = _find_common_range(wire_tables, layout)
    moment_slip = compute_slipping_moment(curvature, wire_tables, counts)
    stretching = compute_stretching_moment(curvature, layout.y, layout.kind, wire_tables)
    linear_ranges = _find_linear_ranges(wire_tables, layout, stick.neutral[1])
    circle_centre, circle_diameter = _find_circle(bundle, layout)
    bore = bundle.conduit_bore
    model = BundleModel(
        bundle=bundle,
        layout=layout,
        low=float(np.dot(counts, [table.slip_stiffness for table in wire_tables])),
        free=float(own_stiffness.sum()),
        high=float(stick.tensor[1, 1]),
        **asdict(stick),
        axial_stiffness=float(axial_stiffness.sum()),
        smallest_bore=circle_diameter,
        middle=circle_centre,
        packing_fraction=None if bore is None else compute_packing_fraction(layout.diameter, bore),
        curvature=curvature,
        moment_slip=moment_slip,
        moment_stick=moment_slip + stretching,
        doubtful_curvature=linear_ranges[0],
        doubtful_curvature_stick=linear_ranges[1],
    )
    diameter_notes, law_notes = _find_diameter_notes(bundle, wire_tables), _find_law_notes(model)
    return replace(model, notes=(*diameter_notes, *range_notes, *law_notes))


def _choose_diameter(wire: BundleWire, table: WireTable) -> float:
    """Return the stated diameter over the insulation, or that of the table, m.

    ValueError is raised if the two differ so much that a unit or a type may be wrong.
    """
    max_factor = 2.0
    table_diameter = 2.0 * table.layout.wire_radius
    if wire.diameter is None:
        return table_diameter
    if not table_diameter / max_factor <= wire.diameter <= max_factor * table_diameter:
        message = (
            f"{wire.type}: the bundle has {1e3 * wire.diameter:.4g} mm over the insulation, the "
            f"wire sheet {1e3 * table_diameter:.4g} mm; the factor must be at most "
            f"{max_factor:g}: check the unit, or leave the diameter out"
        )
        raise ValueError(message)
    return wire.diameter


def _find_circle(bundle: Bundle, layout: BundleLayout) -> tuple[tuple[float, float], float]:
    """Find the centre and the diameter of the smallest circle around the wires, m.

    ValueError is raised if the conduit is narrower than the circle.
    """
    centres = np.column_stack([layout.x, layout.y])
    circle_centre, radius = find_enclosing_circle(centres, layout.diameter)
    min_bore, bore = 2.0 * radius, bundle.conduit_bore
    if bore is not None and not fits_bore(min_bore, bore):
        message = (
            f"the {bundle.number} wires in this layout need a bore of {1e3 * min_bore:.4g} mm, "
            f"the conduit has {1e3 * bore:.4g} mm "
            f"(packing fraction {compute_packing_fraction(layout.diameter, bore):.3g})"
        )
        raise ValueError(message)
    return (float(circle_centre[0]), float(circle_centre[1])), min_bore


def _find_diameter_notes(bundle: Bundle, tables: Sequence[WireTable]) -> Iterator[QualityNote]:
    """Yield a note for each wire type whose stated diameter differs from that of its table."""
    max_difference = 0.05  # relative difference; tolerances of manufacturers are smaller
    for wire, table in zip(bundle.wires, tables, strict=True):
        nominal = 2.0 * table.layout.wire_radius
        if wire.diameter and abs(wire.diameter - nominal) > max_difference * nominal:
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
    """Find the curvatures at which all laws are known, 1/m, and make a note if a law goes farther.

    The curvatures also end where the strain of a sticking wire reaches the end of a stress table.
    """
    curvature = find_common_curvatures(tables)
    height = float(np.ptp(layout.y))
    layers = [layer for table in tables for layer in make_layers(table.spec)]
    strains = [layer.material.largest_strain / np.cos(layer.lay_angle) ** 2 for layer in layers]
    last_curvature = float(min(strains)) / height if height else np.inf
    if last_curvature < curvature[-1]:
        curvature = np.append(curvature[curvature < last_curvature], last_curvature)
        reason = f"sticking wires {1e3 * height:.3g} mm apart reach the end of a table"
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
        wire=longest.name,
        wire_end=longest.curvature[-1],
    )
    return curvature, (note,)


def _find_linear_ranges(
    tables: Sequence[WireTable], layout: BundleLayout, neutral_height: float
) -> tuple[float, float]:
    """Compute the curvatures up to which all insulations are linear, 1/m.

    The first is for slipping wires, the second for sticking wires. The strain at the rim of a
    sticking wire is the curvature times the distance of the rim from the neutral axis of the
    bundle. The neutral axis of elastic wires is used, which moves slightly when copper yields.
    """
    slip_curvature = np.array([table.doubtful_curvature for table in tables])
    radius = np.array([table.layout.wire_radius for table in tables])
    largest_strain = (slip_curvature * radius)[layout.kind]
    rim_distance = np.abs(layout.y - neutral_height) + radius[layout.kind]
    return float(slip_curvature.min()), float(np.min(largest_strain / rim_distance))


def _find_law_notes(model: BundleModel) -> Iterator[QualityNote]:
    """Yield notes on oblique principal axes, yielding of copper and the range of insulations."""
    max_relative_loss = 0.01  # loss of stiffness along y if the bundle may deflect along x
    yield_factor = 0.5  # ratio to the elastic moment below which copper has clearly yielded
    min_stretching_factor = 2.0  # above this ratio, stretching is over half of the stiffness
    (stiffness_x, stiffness_xy), (_, stiffness_y) = model.tensor
    loss = stiffness_xy**2 / (stiffness_x * stiffness_y)
    if loss > max_relative_loss:
        yield QualityNote.of(
            "mechanics.wire.oblique_axes",
            "bundle",
            degrees=np.degrees(model.principal_angle),
            percent=100.0 * loss,
            stiffness=_format_stiffness(stiffness_y),
        )
    curvature = model.curvature
    has_yielded = model.moment_stick < yield_factor * model.high * curvature
    # With less stretching, stiffness is lost mainly because strands slip.
    if np.any(has_yielded) and model.high >= min_stretching_factor * model.free:
        yield QualityNote.of(
            "mechanics.wire.copper_yields",
            "bundle",
            stiffness=_format_stiffness(model.high),
            curvature=curvature[np.argmax(has_yielded)],
        )
    slip_limit, stick_limit = model.doubtful_curvature, model.doubtful_curvature_stick
    if curvature[-1] > stick_limit:
        condition = " if wires stick" if slip_limit > stick_limit * (1.0 + _TIE_TOLERANCE) else ""
        if condition and curvature[-1] > slip_limit:
            condition += f", and beyond {slip_limit:.4g} 1/m if they slip"
        facts = {"curvature": stick_limit, "condition": condition}
        yield QualityNote.of("mechanics.wire.bundle_insulation_doubtful", "bundle", **facts)


def _format_stiffness(stiffness: float) -> str:
    """Format a stiffness, N m^2, in N mm^2 with four digits and without an exponent."""
    return f"{float(f'{1e6 * stiffness:.4g}'):.10g} N mm^2"


_TIE_TOLERANCE = 1e-6
"""Relative difference below which stiffnesses or curvatures count as equal.

It is also the angle, rad, below which an axis counts as parallel to y.
"""


@dataclass(frozen=True, slots=True, eq=False)
class StickStiffness:
    """Bending stiffness, in all directions, of a bundle whose wires stick to each other.

    Parameters
    ----------
    tensor : shape (2, 2), N m^2, bending stiffness; the xx component is for bending along x, the yy
        component for bending along y
    neutral : m, (x, y) of the intersection of the neutral axes: the centroid of the axial
        stiffnesses
    principal : N m^2, smallest and largest stiffness of all directions
    principal_angle : rad, in (-pi/2, pi/2], from the x axis to the direction of the largest
        stiffness; 0 if all directions are equal
    """

    tensor: Floats
    neutral: tuple[float, float]
    principal: tuple[float, float]
    principal_angle: float


def compute_stick_tensor(
    x: Floats, y: Floats, bending_stiffness: Floats, axial_stiffness: Floats
) -> StickStiffness:
    """Compute the bending stiffness of wires that stick to each other, in all directions.

    Parameters
    ----------
    x, y : shape (wires,), m, centres of the wires
    bending_stiffness : shape (wires,), N m^2, bending stiffness of each single wire, which is equal
        in all directions
    axial_stiffness : shape (wires,), N, axial stiffness of each single wire

    Notes
    -----
    With r = (x, y) from the centroid of the axial stiffnesses, K = sum EI I + sum EA r r^T by the
    parallel axis theorem (Timoshenko, *Strength of Materials I*, 1955, appendix A); I is the unit
    matrix in the first sum. Bending along the unit vector n requires the moment n^T K n per
    curvature if transverse deflection is prevented, and 1 / (n^T K^-1 n) if it is free. The latter
    moment is smaller unless n is a principal direction.
    """
    centres = np.column_stack([x, y])
    neutral_point = np.average(centres, axis=0, weights=axial_stiffness)
    r = centres - neutral_point
    tensor = np.eye(2) * bending_stiffness.sum() + (axial_stiffness[:, None] * r).T @ r
    lowest, highest = np.linalg.eigvalsh(tensor).tolist()
    angle = 0.5 * float(np.arctan2(2.0 * tensor[0, 1], tensor[0, 0] - tensor[1, 1]))
    if highest - lowest <= _TIE_TOLERANCE * highest:
        angle = 0.0
    elif angle <= -np.pi / 2.0 + _TIE_TOLERANCE:
        angle += np.pi
    x0, y0 = neutral_point.tolist()
    return StickStiffness(tensor, (x0, y0), (lowest, highest), angle)


def find_common_curvatures(tables: Sequence[WireTable]) -> Floats:
    """Return the curvatures of all tables up to the end of the shortest table, 1/m.

    Parameters
    ----------
    tables : tables of at least one wire type
    """
    last_curvature = min(float(table.curvature[-1]) for table in tables)
    curvature = np.unique(np.concatenate([table.curvature for table in tables]))
    return np.asarray(curvature[curvature <= last_curvature])


def compute_slipping_moment(
    curvature: Floats, tables: Sequence[WireTable], counts: Sequence[int]
) -> Floats:
    """Compute the sum of the moments of wires that slip without friction, N m, shape (n,).

    Parameters
    ----------
    curvature : shape (n,), 1/m, within the range of every law
    tables : table of each wire type
    counts : number of wires of each type

    Notes
    -----
    Moments are interpolated linearly between the points of the tables.
    """
    laws = [np.interp(curvature, table.curvature, table.moment) for table in tables]
    return np.asarray(np.array(counts, dtype=np.float64) @ np.array(laws))


def compute_composite_degree(stiffness: float, low: float, high: float) -> float:
    """Compute the degree of composite action, 0 at the lower bound of a stiffness, 1 at the upper.

    Parameters
    ----------
    stiffness : N m^2, bending stiffness
    low, high : N m^2, bounds of the stiffness, 0 < low < high

    Returns
    -------
    The degree; below 0 or above 1 if the stiffness is outside the bounds.

    Raises
    ------
    ValueError
        If the bounds are not 0 < low < high.

    Notes
    -----
    The degree of composite action of layered beams (Newmark, Siess and Viest, Proc. Soc. Exp.
    Stress Anal. 9 (1951) 75) is (stiffness - low) / (high - low).
    """
    require("bounds", (low, high), "above 0 and increasing", holds=0.0 < low < high)
    return (stiffness - low) / (high - low)


def compute_axial_force(table: WireTable, strain: Floats) -> Floats:
    """Compute the axial force of a stretched wire that does not rotate about its axis, N.

    Parameters
    ----------
    table : table of the wire
    strain : shape (n,), axial strain of the wire, not negative; the strain of a strand must be
        within the range of its material

    Notes
    -----
    The force is the sum of A cos(alpha) sigma(strain cos^2(alpha)) over the strands, plus E A
    strain of the insulation. The strain of a helical strand is cos^2(alpha) times that of the wire,
    and its force contributes with cos(alpha) (Costello, *Theory of Wire Rope*, 1997). The
    derivative at zero strain is the axial stiffness of the table.
    """
    force = make_insulation(table.spec).axial_stiffness * strain
    for layer in make_layers(table.spec):
        cosine = np.cos(layer.lay_angle)
        stress = layer.material.compute_stress(strain * cosine**2)
        force = force + layer.count * layer.area * cosine * stress
    return np.asarray(force)


def compute_stretching_moment(
    curvature: Floats, y: Floats, wire_types: Ints, tables: Sequence[WireTable]
) -> Floats:
    """Compute the moment of the axial forces of sticking wires, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, not negative
    y : shape (wires,), m, heights of the centres
    wire_types : shape (wires,), index of the table of each wire
    tables : table of each wire type

    Returns
    -------
    Shape (n,), sum of N y, where N is the axial force of a wire at the strain kappa (y - y0), equal
    in tension and compression. The height y0 of the neutral axis is that at which the sum of N is
    zero. The derivative at zero curvature is the sum of EA (y - y0)^2.
    """
    n_points = 600
    min_relative_strain = 1e-9  # first strain after zero, at which copper is elastic
    n_bisections = 60
    largest_strain = float(np.ptp(y)) * float(np.max(curvature, initial=0.0))
    law_strain = np.append(0.0, np.geomspace(min_relative_strain, 1.0, n_points) * largest_strain)
    axial_forces = [compute_axial_force(table, law_strain) for table in tables]

    def compute_forces(neutral_height: Floats) -> Floats:
        strain = curvature[:, None] * (y - neutral_height[:, None])
        force = np.empty_like(strain)
        for index, law_force in enumerate(axial_forces):
            is_type = wire_types == index
            force[:, is_type] = np.interp(np.abs(strain[:, is_type]), law_strain, law_force)
        return np.asarray(np.sign(strain) * force)

    low, high = (np.full(len(curvature), height) for height in (y.min(), y.max()))
    for _ in range(n_bisections):
        middle = 0.5 * (low + high)
        is_above = compute_forces(middle).sum(axis=1) > 0.0  # the neutral axis is above `middle`
        low, high = np.where(is_above, middle, low), np.where(is_above, high, middle)
    return np.asarray(compute_forces(0.5 * (low + high)) @ y)


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of a bundle; c, kappa_s, kappa_t and h are those of the module docstring.

    Parameters
    ----------
    composite_share : c, stiffness of the springs relative to the axial stiffness of the wires, from
        0 to 1
    slip_curvature : kappa_s, 1/m, curvature of first slip, > 0
    slide_curvature : kappa_t, 1/m, curvature at which the tape slides, > 0; may be infinite
    held : h, fraction of the contacts that hold until the tape slides, from 0 to 1
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
    """Compute the moment of first loading of a bundle with friction, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0 to the largest curvature of the model
    model : model of the bundle, bent along y
    tables : table of each wire type of the bundle, in the order of the types
    friction : friction between the wires

    Returns
    -------
    Shape (n,), between `moment_slip` of the model and the moment of elastic wires that stick.

    Raises
    ------
    ValueError
        If all wires are on the neutral axis.
    """
    distance, stiffness = _find_lever_arms(model, tables)
    slip_curvatures = _compute_slip_curvatures(friction, distance)
    slip_moment = np.minimum(curvature[:, None], slip_curvatures) @ (stiffness * distance**2)
    tape_curvature = np.minimum(curvature, friction.slide_curvature)
    tape_moment = tape_curvature * float(stiffness @ distance**2)
    c, h = friction.composite_share, friction.held
    wire_moment = np.interp(curvature, model.curvature, model.moment_slip)
    return np.asarray(wire_moment + c * ((1.0 - h) * slip_moment + h * tape_moment))


def make_friction_law(
    model: BundleModel, tables: Sequence[WireTable], friction: Friction
) -> PlayLaw:
    """Make the law of plays of a bundle with friction.

    Parameters
    ----------
    model, tables, friction : model, tables of the wires and friction of the bundle, as for
        `compute_friction_moment`

    Returns
    -------
    A piecewise linear law up to the largest curvature of the model. It has corners where a wire
    slips, where the tape slides, and on a grid of curvatures.

    Raises
    ------
    ValueError
        If all wires are on the neutral axis, or for the reasons of `make_concave_law`.
    """
    n_corners = 40
    first_corner = 1e-2  # 1/m
    last_corner = float(model.curvature[-1])
    distance, _ = _find_lever_arms(model, tables)
    grid = np.geomspace(min(first_corner, last_corner / 2.0), last_corner, n_corners)
    slip_curvatures = _compute_slip_curvatures(friction, distance)
    corners = np.concatenate([grid, slip_curvatures, [friction.slide_curvature]])
    curvature = np.unique(corners[corners <= last_corner])
    return make_concave_law(curvature, compute_friction_moment(curvature, model, tables, friction))


def _compute_slip_curvatures(friction: Friction, distance: Floats) -> Floats:
    """Compute the slip curvatures of wires, 1/m, from their distances to the neutral axis, m."""
    root_mean_square = float(np.sqrt(np.mean(distance**2)))
    return np.asarray(friction.slip_curvature * root_mean_square / distance)


def _find_lever_arms(model: BundleModel, tables: Sequence[WireTable]) -> tuple[Floats, Floats]:
    """Return distance from the neutral axis, m, and axial stiffness, N, of wires not on the axis.

    Raises
    ------
    ValueError
        If all wires are on the neutral axis.
    """
    min_relative_arm = 1e-6  # relative to the largest wire; nearer wires count as on the axis
    axial_stiffness = np.array([table.axial_stiffness for table in tables])[model.layout.kind]
    distance = np.abs(model.layout.y - model.neutral[1])
    has_arm = distance > min_relative_arm * model.layout.diameter.max()
    if not np.any(has_arm):
        message = "all wires lie on the neutral axis: friction between wires has no moment"
        raise ValueError(message)
    return distance[has_arm], axial_stiffness[has_arm]


def fit_friction(model: BundleModel, tables: Sequence[WireTable], loop: BundleLoop) -> FrictionFit:
    """Fit the fraction h of contacts that hold, and predict the other cycles of a loop.

    Parameters
    ----------
    model : model of the bundle, bent along y
    tables : table of each wire type of the bundle, in the order of the types
    loop : measured cycles. The first cycle is fitted, or the loading of a single cycle

    Returns
    -------
    The fit, with predicted forces at all points of the loop.

    Raises
    ------
    ValueError
        If all wires are on the neutral axis, the bundle is not stiffer than its slipping wires, the
        loop has a single branch, or the wires would be bent beyond their laws.

    Notes
    -----
    The fraction h is fitted by least squares of the force. `wire.first_loading` models the
    cantilever. Negative total forces are set to zero, because the string is slack or the load has
    lost contact. Measured forces are zeroed at rest, where a force supports the weight. The
    predicted force is therefore at least minus this force.

    At the ends of the interval of h, the sum of squares exceeds its minimum by t^2 times the mean
    square. The degrees of freedom are reduced for first-order autocorrelation of the residuals,
    because errors of the model are treated as autocorrelated noise. The cycles that are not fitted
    validate h.
    """
    n_stations = 16
    tolerance = 2e-3  # tolerance of h and of the ends of its interval
    curvature_per_deflection = 3.0 / loop.length**2  # curvature at the clamp, small deflections
    is_held_out = loop.branch > (1 if loop.branch.max(initial=0) > 1 else 0)
    if not np.any(is_held_out):
        message = "the loop has no unloading branch: a loop needs loading and unloading"
        raise ValueError(message)
    slip_curvature = curvature_per_deflection * loop.kink[0]
    slide_curvature = curvature_per_deflection * loop.slide
    composite_share = _compute_composite_share(model, loop)
    friction = Friction(composite_share, slip_curvature, slide_curvature, held=0.0)

    def predict(held: float, n_points: int | None = None) -> Floats:
        """Predict the first `n_points` forces; NaN where wires would be bent beyond their laws."""
        law = make_friction_law(model, tables, replace(friction, held=held))
        deflection = loop.deflection[:n_points]
        path = compute_end_load_path(
            law, loop.length, deflection, n_stations=n_stations, self_weight=loop.self_weight
        )
        rest_force = 0.0 if path.rest is None else path.rest.force
        n_missing = len(deflection) - len(path.load)
        return np.pad(np.maximum(path.load, -rest_force), (0, n_missing), constant_values=np.nan)

    n_fitted = int(np.argmax(is_held_out))

    def sum_squares(held: float) -> float:
        return float(np.sum((predict(held, n_fitted) - loop.force[:n_fitted]) ** 2))

    optimum = minimize_scalar(
        sum_squares, bounds=(0.0, 1.0), method="bounded", options={"xatol": tolerance}
    )
    held = float(optimum.x)
    forces = predict(held)
    if np.isnan(forces).any():
        message = "the bundle was bent beyond the laws of its wires"
        raise ValueError(message)
    square_limit = _compute_square_limit((forces - loop.force)[:n_fitted])

    def compute_excess(held: float) -> float:
        return float(np.nan_to_num(sum_squares(held) - square_limit, nan=np.inf))

    limits = [0.0, 1.0]
    for index, bound in enumerate(limits):
        if compute_excess(bound) > 0.0:
            limits[index] = float(bisect(compute_excess, held, bound, xtol=tolerance))
    return _make_friction_fit(replace(friction, held=held), limits, loop, forces, is_held_out)


def _compute_composite_share(model: BundleModel, loop: BundleLoop) -> float:
    """Compute the fraction c from the stiffness up to the kink; at most 1.

    Raises
    ------
    ValueError
        If the bundle is not stiffer than its slipping wires.
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


def _compute_square_limit(residuals: Floats) -> float:
    """Compute the sum of squares at the ends of the 95 % interval, N^2."""
    max_correlation = 0.98  # largest correlation of neighbouring residuals
    minimum = float(residuals @ residuals)
    correlation = float(residuals[1:] @ residuals[:-1]) / minimum if minimum > 0.0 else 0.0
    correlation = min(max(correlation, 0.0), max_correlation)
    freedom = max(len(residuals) * (1.0 - correlation) / (1.0 + correlation) - 1.0, 1.0)
    return minimum * (1.0 + float(stdtrit(freedom, 0.975)) ** 2 / freedom)


def _make_friction_fit(
    friction: Friction,
    limits: Sequence[float],
    loop: BundleLoop,
    predicted: Floats,
    is_held_out: Flags,
) -> FrictionFit:
    """Make the record of the fit, with its errors and the dissipated work.

    The work is that of the cycles that are not fitted or, for a single cycle, that of the loop.
    """
    error = (predicted - loop.force) / float(loop.force.max())
    is_loss_point = is_held_out if loop.branch.max() > 1 else np.ones_like(is_held_out)
    deflection, measured = loop.deflection[is_loss_point], loop.force[is_loss_point]
    return FrictionFit(
        **asdict(friction),
        held_lower=limits[0],
        held_upper=limits[1],
        loop=loop,
        predicted=predicted,
        is_held_out=is_held_out,
        error_fitted=float(np.sqrt(np.mean(error[~is_held_out] ** 2))),
        error_held_out=float(np.sqrt(np.mean(error[is_held_out] ** 2))),
        loss=float(np.trapezoid(measured, deflection)),
        predicted_loss=float(np.trapezoid(predicted[is_loss_point], deflection)),
    )
