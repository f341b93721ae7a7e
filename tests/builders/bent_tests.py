"""First loadings of a clamped wire, exact to the solver, as processing has shapes and force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.markers.specimen_shape import Offsets, fit_shape
from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.cantilever import (
    CantileverShape,
    StringRig,
    bend_to_travel,
    bend_under_force,
    compute_shape,
    make_straight,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import AT_REST, PointFlag
from labpipe.results.measured_law import BendingErrors, BendingTest, TipPull

LENGTH, STRING, WEIGHT = 0.085, 0.760, 0.0265
HEIGHT, PULL_OFFSET = 0.0008, 0.004
PLACES: Floats = np.linspace(0.008, LENGTH - PULL_OFFSET, 8)
RESTING = 20
"""Frames before the loading."""
NO_ERRORS = BendingErrors(force_noise=0.0, force_zero=0.0, force_scale=0.0, end_position=0.0)


def pulled(law: PlayLaw, *, travel: float, frames: int) -> list[CantileverShape]:
    """Shapes of a wire that hangs under the counterweight, the string just slack, and is pulled."""
    start = bend_under_force(law, make_straight(law, 48), LENGTH, np.array([0.0, -WEIGHT]))
    tip = (float(start.x[-1]), float(start.y[-1]))
    level = StringRig(STRING, WEIGHT, LENGTH, STRING)
    rig = replace(level, anchor_height=STRING + level.compute_taut_travel(*tip))
    shapes, state = [start], start.state
    for at in np.linspace(0.0, travel, frames)[1:]:
        shapes.append(bend_to_travel(law, state, LENGTH, rig, float(at)))
        state = shapes[-1].state
    return shapes


HEAVY = 0.3
"""N/m, of a wire with weight: twelve per cent of the load at a millimetre."""


def lifted(law: PlayLaw, *, travel: float, frames: int) -> list[CantileverShape]:
    """Shapes of a wire that weighs `HEAVY`, lies level at rest, and is pulled by its string."""
    shapes, state = [], make_straight(law, 48, self_weight=HEAVY)
    rig = StringRig(STRING, WEIGHT, LENGTH, STRING)
    for at in np.linspace(0.0, travel, frames):
        shapes.append(bend_to_travel(law, state, LENGTH, rig, float(at)))
        state = shapes[-1].state
    return shapes


def loaded(law: PlayLaw, *, force: float, frames: int) -> list[CantileverShape]:
    """Shapes of a straight wire under a growing end load normal to the clamped axis."""
    shapes, state = [], make_straight(law, 48)
    shapes.append(compute_shape(state, LENGTH))
    for load in np.linspace(0.0, force, frames)[1:]:
        shapes.append(bend_under_force(law, state, LENGTH, np.array([0.0, float(load)])))
        state = shapes[-1].state
    return shapes


def centres(shape: CantileverShape) -> Floats:
    """Centres of the markers, shape (markers, 3), m."""
    x, y, angle = (_at(shape, values, PLACES) for values in (shape.x, shape.y, shape.angle))
    at = [x - HEIGHT * np.sin(angle), y + HEIGHT * np.cos(angle), np.zeros_like(x)]
    return np.stack(at, axis=1)


def _at(shape: CantileverShape, values: Floats, places: Floats) -> Floats:
    """Values along the wire between the solver's stations, by the polynomial through them."""
    from numpy.polynomial import Chebyshev

    series = Chebyshev.fit(shape.arc_length, values, deg=len(values) - 1, domain=[0.0, LENGTH])
    return np.asarray(series(places), dtype=np.float64)


def bending_test(
    shapes: list[CantileverShape],
    *,
    has_string: bool = True,
    noise: float = 0.0,
    seed: int = 1,
    terms: int = 7,
    pull: TipPull | None = None,
) -> BendingTest:
    """Lay out shapes as a test: at rest for `RESTING` frames, then one frame for each shape.

    The string carries nothing at rest unless `pull` says so: then the force is what it carries
    more; without one the force is the end load.
    """
    rng = np.random.default_rng(seed)
    rows = [0] * RESTING + list(range(len(shapes)))
    markers = np.stack([centres(shape) for shape in shapes])[rows]
    markers = markers + noise * rng.standard_normal(markers.shape)
    count = len(rows)
    time: Floats = 0.1 * np.arange(count, dtype=np.float64)
    rest = np.arange(count) < RESTING
    fit = fit_shape(
        markers,
        np.full(markers.shape[:2], PointFlag.MEASURED, dtype=np.uint8),
        [f"M{number}" for number in range(len(PLACES))],
        time,
        clamp_specimen=np.zeros((count, 3)),
        rotation_lab_to_specimen=np.eye(3),
        offsets=Offsets(0.0, PULL_OFFSET, HEIGHT),
        terms=terms,
        tip="free",
        rest_frames=rest,
    )
    force = [shape.tension if has_string else float(shape.force[1]) for shape in shapes]
    anchor = float(shapes[0].x[-1]) if has_string else 0.0
    if pull is None:
        pull = TipPull(STRING, WEIGHT, 0.0, anchor) if has_string else TipPull(None, 0.0, 0.0, 0.0)
    force = [tension - pull.tension_at_rest for tension in force]
    return BendingTest(
        shape=fit.shape,
        force=np.array(force)[rows],
        branch=np.where(rest, AT_REST, 0),
        cycle=np.where(rest, 0, 1),
        first_branch=0,
        is_at_rest=rest,
        centre_offset=HEIGHT,
        free_tip=True,
        pull=pull,
        errors=NO_ERRORS,
    )


def law_moment(law: PlayLaw, curvature: Floats, *, most: float = 0.5) -> Floats:
    """Moment of a law's first loading at curvatures, N m."""
    moment = np.linspace(0.0, most, 200_001)
    beyond = np.maximum(moment[:, None] - law.half_widths, 0.0)
    return np.interp(curvature, moment / law.stiffness + beyond @ law.compliances, moment)
