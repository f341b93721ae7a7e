"""Define the results of a test, and the record of the whole test."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from datetime import date as Day  # noqa: N812 - a record has a field called date
from enum import StrEnum
from hashlib import sha256
from math import isfinite

from labpipe.records.curve import Aligned, Bending, Curve, FittedLine, Interval, Shape, Slip
from labpipe.records.harness_bundle import Bundle
from labpipe.records.quality import QualityNote, Reason, join_reasons
from labpipe.records.recording import Recording


class Status(StrEnum):
    """Status of a result."""

    OK = "ok"
    DOUBTFUL = "doubtful"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Contribution:
    """Row of an uncertainty budget: the contribution of one cause.

    Parameters
    ----------
    cause : a key of `labpipe.records.causes.IS_COMMON`, such as ``noise of the force``
    change : signed change of the result by one standard uncertainty of the cause, in the unit of
        the result; for noise a standard deviation
    is_common : whether the cause is common to all tests of a rig, so that it does not average out
    """

    cause: str
    change: float
    is_common: bool = False


def find_distinct_estimate(
    value: float, estimate: float | None, interval: Interval | None
) -> float | None:
    """Find an estimate that is so far from its value that reports show both.

    For example, the largest sample of a noisy plateau is above the true force.

    Parameters
    ----------
    value, estimate : value and its estimate without noise, in one unit
    interval : interval of the estimate, in the same unit

    Returns
    -------
    The estimate if it differs from the value by more than half the half-width of the interval;
    otherwise None.
    """
    if estimate is None or interval is None:
        return None
    half_width = 0.5 * (interval.upper - interval.lower)
    return estimate if abs(value - estimate) > 0.5 * half_width else None


def compute_seal(name: str, unit: str, status: str, numbers: Sequence[float | None]) -> str:
    """Compute the SHA-256 of the numbers of a result, which reveals later changes in a file.

    Parameters
    ----------
    name, unit, status : name, unit and status of the result
    numbers : value, lower and upper end of the interval, level and estimate; a number that is not
        finite is treated as None

    Examples
    --------
    >>> compute_seal("slack", "m", "ok", (1e-3, 9e-4, 1.1e-3, 0.95, 1e-3))[:8]
    'a69d6053'
    """
    texts = (None if x is None or not isfinite(x) else repr(float(x)) for x in numbers)
    return sha256(repr((name, unit, str(status), *texts)).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a test: a value with unit, 95 % interval, status and reasons.

    The interval is that of `estimate`, and contains `value`.

    Parameters
    ----------
    name : stable name in snake case, followed by the cycle after a dot: ``peak_force.1``
    value : value in `unit`; None if it could not be computed
    unit : SI unit, ``1`` for a pure number
    interval : 95 % interval in `unit`; None if it is not available, for one of the reasons
    status : status of the result, ``failed`` exactly when `value` is None
    reasons : reasons why the result is doubtful, failed, or without an interval; otherwise empty
    method : description of the computation of value and interval; equal in all tests with the same
        processing
    n : number of samples from which the result is computed
    made_of : name of the result from which this one is computed, such as a stiffness; may be empty
    remark : addition to the method for this test only, such as force added by repaired slips
    estimate : value minus the mean effect of noise, in `unit`; None if it equals the value
    budget : contributions to the interval; empty if they are not known separately
    """

    name: str
    value: float | None
    unit: str
    interval: Interval | None = None
    status: Status = Status.OK
    reasons: tuple[Reason, ...] = ()
    method: str = ""
    n: int = 0
    made_of: str = ""
    remark: str = ""
    estimate: float | None = None
    budget: tuple[Contribution, ...] = ()

    def __post_init__(self) -> None:
        if (self.value is None) != (self.status is Status.FAILED):
            message = f"{self.name}: a result is failed exactly when it has no value"
            raise ValueError(message)
        if self.status is not Status.OK and not self.reasons:
            message = f"{self.name}: a {self.status} result must have a reason"
            raise ValueError(message)

    @property
    def full_method(self) -> str:
        """Method with the remark of this test."""
        return "; ".join(filter(None, (self.method, self.remark)))

    @property
    def fractions(self) -> tuple[float, ...]:
        """Fraction of the variance for each contribution of the budget; 0 without a variance."""
        variances = [contribution.change**2 for contribution in self.budget]
        total = sum(variances)
        return tuple(variance / total if total > 0.0 else 0.0 for variance in variances)

    @property
    def largest_cause(self) -> tuple[str, float] | None:
        """Cause with the largest fraction of the variance, and this fraction; None if all are 0."""
        pairs = zip((row.cause for row in self.budget), self.fractions, strict=True)
        cause, fraction = max(pairs, key=lambda pair: pair[1], default=("", 0.0))
        return (cause, fraction) if fraction > 0.0 else None

    @property
    def distinct_estimate(self) -> float | None:
        """Estimate if a report shows it beside the value, see `find_distinct_estimate`."""
        if self.value is None:
            return None
        return find_distinct_estimate(self.value, self.estimate, self.interval)

    @property
    def best_estimate(self) -> float | None:
        """Estimate; the value if there is no estimate."""
        return self.value if self.estimate is None else self.estimate

    @property
    def seal(self) -> str:
        """SHA-256 of the numbers, equal in every file of the test."""
        interval = self.interval
        ends = (interval.lower, interval.upper, interval.level) if interval else (None, None, None)
        numbers = (self.value, *ends, self.best_estimate)
        return compute_seal(self.name, self.unit, self.status, numbers)

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of the reasons, each once."""
        return tuple(dict.fromkeys(reason.code for reason in self.reasons))

    @property
    def reason_text(self) -> str:
        """Reasons as text, such as ``not_reached: the branch ends at 4.2 mm``."""
        return join_reasons(self.reasons)


def find_result(results: Iterable[Result], name: str) -> Result | None:
    """Find the result with a name; None if there is none."""
    return next((result for result in results if result.name == name), None)


@dataclass(frozen=True, slots=True)
class Specimen:
    """Tested specimen.

    Parameters
    ----------
    type, spool, sample : names of the type, of the spool of this type, and of the sample that was
        cut from the spool
    dimensions : dimensions, m, keyed by name, such as ``length``
    bundle : composition of a harness bundle; None for any other specimen
    labels : text of each other property in the test sheet, keyed by name
    observed : answer to each question of the protocol, keyed by question; no groups depend on it
    """

    type: str
    spool: str
    sample: str
    dimensions: Mapping[str, float] = field(default_factory=dict)
    bundle: Bundle | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    observed: Mapping[str, str] = field(default_factory=dict)

    @property
    def fields(self) -> Mapping[str, str]:
        """Text of each grouping field; a label overrides a field of the same name."""
        names = {"type": self.type, "spool": self.spool}
        return names | dict(self.bundle.fields if self.bundle else {}) | dict(self.labels)


@dataclass(frozen=True, slots=True)
class InputFile:
    """Export of a test, with its fingerprint.

    Parameters
    ----------
    role : role in the test, such as ``force``, ``markers`` or ``frame``
    file : name of the file in the folder of the test
    sha256 : SHA-256 of the file, hexadecimal
    bytes : size of the file, byte
    """

    role: str
    file: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Instrument:
    """Instrument of a test, with its calibration certificate.

    Parameters
    ----------
    channel : name of its channel in the protocol; ``markers`` for the cameras
    measures : quantities that depend on the instrument, such as ``force``
    certificate : number of the certificate
    calibrated : day of the calibration
    due : day of the next calibration; None if the certificate does not state it
    uncertainty : expanded relative uncertainty of the scale; None if the certificate does not state
        it
    k : coverage factor of `uncertainty`
    """

    channel: str
    measures: tuple[str, ...]
    certificate: str
    calibrated: date
    due: date | None = None
    uncertainty: float | None = None
    k: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class TestResult:
    """All data of one processed test, as stored in its result file.

    Parameters
    ----------
    test : name of the test
    specimen : tested specimen
    protocol : name of the protocol
    protocol_yaml : resolved protocol with its defaults
    test_yaml : test sheet as written
    labpipe_version : version of labpipe that processed the test
    inputs : exports of the test
    recordings : recording of each role, with the channels that the protocol names and all marker
        tracks
    aligned, curve, shape : stages of processing; None if the protocol does not request a stage, or
        if it failed
    results : results in the order of the protocol
    quality : quality notes of readers and steps
    display : display unit of each quantity (``displacement: mm``)
    figures : names of the figures that the protocol requests
    slips : slips of the curve
    lines : straight lines whose slopes are stiffnesses
    bending : measured bending law; None if the protocol does not request it, or if it failed
    run : key of exports, test sheet, protocol and processing, the same in all files of the test;
        empty in old results
    date : day of the test from its sheet, or from its exports; None if neither states it
    operator : operator of the test; empty if the sheet does not state it
    instruments : instruments whose certificates the protocol states
    """

    __test__ = False  # otherwise pytest would collect a class of this name

    test: str
    specimen: Specimen
    protocol: str
    protocol_yaml: str
    test_yaml: str
    labpipe_version: str
    inputs: tuple[InputFile, ...]
    recordings: Mapping[str, Recording]
    aligned: Aligned | None
    curve: Curve | None
    shape: Shape | None
    results: tuple[Result, ...]
    quality: tuple[QualityNote, ...]
    display: Mapping[str, str] = field(default_factory=dict)
    figures: tuple[str, ...] = ()
    slips: tuple[Slip, ...] = ()
    lines: tuple[FittedLine, ...] = ()
    bending: Bending | None = None
    run: str = ""
    date: Day | None = None
    operator: str = ""
    instruments: tuple[Instrument, ...] = ()
