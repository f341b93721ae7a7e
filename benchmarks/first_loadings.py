"""First loadings in memory, for studies of many campaigns.

What load cell and cameras would give if their clocks agreed and nothing were lost: the true curve,
noise, and the error of the load cell. The curve is solved as that of every test is, but only three
times for each wire and length: with moments f times as large the wire does under weights w of its
own and at its tip exactly what the plain one does under w / f, at f times the force; and that is
smooth in 1 / f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MechanicalTest, solve_path
from labpipe.virtual_lab.specimens import BundleModel, StrandedWire

MAX_SCATTER = 1.25
"""Farthest that a sample's factor, or its inverse, may be from 1."""
_INVERSES = np.array([1.0 / MAX_SCATTER, 1.0, MAX_SCATTER])


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """The first loading of one test; arrays of shape (n,), evenly spread over the clamp's travel.

    Parameters
    ----------
    scenario, seed : what it was made from
    travel : m, of the clamp
    deflection, force : m, N, as measured; force is counted from that at rest
    true_deflection, true_force : m, N
    """

    scenario: CantileverScenario
    seed: int
    travel: Floats
    deflection: Floats
    force: Floats
    true_deflection: Floats
    true_force: Floats


def observe_loading(
    scenario: CantileverScenario, seed: int, *, n_points: int = 272, noise: float | None = None
) -> Loading:
    """Load a virtual test without writing files, and without its unloading.

    Parameters
    ----------
    scenario : the test, of a stranded wire or a bundle. Of the load cell, its gain error and noise
        are used; of the markers, the noise, taken for that of the tip's deflection
    seed : the same seed gives the same noise, and the same gain error where it is drawn
    n_points : of the curve; the source's curves have 272
    noise : N, rms, of a point's force; None for that of the load cell

    Returns
    -------
    The curve; its first point is one interval after the rest.

    Raises
    ------
    ValueError
        If the wire is neither one of strands nor a bundle, its factor is farther from 1 than
        `MAX_SCATTER`, the string is slack at first, or the mechanics have no solution.
    """
    random = np.random.default_rng([seed, 43])
    cell = scenario.load_cell
    drawn = cell.gain_uncertainty * float(random.standard_normal())
    gain_error = drawn if cell.gain_error is None else cell.gain_error
    travel = scenario.mechanics.stroke * np.arange(1, n_points + 1) / n_points
    deflection, force = _true_loading(scenario.mechanics, travel)
    sd = cell.noise if noise is None else noise
    read = (force + sd * random.standard_normal(n_points)) / (1.0 + gain_error)
    return Loading(
        scenario=scenario,
        seed=seed,
        travel=travel,
        deflection=deflection + scenario.markers.noise * random.standard_normal(n_points),
        force=read,
        true_deflection=deflection,
        true_force=force,
    )


def _true_loading(test: MechanicalTest, travel: Floats) -> tuple[Floats, Floats]:
    """Deflection, m, and force, N, at travels, m."""
    wire = _stranded(test)
    solved = _plain_loadings(replace(test, wire=replace(wire, factor=1.0), cycles=1))
    deflection, force = np.tensordot(_shares(1.0 / wire.factor), solved, axes=1)
    interpolated = CubicSpline(
        _positions(test), np.column_stack([deflection, wire.factor * force])
    )(travel)
    return interpolated[:, 0], interpolated[:, 1]


def _stranded(test: MechanicalTest) -> StrandedWire | BundleModel:
    """The wire or bundle, if the test is one that scales."""
    wire = test.wire
    if not isinstance(wire, StrandedWire | BundleModel) or test.slack is not None:
        message = (
            f"wire={type(wire).__name__}, slack={test.slack}: expected a StrandedWire or a "
            f"BundleModel, and None"
        )
        raise ValueError(message)
    if not 1.0 / MAX_SCATTER <= wire.factor <= MAX_SCATTER:
        message = f"factor={wire.factor!r}: must be from {1.0 / MAX_SCATTER:g} to {MAX_SCATTER:g}"
        raise ValueError(message)
    return wire


def _shares(inverse: float) -> Floats:
    """Weights of the three solutions in the parabola through them (Lagrange)."""
    others = [np.delete(_INVERSES, i) for i in range(len(_INVERSES))]
    return np.array(
        [
            np.prod((inverse - other) / (own - other))
            for own, other in zip(_INVERSES, others, strict=True)
        ]
    )


def _positions(test: MechanicalTest) -> Floats:
    """Travels at which a loading is solved, m."""
    share: Floats = np.linspace(0.0, 1.0, test.steps_per_branch + 1) ** test.crowding
    return share * test.stroke


@lru_cache(maxsize=32)
def _plain_loadings(test: MechanicalTest) -> Floats:
    """Deflections and forces of the plain wire under three gravities, shape (3, 2, n)."""
    curves = []
    for inverse in _INVERSES.tolist():
        path = solve_path(replace(test, gravity=test.gravity * inverse))
        at = _positions(test)
        curves.append(
            [path.compute_deflection(at), path.compute_tension(at) - path.rest_shape.tension]
        )
    return np.array(curves)
