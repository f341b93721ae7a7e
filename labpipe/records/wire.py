"""Define the records of wires: specification, layout, table of the model, calibration, curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Reason

AUTO_LAYOUT = "auto"
"""Name for a layout that labpipe chooses: hexagonal, else concentric, else packed."""

LAYOUTS = (AUTO_LAYOUT, "hexagonal", "concentric", "packed", "compressed")
"""Names of the layouts in a wire sheet."""


@dataclass(frozen=True, slots=True)
class WireSpec:
    """Specification of a wire, a row of a wire sheet; blank cells have defaults.

    Parameters
    ----------
    name : name of the wire
    wire_diameter : outer diameter of the insulation, m
    layer_counts : number of strands of each layer, from the axis outwards; a core has one strand
    strand_diameters : diameter of the strands of each layer, m; for compressed strands the diameter
        of a circle of equal area
    lay_angles : lay angle of each layer except the core, rad; layers of opposite hand have opposite
        signs
    insulation_thickness : wall thickness of the insulation, m
    insulation_modulus, conductor_modulus : elastic moduli, Pa
    poisson, insulation_poisson : Poisson's ratios of the strands and of the insulation
    copper_k : strength of the Ramberg-Osgood curve, Pa
    copper_n : exponent of the Ramberg-Osgood curve
    isotropic_share : fraction of the hardening of the strands that is isotropic; None if unknown
    stress_table : strains and stresses (Pa) that replace the Ramberg-Osgood curve; None without a
        table
    insulation_table : strains and stresses (Pa) that replace the modulus of the insulation; None
        without a table
    insulation_strain : strain at the rim of the wire up to which the insulation has a linear law
    friction_strand : coefficient of friction between strands
    friction_insulation : coefficient of friction between the outermost layer and the insulation
    radial_force : force of the insulation on a strand of the outermost layer, N per radian of the
        helix of the strand
    layout : name of the layout, one of `LAYOUTS`
    layer_radii : radius of the centroids of the strands in compressed layers, m; None if unknown
    mass_per_length : mass per length, kg/m; None to compute it from section and densities
    conductor_density, insulation_density : densities, kg/m^3
    length : free length of the cantilever, m
    tension : tension of the wire, N
    orientation : angle of the section from the neutral axis, rad
    largest_curvature : largest curvature of the wire table, 1/m; if None, that of a bending radius
        of five wire diameters
    defaults : description of each default that was used, keyed by field
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
    layout: str = AUTO_LAYOUT
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
    """Positions of the strands of a wire; arrays have the shape (strands,).

    Parameters
    ----------
    kind : name of the layout
    x, y : centre of each strand, m
    layer : index of the layer of each strand, 0 for the innermost
    diameter : diameter of each strand, m
    bore_radius, wire_radius : inner and outer radius of the insulation, m
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
    """State of a cantilever under its own weight, with its tip at the height of the clamp.

    Parameters
    ----------
    force : force at the tip, N, which a zeroed load cell does not show
    moment : moment at the clamp, N m; negative, because weight bends the wire away from the pull
    curvature : curvature at the clamp, 1/m
    sag : distance of the lowest point below the undeformed axis, m
    """

    force: float
    moment: float
    curvature: float
    sag: float


@dataclass(frozen=True, slots=True, eq=False)
class WireTable(ArrayRecord):
    """Law of a wire on first loading, and its stiffnesses; shape (n,) unless stated.

    Parameters
    ----------
    name : name of the wire
    spec : specification of the wire
    layout : positions of the strands
    curvature : curvatures, 1/m, increasing from 0
    moment : moment, N m, the sum of its five components
    stick, slip : moment of the axial forces in sticking and in slipping strands, N m
    bending : moment of elastic strands about their own axes, N m
    plastic : change of this moment because strands yield, N m
    insulation : moment of the insulation, N m
    tangent_stiffness, secant_stiffness : bending stiffness at each curvature, N m^2
    stick_stiffness, slip_stiffness : bending stiffness if no strand slips, and if all strands slip
        without friction, N m^2
    axial_stiffness : axial stiffness EA at zero twist, N
    torsional_stiffness : torsional stiffness GJ at zero axial strain, N m^2
    free_torsional_stiffness : torsional stiffness GJ - C^2 / EA at zero axial force, N m^2
    stretch_twist_coupling : coupling C, N m: torque per strain, and axial force per twist in rad/m
    slip_onsets : shape (onsets,), curvatures within the table at which strands begin to slip, 1/m,
        increasing; the first is 0 if strands slip immediately
    lowest_moment, highest_moment : extremes of the moment over all orientations of the section, N m
    tip_deflection, tip_force : shape (m,), m and N, deflection and force of a cantilever of
        `spec.length` under an end load normal to the clamped axis, both relative to rest
    mass_per_length : mass per length, kg/m
    rest : state of this cantilever at rest; None if its weight is neglected
    doubtful_curvature, doubtful_deflection : curvature, 1/m, and deflection, m, beyond which the
        strain at the rim exceeds `spec.insulation_strain`; infinite for a stress table of the
        insulation
    notes : quality notes on defaults and limits
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
        """Whether each curvature is beyond `doubtful_curvature`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature)

    @property
    def insulation_share(self) -> Floats:
        """Fraction of the moment that the insulation carries, shape (n,).

        At zero moment it is the fraction at the second curvature.
        """
        is_zero = self.moment == 0.0
        fraction = self.insulation / np.where(is_zero, 1.0, self.moment)
        return np.asarray(np.where(is_zero, fraction[1], fraction))

    @property
    def slips_immediately(self) -> bool:
        """Whether strands slip as soon as the wire bends, without stick stiffness.

        The first secant of the table is then the slope of the law at zero curvature.
        """
        return bool(np.any(self.slip_onsets == 0.0))

    def find_slip_onset(self, index: int) -> float | str:
        """Find the curvature at which strands begin to slip, or a text in its place.

        Parameters
        ----------
        index : 0 for the first onset, -1 for the last

        Returns
        -------
        The curvature, 1/m; ``at once`` if strands slip as soon as the wire bends, ``beyond`` if no
        strand slips within the range, ``none`` for a single strand.
        """
        if len(self.layout.layer) == 1:
            return "none"
        onsets = self.slip_onsets[self.slip_onsets <= self.curvature[-1]]
        if not len(onsets):
            return "beyond"
        return float(onsets[index]) or "at once"


@dataclass(frozen=True, slots=True, eq=False)
class CurveAgreement(ArrayRecord):
    """Agreement of a measured curve with the model.

    Parameters
    ----------
    test, sample : names of the test and of the sample
    length : free length of the wire, m
    deflection, force : shape (n,), measured deflection, m, and force, N
    model : shape (n,), N, force of the model without `sample_factor`
    sample_factor : factor of this sample and load cell on the force of the model
    sse : sum of the squared errors of the model without `sample_factor`, N^2
    rmse : root mean square of these errors, N
    rmse_share : root mean square divided by the largest measured force
    lag_one_correlation : correlation of neighbouring normalised residuals,
        (force - sample_factor x model) / noise
    runs_p : p-value of the runs test of these residuals; small if signs change too rarely or too
        often
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
    """Isotropic fraction of the hardening, from residual deflections and peaks of cyclic tests.

    Parameters
    ----------
    value, interval : least-squares value, and its 95 % interval between 0 and 1
    intervals : 95 % interval from residual deflections only, and from peaks only, keyed
        by the name of the result
    n_tests : number of tests with cycles
    is_creep : whether the two values differ by more than 2.5 standard errors, probably by creep;
        the fraction is then not calibrated
    """

    value: float
    interval: Interval
    intervals: Mapping[str, Interval]
    n_tests: int
    is_creep: bool


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(ArrayRecord):
    """Predicted loading curve with 95 % bands; arrays have the shape (n,).

    Parameters
    ----------
    deflection, force : predicted deflection, m, and force, N
    lower, upper : ends of the pointwise band for the curve of a further sample, with noise, N
    lower_mean, upper_mean : ends of the pointwise band of the curve of the mean sample, without
        noise, N
    notes : quality notes on causes of uncertainty that the bands do not include
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
    """Errors of one curve relative to another, as in Table 3.3 of [1]_.

    Parameters
    ----------
    n : number of compared points
    sse : sum of the squared errors, N^2
    rmse : root mean square error, N
    rmse_share : root mean square error divided by the largest force of the reference
    coverage : fraction of the points that lie inside the band; NaN without a band

    References
    ----------
    .. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
           dissertation.
    """

    n: int
    sse: float
    rmse: float
    rmse_share: float
    coverage: float


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurve(ArrayRecord):
    """Loading curve from another source: finite elements, a paper, another lab.

    Parameters
    ----------
    name : name of the curve in the plan of the calibration
    file : name of the file of the curve in the plan
    wire : name of the wire
    length : free length, m
    deflection : shape (n,), m, deflection of the tip, increasing
    force : shape (n,), N, force at the tip
    is_normal : whether the load remains normal to the undeformed axis; otherwise its direction is
        that of the tests
    source : description of the origin of the curve
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
    """Comparison of an external curve with another curve, at the deflections of the external curve.

    Parameters
    ----------
    reference : shape (n,), N, force of the other curve; NaN where that curve has no force
    errors : errors over the common points, relative to the largest force of the other curve and its
        95 % band; None for fewer than three common points
    n_excluded : number of points that were not compared
    explanation : reason why points were not compared; empty if all points were compared
    """

    reference: Vector
    errors: CurveErrors | None
    n_excluded: int = 0
    explanation: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurveComparison:
    """Comparison of an external curve with the mean of the tests and with the calibrated model.

    Parameters
    ----------
    curve : external curve
    tests : comparison with the mean of the tests of the wire and length of the curve; None without
        tests
    model : comparison with the model
    prediction : curve of the model over the range of curve and tests; None if the model has no
        solution
    notes : quality notes on points that were not compared
    """

    curve: ExternalCurve
    tests: CurveMatch | None
    model: CurveMatch
    prediction: Prediction | None
    notes: tuple[QualityNote, ...] = ()


RADIAL_FRICTION = "radial_friction"
"""Name of the radial friction phi = F_rad (mu_s + mu_p), N, on which alone a loading curve depends
of `radial_force`, `friction_strand` and `friction_insulation`."""
INSULATION_MODULUS = "insulation_modulus"
"""Name of the elastic modulus of the insulation, Pa."""
COPPER_SCALE = "copper_scale"
"""Name of the factor on the strength of the copper in its stress-strain curve."""

PARAMETERS = (RADIAL_FRICTION, INSULATION_MODULUS, COPPER_SCALE)
"""Names of the calibrated parameters, in the order of every array over parameters."""
PARAMETER_UNITS = {RADIAL_FRICTION: "N", INSULATION_MODULUS: "Pa", COPPER_SCALE: "1"}
"""SI unit of each parameter."""
DISPLAY_UNITS = {
    RADIAL_FRICTION: (1e3, "mN"),
    INSULATION_MODULUS: (1e-6, "MPa"),
    COPPER_SCALE: (1.0, ""),
}
"""Factor from the SI unit to the display unit of each parameter, and the display unit."""


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """Settings of one parameter in a calibration.

    Parameters
    ----------
    value : start of the search, value of a fixed parameter, or centre of a prior; None for the
        value in the wire sheet
    is_fixed : whether the parameter is not fitted
    factor : factor of a log-normal prior, by which the parameter lies between value / factor and
        value x factor with a probability of 95 %; None without a prior
    lower, upper : bounds of the search; None for the default bounds
    source : source of a prior or a fixed value, for the report
    """

    value: float | None = None
    is_fixed: bool = False
    factor: float | None = None
    lower: float | None = None
    upper: float | None = None
    source: str = ""


class Identifiability(StrEnum):
    """Degree to which the tests identify a parameter."""

    IDENTIFIED = "identified"
    """The 95 % interval, and the values that the tests allow at 99 %, span less than a factor of
    2."""
    WEAKLY_IDENTIFIED = "weakly identified"
    """The values that the tests allow span a factor of 2 or more, the interval is bounded, and no
    other verdict applies."""
    TWO_SOLUTIONS = "two solutions"
    """The values span a factor of 2 or more, and the 95 % interval has separate parts or the tests
    allow a solution outside it at 99 %."""
    NOT_IDENTIFIED = "not identified"
    """The 95 % interval is unbounded on a side, or spans more than a factor of 100."""
    BY_PRIOR = "known from its prior"
    """The tests add hardly any information to the prior."""
    AGAINST_PRIOR = "contradicts its prior"
    """The values of prior and tests differ at the 95 % level; the calibrated value is between."""
    AT_BOUND = "at its bound"
    """The search ended at a bound of the parameter."""
    FIXED = "fixed"
    """The parameter was not fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile(ArrayRecord):
    """Profile of the objective along one parameter, traced from one solution.

    Parameters
    ----------
    value : shape (n,), values of the parameter, increasing
    deviance : shape (n,), increase of the objective above its lowest minimum, with all other
        parameters fitted again
    threshold_below, threshold_above : deviance at the lower and the upper end of the 95 % interval:
        the square of the quantile of the mixture of t distributions, in standard errors
    """

    value: Vector
    deviance: Vector
    threshold_below: float
    threshold_above: float


@dataclass(frozen=True, slots=True)
class PriorConflict:
    """Comparison of a prior with the value that is fitted without it.

    Parameters
    ----------
    centre : centre of the prior
    factor : factor of the prior, see `ParameterChoice`
    estimate : value from the tests without this prior
    size : difference between prior and tests, in combined standard deviations
    freedom : degrees of freedom of the combined standard deviation
    contradicts : whether `size` exceeds the two-sided 95 % quantile of t
    message : sentence with the values
    source : source of the prior
    """

    centre: float
    factor: float
    estimate: float
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
    name, unit : name of the parameter, one of `PARAMETERS`, and its SI unit
    value : value at the minimum of the objective; NaN if the parameter has no effect on the wire
    intervals : 95 % intervals by profile likelihood, the union of those of the solutions in
        the 95 % set, in increasing order. An open interval ends at the bound of the search. Empty
        if the parameter was not fitted
    log_error : standard error of the logarithm at the minimum of the objective; 0 if not fitted
    freedom : degrees of freedom of `log_error`
    is_open_below, is_open_above : whether the interval ends at the bound of the search, because
        the tests give no limit on this side
    at_bound : bound of the search that the value equals, ``lower`` or ``upper``; empty for none
    verdict : identifiability of the parameter
    explanation : sentence that explains the verdict
    profiles : profiles of the solutions whose values are in the interval, the best first; empty if
        the parameter was not fitted
    conflict : comparison of the prior with the tests; None without a prior
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
        """Interval from the lowest to the highest end; None if the parameter was not fitted."""
        if not self.intervals:
            return None
        return Interval(self.intervals[0].lower, self.intervals[-1].upper)


@dataclass(frozen=True, slots=True, eq=False)
class Separability(ArrayRecord):
    """Separability of several parameters by the tests.

    Parameters
    ----------
    names : names of the parameters
    singular_values : shape (n,), decreasing, singular values of the derivatives of all forces with
        respect to the logarithms of the parameters, divided by the noise: a combination with the
        singular value s has a standard error of 1 / s
    combinations : shape (n, n), weights of the logarithms, one row per singular value; the weight
        of largest magnitude in a row is positive
    are_identified : whether each parameter is identified, keyed by the name of the parameter
    explanation : one or two sentences on the combinations
    """

    names: tuple[str, ...]
    singular_values: Annotated[Floats, "names"]
    combinations: Annotated[Floats, "names", "names"]
    are_identified: Mapping[str, bool]
    explanation: str


@dataclass(frozen=True, slots=True, eq=False)
class ScatterMixture(ArrayRecord):
    """Fits of the parameters, one for each scatter of samples that the tests allow.

    Parameters
    ----------
    chance : shape (scatters,), probability of each scatter, with the sum 1
    scatter : shape (scatters,), standard deviation of the logarithms of the sample factors
    shift : shape (scatters, 4), change of the logarithms of parameters and gain from the fit
    covariance : shape (scatters, 4, 4), covariance of these logarithms
    freedom : degrees of freedom of the noise
    """

    chance: Vector
    scatter: Vector
    shift: Annotated[Floats, "n", 4]
    covariance: Annotated[Floats, "n", 4, 4]
    freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class Solution(ArrayRecord):
    """Local minimum of the objective that the tests allow at 99 %.

    Parameters
    ----------
    values : shape (3,), values of `PARAMETERS`; NaN for a parameter that the wire does not have
    rise : increase of the objective above that of the best solution; exp(-rise / 2) is the
        likelihood ratio
    rmse : root mean square error over all curves, N
    covariance : shape (4, 4), covariance of the logarithms of the parameters and of the gain of the
        load cell; 0 for fixed parameters
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
        """Whether the solution is in the 95 % set, which intervals and bands include."""
        return self.rise < self.limit

    @property
    def likelihood(self) -> float:
        """Ratio of the likelihood to that of the best solution."""
        return float(np.exp(-0.5 * self.rise))


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """Levels of noise and scatter about the model.

    Parameters
    ----------
    noise_factor : ratio of the estimated to the stated noise of a point
    correlation : correlation of neighbouring points
    scatter : standard deviation of the logarithms of the sample factors on the force
    gain : relative standard uncertainty of the gain of the load cell, which all curves share
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
    """Calibration of a wire by its tests.

    Parameters
    ----------
    wire : name of the wire
    parameters : parameters in the order of `PARAMETERS`
    solutions : local minima of the objective that the tests allow at 99 %, the best first
    widening : factor on quantiles, at least 1, because insulation and copper compensate each other
        along a curved valley of the objective
    correlations : shape (3, 3), correlations of the logarithms at the best solution; NaN in rows
        and columns of fixed parameters
    levels : noise of the points, scatter of the samples, and gain of the load cell
    separability : separability of the parameters that affect the wire, as if all were fitted
    curves : agreement of each curve with the model
    n_points, n_samples : numbers of points and of samples of the calibration
    sse, rmse, rmse_share : errors over all curves, as in `CurveErrors`
    method : description of the calibration for the report
    notes : quality notes
    isotropic_share : isotropic fraction of the hardening; None if no test has cycles
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
    isotropic_share: IsotropicShare | None = None

    def get_parameter(self, name: str) -> CalibratedParameter:
        """Return the parameter with a name, one of `PARAMETERS`."""
        return self.parameters[PARAMETERS.index(name)]


@dataclass(frozen=True, slots=True)
class CalibrationFailure(Reason):
    """Reason why a wire has no calibration."""
