"""Predicted 95 % bands of a line: shape, curvature, smallest bend radius, forces.

Bands are pointwise: each node, each component for itself lies inside in 95 of 100 lines; that a
whole shape does is rarer. The smallest bend radius is the least along the line in every draw of
the response, wherever along the line it then is, and its band is that of these least values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.rod.input_distributions import InputDistribution
from labpipe.rod.path import RodPath, RodState
from labpipe.rod.response import Band, Fields, Response, band_of, field_band, respond
from labpipe.rod.rotations import conjugate, multiply, rotation_vectors

Solve = Callable[[Mapping[str, float]], RodPath]
"""Build a line and what holds it from named inputs, and follow it along its whole path."""

PLAIN = ("positions", "forces", "moments", "reaction_forces", "reaction_moments")
BENT = "bent"


@dataclass(frozen=True, slots=True, eq=False)
class StateBands:
    """Bands of one step.

    Parameters
    ----------
    step : which
    positions : shape (n + 1, 3), m
    curvature : shape (n + 1,), 1/m, of the line as it lies, free curvature included; the larger one
        where a clamp parts both sides of a node
    smallest_bend_radius : one number, m: the least along the line; infinite of a straight one
    forces : shape (n, 3), N, in space
    moments : shape (n + 1, 2, 3), N m, in space, before and behind every node
    reaction_forces, reaction_moments : shape (boundaries, 3), N, N m
    shares : by ``positions``, ``smallest_bend_radius`` and ``reaction_forces``: the share of each
        cause in the variance, over all their numbers together, for the best belief
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
    path : of the best inputs of the best belief
    states : of the steps that were asked for
    notes : what makes the bands doubtful; none if nothing does
    """

    path: RodPath
    states: tuple[StateBands, ...]
    notes: tuple[QualityNote, ...] = ()


def bands_of(
    solve: Solve | Sequence[Solve],
    beliefs: Sequence[InputDistribution],
    *,
    at: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solve : follows the line for some inputs; called 1 + 2 x causes times for each belief. One for
        all beliefs, or one for each: a law keeps slip curvatures that were chosen for its solution
    beliefs : what its inputs may be: one for each solution of a calibration, the best first
    at : steps to look at; negative ones count from the last
    tested_curvature : 1/m, largest that the tests of the calibration reached

    Returns
    -------
    The bands, from the lowest to the highest of all beliefs; None if the line fails at the best
    inputs of one. Notes: ``beyond_tested`` (curvature, step, node), ``one_sided`` and ``silent``
    (causes of which one side or none has an equilibrium), ``jumps`` (a jump at other steps than at
    the best inputs, where no smooth response holds).

    Raises
    ------
    ValueError
        If there is no belief.
    """
    if not beliefs:
        message = "beliefs: allowed is at least one"
        raise ValueError(message)
    solves = [solve] * len(beliefs) if callable(solve) else solve
    looks = [_Look(solve, at) for solve, _ in zip(solves, beliefs, strict=True)]
    responses = [respond(look, belief) for look, belief in zip(looks, beliefs, strict=True)]
    found = [response for response in responses if response is not None]
    if len(found) < len(beliefs):
        return None
    best = looks[0].paths[0]
    notes = [*_beyond(best, tested_curvature), *_unsolved(found), *_jumps(looks)]
    steps = [range(len(best.states))[step] for step in at]
    states = tuple(_bands(found, number, step) for number, step in enumerate(steps))
    return LineBands(best, states, tuple(notes))


class _Look:
    """Solves, and keeps of each path what is wanted of it; the first one whole."""

    def __init__(self, solve: Solve, at: Sequence[int]) -> None:
        self.solve, self.at = solve, tuple(at)
        self.paths: list[RodPath] = []
        self.snapped: list[tuple[int, ...]] = []

    def __call__(self, inputs: Mapping[str, float]) -> Fields | None:
        path = self.solve(inputs)
        if path.status == "failed":
            return None
        self.paths = self.paths or [path]
        self.snapped.append(tuple(step for step in path.snapped if step > 0))
        return dict(_fields(path, self.at))


def _fields(path: RodPath, at: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    for number, step in enumerate(at):
        state = path.states[step]
        for name in PLAIN:
            yield f"{name} {number}", np.asarray(getattr(state, name))
        yield f"{BENT} {number}", bent(state)


def bent(state: RodState) -> Floats:
    """Curvature vectors across the line as it lies, shape (n + 1, 2, 2), 1/m.

    Parameters
    ----------
    state : of the line

    Notes
    -----
    The state has curvatures less those at rest. What is missing at an inner node is the turn
    between its two elements over half of both, less their mean; ends have the curvature at rest of
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


def _sizes(vectors: Floats) -> Floats:
    """Curvature at nodes, shape (..., n + 1), the larger one of both sides."""
    return np.asarray(np.linalg.norm(vectors, axis=-1).max(axis=-1))


def _smallest_radius(vectors: Floats) -> Floats:
    most = _sizes(vectors).max(axis=-1)
    return np.asarray(np.divide(1.0, most, out=np.full_like(most, np.inf), where=most > 0.0))


def _bands(responses: Sequence[Response], number: int, step: int) -> StateBands:
    plain = {name: field_band(responses, f"{name} {number}") for name in PLAIN}
    name = f"{BENT} {number}"
    curvature = band_of(responses, lambda response: _both(response, name, _sizes))
    radius = band_of(responses, lambda response: _both(response, name, _smallest_radius))
    best = responses[0]
    shares = {
        each: best.shares(f"{each} {number}") for each in ("positions", "reaction_forces")
    } | {"smallest_bend_radius": best.shares(name)}
    return StateBands(
        step=step, curvature=curvature, smallest_bend_radius=radius, shares=shares, **plain
    )


def _both(
    response: Response, name: str, measure: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    return measure(response.value[name]), measure(response.drawn(name))


def _beyond(path: RodPath, tested: float) -> Iterator[QualityNote]:
    most = np.array([state.bendings.max() for state in path.states])
    if most.max() <= tested:
        return
    step = int(np.argmax(most))
    node = int(np.argmax(path.states[step].bendings))
    message = (
        f"step {step}, node {node}: the line is bent to {most[step]:.3g} 1/m, the tests of the "
        f"calibration reached {tested:.3g} 1/m: the law beyond, and the band, are the model's alone"
    )
    yield QualityNote("beyond_tested", Severity.WARNING, f"step {step}, node {node}", message)


def _unsolved(responses: Sequence[Response]) -> Iterator[QualityNote]:
    for code, what in (
        ("one_sided", "to one side of these causes the line has no equilibrium, and the band takes "
         "the other side for both"),
        ("silent", "to both sides of these causes the line has no equilibrium, and the band leaves "
         "them out"),
    ):  # fmt: skip
        causes = dict.fromkeys(cause for response in responses for cause in getattr(response, code))
        if causes:
            message = f"{what}: {', '.join(causes)}"
            yield QualityNote(code, Severity.WARNING, ", ".join(causes), message)


def _jumps(looks: Sequence[_Look]) -> Iterator[QualityNote]:
    """Jumps in step 0 are none: there a line is laid, wherever its drawing has it."""
    differing = [each for look in looks for each in look.snapped if each != look.snapped[0]]
    if differing:
        steps = looks[0].snapped[0], differing[0]
        at, beside = (", ".join(map(str, step)) or "none" for step in steps)
        message = (
            f"steps in which the line jumps: {at} at the best inputs, {beside} to one side of a "
            "cause; near a jump a smooth response, and the band, do not hold"
        )
        yield QualityNote("jumps", Severity.WARNING, "", message)
