"""Records of a calibrated wire model: curves compared, parameters, samples, verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats, Vector
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Reason


@dataclass(frozen=True, slots=True, eq=False)
class CurveAgreement(ArrayRecord):
    """One measured curve against the model.

    Parameters
    ----------
    test, sample : names
    length : m
    deflection, force, model : shape (n,), m, N, N; the model without the sample's own factor
    sample_factor : of this sample on the force of the model, load cell included
    sse, rmse, rmse_share : of force - model: N^2, N, and RMSE over the largest force
    lag_one : correlation of neighbouring residuals, the sample's factor taken out
    runs_p : p-value of the runs test of the same residuals: small where their signs stay
    """

    test: str
    sample: str
    length: float
    deflection: Vector
    force: Vector
    model: Vector
    sample_factor: float
    sse: float
    rmse: float
    rmse_share: float
    lag_one_correlation: float
    runs_p: float


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(ArrayRecord):
    """A predicted loading curve, with 95 % bands; arrays of shape (n,).

    Parameters
    ----------
    deflection, force : m, N
    lower, upper : N, band of the curve of one more sample, point by point, noise included
    lower_mean, upper_mean : N, band of the curve of the mean sample, without noise
    notes : what the bands leave out
    """

    deflection: Vector
    force: Vector
    lower: Vector
    upper: Vector
    lower_mean: Vector
    upper_mean: Vector
    notes: tuple[QualityNote, ...] = ()


@dataclass(frozen=True, slots=True)
class CurveErrors:
    """A model against measured forces: a row of the dissertation's Table 3.3.

    Parameters
    ----------
    n : points
    sse : N^2
    rmse : N
    rmse_share : RMSE over the largest measured force
    inside : share of the points inside the band; NaN without one
    """

    n: int
    sse: float
    rmse: float
    rmse_share: float
    inside: float


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurve(ArrayRecord):
    """A loading curve that is neither test nor model: finite elements, a paper, another lab.

    Parameters
    ----------
    name : as the plan calls it
    file : as the plan names it
    wire : name of the wire
    length : free length, m
    deflection : shape (n,), m, of the tip, rising
    force : shape (n,), N
    is_normal : its load stays normal to the undeformed axis; else it is pulled as the tests are
    source : where it comes from, in words
    """

    name: str
    file: str
    wire: str
    length: float
    deflection: Vector
    force: Vector
    is_normal: bool = False
    source: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CurveMatch(ArrayRecord):
    """An external curve beside one other curve, at its own deflections.

    Parameters
    ----------
    reference : shape (n,), N, of the other curve; NaN where that one has no force
    errors : over the points that both have, RMSE over the largest force of the other curve there,
        share of its points inside the 95 % band of the other; None without any
    left_out : number of points that were not compared
    explanation : which points were left out, or why none was compared; empty if all were
    """

    reference: Vector
    errors: CurveErrors | None
    left_out: int = 0
    explanation: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurveComparison:
    """An external curve compared with the mean of the tests and with the calibrated model.

    Parameters
    ----------
    curve : from elsewhere
    tests : beside the mean of the tests of that wire and length; None where there are none
    model : beside the model
    prediction : the model as far as the curve and the tests go; None where it has none
    notes : what was not compared, and why
    """

    curve: ExternalCurve
    tests: CurveMatch | None
    model: CurveMatch
    prediction: Prediction | None
    notes: tuple[QualityNote, ...] = ()


RADIAL_FRICTION = "radial_friction"
"""phi = F_rad (mu_s + mu_p), N: all that a loading curve knows of friction."""
INSULATION_MODULUS = "insulation_modulus"
"""E_ins, Pa."""
COPPER_SCALE = "copper_scale"
"""Factor on the strength of the copper's stress-strain curve."""

PARAMETERS = (RADIAL_FRICTION, INSULATION_MODULUS, COPPER_SCALE)
"""What is calibrated, in the order of every array over parameters."""
UNITS = {RADIAL_FRICTION: "N", INSULATION_MODULUS: "Pa", COPPER_SCALE: "1"}
DISPLAYED = {
    RADIAL_FRICTION: (1e3, "mN"),
    INSULATION_MODULUS: (1e-6, "MPa"),
    COPPER_SCALE: (1.0, ""),
}
"""Factor and unit in which people see a value."""


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """How one parameter enters a calibration.

    Parameters
    ----------
    value : where the search starts; of a fixed one its value, of one with a prior its centre. None
        for the value that the wire came with
    is_fixed : not fitted
    factor : of a log-normal prior: with 95 % probability the parameter lies between value / factor
        and value x factor. None without a prior
    lower, upper : bounds of the search
    source : where a prior or a fixed value comes from, for the report
    """

    value: float | None = None
    is_fixed: bool = False
    factor: float | None = None
    lower: float | None = None
    upper: float | None = None
    source: str = ""


class Identifiability(StrEnum):
    """What the tests say of a parameter."""

    WELL = "identified"
    """The 95 % interval spans less than a factor of two."""
    WEAKLY = "weakly identified"
    """It has both ends, and spans more."""
    TWO = "two solutions"
    """It spans more, and falls into parts that belong to solutions of their own; or there is a
    solution elsewhere that the tests allow at 99 %."""
    NOT = "not identified"
    """It is open on a side, or spans more than a factor of a hundred."""
    BY_PRIOR = "known from its prior"
    """The tests add next to nothing to what the prior says."""
    AGAINST_PRIOR = "contradicts its prior"
    """Prior and tests ask for different values; the one found lies between them."""
    AT_BOUND = "at its bound"
    """The search wanted to go beyond what it was allowed."""
    FIXED = "fixed"
    """It was not fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile(ArrayRecord):
    """Profile of the objective along one parameter, traced from one solution.

    Parameters
    ----------
    value : shape (n,), of the parameter, increasing
    deviance : shape (n,), rise of the objective over the least of all solutions, all others fitted
        again
    threshold_below, threshold_above : of the deviance, at the lower and the upper end of the 95 %
        interval: the square of a quantile of t, averaged over what the scatter of samples may be
    """

    value: Vector
    deviance: Vector
    threshold_below: float
    threshold_above: float


@dataclass(frozen=True, slots=True)
class PriorConflict:
    """A prior against the tests without it.

    Parameters
    ----------
    centre, factor, source : of the prior, and where it comes from
    alone : value that the tests give without this prior
    size : distance of the two in standard deviations of both together
    freedom : degrees of freedom of that standard deviation
    contradicts : whether `size` exceeds the two-sided 95 % quantile of t
    message : in words, with the numbers
    """

    centre: float
    factor: float
    alone: float
    size: float
    freedom: float
    contradicts: bool
    message: str
    source: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedParameter:
    """One parameter of the wire, and what the tests say of it.

    Parameters
    ----------
    name, unit : one of `PARAMETERS`
    value : at the least of the objective
    intervals : 95 %, by profile likelihood: the union of those of all solutions, rising; more than
        one where it falls apart. Ends are those of the search where it is open. None for a fixed
        parameter
    log_error : standard error of its logarithm at the least of the objective; 0 if fixed
    freedom : degrees of freedom of that error
    is_open_below, is_open_above : the tests do not bound it on that side
    at_bound : ``lower``, ``upper``, or empty
    verdict : in one word or two
    explanation : the verdict as a sentence
    profiles : one of each solution whose part of the interval is not empty, the best first; none
        for a fixed parameter
    conflict : None without a prior
    source : where a fixed value comes from; empty for what was fitted
    """

    name: str
    unit: str
    value: float
    intervals: tuple[Interval, ...] = ()
    log_error: float = 0.0
    freedom: float = np.inf
    is_open_below: bool = False
    is_open_above: bool = False
    at_bound: str = ""
    verdict: Identifiability = Identifiability.FIXED
    explanation: str = ""
    profiles: tuple[Profile, ...] = ()
    conflict: PriorConflict | None = None
    source: str = ""

    @property
    def interval(self) -> Interval | None:
        """Return the interval from the lowest to the highest end; None for a fixed parameter."""
        if not self.intervals:
            return None
        return Interval(self.intervals[0].lower, self.intervals[-1].upper)


@dataclass(frozen=True, slots=True, eq=False)
class Separability(ArrayRecord):
    """Whether the tests separate several numbers.

    Parameters
    ----------
    names : of the numbers
    singular_values : shape (n,), of the derivatives of all forces by their logarithms over the
        noise, falling: a combination with singular value s is known to 1 / s (in logarithms)
    combinations : shape (n, n), a row for each singular value: weights of the logarithms
    are_identified : by name
    explanation : in a sentence or two
    """

    names: tuple[str, ...]
    singular_values: Annotated[Floats, "names"]
    combinations: Annotated[Floats, "names", "names"]
    are_identified: Mapping[str, bool]
    explanation: str


@dataclass(frozen=True, slots=True, eq=False)
class ScatterMixture(ArrayRecord):
    """What is known of the parameters for each scatter of samples that the tests allow.

    Parameters
    ----------
    chance : shape (scatters,), sum to 1
    scatter : shape (scatters,), standard deviation of the samples' factors, in logarithms
    shift : shape (scatters, 4), of the logarithms of the parameters and of the gain, from the fit
    covariance : shape (scatters, 4, 4)
    freedom : degrees of freedom of the noise
    """

    chance: Vector
    scatter: Vector
    shift: Annotated[Floats, "n", 4]
    covariance: Annotated[Floats, "n", 4, 4]
    freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class Solution(ArrayRecord):
    """A least of the objective that the tests allow at 99 %: the best one, or another valley.

    Parameters
    ----------
    values : shape (3,), of `PARAMETERS`; NaN where the wire has no such thing
    rise : of the objective over that of the best; exp(-rise / 2) is its likelihood over the best's
    rmse : N, over all curves
    covariance : shape (4, 4), of the logarithms and of the load cell's gain, last; 0 for what is
        fixed
    mixture : the same for each scatter of samples that the tests allow
    limit : of the rise, below which a solution is in the 95 % set
    """

    values: Annotated[Floats, 3]
    rise: float
    rmse: float
    covariance: Annotated[Floats, 4, 4]
    mixture: ScatterMixture
    limit: float

    @property
    def is_allowed(self) -> bool:
        """Return whether it is in the 95 % set: intervals and bands take it in."""
        return self.rise < self.limit

    @property
    def likelihood(self) -> float:
        """Return the likelihood over that of the best solution."""
        return float(np.exp(-0.5 * self.rise))


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """What scatters about the model.

    Parameters
    ----------
    noise_factor : of the noise of every point, found over stated: 1 where it was stated well
    correlation : of neighbouring points
    scatter : standard deviation of the samples' factors on the force, in logarithms
    gain : standard uncertainty of the load cell's gain, common to all curves, in logarithms
    scatter_freedom : degrees of freedom of `scatter`; infinite where it was given, 0 where nothing
        is known of it
    noise_freedom : degrees of freedom of `noise_factor`
    """

    noise_factor: float
    correlation: float
    scatter: float
    gain: float
    scatter_freedom: float
    noise_freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(ArrayRecord):
    """What tests of one wire say of its parameters.

    Parameters
    ----------
    wire : name
    parameters : in the order of `PARAMETERS`
    solutions : every least of the objective that is not quite unlikely, the best first
    widening : of quantiles, at least 1, since insulation and copper trade places on a bent line
        of curves
    correlations : shape (3, 3), of the logarithms at the best; NaN in rows of fixed parameters
    levels : noise, scatter, gain
    separability : of the three parameters, all taken as free
    friction_separability : of mu_s, mu_p and F_rad; None where nothing rubs
    curves : one by one
    n_points, n_samples : what it rests on
    sse, rmse, rmse_share : over all curves: N^2, N, and RMSE over the largest force
    method : in words
    notes : what a careful person would want to know
    """

    wire: str
    parameters: tuple[CalibratedParameter, ...]
    solutions: tuple[Solution, ...]
    widening: float
    correlations: Annotated[Floats, 3, 3]
    levels: NoiseLevels
    separability: Separability
    friction_separability: Separability | None
    curves: tuple[CurveAgreement, ...]
    n_points: int
    n_samples: int
    sse: float
    rmse: float
    rmse_share: float
    method: str
    notes: tuple[QualityNote, ...] = field(default=())

    def parameter(self, name: str) -> CalibratedParameter:
        """Return the parameter of a name."""
        return self.parameters[PARAMETERS.index(name)]


@dataclass(frozen=True, slots=True)
class CalibrationFailure(Reason):
    """Why there is no calibration."""
