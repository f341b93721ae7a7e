"""Predicted 95 % bands of a line: shape, curvature, smallest bend radius, forces.

Bands are pointwise: each component at each node lies inside its band in 95 of 100 lines, a whole
shape in fewer. The band of the smallest bend radius is that of the minimum along the line, which
may be at another node in each draw.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod.input_distributions import InputDistribution
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.response import (
    Band,
    Fields,
    Response,
    compute_band,
    compute_field_band,
    respond,
)
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote

Solve = Callable[[Mapping[str, float]], RodPath]
"""Function that builds a line and its boundaries from named inputs, and solves its path."""

_PLAIN_FIELDS = ("positions", "reaction_forces", "reaction_moments")
_CURVATURE_FIELD = "curvature"


@dataclass(frozen=True, slots=True, eq=False)
class StateBands:
    """Bands of one step.

    Parameters
    ----------
    step : its number
    positions : shape (n + 1, 3), m
    curvature : shape (n + 1,), 1/m, including the curvature at rest; the larger one where a
        clamp separates both sides of a node
    smallest_bend_radius : m, a single number, the minimum along the line; infinite if straight
    reaction_forces, reaction_moments : shape (boundaries, 3), N, N m
    shares : by ``positions``, ``smallest_bend_radius`` and ``reaction_forces``: the share of each
        cause in the variance, over all their numbers together, for the best distribution
    """

    step: int
    positions: Band
    curvature: Band
    smallest_bend_radius: Band
    reaction_forces: Band
    reaction_moments: Band
    shares: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, eq=False)
class LineBands:
    """Bands of a line.

    Parameters
    ----------
    path : of the best inputs of the best distribution
    states : of the requested steps
    notes : what makes the bands doubtful
    """

    path: RodPath
    states: tuple[StateBands, ...]
    notes: tuple[QualityNote, ...] = ()


def predict_line_bands(
    solve: Solve | Sequence[Solve],
    distributions: Sequence[InputDistribution],
    *,
    steps: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solve : solves the line for some inputs; called 1 + 2 x causes times for each distribution. One
        function for all distributions, or one for each, because the slip curvatures of a law are
        chosen for its solution of the calibration
    distributions : of the inputs, one for each solution of a calibration, the best first
    steps : with bands; negative numbers count from the last step
    tested_curvature : 1/m, largest curvature in the tests of the calibration

    Returns
    -------
    The bands, from the lowest to the highest end for all distributions; None if the line cannot be
    solved at the best inputs of one of them. Notes: ``beyond_tested``, ``one_sided``, ``silent``,
    and ``jumps`` if the line jumps at other steps than at the best inputs.

    Raises
    ------
    ValueError
        If there is no distribution.
    """
    if not distributions:
        raise ValueError(format_sentence("mechanics.rod.no_distribution"))
    solves = [solve] * len(distributions) if callable(solve) else solve
    solvers = [_Solver(solve, steps) for solve, _ in zip(solves, distributions, strict=True)]
    responses = [
        respond(solver, distribution)
        for solver, distribution in zip(solvers, distributions, strict=True)
    ]
    solved = [response for response in responses if response is not None]
    if len(solved) < len(distributions):
        return None
    best = solvers[0].paths[0]
    notes = [*_note_range(best, tested_curvature), *_note_sides(solved), *_note_jumps(solvers)]
    step_numbers = [range(len(best.states))[step] for step in steps]
    states = tuple(_compute_bands(solved, number, step) for number, step in enumerate(step_numbers))
    return LineBands(best, states, tuple(notes))


class _Solver:
    """Solver that returns the fields of a path, and stores the first path and all jumps."""

    def __init__(self, solve: Solve, steps: Sequence[int]) -> None:
        self.solve, self.steps = solve, tuple(steps)
        self.paths: list[RodPath] = []
        self.snapped: list[tuple[int, ...]] = []

    def __call__(self, inputs: Mapping[str, float]) -> Fields | None:
        path = self.solve(inputs)
        if path.status == "failed":
            return None
        self.paths = self.paths or [path]
        self.snapped.append(tuple(step for step in path.snapped if step > 0))
        return dict(_collect_fields(path, self.steps))


def _collect_fields(path: RodPath, steps: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    for number, step in enumerate(steps):
        state = path.states[step]
        for name in _PLAIN_FIELDS:
            yield f"{name} {number}", np.asarray(getattr(state, name))
        yield f"{_CURVATURE_FIELD} {number}", compute_line_curvatures(state)


def compute_line_curvatures(state: RodState) -> Floats:
    """Return the bending curvature vectors of the line, shape (n + 1, 2, 2), 1/m.

    Parameters
    ----------
    state : of the line

    Notes
    -----
    The curvatures of a state do not include those at rest. The curvature at rest of an inner node
    is computed as the turn between its elements over half their lengths, minus the mean curvature
    of the state. The ends have that of their neighbours.
    """
    turned = to_rotation_vectors(multiply(conjugate(state.frames[:-1]), state.frames[1:]))
    chords = np.linalg.norm(np.diff(state.positions, axis=0), axis=1) / (1.0 + state.stretches)
    sides = np.stack([chords[:-1], chords[1:]], axis=1)
    weights = sides / sides.sum(axis=1, keepdims=True)
    inner = state.curvatures[1:-1]
    mean = np.einsum("ns,nsx->nx", weights, inner)
    at_rest = turned / (0.5 * sides.sum(axis=1, keepdims=True)) - mean
    if len(at_rest):
        at_rest = np.concatenate([at_rest[:1], at_rest, at_rest[-1:]])
        return np.asarray((state.node_curvatures + at_rest[:, None, :])[:, :, :2])
    return np.asarray(state.node_curvatures[:, :, :2])


def _find_node_curvatures(vectors: Floats) -> Floats:
    """Return the curvature at the nodes, shape (..., n + 1), the larger one of both sides."""
    return np.asarray(np.linalg.norm(vectors, axis=-1).max(axis=-1))


def _find_smallest_radius(vectors: Floats) -> Floats:
    peak = _find_node_curvatures(vectors).max(axis=-1)
    return np.asarray(np.divide(1.0, peak, out=np.full_like(peak, np.inf), where=peak > 0.0))


def _compute_bands(responses: Sequence[Response], number: int, step: int) -> StateBands:
    bands = {name: compute_field_band(responses, f"{name} {number}") for name in _PLAIN_FIELDS}
    name = f"{_CURVATURE_FIELD} {number}"
    curvature = compute_band(
        responses, lambda response: _evaluate_draws(response, name, _find_node_curvatures)
    )
    radius = compute_band(
        responses, lambda response: _evaluate_draws(response, name, _find_smallest_radius)
    )
    best = responses[0]
    shares = {
        field: best.shares(f"{field} {number}") for field in ("positions", "reaction_forces")
    } | {"smallest_bend_radius": best.shares(name)}
    return StateBands(
        step=step, curvature=curvature, smallest_bend_radius=radius, shares=shares, **bands
    )


def _evaluate_draws(
    response: Response, name: str, measure: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    return measure(response.value[name]), measure(response.drawn(name))


def _note_range(path: RodPath, tested: float) -> Iterator[QualityNote]:
    largest = np.array([state.bendings.max() for state in path.states])
    if largest.max() <= tested:
        return
    step = int(np.argmax(largest))
    node = int(np.argmax(path.states[step].bendings))
    yield QualityNote.of(
        "mechanics.rod.beyond_tested",
        f"step {step}, node {node}",
        step=step,
        node=node,
        curvature=largest[step],
        tested=tested,
    )


def _note_sides(responses: Sequence[Response]) -> Iterator[QualityNote]:
    for code in ("one_sided", "silent"):
        causes = dict.fromkeys(cause for response in responses for cause in getattr(response, code))
        if causes:
            names = ", ".join(causes)
            yield QualityNote.of(
                "mechanics.rod.one_sided" if code == "one_sided" else "mechanics.rod.silent",
                names,
                causes=names,
            )


def _note_jumps(solvers: Sequence[_Solver]) -> Iterator[QualityNote]:
    """Note jumps that differ between inputs; step 0 does not count."""
    differing = [
        steps for solver in solvers for steps in solver.snapped if steps != solver.snapped[0]
    ]
    if differing:
        steps = solvers[0].snapped[0], differing[0]
        best_steps, other = (", ".join(map(str, step)) or "none" for step in steps)
        yield QualityNote.of("mechanics.rod.jumps", "", steps=best_steps, other=other)
