"""Compute the response of a line to its uncertain inputs, and pointwise 95 % bands.

The path is solved for the best inputs, and once to each side of every cause, at the distance that
covers 95 % of the draws of that cause. The response to a cause is the parabola through these three
solutions, continued linearly. The effects of the causes are added. The response to a dominant cause
is therefore exact at the ends of its band. Thousands of draws require only two matrix products.
Quantiles of Student's t, of its mixtures and of largest values along the line need no further
approximation.

Bands are pointwise: each component at each node lies inside its band in 95 of 100 lines, and a
complete shape in fewer. The band of the smallest bend radius is that of the minimum along the line,
which may be at a different node in each draw.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np

from labpipe.mechanics.rod.input_distributions import InputDistribution
from labpipe.mechanics.rod.path import RodPath
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import QualityNote

Fields = Mapping[str, Floats]
"""Fields of a line, arrays of any shape, keyed by name."""
TAIL = 0.025
"""Probability outside a band, on each side."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Response of a line to the causes of a distribution.

    Parameters
    ----------
    distribution : distribution of the inputs
    value : fields at the best inputs
    max_amounts : shape (causes,), amounts of each cause up to which the parabola holds
    slopes, bends : fields of shape (causes, ...). An amount x of a cause changes the value by
        slope x + bend x^2 up to `max_amounts`, and linearly beyond
    one_sided : causes without an equilibrium on one side; the other side is used for both
    unsolved : causes without an equilibrium on either side, which have no effect on the band
    """

    distribution: InputDistribution
    value: Fields
    max_amounts: Floats
    slopes: Fields
    bends: Fields
    one_sided: tuple[str, ...] = ()
    unsolved: tuple[str, ...] = ()

    def compute_draws(self, name: str) -> Floats:
        """Return draws of a field, shape (draws, ...)."""
        value = self.value[name]
        all_causes = np.ones(len(self.distribution.causes), dtype=np.bool_)
        changes = self._compute_changes(name, all_causes)
        return np.asarray(value + changes.reshape(len(changes), *value.shape))

    def _compute_changes(self, name: str, selected: Flags) -> Floats:
        """Return the changes of a field due to selected causes, shape (draws, values)."""
        amounts, max_amounts = self.distribution.amounts[:, selected], self.max_amounts[selected]
        clipped = np.clip(amounts, -max_amounts, max_amounts)
        squares = clipped * (2.0 * amounts - clipped)  # linear beyond the largest amounts
        shape = (len(self.distribution.causes), self.value[name].size)
        slopes, bends = (item[name].reshape(shape)[selected] for item in (self.slopes, self.bends))
        return np.asarray(amounts @ slopes + squares @ bends)

    def find_shares(self, name: str) -> dict[str, float]:
        """Return the fraction of each cause in the variance of a field, summed over its values.

        All steps of a cause count together. The mapping is empty if the field is constant. The
        standard deviation is half the width of the central 68 % of the draws, because of heavy
        tails.
        """
        causes, variances = np.array(self.distribution.causes), {}
        for cause in dict.fromkeys(self.distribution.causes):
            changes = self._compute_changes(name, causes == cause)
            low, high = np.quantile(changes, [0.15866, 0.84134], axis=0)
            variances[cause] = float(np.nansum((0.5 * (high - low)) ** 2))
        total = sum(variances.values())
        if not total > 0.0:
            return {}
        return {cause: variance / total for cause, variance in variances.items()}


def respond(
    solve: Callable[[Mapping[str, float]], Fields | None], distribution: InputDistribution
) -> Response | None:
    """Solve a line for the best inputs and to both sides of every cause.

    Parameters
    ----------
    solve : function that returns the fields of a line for inputs, or None without an equilibrium;
        it is called 1 + 2 x causes times
    distribution : distribution of the inputs

    Returns
    -------
    The response; None if the line has no equilibrium at the best inputs.
    """
    # Steps of a cause. Closer solutions differ by little more than the error of the solver.
    min_amount = 0.1
    max_amount = 2.0  # long tails are extrapolated
    value = solve(distribution.to_inputs())
    if value is None:
        return None
    amounts = np.quantile(np.abs(distribution.amounts), 1.0 - 2.0 * TAIL, axis=0)
    amounts = np.clip(amounts, min_amount, max_amount)
    pairs = [
        [solve(distribution.to_inputs(sign * row)) for sign in (1, -1)] for row in np.diag(amounts)
    ]
    slopes, bends = {}, {}
    for name, best in value.items():
        slopes[name], bends[name] = (np.zeros((len(amounts), *best.shape)) for _ in range(2))
        for cause, ((plus, minus), amount) in enumerate(zip(pairs, amounts, strict=True)):
            sides = [] if plus is None else [plus[name] - best]
            sides += [] if minus is None else [best - minus[name]]
            if sides:  # a straight line if only one side is solved
                slopes[name][cause] = 0.5 * (sides[0] + sides[-1]) / amount
                bends[name][cause] = 0.5 * (sides[0] - sides[-1]) / amount**2
    n_unsolved = np.array([sum(side is None for side in pair) for pair in pairs])
    one_sided, unsolved = (
        tuple(dict.fromkeys(np.array(distribution.causes)[n_unsolved == count].tolist()))
        for count in (1, 2)
    )
    return Response(distribution, value, amounts, slopes, bends, one_sided, unsolved)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A number or an array with its pointwise 95 % band.

    Parameters
    ----------
    value : value for the best inputs of the best distribution
    lower, upper : ends of the band, of the same shape
    """

    value: Floats
    lower: Floats
    upper: Floats


def compute_band(
    responses: Sequence[Response], name: str, measure: Callable[[Floats], Floats] = np.asarray
) -> Band:
    """Compute the pointwise 95 % band of a field over all distributions.

    Parameters
    ----------
    responses : response for each solution of a calibration, the best first
    name : name of the field
    measure : function that computes numbers from a field, and from draws of it along the first axis

    Returns
    -------
    The band, see `join_draws`.
    """
    return join_draws(
        (measure(response.value[name]), measure(response.compute_draws(name)))
        for response in responses
    )


def join_draws(values_and_draws: Iterable[tuple[Floats, Floats]]) -> Band:
    """Join draws of several distributions in one pointwise 95 % band.

    Parameters
    ----------
    values_and_draws : value, shape (...), and draws, shape (draws, ...), for each distribution, the
        best first

    Returns
    -------
    The band from the lowest to the highest end of the bands of all distributions. Each of these
    includes its value.
    """
    values, lows, highs = [], [], []
    for value, draws in values_and_draws:
        low, high = np.quantile(draws, [TAIL, 1.0 - TAIL], axis=0)
        values.append(value)
        lows.append(np.minimum(low, value))
        highs.append(np.maximum(high, value))
    return Band(values[0], np.min(lows, axis=0), np.max(highs, axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class StateBands:
    """Bands of one step.

    Parameters
    ----------
    step : number of the step
    positions : shape (n + 1, 3), m, positions of the nodes
    curvature : shape (n + 1,), 1/m, curvature including that at rest; the larger curvature if a
        clamp separates both sides of a node
    smallest_bend_radius : m, a single number, the minimum along the line; infinite if straight
    reaction_forces : shape (boundaries, 3), N
    reaction_moments : shape (boundaries, 3), N m
    shares : fraction of each cause in the variance along the line, for the best distribution, keyed
        by ``positions``, ``reaction_forces`` and ``smallest_bend_radius`` (of the curvature
        vectors), then by the cause
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
    path : path for the best inputs of the best distribution
    states : bands of the requested steps
    notes : reasons why the bands are doubtful
    responses : response for each distribution
    """

    path: RodPath
    states: tuple[StateBands, ...]
    notes: tuple[QualityNote, ...]
    responses: tuple[Response, ...]


Solve = Callable[[Mapping[str, float]], RodPath]
"""Function that builds a line and its boundaries from named inputs, and solves its path."""


def predict_line_bands(
    solves: Sequence[Solve],
    distributions: Sequence[InputDistribution],
    *,
    steps: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
    collect: Callable[[RodPath], Fields] = lambda _: {},
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solves : functions that solve the line for inputs, one for each distribution, because each
        solution of a calibration has its own slip curvatures; called 1 + 2 x causes times each
    distributions : distributions of the inputs, one for each solution of a calibration, the best
        first
    steps : numbers of the steps for which to compute bands; negative numbers count from the last
        step
    tested_curvature : 1/m, largest curvature in the tests of the calibration
    collect : function that returns further fields of a path, for `LineBands.responses`

    Returns
    -------
    The bands, from the lowest to the highest end of all distributions; None if the line cannot be
    solved for the best inputs of a distribution. Notes can be ``beyond_tested``, ``one_sided``,
    ``silent``, and ``jumps`` if the line jumps at other steps than for the best inputs.

    Raises
    ------
    ValueError
        If there is no distribution.
    """
    if not distributions:
        raise ValueError(format_sentence("mechanics.rod.no_distribution"))
    paths: list[list[RodPath]] = [[] for _ in solves]

    def collect_fields(number: int, inputs: Mapping[str, float]) -> Fields | None:
        path = solves[number](inputs)
        if path.status == "failed":
            return None
        paths[number].append(path)
        return {**_collect_step_fields(path, steps), **collect(path)}

    responses = []
    for number, distribution in enumerate(distributions):
        response = respond(partial(collect_fields, number), distribution)
        if response is None:
            return None
        responses.append(response)
    best = paths[0][0]
    range_notes, jump_notes = _find_range_notes(best, tested_curvature), _find_jump_notes(paths)
    notes = (*range_notes, *_find_side_notes(responses), *jump_notes)
    step_numbers = [range(len(best.states))[step] for step in steps]
    states = tuple(_compute_step_bands(responses, step) for step in step_numbers)
    return LineBands(best, states, notes, tuple(responses))


_STEP_FIELDS = ("positions", "reaction_forces", "reaction_moments", "curvature_vectors")


def _collect_step_fields(path: RodPath, steps: Sequence[int]) -> dict[str, Floats]:
    """Collect the fields of steps, keyed by field and number of the step, such as `positions 3`."""
    numbers = [range(len(path.states))[step] for step in steps]
    return {
        f"{name} {step}": getattr(path.states[step], name)
        for step in numbers
        for name in _STEP_FIELDS
    }


def compute_node_curvature(vectors: Floats) -> Floats:
    """Return the larger curvature of both sides of each node, 1/m, shape (..., n + 1).

    Parameters
    ----------
    vectors : `RodState.curvature_vectors`, shape (..., n + 1, 2, 2)
    """
    return np.asarray(np.linalg.norm(vectors, axis=-1).max(axis=-1))


def _find_smallest_radius(vectors: Floats) -> Floats:
    """Return the smallest bend radius along the line, m."""
    curvature = compute_node_curvature(vectors).max(axis=-1)
    infinite = np.full_like(curvature, np.inf)
    return np.asarray(np.divide(1.0, curvature, out=infinite, where=curvature > 0.0))


def _compute_step_bands(responses: Sequence[Response], step: int) -> StateBands:
    """Compute the bands of one step."""
    bands = {name: compute_band(responses, f"{name} {step}") for name in _STEP_FIELDS[:3]}
    vectors = f"curvature_vectors {step}"
    names = {name: f"{name} {step}" for name in ("positions", "reaction_forces")}
    names["smallest_bend_radius"] = vectors
    return StateBands(
        step=step,
        curvature=compute_band(responses, vectors, compute_node_curvature),
        smallest_bend_radius=compute_band(responses, vectors, _find_smallest_radius),
        shares={key: responses[0].find_shares(name) for key, name in names.items()},
        **bands,
    )


def _find_range_notes(path: RodPath, tested_curvature: float) -> Iterator[QualityNote]:
    """Yield a note if the line is bent beyond the tests of the calibration."""
    bendings = np.array([state.bendings for state in path.states])
    step, node = divmod(int(np.argmax(bendings)), bendings.shape[1])
    if bendings[step, node] > tested_curvature:
        yield QualityNote.of(
            "mechanics.rod.beyond_tested",
            f"step {step}, node {node}",
            step=step,
            node=node,
            curvature=bendings[step, node],
            tested=tested_curvature,
        )


def _find_side_notes(responses: Sequence[Response]) -> Iterator[QualityNote]:
    """Yield notes on causes without an equilibrium on one side or on both sides."""
    one_sided = chain.from_iterable(response.one_sided for response in responses)
    if names := ", ".join(dict.fromkeys(one_sided)):
        yield QualityNote.of("mechanics.rod.one_sided", names, causes=names)
    unsolved = chain.from_iterable(response.unsolved for response in responses)
    if names := ", ".join(dict.fromkeys(unsolved)):
        yield QualityNote.of("mechanics.rod.silent", names, causes=names)


def _find_jump_notes(paths: Sequence[Sequence[RodPath]]) -> Iterator[QualityNote]:
    """Yield a note if the line jumps at different steps for different inputs, except at step 0."""
    jumps = [[[step for step in path.snapped if step > 0] for path in group] for group in paths]
    pairs = [(group[0], steps) for group in jumps for steps in group if steps != group[0]]
    if pairs:  # the first path of a group has the best inputs
        best, other = (", ".join(map(str, steps)) or "none" for steps in pairs[0])
        yield QualityNote.of("mechanics.rod.jumps", "", steps=best, other=other)
