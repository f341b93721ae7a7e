"""Compute the response of a line to its uncertain inputs, and pointwise 95 % bands.

The path is solved for the best inputs, and with every cause changed by plus and minus the amount
that covers 95 % of its draws, limited to 0.1 to 2 units of the cause. The response to a cause is
the parabola through these three solutions, continued linearly. The effects of the causes are added.
If one cause dominates and its amount is within the limits, the response is exact at the ends of the
band. Thousands of draws require only two matrix products. Quantiles of Student's t, of its mixtures
and of the largest values along the line need no further approximation.

Bands are pointwise: each component at each node lies inside its band in 95 of 100 lines. A complete
shape lies inside its bands in fewer lines. The band of the smallest bend radius is that of the
minimum along the line, which may be at a different node in each draw.
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
from labpipe.records.result import Status

Fields = Mapping[str, Floats]
"""Fields of a line, arrays of any shape, keyed by name."""
PathSolver = Callable[[Mapping[str, float]], RodPath]
"""Function that builds a line and its boundaries from named inputs, and solves its path."""
TAIL = 0.025
"""Probability below the lower end of a band, and above its upper end."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Response of a line to the causes of a distribution.

    Parameters
    ----------
    distribution : distribution of the inputs
    value : fields at the best inputs
    max_amounts : shape (causes,), amount of each cause up to which the parabola holds
    linear_coefficients, quadratic_coefficients : fields of shape (causes, ...). An amount x of a
        cause changes the value by linear x + quadratic x^2 up to `max_amounts`, and along the
        tangent beyond
    one_sided : names of the causes without an equilibrium for one sign of the amount; the response
        is linear through the other solution
    unsolved : names of the causes without an equilibrium for either sign, which have no effect on
        the band
    """

    distribution: InputDistribution
    value: Fields
    max_amounts: Floats
    linear_coefficients: Fields
    quadratic_coefficients: Fields
    one_sided: tuple[str, ...] = ()
    unsolved: tuple[str, ...] = ()

    def compute_draws(self, name: str) -> Floats:
        """Return draws of a field, shape (draws, ...)."""
        value = self.value[name]
        all_causes = np.ones(len(self.distribution.causes), dtype=np.bool_)
        changes = self._compute_changes(name, all_causes)
        return np.asarray(value + changes.reshape(len(changes), *value.shape))

    def _compute_changes(self, name: str, selected: Flags) -> Floats:
        """Return the changes of a field due to selected causes in all draws, (draws, values)."""
        amounts, max_amounts = self.distribution.amounts[:, selected], self.max_amounts[selected]
        clipped = np.clip(amounts, -max_amounts, max_amounts)
        squares = clipped * (2.0 * amounts - clipped)  # the tangent beyond the largest amounts
        shape = (len(self.distribution.causes), self.value[name].size)
        linear = self.linear_coefficients[name].reshape(shape)[selected]
        quadratic = self.quadratic_coefficients[name].reshape(shape)[selected]
        return np.asarray(amounts @ linear + squares @ quadratic)

    def compute_variance_fractions(self, name: str) -> dict[str, float]:
        """Return the fraction of the variance of a field, summed over its values, by cause.

        Columns of the distribution with the same cause are taken together. The mapping is empty if
        the field is constant. The standard deviation is half the width of the central 68 % of the
        draws, which heavy tails hardly change.
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


def compute_response(
    solve_fields: Callable[[Mapping[str, float]], Fields | None], distribution: InputDistribution
) -> Response | None:
    """Compute the response of the fields of a line to the causes of a distribution.

    Parameters
    ----------
    solve_fields : function that returns the fields of a line for inputs, or None without an
        equilibrium; it is called 1 + 2 x causes times
    distribution : distribution of the inputs

    Returns
    -------
    The response; None if the line has no equilibrium at the best inputs.
    """
    # The amounts of a cause for which the line is solved are limited. Solutions for smaller amounts
    # differ by little more than the error of the solver. Draws in long tails are extrapolated.
    min_amount, max_amount = 0.1, 2.0
    value = solve_fields(distribution.to_inputs())
    if value is None:
        return None
    amounts = np.quantile(np.abs(distribution.amounts), 1.0 - 2.0 * TAIL, axis=0)
    amounts = np.clip(amounts, min_amount, max_amount)
    steps = np.diag(amounts)
    pairs = [[solve_fields(distribution.to_inputs(step)) for step in (row, -row)] for row in steps]
    linear, quadratic = {}, {}
    for name, best_value in value.items():
        linear[name], quadratic[name] = np.zeros((2, len(amounts), *best_value.shape))
        for cause, ((plus, minus), amount) in enumerate(zip(pairs, amounts, strict=True)):
            increments = [] if plus is None else [plus[name] - best_value]
            increments += [] if minus is None else [best_value - minus[name]]
            if increments:  # with one solution only, the quadratic coefficient becomes zero
                linear[name][cause] = 0.5 * (increments[0] + increments[-1]) / amount
                quadratic[name][cause] = 0.5 * (increments[0] - increments[-1]) / amount**2
    n_unsolved = np.array([sum(fields is None for fields in pair) for pair in pairs])
    one_sided, unsolved = (
        tuple(dict.fromkeys(np.array(distribution.causes)[n_unsolved == count].tolist()))
        for count in (1, 2)
    )
    return Response(distribution, value, amounts, linear, quadratic, one_sided, unsolved)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A number or an array with its pointwise 95 % band.

    Parameters
    ----------
    value : value for the best inputs of the best distribution
    lower, upper : ends of the band, of the shape of `value`
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
    measure : function that computes a quantity from a field, and from its draws along the first
        axis

    Returns
    -------
    The band of the quantity, see `join_bands`.
    """
    return join_bands(
        (measure(response.value[name]), measure(response.compute_draws(name)))
        for response in responses
    )


def join_bands(values_and_draws: Iterable[tuple[Floats, Floats]]) -> Band:
    """Join the pointwise 95 % bands of several distributions in their envelope.

    Parameters
    ----------
    values_and_draws : value, shape (...), and draws, shape (draws, ...), for each distribution, the
        best first

    Returns
    -------
    The band from the lowest lower end to the highest upper end of the bands of all distributions.
    The band of a distribution includes its value.
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
    """Bands of the quantities of a line at one step.

    Parameters
    ----------
    step : index of the step
    positions : shape (n + 1, 3), m, positions of the nodes
    curvature : shape (n + 1,), 1/m, curvature including that at rest; at a clamp the larger of
        the curvatures on the two sides
    smallest_bend_radius : shape (), m, minimum along the line; infinite if the line is straight
    reaction_forces : shape (boundaries, 3), N
    reaction_moments : shape (boundaries, 3), N m
    shares : fractions of the variance, summed along the line, that the causes of the best
        distribution contribute, keyed by ``positions``, ``reaction_forces`` and
        ``smallest_bend_radius``, then by cause. The fractions of ``smallest_bend_radius`` are those
        of the curvature vectors of the whole line
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
    """Bands of a line at the requested steps.

    Parameters
    ----------
    path : path for the best inputs of the best distribution
    states : bands of the requested steps, in the order of the request
    notes : reasons why the bands are doubtful
    responses : response of the line for each distribution
    """

    path: RodPath
    states: tuple[StateBands, ...]
    notes: tuple[QualityNote, ...]
    responses: tuple[Response, ...]


def predict_line_bands(
    solvers: Sequence[PathSolver],
    distributions: Sequence[InputDistribution],
    *,
    steps: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
    collect: Callable[[RodPath], Fields] = lambda _: {},
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solvers : function that solves the line for inputs, for each distribution, because each solution
        of a calibration has its own slip curvatures. Each is called 1 + 2 x causes times
    distributions : distributions of the inputs, one for each solution of a calibration, the best
        first
    steps : indices of the steps for which bands are computed; negative indices count from the end
    tested_curvature : 1/m, largest curvature in the tests of the calibration
    collect : function that returns further fields of a path, for `LineBands.responses`

    Returns
    -------
    The envelope of the bands of all distributions; None if the line cannot be solved for the best
    inputs of a distribution. The notes are ``beyond_tested`` if the line is bent beyond the tests,
    ``one_sided`` if a cause has no equilibrium for one sign of its amount, ``silent`` if it has
    none for either sign, so that the band excludes the cause, and ``jumps`` if the line jumps at
    other steps than for the best inputs.

    Raises
    ------
    ValueError
        If there is no distribution.
    """
    if not distributions:
        raise ValueError(format_sentence("mechanics.rod.no_distribution"))
    paths_by_distribution: list[list[RodPath]] = [[] for _ in solvers]

    def solve_fields(index: int, inputs: Mapping[str, float]) -> Fields | None:
        path = solvers[index](inputs)
        if path.status is Status.FAILED:
            return None
        paths_by_distribution[index].append(path)
        return {**_collect_step_fields(path, steps), **collect(path)}

    responses = []
    for index, distribution in enumerate(distributions):
        response = compute_response(partial(solve_fields, index), distribution)
        if response is None:
            return None
        responses.append(response)
    best_path = paths_by_distribution[0][0]
    notes = [*_find_range_notes(best_path, tested_curvature), *_find_equilibrium_notes(responses)]
    notes += _find_jump_notes(paths_by_distribution)
    step_indices = [range(len(best_path.states))[step] for step in steps]
    states = tuple(_compute_step_bands(responses, step) for step in step_indices)
    return LineBands(best_path, states, tuple(notes), tuple(responses))


_STEP_FIELDS = ("positions", "reaction_forces", "reaction_moments", "curvature_vectors")


def _collect_step_fields(path: RodPath, steps: Sequence[int]) -> dict[str, Floats]:
    """Collect the fields of steps, keyed by field and index of the step, such as `positions 3`."""
    step_indices = [range(len(path.states))[step] for step in steps]
    return {
        f"{name} {step}": getattr(path.states[step], name)
        for step in step_indices
        for name in _STEP_FIELDS
    }


def compute_node_curvature(curvature_vectors: Floats) -> Floats:
    """Return the larger of the curvatures on the two sides of each node, 1/m, shape (..., n + 1).

    Parameters
    ----------
    curvature_vectors : shape (..., n + 1, 2, 2), 1/m, see `RodState.curvature_vectors`
    """
    return np.asarray(np.linalg.norm(curvature_vectors, axis=-1).max(axis=-1))


def _compute_smallest_radius(curvature_vectors: Floats) -> Floats:
    """Return the smallest bend radius along the line, m, shape (...)."""
    curvature = compute_node_curvature(curvature_vectors).max(axis=-1)
    infinite = np.full_like(curvature, np.inf)
    return np.asarray(np.divide(1.0, curvature, out=infinite, where=curvature > 0.0))


def _compute_step_bands(responses: Sequence[Response], step: int) -> StateBands:
    """Compute the bands of the quantities of a line at one step, from 0."""
    positions, forces, moments, curvatures = (f"{name} {step}" for name in _STEP_FIELDS)
    fields = {"positions": positions, "reaction_forces": forces, "smallest_bend_radius": curvatures}
    compute_fractions = responses[0].compute_variance_fractions
    return StateBands(
        step=step,
        positions=compute_band(responses, positions),
        curvature=compute_band(responses, curvatures, compute_node_curvature),
        smallest_bend_radius=compute_band(responses, curvatures, _compute_smallest_radius),
        reaction_forces=compute_band(responses, forces),
        reaction_moments=compute_band(responses, moments),
        shares={name: compute_fractions(field) for name, field in fields.items()},
    )


def _find_range_notes(path: RodPath, tested_curvature: float) -> Iterator[QualityNote]:
    """Yield a note if the line is bent beyond the tests of the calibration."""
    curvatures = np.array([state.bending_curvatures for state in path.states])
    step, node = divmod(int(np.argmax(curvatures)), curvatures.shape[1])
    if curvatures[step, node] > tested_curvature:
        yield QualityNote.of(
            "mechanics.rod.beyond_tested",
            f"step {step}, node {node}",
            step=step,
            node=node,
            curvature=curvatures[step, node],
            tested=tested_curvature,
        )


def _find_equilibrium_notes(responses: Sequence[Response]) -> Iterator[QualityNote]:
    """Yield notes on causes without an equilibrium for one sign of their amount, or for both."""
    one_sided = chain.from_iterable(response.one_sided for response in responses)
    if names := ", ".join(dict.fromkeys(one_sided)):
        yield QualityNote.of("mechanics.rod.one_sided", names, causes=names)
    unsolved = chain.from_iterable(response.unsolved for response in responses)
    if names := ", ".join(dict.fromkeys(unsolved)):
        yield QualityNote.of("mechanics.rod.silent", names, causes=names)


def _find_jump_notes(groups: Sequence[Sequence[RodPath]]) -> Iterator[QualityNote]:
    """Yield a note if the line jumps at other steps than for the best inputs of a distribution.

    Each group holds the paths of one distribution, that of its best inputs first. Jumps at step 0
    are ignored.
    """
    jumps = [[[step for step in path.snapped if step > 0] for path in paths] for paths in groups]
    pairs = [(paths[0], steps) for paths in jumps for steps in paths if steps != paths[0]]
    if pairs:
        best_steps, changed_steps = (", ".join(map(str, steps)) or "none" for steps in pairs[0])
        yield QualityNote.of("mechanics.rod.jumps", "", steps=best_steps, other=changed_steps)
