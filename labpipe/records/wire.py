"""Define the records of wires: specification, layout, table of the wire model, and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Reason

AUTO = "auto"
"""Choice of the layout: a hexagon if it fits, else rings if they fit, else a packing."""

LAYOUTS = (AUTO, "hexagonal", "concentric", "packed", "compressed")
"""Layouts in a wire sheet."""


@dataclass(frozen=True, slots=True)
class WireSpec:
    """One row of a wire sheet, in SI units; defaults apply to missing columns.

    Parameters
    ----------
    name : name of the wire
    wire_diameter : over the insulation, m
    layer_counts : strands of each layer from the axis outwards, 1 for a core
    strand_diameters : m, of the strands of each layer; for compressed strands the diameter of a
        circle of equal area
    lay_angles : rad, signed, one per ring (the core has none)
    insulation_thickness : wall, m
    insulation_modulus, conductor_modulus : Pa
    poisson, insulation_poisson : Poisson's ratios of the strands and of the insulation
    copper_k : strength of the Ramberg-Osgood curve, Pa
    copper_n : its exponent
    isotropic_share : share of the strands' hardening that is isotropic, from 0 to 1; None if it is
        not known
    stress_table : strains and stresses (Pa) that replace the Ramberg-Osgood curve
    insulation_table : strains and stresses (Pa) that replace the modulus of the insulation
    insulation_strain : strain at the rim of the wire up to which the insulation is linear
    friction_strand : coefficient of friction between strands
    friction_insulation : coefficient of friction between the outermost ring and the insulation
    radial_force : force of the insulation on a strand of the outermost ring, N per radian of its
        lay
    layout : one of `LAYOUTS`
    layer_radii : m, of the centroids of the strands in compressed layers; None if unknown
    mass_per_length : kg/m; None to compute it from section and densities
    conductor_density, insulation_density : kg/m^3
    length : free length of the cantilever, m
    tension : tension of the wire, N
    orientation : orientation of the section against the neutral axis, rad
    largest_curvature : 1/m, end of the tables; None for a bending radius of five wire diameters
    defaults : description of each default that was used, by field
    place : place of the row, for messages, such as ``sheet 'wires', row 4``
    """

    name: str
    wire_diameter: float
    layer_counts: tuple[int, ...]
    strand_diameters: tuple[float, ...]
    lay_angles: tuple[float, ...]
    insulation_thickness: float
    insulation_modulus: float = 1.0e9
    conductor_modulus: float = 110.0e9
    poisson: float = 0.34
    insulation_poisson: float = 0.4
    copper_k: float = 530.0e6
    copper_n: float = 0.44
    isotropic_share: float | None = None
    stress_table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    insulation_table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    insulation_strain: float = 0.03
    friction_strand: float = 0.21
    friction_insulation: float = 0.10
    radial_force: float = 0.15
    layout: str = AUTO
    layer_radii: tuple[float, ...] | None = None
    mass_per_length: float | None = None
    conductor_density: float = 8960.0
    insulation_density: float = 1400.0
    length: float = 85.0e-3
    tension: float = 0.0
    orientation: float = 0.0
    largest_curvature: float | None = None
    defaults: Mapping[str, str] = field(default_factory=dict)
    place: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class WireLayout(ArrayRecord):
    """Positions of the strands; arrays of shape (strands,).

    Parameters
    ----------
    kind : name of the layout
    x, y : m, strand centres
    layer : index of the layer, 0 for the innermost
    diameter : m, of each strand
    bore_radius, wire_radius : m, inner and outer radius of the insulation
    """

    kind: str
    x: Vector
    y: Vector
    layer: Annotated[Ints, "n"]
    diameter: Vector
    bore_radius: float
    wire_radius: float


@dataclass(frozen=True, slots=True)
class WireAtRest:
    """State of a cantilever under its own weight with its tip held level.

    Parameters
    ----------
    force : N, at the tip; removed by the zero of a load cell
    moment : N m, at the clamp; negative: it bends the wire away from the pull
    curvature : 1/m, at the clamp
    sag : m, lowest point below the axis
    """

    force: float
    moment: float
    curvature: float
    sag: float


@dataclass(frozen=True, slots=True, eq=False)
class WireTable(ArrayRecord):
    """The law of a wire on first loading, and its stiffnesses; arrays of shape (n,).

    Parameters
    ----------
    name : name of the wire
    spec : specification
    layout : positions of the strands
    curvature : 1/m, from 0, increasing, to the end of the range
    moment : N m, sum of the five parts
    stick, slip, bending, plastic, insulation : N m, parts of the moment
    tangent_stiffness, secant_stiffness : N m^2
    stick_stiffness, slip_stiffness : N m^2
    axial_stiffness : EA, N, at zero twist
    torsional_stiffness : GJ, N m^2, at zero axial strain
    free_torsional_stiffness : N m^2, at zero axial force: GJ - C^2 / EA
    stretch_twist_coupling : C, N m: torque per strain, and axial force per twist in rad/m
    slip_onsets : 1/m, curvatures at which strands begin to slip, increasing; the first is 0 if
        strands slip as soon as the wire bends
    lowest_moment, highest_moment : N m, over all orientations of the section
    tip_deflection, tip_force : shape (m,), m and N, of the cantilever of `spec.length` under an
        end load normal to the clamped axis, both from rest
    mass_per_length : kg/m
    rest : state of that cantilever at rest; None if its weight is neglected
    doubtful_curvature, doubtful_deflection : 1/m and m, beyond which the strain at the rim exceeds
        `spec.insulation_strain`; infinite for a stress table
    notes : on defaults and limits
    """

    name: str
    spec: WireSpec
    layout: WireLayout
    curvature: Vector
    moment: Vector
    stick: Vector
    slip: Vector
    bending: Vector
    plastic: Vector
    insulation: Vector
    tangent_stiffness: Vector
    secant_stiffness: Vector
    stick_stiffness: float
    slip_stiffness: float
    axial_stiffness: float
    torsional_stiffness: float
    free_torsional_stiffness: float
    stretch_twist_coupling: float
    slip_onsets: Annotated[Floats, "onsets"]
    lowest_moment: Vector
    highest_moment: Vector
    tip_deflection: Annotated[Floats, "points"]
    tip_force: Annotated[Floats, "points"]
    mass_per_length: float
    rest: WireAtRest | None
    doubtful_curvature: float
    doubtful_deflection: float
    notes: tuple[QualityNote, ...] = ()

    @property
    def is_doubtful(self) -> Flags:
        """Return whether each curvature is beyond `doubtful_curvature`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature)

    @property
    def insulation_share(self) -> Floats:
        """Return the share of the insulation in the moment, shape (n,).

        At zero moment it is that of the second curvature.
        """
        is_zero = self.moment == 0.0
        share = self.insulation / np.where(is_zero, 1.0, self.moment)
        return np.asarray(np.where(is_zero, share[1], share))

    @property
    def slips_at_once(self) -> bool:
        """Return whether strands slip as soon as the wire bends, without stick stiffness.

        The first secant of the table is then the slope of the law at zero curvature.
        """
        return bool(np.any(self.slip_onsets == 0.0))

    def slip_onset(self, which: int) -> float | str:
        """Return the curvature at which strands begin to slip, or a word if there is none.

        Parameters
        ----------
        which : 0 for the first onset, -1 for the last

        Returns
        -------
        1/m; ``at once`` if strands slip as soon as the wire bends, ``beyond`` if none slips within
        the range, ``none`` for a single strand.
        """
        if len(self.layout.layer) == 1:
            return "none"
        onsets = self.slip_onsets[self.slip_onsets <= self.curvature[-1]]
        if not len(onsets):
            return "beyond"
        return float(onsets[which]) or "at once"


@dataclass(frozen=True, slots=True, eq=False)
class CurveAgreement(ArrayRecord):
    """One measured curve against the model.

    Parameters
    ----------
    test, sample : names
    length : m
    deflection, force, model : shape (n,), m, N, N; the model without `sample_factor`
    sample_factor : factor of this sample and load cell on the force of the model
    sse, rmse, rmse_share : of force - model: N^2, N, and RMSE over the largest force
    lag_one_correlation : of the residuals over the noise, with `sample_factor` on the model
    runs_p : p-value of the runs test of these residuals; small if signs rarely change
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


@dataclass(frozen=True, slots=True)
class IsotropicShare:
    """The share of isotropic hardening, from residual deflections and peaks of cyclic tests.

    Parameters
    ----------
    value, interval : least-squares value, with its 95 % interval within 0 and 1
    by_number : 95 % interval by the residual deflection alone and by the peaks alone
    n_tests : number of tests with cycles
    is_creep : whether these two disagree, so that the share is not calibrated
    """

    value: float
    interval: Interval
    by_number: Mapping[str, Interval]
    n_tests: int
    is_creep: bool


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(ArrayRecord):
    """A predicted loading curve, with 95 % bands; arrays of shape (n,).

    Parameters
    ----------
    deflection, force : m, N
    lower, upper : N, pointwise band of the curve of one more sample, with noise
    lower_mean, upper_mean : N, band of the curve of the mean sample, without noise
    notes : on causes that the bands do not include
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
    """Errors of a model against measured forces: a row of Table 3.3 of the dissertation.

    Parameters
    ----------
    n : points
    sse : N^2
    rmse : N
    rmse_share : RMSE over the largest measured force
    inside : share of the points inside the band; NaN without a band
    """

    n: int
    sse: float
    rmse: float
    rmse_share: float
    inside: float


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurve(ArrayRecord):
    """A loading curve from another source: finite elements, a paper, another lab.

    Parameters
    ----------
    name : name in the plan
    file : file in the plan
    wire : name of the wire
    length : free length, m
    deflection : shape (n,), m, of the tip, rising
    force : shape (n,), N
    is_normal : whether the load stays normal to the undeformed axis; else it is applied as in the
        tests
    source : description of the source
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
    """Comparison of an external curve with another curve at the deflections of the external one.

    Parameters
    ----------
    reference : shape (n,), N, force of the other curve; NaN where it has none
    errors : over the common points, relative to the largest force of the other curve and its 95 %
        band; None without common points
    left_out : number of points that were not compared
    explanation : why points were not compared; empty if all were
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
    curve : external curve
    tests : match with the mean of the tests of that wire and length; None without tests
    model : match with the model
    prediction : curve of the model over the range of curve and tests; None if it has none
    notes : on points that were not compared
    """

    curve: ExternalCurve
    tests: CurveMatch | None
    model: CurveMatch
    prediction: Prediction | None
    notes: tuple[QualityNote, ...] = ()


RADIAL_FRICTION = "radial_friction"
"""phi = F_rad (mu_s + mu_p), N: the only effect of friction on a loading curve."""
INSULATION_MODULUS = "insulation_modulus"
"""E_ins, Pa."""
COPPER_SCALE = "copper_scale"
"""Factor on the strength of the copper in its stress-strain curve."""

PARAMETERS = (RADIAL_FRICTION, INSULATION_MODULUS, COPPER_SCALE)
"""Calibrated parameters, in the order of every array over parameters."""
UNITS = {RADIAL_FRICTION: "N", INSULATION_MODULUS: "Pa", COPPER_SCALE: "1"}
DISPLAYED = {
    RADIAL_FRICTION: (1e3, "mN"),
    INSULATION_MODULUS: (1e-6, "MPa"),
    COPPER_SCALE: (1.0, ""),
}
"""Factor and unit for display."""


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """Settings of one parameter in a calibration.

    Parameters
    ----------
    value : start of the search, value of a fixed parameter, or centre of a prior; None for the
        value in the wire sheet
    is_fixed : whether it is not fitted
    factor : factor of a log-normal prior: with 95 % probability the parameter lies between
        value / factor and value x factor. None without a prior
    lower, upper : bounds of the search; None for the default ones
    source : source of a prior or a fixed value, for the report
    """

    value: float | None = None
    is_fixed: bool = False
    factor: float | None = None
    lower: float | None = None
    upper: float | None = None
    source: str = ""


class Identifiability(StrEnum):
    """Identifiability of a parameter by the tests."""

    WELL = "identified"
    """The 95 % interval, and all that the tests allow at 99 %, span less than a factor of two."""
    WEAKLY = "weakly identified"
    """They span more; the 95 % interval is bounded on both sides, and no other verdict applies."""
    TWO = "two solutions"
    """The 95 % interval has parts that belong to different solutions; or the tests allow a solution
    outside of it at 99 %."""
    NOT = "not identified"
    """The 95 % interval is unbounded on a side, or spans more than a factor of a hundred."""
    BY_PRIOR = "known from its prior"
    """The tests add hardly any information to the prior."""
    AGAINST_PRIOR = "contradicts its prior"
    """Prior and tests have different values; the calibrated one lies between them."""
    AT_BOUND = "at its bound"
    """The search ended at a bound."""
    FIXED = "fixed"
    """It was not fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile(ArrayRecord):
    """Profile of the objective along one parameter, traced from one solution.

    Parameters
    ----------
    value : shape (n,), of the parameter, increasing
    deviance : shape (n,), rise of the objective over its minimum, with all other parameters fitted
        again
    threshold_below, threshold_above : deviance at the lower and the upper end of the 95 % interval:
        the square of a quantile of t, averaged over the possible scatters of samples
    """

    value: Vector
    deviance: Vector
    threshold_below: float
    threshold_above: float


@dataclass(frozen=True, slots=True)
class PriorConflict:
    """Comparison of a prior with the tests alone.

    Parameters
    ----------
    centre, factor, source : fields of the prior
    alone : value from the tests without this prior
    size : difference of the two in combined standard deviations
    freedom : degrees of freedom of that standard deviation
    contradicts : whether `size` exceeds the two-sided 95 % quantile of t
    message : sentence with the numbers
    """

    centre: float
    factor: float
    alone: float
    size: float
    freedom: float
    contradicts: bool = False
    message: str = ""
    source: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedParameter:
    """One calibrated parameter of the wire.

    Parameters
    ----------
    name, unit : one of `PARAMETERS`
    value : value at the minimum of the objective; NaN if it does not act on the wire
    intervals : 95 %, by profile likelihood: union of the intervals of all solutions, in rising
        order. An open interval ends at the bound of the search. Empty if it was not fitted
    log_error : standard error of its logarithm at the minimum of the objective; 0 if not fitted
    freedom : degrees of freedom of that error
    is_open_below, is_open_above : whether the tests do not bound it on that side
    at_bound : ``lower``, ``upper``, or empty
    verdict : identifiability
    explanation : sentence on the verdict
    profiles : profiles of the solutions with a part of the interval, the best first; empty if the
        parameter was not fitted
    conflict : None without a prior
    source : source of a fixed value; empty for a fitted one
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
        """Return the interval from the lowest to the highest end; None if it was not fitted."""
        if not self.intervals:
            return None
        return Interval(self.intervals[0].lower, self.intervals[-1].upper)


@dataclass(frozen=True, slots=True, eq=False)
class Separability(ArrayRecord):
    """Separability of several parameters by the tests.

    Parameters
    ----------
    names : names of the parameters
    singular_values : shape (n,), decreasing, of the derivatives of all forces by the logarithms of
        the parameters, divided by the noise: a combination with singular value s has a standard
        error of 1 / s
    combinations : shape (n, n), weights of the logarithms, one row per singular value
    are_identified : whether each parameter is identified, by name
    explanation : one or two sentences
    """

    names: tuple[str, ...]
    singular_values: Annotated[Floats, "names"]
    combinations: Annotated[Floats, "names", "names"]
    are_identified: Mapping[str, bool]
    explanation: str


@dataclass(frozen=True, slots=True, eq=False)
class ScatterMixture(ArrayRecord):
    """Fits of the parameters for each scatter of samples that the tests allow.

    Parameters
    ----------
    chance : shape (scatters,), probability of each scatter, with sum 1
    scatter : shape (scatters,), standard deviation of the logarithms of the sample factors
    shift : shape (scatters, 4), change of the logarithms of parameters and gain from the best fit
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
    """A local minimum of the objective that the tests allow at 99 %.

    Parameters
    ----------
    values : shape (3,), of `PARAMETERS`; NaN for a parameter that the wire does not have
    rise : rise of the objective over the best solution; exp(-rise / 2) is the likelihood ratio
    rmse : N, over all curves
    covariance : shape (4, 4), of the logarithms of the parameters and of the gain of the load cell;
        0 for fixed ones
    mixture : fits for each scatter of samples that the tests allow
    limit : rise below which a solution is in the 95 % set
    """

    values: Annotated[Floats, 3]
    rise: float
    rmse: float
    covariance: Annotated[Floats, 4, 4]
    mixture: ScatterMixture
    limit: float

    @property
    def is_allowed(self) -> bool:
        """Return whether it is in the 95 % set, which intervals and bands include."""
        return self.rise < self.limit

    @property
    def likelihood(self) -> float:
        """Return the ratio of its likelihood to that of the best solution."""
        return float(np.exp(-0.5 * self.rise))


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """Noise and scatter about the model.

    Parameters
    ----------
    noise_factor : estimated over stated noise of a point
    correlation : correlation of neighbouring points
    scatter : standard deviation of the logarithms of the sample factors on the force
    gain : relative standard uncertainty of the gain of the load cell, common to all curves
    scatter_freedom : degrees of freedom of `scatter`; infinite if it was stated, 0 if unknown
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
    """The calibration of a wire by its tests.

    Parameters
    ----------
    wire : name
    parameters : parameters in the order of `PARAMETERS`
    solutions : local minima of the objective that the tests allow at 99 %, the best first
    widening : factor on quantiles, at least 1, since the objective has a curved valley along which
        insulation and copper compensate each other
    correlations : shape (3, 3), of the logarithms at the best solution; NaN in rows of fixed
        parameters
    levels : noise, scatter, gain
    separability : separability of the three parameters, as if all were free
    curves : compared curves
    n_points, n_samples : numbers of points and of samples of the calibration
    sse, rmse, rmse_share : over all curves: N^2, N, and RMSE over the largest force
    method : description for the report
    notes : quality notes
    share : isotropic share of the hardening; None where no test has cycles
    """

    wire: str
    parameters: tuple[CalibratedParameter, ...]
    solutions: tuple[Solution, ...]
    widening: float
    correlations: Annotated[Floats, 3, 3]
    levels: NoiseLevels
    separability: Separability
    curves: tuple[CurveAgreement, ...]
    n_points: int
    n_samples: int
    sse: float
    rmse: float
    rmse_share: float
    method: str
    notes: tuple[QualityNote, ...] = field(default=())
    share: IsotropicShare | None = None

    def parameter(self, name: str) -> CalibratedParameter:
        """Return the parameter of a name."""
        return self.parameters[PARAMETERS.index(name)]


@dataclass(frozen=True, slots=True)
class CalibrationFailure(Reason):
    """Reason why there is no calibration."""
