"""Residual curvature of a released line, by Masing's rule and at most."""

from __future__ import annotations

import numpy as np

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import Floats
from labpipe.records.quality import Reason
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState

_MIN_CURVATURE = 1e-3
"""1/m; below it a line is straight."""


def curvature_after_release(law: SliderLaw, rests: Floats) -> Floats:
    """Return the curvature of each station after release, 1/m, shape (..., 2).

    Parameters
    ----------
    law : of every station
    rests : 1/m, shape (..., sliders, 2): rest curvatures of its sliders

    Notes
    -----
    The curvature at zero moment, where sliders slide in the other direction: EI_0 kappa + sum of
    w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|), solved for kappa with the
    w_j of the step before (Weiszfeld's iteration, which descends on a convex energy). It starts
    at the curvature reached if no slider slides. Without sliders it is 0.
    """
    max_iterations, relative_tolerance = 1000, 1e-9
    curvature = np.zeros((*rests.shape[:-2], 2))
    if not len(law.stiffnesses):
        return curvature
    weights = np.broadcast_to(law.stiffnesses, rests.shape[:-1])
    for _ in range(max_iterations):
        total = law.stiffness + weights.sum(axis=-1)
        previous, curvature = (
            curvature,
            np.einsum("...j,...jx->...x", weights, rests) / total[..., None],
        )
        if np.max(np.abs(curvature - previous)) <= relative_tolerance * np.max(np.abs(curvature)):
            break
        bent = np.linalg.norm(curvature[..., None, :] - rests, axis=-1)
        weights = law.stiffnesses * law.slip_curvatures / np.maximum(bent, law.slip_curvatures)
    return curvature


def residual_curvature(state: RodState, law: SliderLaw) -> Floats:
    """Return the curvature of the line if it were released, 1/m, shape (n + 1,).

    Parameters
    ----------
    state : with the state of its sliders
    law : of the line

    Notes
    -----
    Without rest curvature. See `curvature_after_release`; the larger one where both sides of a
    node differ at a clip.
    """
    return np.asarray(np.linalg.norm(curvature_after_release(law, state.rests), axis=2).max(axis=1))


def max_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Return the residual curvature if no slider slid on unloading, 1/m, shape (n + 1,).

    Parameters
    ----------
    path : of the line
    law : of the line

    Notes
    -----
    From the largest bend of each node: sum of K_j a_j over the first stiffness.
    """
    if not len(law.stiffnesses):
        return np.zeros(len(path.last.positions))
    sizes = [
        np.linalg.norm(np.einsum("j,nsjx->nsx", law.stiffnesses, state.rests), axis=2).max(axis=1)
        for state in path.states
    ]
    return np.asarray(np.max(sizes, axis=0) / law.first_stiffness)


def largest_unbending(path: RodPath) -> float:
    """Return the largest decrease of curvature at a node over the sharpest bend of the line.

    Parameters
    ----------
    path : of the line
    """
    bent = np.array([state.bendings for state in path.states])
    largest = bent.max(axis=0)
    return float(np.max(largest - bent[-1]) / max(float(largest.max()), _MIN_CURVATURE))


def unloading_reason(path: RodPath, line: Line) -> Reason | None:
    """Return the reason why numbers that depend on unloading are doubtful, if they are.

    Parameters
    ----------
    path : of the line
    line : of the path

    Notes
    -----
    The law of a wire is that of first loading; on unloading it follows Masing's rule, by which
    copper springs back two to four times as far as standards of annealed wire allow.
    """
    law = line.section.law
    largest = max_residual_curvature(path, law)
    node = int(np.argmax(largest))
    residual = float(residual_curvature(path.last, law)[node])
    if largest[node] <= max(_MIN_CURVATURE, 1.1 * residual):
        return None
    message = (
        "unloading is computed from the first loading by Masing's rule, which overestimates the "
        f"springback of copper: {1e3 * line.stations[node]:.4g} mm from the start the residual "
        f"curvature is {residual:.3g} 1/m by the rule and {largest[node]:.3g} 1/m without sliding "
        "on unloading"
    )
    return Reason("unloading_assumed", message)
