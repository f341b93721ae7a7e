"""Predicted 95 % bands of a line: shape, curvature, smallest bend radius, forces.

Bands are pointwise: each component of each node lies inside in 95 of 100 lines; a whole shape does
less often. The smallest bend radius is the least along the line in each draw of the response, at
any node, and its band is that of these values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod.input_distributions import InputDistribution
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.response import Band, Fields, Response, band_of, field_band, respond
from labpipe.mechanics.rod.rotations import conjugate, multiply, rotation_vectors
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote

Solve = Callable[[Mapping[str, float]], RodPath]
"""Build a line and its boundaries from named inputs, and follow it along its whole path."""

_PLAIN_FIELDS = ("positions", "forces", "moments", "reaction_forces", "reaction_moments")
_CURVATURE_FIELD = "bent"


@dataclass(frozen=True, slots=True, eq=False)
class StateBands:
    """Bands of one step.

    Parameters
    ----------
    step : its number
    positions : shape (n + 1, 3), m
    curvature : shape (n + 1,), 1/m, including the curvature at rest; the larger one where a
        clamp separates both sides of a node
    smallest_bend_radius : one number, m: the least along the line; infinite for a straight one
    forces : shape (n, 3), N, in space
    moments : shape (n + 1, 2, 3), N m, in space, before and behind every node
    reaction_forces, reaction_moments : shape (boundaries, 3), N, N m
    shares : by ``positions``, ``smallest_bend_radius`` and ``reaction_forces``: the share of each
        cause in the variance, over all their numbers together, for the best distribution
    """

    step: int
    positions: Band
    curvature: Band
    smallest_bend_radius: Band
    forces: Band
    moments: Band
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


def bands_of(
    solve: Solve | Sequence[Solve],
    distributions: Sequence[InputDistribution],
    *,
    steps: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solve : follows the line for some inputs; called 1 + 2 x causes times for each distribution. One
    for
        all distributions, or one for each: a law keeps slip curvatures that were chosen for its
        solution
    distributions : of its inputs: one for each solution of a calibration, the best first
    steps : steps of the bands; negative ones count from the last
    tested_curvature : 1/m, largest that the tests of the calibration reached

    Returns
    -------
    The bands, from the lowest to the highest of all distributions; None if the line fails at the
    best inputs of one. Notes: ``beyond_tested`` (curvature, step, node), ``one_sided`` and
    ``silent`` (causes of which one side or none has an equilibrium), ``jumps`` (a jump at other
    steps than at the best inputs, where no smooth response holds).

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
        respond(look, distribution)
        for look, distribution in zip(solvers, distributions, strict=True)
    ]
    solved = [response for response in responses if response is not None]
    if len(solved) < len(distributions):
        return None
    best = solvers[0].paths[0]
    notes = [*_range_notes(best, tested_curvature), *_side_notes(solved), *_jump_notes(solvers)]
    step_numbers = [range(len(best.states))[step] for step in steps]
    states = tuple(_bands(solved, number, step) for number, step in enumerate(step_numbers))
    return LineBands(best, states, tuple(notes))


class _Solver:
    """Solver that keeps the fields of each path, and the first path."""

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
        return dict(_fields(path, self.steps))


def _fields(path: RodPath, steps: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    for number, step in enumerate(steps):
        state = path.states[step]
        for name in _PLAIN_FIELDS:
            yield f"{name} {number}", np.asarray(getattr(state, name))
        yield f"{_CURVATURE_FIELD} {number}", line_curvatures(state)


def line_curvatures(state: RodState) -> Floats:
    """Return the bending curvature vectors of the line, shape (n + 1, 2, 2), 1/m.

    Parameters
    ----------
    state : of the line

    Notes
    -----
    The state has curvatures less those at rest. The curvature at rest of an inner node is the turn
    between its two elements over half their lengths, less the mean of the state; ends have that of
    their neighbours.
    """
    turned = rotation_vectors(multiply(conjugate(state.frames[:-1]), state.frames[1:]))
    chords = np.linalg.norm(np.diff(state.positions, axis=0), axis=1) / (1.0 + state.stretches)
    both = np.stack([chords[:-1], chords[1:]], axis=1)
    weights = both / both.sum(axis=1, keepdims=True)
    inner = state.curvatures[1:-1]
    mean = np.einsum("ns,nsx->nx", weights, inner)
    at_rest = turned / (0.5 * both.sum(axis=1, keepdims=True)) - mean
    if len(at_rest):
        at_rest = np.concatenate([at_rest[:1], at_rest, at_rest[-1:]])
        return np.asarray((state.node_curvatures + at_rest[:, None, :])[:, :, :2])
    return np.asarray(state.node_curvatures[:, :, :2])


def _node_curvatures(vectors: Floats) -> Floats:
    """Return the curvature at nodes, shape (..., n + 1), the larger one of both sides."""
    return np.asarray(np.linalg.norm(vectors, axis=-1).max(axis=-1))


def _smallest_radius(vectors: Floats) -> Floats:
    peak = _node_curvatures(vectors).max(axis=-1)
    return np.asarray(np.divide(1.0, peak, out=np.full_like(peak, np.inf), where=peak > 0.0))


def _bands(responses: Sequence[Response], number: int, step: int) -> StateBands:
    bands = {name: field_band(responses, f"{name} {number}") for name in _PLAIN_FIELDS}
    name = f"{_CURVATURE_FIELD} {number}"
    curvature = band_of(responses, lambda response: _with_draws(response, name, _node_curvatures))
    radius = band_of(responses, lambda response: _with_draws(response, name, _smallest_radius))
    best = responses[0]
    shares = {
        field: best.shares(f"{field} {number}") for field in ("positions", "reaction_forces")
    } | {"smallest_bend_radius": best.shares(name)}
    return StateBands(
        step=step, curvature=curvature, smallest_bend_radius=radius, shares=shares, **bands
    )


def _with_draws(
    response: Response, name: str, measure: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    return measure(response.value[name]), measure(response.drawn(name))


def _range_notes(path: RodPath, tested: float) -> Iterator[QualityNote]:
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


def _side_notes(responses: Sequence[Response]) -> Iterator[QualityNote]:
    for code in ("one_sided", "silent"):
        causes = dict.fromkeys(cause for response in responses for cause in getattr(response, code))
        if causes:
            names = ", ".join(causes)
            yield QualityNote.of(
                "mechanics.rod.one_sided" if code == "one_sided" else "mechanics.rod.silent",
                names,
                causes=names,
            )


def _jump_notes(solvers: Sequence[_Solver]) -> Iterator[QualityNote]:
    """Note jumps at different steps; step 0, where the line is laid, does not count."""
    differing = [jumps for look in solvers for jumps in look.snapped if jumps != look.snapped[0]]
    if differing:
        steps = solvers[0].snapped[0], differing[0]
        here, other = (", ".join(map(str, step)) or "none" for step in steps)
        yield QualityNote.of("mechanics.rod.jumps", "", steps=here, other=other)
