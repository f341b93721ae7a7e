"""Compute the response of a line to its uncertain inputs, and pointwise 95 % bands.

The path is solved for the best inputs, and with every cause changed by plus and minus the amount
that covers 95 % of its draws, limited to 0.1 to 2 units of the cause. The response to a cause is
the parabola through these three solutions, continued linearly. The effects of the causes are added.
If one cause dominates and its amount is within the limits, the response is exact at the ends of the
band. Thousands of draws require only two matrix products. Quantiles of Student's t, of its
mixtures, and of the largest values along the line are computed without further approximation.

Bands are pointwise: each component at each node lies inside its band in 95 of 100 lines. A complete
shape lies inside its bands in fewer lines. The band of the smallest bend radius is that of the
minimum along the line, which may be at a different node in each draw.

A distribution is a set of named inputs and of causes that change them linearly. A calibration has
a distribution for each of its solutions. The logarithms of the parameters are distributed about the
solution as the mixture of Student's t of that solution. A specimen of the spool differs from the
mean of the tested samples by a factor on all moments. Parameters and factor are drawn together,
because the uncertain scatter of samples widens both. All other inputs, such as free curvature and
mass, are independent. Each is stated as a standard deviation, with degrees of freedom if these are
few, or as a range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Annotated

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

from labpipe.mechanics.rod.path import RodPath
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints
from labpipe.records.quality import QualityNote
from labpipe.records.result import Status
from labpipe.records.wire import PARAMETERS, Solution

N_DRAWS = 4096
"""Number of draws of a distribution, a power of two. If the scatter of specimens, estimated from
three samples, dominates, the error of the width of a band is 1.5 %. With random draws it is 3 %."""
CALIBRATION = "calibration"
"""Name of the cause for uncertain parameters of a calibration."""
SPECIMEN = "specimen"
"""Name of the cause for the difference of a specimen from the mean sample."""

_MAX_LOG_STEP = 0.3
"""Largest step of the logarithm of an input. A line is solved up to two steps away, at which the
input differs by a factor of 1.8."""


@dataclass(frozen=True, slots=True, eq=False)
class InputDistribution(ArrayRecord):
    """Inputs of a line, and the causes that change them: inputs = centre + steps x amounts.

    Parameters
    ----------
    names : names of the inputs, without duplicates
    causes : name of the cause of each column of `steps`; a cause may have several columns
    centre : shape (names,), best values in the units of the inputs
    steps : shape (names, causes), change of each input per unit of each cause
    amounts : shape (draws, causes), joint draws of all causes, in units of `steps`
    """

    names: tuple[str, ...]
    causes: tuple[str, ...]
    centre: Annotated[Floats, "names"]
    steps: Annotated[Floats, "names", "causes"]
    amounts: Annotated[Floats, "draws", "causes"]

    def to_inputs(self, amounts: Floats | None = None) -> dict[str, float]:
        """Return the inputs for amounts of the causes, shape (causes,), or the best for None."""
        values = self.centre if amounts is None else self.centre + self.steps @ amounts
        return dict(zip(self.names, values.tolist(), strict=True))


def build_t_distribution(
    name: str,
    deviation: float,
    *,
    centre: float = 0.0,
    freedom: float = np.inf,
    cause: str = "",
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> InputDistribution:
    """Build a Student's t distribution of an input from its standard deviation.

    Parameters
    ----------
    name : name of the input
    deviation : standard deviation in the unit of the input, positive
    centre : best value in the unit of the input
    freedom : degrees of freedom of the deviation; infinite for the normal distribution
    cause : name of the cause; if empty, the name of the input
    n_draws : number of draws, which are the quantiles at evenly spaced probabilities
    seed : seed of the order of the draws, together with name and cause. The order must differ
        between the distributions of a line; different names ensure this

    Raises
    ------
    ValueError
        If the deviation is not positive and finite, or `freedom` is not positive.
    """
    if not (np.isfinite(deviation) and deviation > 0.0 and freedom > 0.0):
        facts = {"name": name, "deviation": deviation, "freedom": freedom}
        raise ValueError(format_sentence("mechanics.rod.bad_deviation", **facts))
    random = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    probability = (random.permutation(n_draws) + 0.5) / n_draws
    quantiles = ndtri(probability) if np.isinf(freedom) else stdtrit(freedom, probability)
    amounts = np.asarray(quantiles, np.float64)[:, None]
    best, steps = np.array([centre]), np.array([[deviation]])
    return InputDistribution((name,), (cause or name,), best, steps, amounts=amounts)


def build_uniform_distribution(
    name: str, low: float, high: float, *, cause: str, n_draws: int = N_DRAWS, seed: int = 0
) -> InputDistribution:
    """Build the uniform distribution of an input in a range.

    Parameters
    ----------
    name : name of the input
    low, high : ends of the range, in the unit of the input
    cause : name of the cause
    n_draws, seed : number and order of the draws, as for `build_t_distribution`
    """
    random = np.random.default_rng([seed, *f"{name} {cause}".encode()])
    amounts = 2.0 * (random.permutation(n_draws) + 0.5) / n_draws - 1.0
    centre, steps = np.array([0.5 * (low + high)]), np.array([[0.5 * (high - low)]])
    return InputDistribution((name,), (cause,), centre, steps, amounts=amounts[:, None])


def build_calibration_distributions(
    solutions: Sequence[Solution],
    widening: float = 1.0,
    *,
    specimen: str | None = None,
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> tuple[InputDistribution, ...]:
    """Build a distribution for each solution in the 95 % set of a calibration.

    Parameters
    ----------
    solutions : solutions of the calibration, the best first
    widening : factor on the deviations of the parameters
    specimen : name of the input that is the logarithm of a factor on all moments, drawn from the
        scatter of samples; None for a line with the law of the mean sample
    n_draws : number of draws, a power of two
    seed : seed of the draws

    Returns
    -------
    Distributions of the logarithms of those `PARAMETERS` that are active in the wire. As in the
    bands of the calibration, the deviations for a less likely solution are multiplied by
    sqrt(1 - rise / limit).
    """
    allowed_solutions = [solution for solution in solutions if solution.is_allowed]
    return tuple(
        _build_solution_distribution(
            solution,
            widening * np.sqrt(1.0 - solution.rise / solution.limit),
            specimen=specimen,
            n_draws=n_draws,
            random=np.random.default_rng([seed, index]),
        )
        for index, solution in enumerate(allowed_solutions)
    )


def _build_solution_distribution(
    solution: Solution,
    widening: float,
    *,
    specimen: str | None,
    n_draws: int,
    random: np.random.Generator,
) -> InputDistribution:
    """Build the distribution of one solution, including the factor of the specimen if any."""
    from scipy.stats.qmc import Sobol  # imports scipy.stats, which takes half a second

    active_indices = np.flatnonzero(np.isfinite(solution.values))
    mixture = solution.mixture
    probability_range = 1.0 - 1e-10  # keeps probabilities away from 0 and 1
    draws = Sobol(3 + len(active_indices), seed=random).random(n_draws)
    # Columns: component of the mixture, divisor of Student's t, specimen, and each parameter.
    probability = 0.5 + probability_range * (draws - 0.5)
    components = np.searchsorted(np.cumsum(mixture.chance), probability[:, 0])
    components = np.minimum(components, len(mixture.chance) - 1)
    divisors = np.ones(n_draws)  # convert normal draws to draws of Student's t
    if np.isfinite(mixture.freedom):
        divisors = np.sqrt(chdtri(mixture.freedom, probability[:, 1]) / mixture.freedom)
    normal_draws = ndtri(probability[:, 2:])
    covariances = mixture.covariance[:, active_indices[:, None], active_indices]
    shifts = mixture.shift[:, active_indices]
    variances, axes = np.linalg.eigh(covariances)
    roots = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    deviations = np.einsum("nij,nj->ni", roots[components], normal_draws[:, 1:]) / divisors[:, None]
    changes = widening * (shifts[components] + deviations)
    covariance = np.einsum("s,sij->ij", mixture.chance, covariances)
    covariance += np.einsum("s,si,sj->ij", mixture.chance, shifts, shifts)
    steps = _compute_steps(covariance)
    distribution = InputDistribution(
        names=tuple(PARAMETERS[index] for index in active_indices),
        causes=(CALIBRATION,) * steps.shape[1],
        centre=np.log(solution.values[active_indices]),
        steps=steps,
        amounts=changes @ np.linalg.pinv(steps).T,
    )
    log_factors = mixture.scatter[components] * normal_draws[:, 0] / divisors
    scatter = float(np.sqrt(mixture.chance @ mixture.scatter**2))
    if specimen is None or scatter == 0.0:
        return distribution
    step = min(scatter, _MAX_LOG_STEP)
    amounts, steps = log_factors[:, None] / step, np.array([[step]])
    factor = InputDistribution((specimen,), (SPECIMEN,), np.zeros(1), steps, amounts=amounts)
    return join_distributions([distribution, factor])


def join_distributions(distributions: Iterable[InputDistribution]) -> InputDistribution:
    """Join independent distributions.

    Parameters
    ----------
    distributions : distributions with equal numbers of draws. For an input that is in several of
        them, changes and best values are added
    """
    parts = tuple(distributions)
    names = tuple(dict.fromkeys(name for part in parts for name in part.names))
    counts = [len(part.causes) for part in parts]
    centre, steps = np.zeros(len(names)), np.zeros((len(names), sum(counts)))
    for part, stop in zip(parts, np.cumsum(counts), strict=True):
        rows = np.array([names.index(name) for name in part.names], dtype=np.int64)
        centre[rows] += part.centre
        steps[rows, stop - len(part.causes) : stop] = part.steps
    causes = tuple(cause for part in parts for cause in part.causes)
    amounts = np.hstack([part.amounts for part in parts])
    return InputDistribution(names, causes, centre, steps, amounts=amounts)


def _compute_steps(covariance: Floats) -> Floats:
    """Compute steps of one standard deviation along the principal axes, as columns.

    Axes without variance are omitted. A step with a component above `_MAX_LOG_STEP` is shortened.
    """
    # `min_variance` is relative to the largest one. `min_component` avoids a division by zero.
    min_variance, min_component = 1e-12, 1e-12
    variances, axes = np.linalg.eigh(covariance)
    has_variance = variances > min_variance * max(float(variances[-1]), 1e-300)
    steps = axes[:, has_variance] * np.sqrt(variances[has_variance])
    largest_component = np.abs(steps).max(axis=0, initial=min_component)
    return np.asarray(steps * np.minimum(1.0, _MAX_LOG_STEP / largest_component))


Fields = Mapping[str, Floats]
"""Fields of a line, arrays of any shape, keyed by name."""
PathSolver = Callable[[Mapping[str, float]], RodPath]
"""Function that builds a line and its boundaries from named inputs, and solves its path."""
TAIL_PROBABILITY = 0.025
"""Probability below the lower end of a band, and above its upper end."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Response of a line to the causes of a distribution.

    Parameters
    ----------
    distribution : distribution of the inputs
    best_fields : fields at the best inputs
    max_amounts : shape (causes,), amount of each cause up to which the parabola holds
    linear_coefficients, quadratic_coefficients : coefficients a and b of each field, shape (causes,
        ...). An amount x of a cause changes the field by a x + b x^2. Beyond `max_amounts`, the
        field changes along the tangent of this parabola
    n_unsolved : shape (causes,), number of signs of the amount without an equilibrium. With one,
        the response is linear through the solution for the other sign. With two, the cause does not
        change the band
    """

    distribution: InputDistribution
    best_fields: Fields
    max_amounts: Floats
    linear_coefficients: Fields
    quadratic_coefficients: Fields
    n_unsolved: Ints

    def list_unsolved_causes(self, n_unsolved: int) -> tuple[str, ...]:
        """List the causes without an equilibrium for one or for two signs of their amount."""
        causes = np.array(self.distribution.causes)[self.n_unsolved == n_unsolved]
        return tuple(dict.fromkeys(causes.tolist()))

    def compute_draws(self, name: str) -> Floats:
        """Compute draws of a field, shape (draws, ...)."""
        best_value = self.best_fields[name]
        all_causes = np.ones(len(self.distribution.causes), dtype=np.bool_)
        changes = self._compute_changes(name, all_causes)
        return np.asarray(best_value + changes.reshape(len(changes), *best_value.shape))

    def _compute_changes(self, name: str, mask: Flags) -> Floats:
        """Compute the changes of a field by selected causes in all draws, shape (draws, values)."""
        amounts, max_amounts = self.distribution.amounts[:, mask], self.max_amounts[mask]
        clipped_amounts = np.clip(amounts, -max_amounts, max_amounts)
        # Beyond `max_amounts`, these values are linear in the amounts.
        squares = clipped_amounts * (2.0 * amounts - clipped_amounts)
        shape = (len(self.distribution.causes), self.best_fields[name].size)
        linear = self.linear_coefficients[name].reshape(shape)[mask]
        quadratic = self.quadratic_coefficients[name].reshape(shape)[mask]
        return np.asarray(amounts @ linear + squares @ quadratic)

    def compute_variance_fractions(self, name: str) -> dict[str, float]:
        """Compute the fraction of the variance of a field that each cause contributes.

        The variance is summed over the values of the field, and over the columns of the
        distribution with the same cause. The fractions are keyed by cause; there are none if the
        field is constant. The standard deviation is half the width of the central 68 % of the
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
    best_fields = solve_fields(distribution.to_inputs())
    if best_fields is None:
        return None
    amounts = np.quantile(np.abs(distribution.amounts), 1.0 - 2.0 * TAIL_PROBABILITY, axis=0)
    amounts = np.clip(amounts, min_amount, max_amount)
    solved_pairs = []  # fields with plus and with minus the amount of each cause
    for row in np.diag(amounts):
        solved_pairs.append([solve_fields(distribution.to_inputs(x)) for x in (row, -row)])
    linear, quadratic = {}, {}
    for name, best_value in best_fields.items():
        linear[name], quadratic[name] = np.zeros((2, len(amounts), *best_value.shape))
        for cause, ((plus, minus), amount) in enumerate(zip(solved_pairs, amounts, strict=True)):
            increments = [] if plus is None else [plus[name] - best_value]
            increments += [] if minus is None else [best_value - minus[name]]
            if increments:  # with one solution only, the quadratic coefficient becomes zero
                linear[name][cause] = 0.5 * (increments[0] + increments[-1]) / amount
                quadratic[name][cause] = 0.5 * (increments[0] - increments[-1]) / amount**2
    n_unsolved = np.array([pair.count(None) for pair in solved_pairs])
    coefficients = {"linear_coefficients": linear, "quadratic_coefficients": quadratic}
    return Response(distribution, best_fields, amounts, **coefficients, n_unsolved=n_unsolved)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Number or array with its pointwise 95 % band.

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
        (measure(response.best_fields[name]), measure(response.compute_draws(name)))
        for response in responses
    )


def join_bands(values_and_draws: Iterable[tuple[Floats, Floats]]) -> Band:
    """Compute the envelope of the pointwise 95 % bands of several distributions.

    Parameters
    ----------
    values_and_draws : value, shape (...), and draws, shape (draws, ...), for each distribution, the
        best first

    Returns
    -------
    The band from the lowest lower end to the highest upper end of the bands of all distributions.
    The band of a distribution is extended to its value.
    """
    values, lower_ends, upper_ends = [], [], []
    for value, draws in values_and_draws:
        lower, upper = np.quantile(draws, [TAIL_PROBABILITY, 1.0 - TAIL_PROBABILITY], axis=0)
        values.append(value)
        lower_ends.append(np.minimum(lower, value))
        upper_ends.append(np.maximum(upper, value))
    return Band(values[0], np.min(lower_ends, axis=0), np.max(upper_ends, axis=0))


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
    variance_fractions : fraction of the variance, summed along the line, that each cause of the
        best distribution contributes, keyed by ``positions``, ``reaction_forces`` and
        ``smallest_bend_radius``, then by cause. The fractions of ``smallest_bend_radius`` are those
        of the curvature vectors of the whole line
    """

    step: int
    positions: Band
    curvature: Band
    smallest_bend_radius: Band
    reaction_forces: Band
    reaction_moments: Band
    variance_fractions: Mapping[str, Mapping[str, float]]


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


_STEP_FIELDS = ("positions", "reaction_forces", "reaction_moments", "curvature_vectors")
"""Attributes of `RodState` whose bands are computed."""


def collect_step_fields(path: RodPath) -> dict[str, Floats]:
    """Collect the fields of all steps, keyed by name and index of the step, such as `positions 3`.

    Parameters
    ----------
    path : path of the line
    """
    return {
        f"{name} {step}": getattr(state, name)
        for step, state in enumerate(path.states)
        for name in _STEP_FIELDS
    }


def predict_line_bands(
    solvers: Sequence[PathSolver],
    distributions: Sequence[InputDistribution],
    *,
    steps: Sequence[int] = (-1,),
    tested_curvature: float = np.inf,
    collect: Callable[[RodPath], Fields] = collect_step_fields,
) -> LineBands | None:
    """Predict a line with pointwise 95 % bands.

    Parameters
    ----------
    solvers : for each distribution, a function that solves the line for inputs. Each solution of a
        calibration has its own slip curvatures. A function is called 1 + 2 x causes times
    distributions : distributions of the inputs, one for each solution of a calibration, the best
        first
    steps : indices of the steps for which bands are computed; negative indices count from the end
    tested_curvature : 1/m, largest curvature in the tests of the calibration
    collect : function that returns the fields of a path: those of `collect_step_fields`, and others
        for `LineBands.responses`

    Returns
    -------
    The envelope of the bands of all distributions; None if the line cannot be solved for the best
    inputs of a distribution. The notes are ``beyond_tested`` if the line is bent beyond the tests,
    ``one_sided`` if the line has no equilibrium for one sign of the amount of a cause, ``silent``
    if it has none for either sign, so that the band excludes the cause, and ``jumps`` if changed
    inputs make the line jump at other steps than the best inputs do.

    Raises
    ------
    ValueError
        If there is no distribution.
    """
    if not distributions:
        raise ValueError(format_sentence("mechanics.rod.no_distribution"))
    paths_by_distribution: list[list[RodPath]] = [[] for _ in solvers]

    def solve_fields(index: int, inputs: Mapping[str, float]) -> Fields | None:
        """Solve the line with the solver of a distribution; collect the path and its fields."""
        path = solvers[index](inputs)
        if path.status is Status.FAILED:
            return None
        paths_by_distribution[index].append(path)
        return collect(path)

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
    node_key, force_key, moment_key, bend_key = (f"{name} {step}" for name in _STEP_FIELDS)
    keys = {"positions": node_key, "reaction_forces": force_key, "smallest_bend_radius": bend_key}
    compute_fractions = responses[0].compute_variance_fractions
    return StateBands(
        step=step,
        positions=compute_band(responses, node_key),
        curvature=compute_band(responses, bend_key, compute_node_curvature),
        smallest_bend_radius=compute_band(responses, bend_key, _compute_smallest_radius),
        reaction_forces=compute_band(responses, force_key),
        reaction_moments=compute_band(responses, moment_key),
        variance_fractions={name: compute_fractions(key) for name, key in keys.items()},
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

    def join_causes(n_unsolved: int) -> str:
        causes = chain.from_iterable(item.list_unsolved_causes(n_unsolved) for item in responses)
        return ", ".join(dict.fromkeys(causes))

    if names := join_causes(1):
        yield QualityNote.of("mechanics.rod.one_sided", names, causes=names)
    if names := join_causes(2):
        yield QualityNote.of("mechanics.rod.silent", names, causes=names)


def _find_jump_notes(path_groups: Sequence[Sequence[RodPath]]) -> Iterator[QualityNote]:
    """Yield a note if the line jumps at other steps for changed inputs than for the best inputs.

    Each group has the paths of one distribution, that of the best inputs first. Jumps at step 0 are
    ignored.
    """
    for paths in path_groups:
        jumps = [", ".join(str(step) for step in path.jump_steps if step > 0) for path in paths]
        if changed_texts := [text for text in jumps if text != jumps[0]]:
            steps, other = jumps[0] or "none", changed_texts[0] or "none"
            yield QualityNote.of("mechanics.rod.jumps", "", steps=steps, other=other)
            return
