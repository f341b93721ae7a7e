"""Define the records of a report: samples, groups, means, bands, comparisons, and the campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date as Day  # noqa: N812 - a record has a field called date
from enum import StrEnum
from math import expm1, hypot, log

import numpy as np

from labpipe.records.arrays import ArrayRecord, Ints, Vector
from labpipe.records.curve import FigureLaw, FigureShapes, FittedLine, Interval, Slip
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.result import (
    Contribution,
    InputFile,
    Instrument,
    Result,
    Specimen,
    find_distinct_estimate,
)


@dataclass(frozen=True, slots=True, eq=False)
class SampleCurve(ArrayRecord):
    """One branch of the curve of a sample, reduced to few points for figures.

    Parameters
    ----------
    displacement : shape (n,), m, in the direction of loading; NaN where there is no measurement
    force : shape (n,), N, processed force; NaN where there is no measurement
    measured_force : shape (n,), N, force before the repair of slips; equals `force` without repair
    cycle : number of the cycle of the test, counted from 1
    """

    displacement: Vector
    force: Vector
    measured_force: Vector
    cycle: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Data of one processed test, as a report uses them.

    Parameters
    ----------
    test : name of the test
    specimen : specimen of the test, with its names and dimensions
    protocol : name of the protocol
    loading, unloading : branches of each cycle in order; empty without a curve
    results : results of the test, as in its summary
    slips : slips of the curve
    lines : straight lines whose slopes are stiffnesses
    quality : quality notes
    display : display units, keyed by quantity
    source : file from which the sample was read, for messages
    label : folder of the test relative to that of the campaign, which identifies it in decisions
    run : key that identifies exports, sheet, protocol and processing; empty in old results
    date : day of the test; None if neither sheet nor exports state it
    operator : operator of the test; empty if the sheet does not state it
    instruments : instruments whose certificates the protocol states
    inputs : exports with their fingerprints
    shapes : shapes of the specimen for figures; None without cameras
    law : measured moment against curvature; None if the protocol does not request it
    decision : manual decision on the test with reason, name and date; empty without decision
    """

    test: str
    specimen: Specimen
    protocol: str
    loading: tuple[SampleCurve, ...]
    unloading: tuple[SampleCurve, ...]
    results: tuple[Result, ...]
    slips: tuple[Slip, ...] = ()
    lines: tuple[FittedLine, ...] = ()
    quality: tuple[QualityNote, ...] = ()
    display: Mapping[str, str] = field(default_factory=dict)
    source: str = ""
    label: str = ""
    run: str = ""
    date: Day | None = None
    operator: str = ""
    instruments: tuple[Instrument, ...] = ()
    inputs: tuple[InputFile, ...] = ()
    shapes: FigureShapes | None = None
    law: FigureLaw | None = None
    decision: str = ""


@dataclass(frozen=True, slots=True)
class MeanInterval:
    """Mean with its 95 % interval, by Student's t and the uncertainties common to all values.

    Parameters
    ----------
    mean : mean in the unit of the values
    interval : 95 % interval; None if it is not available
    deviation : standard deviation of the averaged values; NaN for fewer than two
    n : number of averaged values (samples, or spool means)
    reason : reason why there is no interval; None if there is one
    estimate : mean of the estimates of the values (`Result.estimate`), which is the middle of the
        interval; None if it equals the mean
    common : contributions of the causes that all tests of a rig have in common, in the unit of the
        mean; the interval includes them
    is_log : whether the interval is symmetric on a log scale, for a result that cannot be negative
    """

    mean: float
    interval: Interval | None
    deviation: float
    n: int
    reason: Reason | None = None
    estimate: float | None = None
    common: tuple[Contribution, ...] = ()
    is_log: bool = False

    @property
    def middle(self) -> float:
        """Middle of the interval: the estimate, or the mean if there is none."""
        return self.mean if self.estimate is None else self.estimate

    @property
    def half_width(self) -> float:
        """Half-width of the interval before its conversion to a log scale; NaN without interval."""
        if self.interval is None:
            return float("nan")
        lower, upper = self.interval.lower, self.interval.upper
        return 0.5 * self.middle * log(upper / lower) if self.is_log else 0.5 * (upper - lower)

    @property
    def distinct_estimate(self) -> float | None:
        """Estimate if a report shows it beside the mean, see `find_distinct_estimate`."""
        return find_distinct_estimate(self.mean, self.estimate, self.interval)


@dataclass(frozen=True, slots=True)
class AveragingDecision:
    """Decision to average samples or spool means; its text is a sentence with reasons.

    Parameters
    ----------
    action : clause on the choice, such as ``Over 3 spool means``
    grounds : clauses that state the reasons with their numbers
    """

    action: str
    grounds: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{': '.join(filter(None, (self.action, '; '.join(self.grounds))))}."


@dataclass(frozen=True, slots=True)
class NestedMean:
    """Mean of samples from spools, with the decision on how to average them.

    Parameters
    ----------
    chosen : mean and interval of the samples or of the spool means, as independent values
    is_pooled : whether `chosen` is the mean of the samples; always True for one spool
    decision : reason for the choice of the mean
    spool_means : mean and interval of the samples of each spool, keyed by spool
    within_spools : standard deviation of samples within spools; NaN if no spool has two samples
    between_spools : standard deviation between spools, after the variance within spools has been
        subtracted; 0 if that variance explains the whole scatter, NaN for one spool
        or without `within_spools`
    spool_p : p-value of the k-sample Anderson-Darling test that all spools have one distribution;
        NaN if not available
    """

    chosen: MeanInterval
    is_pooled: bool
    decision: AveragingDecision
    spool_means: Mapping[str, MeanInterval]
    within_spools: float
    between_spools: float = float("nan")
    spool_p: float = float("nan")

    @property
    def n_samples(self) -> int:
        """Number of samples of all spools."""
        return sum(mean.n for mean in self.spool_means.values())


@dataclass(frozen=True, slots=True)
class Outlier:
    """Value that a statistical test marks as an outlier; means include outliers.

    Parameters
    ----------
    sample : name of the test in which the sample was measured
    value : value in the unit of the result
    method : name of the statistical test
    p : p-value of the statistical test
    """

    sample: str
    value: float
    method: str
    p: float


@dataclass(frozen=True, slots=True, eq=False)
class Band(ArrayRecord):
    """Mean curve of a group on a common grid, with two 95 % bands.

    Parameters
    ----------
    displacement : shape (n,), m, grid of displacements at which every sample has data
    mean : shape (n,), N, mean curve
    lower, upper : shape (n,), N, ends of the pointwise band, which contains the true mean at any
        single displacement with 95 % probability
    lower_all, upper_all : shape (n,), N, ends of the simultaneous band, which contains the whole
        true mean curve with 95 % probability
    n : number of averaged curves
    members : kind of the averaged curves, ``samples`` or ``spool means``
    reason : reason why there is no curve (all arrays are empty), no band (all bounds are NaN), or
        only a pointwise interval at three displacements (``few_curves``, NaN elsewhere). None if
        there are both bands
    """

    displacement: Vector
    mean: Vector
    lower: Vector
    upper: Vector
    lower_all: Vector
    upper_all: Vector
    n: int
    members: str
    reason: Reason | None = None

    @property
    def has_band(self) -> bool:
        """Whether there is a band, not only intervals at some displacements."""
        max_intervals = 3
        return bool(np.isfinite(self.lower).sum() > max_intervals)

    @property
    def interval_indices(self) -> Ints:
        """Indices of the displacements with an interval; empty if there is a band."""
        indices = np.flatnonzero(np.isfinite(self.lower))
        return indices[:0] if self.has_band else indices


@dataclass(frozen=True, slots=True)
class GroupNumber:
    """One result for all samples of a group.

    Parameters
    ----------
    name, unit : name and unit of the result
    mean : mean of the values, which is NaN without values
    values : averaged results, keyed by test; empty if no sample has the result
    exclusions : reasons why a test is not averaged, keyed by test
    outliers : outliers among the averaged values
    is_set_by_rig : whether the rig imposes the result, which is then not tested for outliers
    """

    name: str
    unit: str
    mean: NestedMean
    values: Mapping[str, Result]
    exclusions: Mapping[str, tuple[Reason, ...]]
    outliers: tuple[Outlier, ...] = ()
    is_set_by_rig: bool = False


class Verdict(StrEnum):
    """Outcome of the comparison of two groups."""

    DIFFERENT = "different"
    EQUIVALENT = "equivalent"
    CANNOT_TELL = "cannot tell"
    NOT_ASKED = "not asked"


@dataclass(frozen=True, slots=True)
class Contrast:
    """Difference of two means, on the scale on which they are compared.

    Parameters
    ----------
    difference : second mean minus the first; on a log scale the logarithm of second / first
    errors : standard errors of the two means from scatter; relative to the means on a log scale
    counts : number of values of each mean
    common_error : standard uncertainty of the difference from causes that all tests of a rig have
        in common
    margin : largest difference without practical importance, on this scale; None if not stated
    is_log : whether the scale is logarithmic, for numbers that cannot be negative
    """

    difference: float
    errors: tuple[float, float]
    counts: tuple[int, int]
    common_error: float = 0.0
    margin: float | None = None
    is_log: bool = False

    @property
    def error(self) -> float:
        """Standard error of the difference from scatter."""
        return hypot(*self.errors)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of `error` by Satterthwaite (Welch, Biometrika 34 (1947) 28)."""
        squares = [error**2 for error in self.errors]
        freedoms = [count - 1 for count in self.counts]
        terms = zip(squares, freedoms, strict=True)
        denominator = sum(square**2 / freedom for square, freedom in terms)
        return sum(squares) ** 2 / denominator if denominator > 0.0 else float(sum(freedoms))


@dataclass(frozen=True, slots=True)
class Difference:
    """Comparison of two groups in one result.

    Parameters
    ----------
    name, unit : name and unit of the result
    first, second : names of the groups
    difference : second mean minus the first with its 95 % interval (Welch), not adjusted for
        multiple comparisons
    margin : largest difference without practical importance, in `unit`; None if not stated
    contrast : the difference on the scale of the test; None if a mean has no interval
    p : p-value under the hypothesis of no difference; NaN without `contrast`
    p_equivalent : p-value of the two one-sided tests; NaN without a margin
    family : name of the comparisons that are judged together; empty if this one was not judged
    n_comparisons : number of comparisons in the family that have a p-value
    interval : interval at the corrected level of 95 % or more: of the difference in `unit`, or on a
        log scale of the relative difference (0.38 for +38 %). The interval excludes zero exactly
        if the groups differ significantly
    verdict : outcome of the comparison, corrected so that at most 5 % of families contain a wrong
        ``different``, and at most 5 % a wrong ``equivalent``
    verdict_reason : clause with the numbers of the verdict
    caveats : clauses on the limitations of the comparison
    fields : values of the first and of the second group in each field in which their specimens
        differ, keyed by field
    """

    name: str
    unit: str
    first: str
    second: str
    difference: MeanInterval
    margin: float | None
    contrast: Contrast | None = None
    p: float = float("nan")
    p_equivalent: float = float("nan")
    family: str = ""
    n_comparisons: int = 0
    interval: Interval | None = None
    verdict: Verdict = Verdict.NOT_ASKED
    verdict_reason: str = ""
    caveats: tuple[str, ...] = ()
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def change(self) -> float | None:
        """Relative change, second / first - 1; None if the scale is not logarithmic."""
        if self.contrast is None or not self.contrast.is_log:
            return None
        return expm1(self.contrast.difference)

    @property
    def single_field(self) -> str:
        """The only field in which the groups differ; empty if there are several or none."""
        return next(iter(self.fields)) if len(self.fields) == 1 else ""


class Answer(StrEnum):
    """Answer to the question of whether a sample or a lot reaches the smallest allowed force."""

    PASS = "pass"
    FAIL = "fail"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True, slots=True)
class SampleVerdict:
    """Verdict on a sample that has to reach a limit.

    Parameters
    ----------
    value_answer : answer by the value alone, as in standards
    interval_answer : answer by the 95 % interval; ``cannot tell`` if the interval is missing or
        contains the limit, or if the value is doubtful
    """

    value_answer: Answer
    interval_answer: Answer

    @property
    def text(self) -> str:
        """Both answers as a text, such as ``pass (cannot tell with its interval)``."""
        if self.value_answer is self.interval_answer:
            return str(self.value_answer)
        return f"{self.value_answer} ({self.interval_answer} with its interval)"


@dataclass(frozen=True, slots=True)
class Lot:
    """Comparison of a group with the smallest allowed force; forces are fractions of this limit.

    Parameters
    ----------
    answer : answer on the lot
    limit : smallest allowed force, N; None if the samples have several limits or none
    verdicts : answers on each sample, keyed by test
    coverage : required fraction of the lot that reaches the limit
    confidence : probability with which this fraction must be demonstrated
    n : number of samples with a value
    mean, deviation, minimum : mean, standard deviation and smallest value of the samples; NaN
        without samples. The deviation is also NaN for one sample
    tolerance_bound : one-sided lower tolerance bound of the lot; NaN for fewer than two samples
    cpk : (mean - limit) / (3 standard deviations); NaN without scatter
    n_needed : number of samples with which this mean and deviation would pass; None without
        scatter, or if more than about 100 000 would be needed
    reasons : reasons for the answer, then caveats
    """

    answer: Answer
    limit: float | None
    verdicts: Mapping[str, SampleVerdict]
    coverage: float
    confidence: float
    n: int
    mean: float
    deviation: float
    minimum: float
    tolerance_bound: float
    cpk: float
    n_needed: int | None
    reasons: tuple[Reason, ...] = ()

    def format_fraction(self, ratio: float) -> str:
        """Format a fraction of the limit in N, or as a percentage if the limits differ."""
        return f"{ratio:.1%} of the limit" if self.limit is None else f"{ratio * self.limit:.4g} N"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Samples of one type, tested by one protocol.

    Parameters
    ----------
    name : specimen type, followed by the protocol if two protocols test the type
    protocol : name of the protocol
    samples : samples in order of spool, sample and test
    numbers : results over all samples
    band : mean loading curve of the first cycle
    scaled_band : mean loading curve of the forces divided by the peak force of each sample; None if
        not requested
    notes : quality notes on the group as a whole
    fields : texts of grouping fields with the same value in all samples, keyed by field
    lot : comparison with the smallest allowed force; None if the protocol does not state it
    """

    name: str
    protocol: str
    samples: tuple[Sample, ...]
    numbers: tuple[GroupNumber, ...]
    band: Band
    scaled_band: Band | None = None
    notes: tuple[QualityNote, ...] = ()
    fields: Mapping[str, str] = field(default_factory=dict)
    lot: Lot | None = None

    def find_number(self, name: str) -> GroupNumber | None:
        """Find the result with a name; None if the group has no such result."""
        return next((number for number in self.numbers if number.name == name), None)


@dataclass(frozen=True, slots=True)
class BoundedStiffness:
    """Measured bending stiffness of a harness bundle, and bounds by the model of the bundle.

    Parameters
    ----------
    group, test : names of the group and of the test; an empty test for the mean of the group
    value : measured bending stiffness, N m^2; None if not available
    interval : 95 % interval of `value`
    low : bending stiffness by the model if all strands slip, N m^2; NaN without a bundle model
    free : bending stiffness if the wires slip and the strands within them stick, N m^2; NaN without
        a bundle model
    high : bending stiffness if nothing slips, bent along y, N m^2; NaN without a bundle model
    principal : smallest and largest bending stiffness of all directions if nothing slips, N m^2
    degree : composite degree, (value - low) / (high - low); NaN without a value or two bounds
    degree_interval : 95 % interval of `degree` from that of `value`, for exact bounds
    reasons : reasons why there is no composite degree; empty if there is one
    """

    group: str
    test: str
    value: float | None
    interval: Interval | None
    low: float = float("nan")
    free: float = float("nan")
    high: float = float("nan")
    principal: tuple[float, float] = (float("nan"), float("nan"))
    degree: float = float("nan")
    degree_interval: Interval | None = None
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Campaign of tests, as a report shows it.

    Parameters
    ----------
    title : title of the report
    groups : groups in order of name
    differences : comparisons of pairs of groups of one protocol
    failures : reasons why tests could not be read, keyed by file
    labpipe_version : labpipe version of the report
    grouping_fields : names of the fields by which the samples are grouped
    compared_field : the only field in which the groups of a pair in `differences` differ; empty if
        all pairs are compared
    pairs_not_shown : number of pairs of groups that differ in other fields
    bounded_stiffnesses : bending stiffnesses of bundles, with the bounds by their models
    wire_sheet : name of the wire sheet for the bounds; empty without one
    rejected : decision of a person to exclude a test, with reason, name and date, keyed by file
    rejected_samples : samples of the rejected tests, which are in no group
    name : name of the folder of the campaign; empty if all tests are elsewhere
    decisions : decisions on tests of the campaign, as in ``decisions.json``
    date : day of the report; None if the report does not state it
    """

    title: str
    groups: tuple[Group, ...]
    differences: tuple[Difference, ...] = ()
    failures: Mapping[str, str] = field(default_factory=dict)
    labpipe_version: str = ""
    grouping_fields: tuple[str, ...] = ("type",)
    compared_field: str = ""
    pairs_not_shown: int = 0
    bounded_stiffnesses: tuple[BoundedStiffness, ...] = ()
    wire_sheet: str = ""
    rejected: Mapping[str, str] = field(default_factory=dict)
    rejected_samples: tuple[Sample, ...] = ()
    name: str = ""
    decisions: tuple[Mapping[str, str], ...] = ()
    date: Day | None = None
