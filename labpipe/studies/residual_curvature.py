"""What a line keeps of its bends: by the rule that its law unloads by, and at most."""

from __future__ import annotations

import numpy as np

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import Floats
from labpipe.records.quality import Reason
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState

MAX_RESIDUAL_RATIO = 1.1
"""At most kept over kept by the rule, above which what hangs on the way back is doubtful."""
_MIN_CURVATURE = 1e-3
"""1/m: who keeps less is straight."""


def curvature_after_release(law: SliderLaw, rests: Floats) -> Floats:
    """Curvature to which each station goes straight when nothing holds it, 1/m, shape (..., 2).

    Parameters
    ----------
    law : of every station
    rests : 1/m, shape (..., sliders, 2): where its sliders rest

    Notes
    -----
    The curvature without moment, where sliders slide the other way as they do: EI_0 kappa + sum of
    w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|), solved for kappa with the
    w_j of the step before (Weiszfeld's iteration, which descends on a convex energy). It begins at
    the curvature that is reached if no slider slides. A law without sliders keeps nothing.
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
    """Curvature that the line would keep if nothing held it any more, 1/m, shape (n + 1,).

    Parameters
    ----------
    state : with the memory of its sliders
    law : of the line

    Notes
    -----
    Less that at rest. See `curvature_after_release`; the larger one where a clip parts both sides
    of a node.
    """
    return np.asarray(np.linalg.norm(curvature_after_release(law, state.rests), axis=2).max(axis=1))


def max_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Curvature that it would keep if nothing slid on the way back, 1/m, shape (n + 1,).

    Parameters
    ----------
    path : as followed
    law : of the line

    Notes
    -----
    From where each node was bent most: sum of K_j a_j over the first stiffness.
    """
    if not len(law.stiffnesses):
        return np.zeros(len(path.last.positions))
    sizes = [
        np.linalg.norm(np.einsum("j,nsjx->nsx", law.stiffnesses, state.rests), axis=2).max(axis=1)
        for state in path.states
    ]
    return np.asarray(np.max(sizes, axis=0) / law.first_stiffness)


def largest_unbending(path: RodPath) -> float:
    """How far a node went back from where it was bent most, as a share of the line's sharpest bend.

    Parameters
    ----------
    path : as followed
    """
    bent = np.array([state.bendings for state in path.states])
    most = bent.max(axis=0)
    return float(np.max(most - bent[-1]) / max(float(most.max()), _MIN_CURVATURE))


def unloading_reason(path: RodPath, line: Line) -> Reason | None:
    """Why numbers that hang on the way back are doubtful, if they are.

    Parameters
    ----------
    path : as followed
    line : that was followed

    Notes
    -----
    The law of a wire is that of first loading; on the way back it follows Masing's rule, by which
    copper alone springs back two to four times as far as standards of annealed wire allow.
    """
    law = line.section.law
    largest = max_residual_curvature(path, law)
    node = int(np.argmax(largest))
    residual = float(residual_curvature(path.last, law)[node])
    if largest[node] <= max(_MIN_CURVATURE, MAX_RESIDUAL_RATIO * residual):
        return None
    message = (
        "how the wire unloads is taken from its first loading (Masing's rule), by which copper "
        f"springs back too far: {1e3 * line.stations[node]:.4g} mm from the start it keeps "
        f"{residual:.3g} 1/m by the rule, and if nothing slid on its way back it would be "
        f"{largest[node]:.3g} 1/m"
    )
    return Reason("unloading_assumed", message)
