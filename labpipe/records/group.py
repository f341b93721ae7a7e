"""Groups of tests: what the report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date as Day  # noqa: N812 - a record has a field called date
from enum import StrEnum
from math import expm1, hypot, log
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector
from labpipe.records.curve import FittedLine, Interval, Slip
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
class DrawnShapes(ArrayRecord):
    """Shapes of a specimen at equal steps of its first loading.

    Parameters
    ----------
    deflection : shape (steps,), m, of the curve
    positions : shape (steps, points, 2), m, in the specimen frame: along it, and in the plane of
        bending; NaN where no camera saw the point
    """

    deflection: Annotated[Floats, "steps"]
    positions: Annotated[Floats, "steps", "points", 2]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLaw(ArrayRecord):
    """The measured moment-curvature law of a first loading, with its 95 % interval.

    Parameters
    ----------
    curvature : shape (n,), 1/m, increasing
    moment, moment_lower, moment_upper : shape (n,), N m
    """

    curvature: Vector
    moment: Vector
    moment_lower: Vector
    moment_upper: Vector


@dataclass(frozen=True, slots=True, eq=False)
class SampleCurve(ArrayRecord):
    """One branch of the curve of one sample, thin enough to draw.

    Parameters
    ----------
    displacement : shape (n,), m, increasing
    force : shape (n,), N, as processed; NaN where there is no datum
    as_measured : shape (n,), N, the force before slips were repaired; the same as `force` where
        nothing was repaired
    cycle : of the test, counted from 1
    """

    displacement: Vector
    force: Vector
    as_measured: Vector
    cycle: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """What the report needs of one processed test.

    Parameters
    ----------
    test : name of the test
    specimen : type, spool, sample, dimensions
    protocol : name of the protocol
    loading, unloading : the branches of each cycle in order; empty where the test has no curve
    results : as in the summary
    slips : the slip ledger
    lines : the straight lines that stiffnesses were read from
    quality : notes
    display : unit in which people see a quantity, by quantity
    source : where it was read from, for messages
    label : folder of the test below that of the campaign, by which decisions name it
    run : key of exports, sheet, protocol and processing; empty in results from before keys
    date : day of the test; None where neither sheet nor exports say it
    operator : who made the test; empty where the sheet does not say it
    instruments : those whose certificates the protocol states
    inputs : the exports, with their fingerprints
    shapes : None without cameras
    law : measured moment against curvature; None where the protocol does not ask for it
    decision : what a person decided of the test, why, by whom and when; empty where nobody did
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
    shapes: DrawnShapes | None = None
    law: DrawnLaw | None = None
    decision: str = ""


@dataclass(frozen=True, slots=True)
class MeanInterval:
    """A mean with its 95 % interval: Student's t, and what is common to all that was averaged.

    Parameters
    ----------
    mean : in the unit of the values
    interval : None where it is not available; `reason` then says why
    deviation : standard deviation of what was averaged; NaN for one value
    n : number of values averaged (samples, or spool means)
    reason : None when there is an interval
    estimate : mean of the estimates, in the middle of the interval; None where it is the mean
    common : what causes that all tests of a rig share change, in the unit of the mean; in the
        interval
    is_log : whether the interval is on a log scale, as that of a positive number
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
        """Return what the interval lies about: the estimate, or else the mean."""
        return self.mean if self.estimate is None else self.estimate

    @property
    def half_width(self) -> float:
        """Return the half-width of the interval, before a log scale if it has one, or NaN."""
        if self.interval is None:
            return float("nan")
        lower, upper = self.interval.lower, self.interval.upper
        return 0.5 * self.middle * log(upper / lower) if self.is_log else 0.5 * (upper - lower)

    @property
    def distinct_estimate(self) -> float | None:
        """Return the estimate if it must be shown beside the mean (`find_distinct_estimate`)."""
        return find_distinct_estimate(self.mean, self.estimate, self.interval)


@dataclass(frozen=True, slots=True)
class Decision:
    """How samples of several spools were averaged, and why, in words.

    Parameters
    ----------
    action : what was averaged, such as ``Over 3 spool means``
    grounds : the numbers it rests on, a clause each
    """

    action: str
    grounds: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{': '.join(filter(None, (self.action, '; '.join(self.grounds))))}."


@dataclass(frozen=True, slots=True)
class NestedMean:
    """A mean of samples that were cut from spools, and the decision how to average them.

    Parameters
    ----------
    chosen : the mean and interval that hold: one of the next two
    over_samples : all samples taken as independent
    over_spools : spool means taken as independent; None for one spool
    is_pooled : whether `chosen` is `over_samples`; always so for one spool
    decision : what was averaged, and the numbers that say so
    spool_means : by spool, mean and interval over its samples
    within : standard deviation of samples of one spool; NaN where no spool has two samples
    between_spools : standard deviation of the true means of spools: the scatter of the spool means
        less what their samples explain; 0 where that is all of it, NaN for one spool or without
        `within`
    spool_p : p-value of the k-sample Anderson-Darling test of equal spools; NaN where it cannot be
        had
    """

    chosen: MeanInterval
    over_samples: MeanInterval
    over_spools: MeanInterval | None
    is_pooled: bool
    decision: Decision
    spool_means: Mapping[str, MeanInterval]
    within: float
    between_spools: float
    spool_p: float


@dataclass(frozen=True, slots=True)
class Outlier:
    """A value that a named test marks; it stays in every mean.

    Parameters
    ----------
    sample : name of its test
    value : in the unit of the values
    method : name of the test
    p : p-value
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
    displacement : shape (n,), m, only where every sample has data
    mean : shape (n,), N
    lower, upper : shape (n,), pointwise band: holds the mean at one displacement
    lower_all, upper_all : shape (n,), simultaneous band: holds the whole mean curve
    n : number of curves averaged
    members : ``samples`` or ``spool means``
    reason : why there is no curve (then all are empty), no band (then all four are NaN), or the
        pointwise interval at three displacements alone (NaN elsewhere: ``few_curves``); else None
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
    def has_area(self) -> bool:
        """Return whether there is a band to draw, not just intervals at some displacements."""
        max_marks = 3
        return bool(np.isfinite(self.lower).sum() > max_marks)

    @property
    def marks(self) -> Ints:
        """Return the places of the intervals that are drawn singly; empty if there is a band."""
        places = np.flatnonzero(np.isfinite(self.lower))
        return places if not self.has_area else places[:0]


@dataclass(frozen=True, slots=True)
class GroupNumber:
    """One result over all samples of a group.

    Parameters
    ----------
    name, unit : of the result
    mean : nested mean; None when no sample has the number
    values : by test, the results that entered
    left_out : by test, why it did not enter: a failed result, or none of that name
    outliers : marked, not removed
    is_set_by_rig : whether it says how the rig was driven; then no value of it is an outlier
    """

    name: str
    unit: str
    mean: NestedMean | None
    values: Mapping[str, Result]
    left_out: Mapping[str, tuple[Reason, ...]]
    outliers: tuple[Outlier, ...] = ()
    is_set_by_rig: bool = False


class Verdict(StrEnum):
    """What a comparison comes to."""

    DIFFERENT = "different"
    EQUIVALENT = "equivalent"
    CANNOT_TELL = "cannot tell"
    NOT_ASKED = "not asked"


@dataclass(frozen=True, slots=True)
class Contrast:
    """What two means differ by, on the scale on which they are compared.

    Parameters
    ----------
    difference : second less first; on a log scale the logarithm of second over first
    errors : standard errors of the two means, by scatter; on a log scale over the means
    counts : values behind each of the means
    shared : standard uncertainty of what tests of a rig share, as far as it does not cancel
    margin : that does not matter, on this scale; None where it is not stated
    is_log : of numbers that cannot be negative
    """

    difference: float
    errors: tuple[float, float]
    counts: tuple[int, int]
    shared: float = 0.0
    margin: float | None = None
    is_log: bool = False

    @property
    def error(self) -> float:
        """Return the standard error of the difference, by scatter."""
        return hypot(*self.errors)

    @property
    def degrees(self) -> float:
        """Return the degrees of freedom after Satterthwaite (Welch, Biometrika 34 (1947) 28)."""
        squares = [error**2 for error in self.errors]
        free = [count - 1 for count in self.counts]
        spread = sum(square**2 / degrees for square, degrees in zip(squares, free, strict=True))
        return sum(squares) ** 2 / spread if spread > 0.0 else float(sum(free))


@dataclass(frozen=True, slots=True)
class Difference:
    """How two groups differ in one result.

    Parameters
    ----------
    name, unit : of the result
    first, second : names of the groups
    difference : second minus first with its own 95 % interval (Welch), which is not corrected;
        interval None when it is not available
    margin : in `unit`, difference that does not matter in practice; None where it is not stated
    contrast : what is judged; None without scatter to judge by
    p : p-value of no difference; NaN without `contrast`
    p_equivalent : p-value of the two one-sided tests; NaN without a margin
    family : which comparisons it is judged together with; empty where nobody asked
    tests : comparisons in the family
    interval : of the difference in `unit`, or of the share on a log scale (0.38 for +38 %), at the
        level that the correction leaves to it: 95 % or more. It leaves zero out exactly where the
        verdict may be different
    verdict : of the family as a whole at most 5 % are wrong
    verdict_reason : the verdict in numbers, a clause
    caveats : what speaks against the comparison, a clause each
    fields : what of the specimens differs between the groups: word of the first and of the second,
        by field
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
    tests: int = 0
    interval: Interval | None = None
    verdict: Verdict = Verdict.NOT_ASKED
    verdict_reason: str = ""
    caveats: tuple[str, ...] = ()
    fields: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def share(self) -> float | None:
        """Return the second over first less 1, of numbers that cannot be negative."""
        is_log = self.contrast is not None and self.contrast.is_log
        return expm1(self.contrast.difference) if self.contrast is not None and is_log else None

    @property
    def verdict_text(self) -> str:
        """Return the verdict with its reason and caveats."""
        verdict = (
            f"{self.verdict}: {self.verdict_reason}" if self.verdict_reason else str(self.verdict)
        )
        return "; ".join((verdict, *self.caveats))

    @property
    def single_field(self) -> str:
        """Return the one field that the groups differ in; empty for several or none."""
        (only,) = self.fields if len(self.fields) == 1 else ("",)
        return only


class Answer(StrEnum):
    """Whether a sample or a lot reaches the smallest force allowed."""

    PASS = "pass"
    FAIL = "fail"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True, slots=True)
class SampleVerdict:
    """Whether a sample reaches its limit.

    Parameters
    ----------
    by_number : as a standard compares it
    with_interval : not told where the 95 % interval contains the limit, or the number is doubtful
    """

    by_number: Answer
    with_interval: Answer

    @property
    def text(self) -> str:
        """Return both, such as ``pass (cannot tell with its interval)``."""
        if self.by_number is self.with_interval:
            return str(self.by_number)
        return f"{self.by_number} ({self.with_interval} with its interval)"


@dataclass(frozen=True, slots=True)
class LotRule:
    """What a lot must show.

    Parameters
    ----------
    coverage : share of the lot that must reach the limit
    confidence : with which it does
    """

    coverage: float = 0.99
    confidence: float = 0.95


@dataclass(frozen=True, slots=True)
class Lot:
    """Samples of a group against the smallest force allowed; numbers are shares of the limit.

    Parameters
    ----------
    answer : of the lot
    limit : N; None if the samples have several limits or none
    verdicts : by test
    rule : coverage and confidence
    n : samples with a number
    mean, deviation, smallest : of the samples; NaN without samples, the deviation of one
    bound : one-sided lower tolerance bound; NaN for one sample
    cpk : (mean - limit) / (3 standard deviations); NaN without scatter
    n_needed : samples with which this mean and deviation would pass; None if no number would
    reasons : for the answer, then caveats
    """

    answer: Answer
    limit: float | None
    verdicts: Mapping[str, SampleVerdict]
    rule: LotRule
    n: int
    mean: float
    deviation: float
    smallest: float
    bound: float
    cpk: float
    n_needed: int | None
    reasons: tuple[Reason, ...] = ()

    def describe_share(self, share: float) -> str:
        """Write a share of the limit in N, or as a share where the limits differ."""
        return f"{share:.1%} of the limit" if self.limit is None else f"{share * self.limit:.4g} N"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Samples of one type, tested by one protocol.

    Parameters
    ----------
    name : specimen type, with the protocol behind it where two protocols share a type
    protocol : name of the protocol
    samples : in order of spool and sample
    numbers : one per result
    band : mean loading curve of the first cycle
    band_scaled : the same for force / peak force of each sample; None where not asked for
    notes : what concerns the group as a whole
    fields : what all samples have alike of what groups can be made by, in words, by name
    lot : the samples against the smallest force allowed; None where the protocol asks for none
    """

    name: str
    protocol: str
    samples: tuple[Sample, ...]
    numbers: tuple[GroupNumber, ...]
    band: Band
    band_scaled: Band | None = None
    notes: tuple[QualityNote, ...] = ()
    fields: Mapping[str, str] = field(default_factory=dict)
    lot: Lot | None = None


@dataclass(frozen=True, slots=True)
class BundlePlace:
    """Where the bending stiffness of a harness bundle lies between slipping and sticking.

    Parameters
    ----------
    group, test : of the sample; without a test, the mean of the group
    value : measured bending stiffness, N m^2; None where there is none
    interval : 95 %, of `value`
    low, free, high : N m^2, of the bundle model: all slips; wires slip and the strands within them
        stick; nothing slips, bent along y. NaN without bounds
    principal : N m^2, least and largest of all directions with nothing slipping
    share : of the way from `low` to `high`; NaN without both
    share_interval : 95 %, from that of `value`; the bounds are taken as known
    reasons : why there are no bounds or no value; empty otherwise
    """

    group: str
    test: str
    value: float | None
    interval: Interval | None
    low: float = float("nan")
    free: float = float("nan")
    high: float = float("nan")
    principal: tuple[float, float] = (float("nan"), float("nan"))
    share: float = float("nan")
    share_interval: Interval | None = None
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Everything a report shows.

    Parameters
    ----------
    title : of the report
    groups : in order of name
    differences : between pairs of groups of one protocol
    left_out : by file, why a test could not be read
    labpipe_version : the version that made the report
    by : fields that the groups were made by
    compared : field that the pairs in `differences` differ in alone; empty for all pairs
    pairs_not_shown : pairs of groups that were left out for it
    places : bending stiffness of bundles between the bounds of their model
    wire_sheet : name of the file that the bounds are from; empty where none was given
    rejected : by file, why a person decided that a test does not count, by whom and when
    rejected_samples : these tests, which are in no group
    name : of the folders of the campaign; empty where all tests lie elsewhere
    decisions : all that was decided on its tests, as ``decisions.json`` has it
    made_on : day on which the report was made; None leaves it away
    """

    title: str
    groups: tuple[Group, ...]
    differences: tuple[Difference, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    labpipe_version: str = ""
    by: tuple[str, ...] = ("type",)
    compared: str = ""
    pairs_not_shown: int = 0
    places: tuple[BundlePlace, ...] = ()
    wire_sheet: str = ""
    rejected: Mapping[str, str] = field(default_factory=dict)
    rejected_samples: tuple[Sample, ...] = ()
    name: str = ""
    decisions: tuple[Mapping[str, str], ...] = ()
    made_on: Day | None = None
