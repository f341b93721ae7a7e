"""Results of one test, and the test as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    """How far a result can be trusted."""

    OK = "ok"
    DOUBTFUL = "doubtful"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one cause adds to the doubt about a number (a row of its uncertainty budget).

    Parameters
    ----------
    cause : in words, such as ``noise of the force`` or ``gain of the load cell``
    change : what one standard uncertainty of the cause changes, in the unit of the number; with
        the sign of the change, of noise its standard deviation
    is_common : whether all tests of a rig share the cause, so that it does not average out
    """

    cause: str
    change: float
    is_common: bool = False


def find_distinct_estimate(
    value: float, estimate: float | None, interval: Interval | None
) -> float | None:
    """Return whether an estimate is so far from its value that both are shown.

    Parameters
    ----------
    value, estimate, interval : in one unit; the interval is that of the estimate

    Returns
    -------
    The estimate where it is off by more than half of the half width of the interval: the largest
    sample of a noisy plateau lies above what was there, even above its interval. None elsewhere.
    """
    if estimate is None or interval is None:
        return None
    half = 0.5 * (interval.upper - interval.lower)
    return estimate if abs(value - estimate) > 0.5 * half else None


def compute_seal(name: str, unit: str, status: str, numbers: Sequence[float | None]) -> str:
    """Return the SHA-256 over the numbers of a result, by which a changed file is found.

    Parameters
    ----------
    name, unit, status : of the result
    numbers : value, lower and upper end, level, estimate; what is not finite counts as None

    Examples
    --------
    >>> compute_seal("slack", "m", "ok", (1e-3, 9e-4, 1.1e-3, 0.95, 1e-3))[:8]
    'a69d6053'
    """
    finite = (None if x is None or not isfinite(x) else repr(float(x)) for x in numbers)
    return sha256(repr((name, unit, str(status), *finite)).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Result:
    """A number with unit, 95 % interval, status and reasons.

    The interval is that of `estimate`, and holds `value`.

    Parameters
    ----------
    name : stable, snake case, with a cycle after a dot: ``peak_force.1``
    value : in `unit`; None when it could not be computed
    unit : SI unit, ``1`` for a pure number
    interval : None when it is not available; a reason then says why
    status : ``failed`` exactly when `value` is None
    reasons : why a result is doubtful, failed, or lacks an interval; empty otherwise
    method : in words, how the value and the interval were made; the same in tests that were
        processed alike
    n : number of samples it rests on
    made_of : name of the result that it is made of, such as a stiffness; empty for none
    remark : addition to the method for this test alone, such as force that slips added
    estimate : the value less what noise adds to it on average, in the middle of the doubt; None
        where it is the value
    budget : what the interval is made of; empty where that is not known apart
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
            message = f"{self.name}: a {self.status} result must say why"
            raise ValueError(message)

    @property
    def full_method(self) -> str:
        """Return the method with the remark of this test."""
        return "; ".join(filter(None, (self.method, self.remark)))

    @property
    def shares(self) -> tuple[float, ...]:
        """Return the share of the variance of each row of the budget; 0 without a variance."""
        squares = [contribution.change**2 for contribution in self.budget]
        total = sum(squares)
        return tuple(square / total if total > 0.0 else 0.0 for square in squares)

    @property
    def largest_share(self) -> tuple[str, float] | None:
        """Return the cause with the largest share of the variance and that share, or None."""
        rows = zip(self.budget, self.shares, strict=True)
        largest = max(rows, key=lambda row: row[1], default=None)
        return None if largest is None or largest[1] == 0.0 else (largest[0].cause, largest[1])

    @property
    def distinct_estimate(self) -> float | None:
        """Return the estimate if it must be shown beside the value (`find_distinct_estimate`)."""
        return (
            None
            if self.value is None
            else find_distinct_estimate(self.value, self.estimate, self.interval)
        )

    @property
    def best_estimate(self) -> float | None:
        """Return the estimate, or else the value."""
        return self.value if self.estimate is None else self.estimate

    @property
    def seal(self) -> str:
        """Return the SHA-256 over its numbers, the same in every file of the test."""
        ends = self.interval
        span = (None, None, None) if ends is None else (ends.lower, ends.upper, ends.level)
        return compute_seal(
            self.name, self.unit, self.status, (self.value, *span, self.best_estimate)
        )

    @property
    def codes(self) -> tuple[str, ...]:
        """Return the codes of the reasons, each once."""
        return tuple(dict.fromkeys(reason.code for reason in self.reasons))

    @property
    def reason_text(self) -> str:
        """Return the reasons in words, such as ``not_reached: the branch ends at 4.2 mm``."""
        return join_reasons(self.reasons)


@dataclass(frozen=True, slots=True)
class Specimen:
    """What was tested.

    Parameters
    ----------
    type, spool, sample : nested: samples are cut from a spool, spools belong to a type
    dimensions : m, by name, such as ``length``
    bundle : what a harness bundle is made of; None for any other specimen
    labels : whatever else the test sheet says of the specimen, by name
    observed : answers to the questions of the protocol, by question; they make no groups
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
        """Return what groups can be made by, in words; labels go before the words of a bundle."""
        names = {"type": self.type, "spool": self.spool}
        return names | dict(self.bundle.fields if self.bundle else {}) | dict(self.labels)


@dataclass(frozen=True, slots=True)
class InputFile:
    """One export that went into a test, with the fingerprint that names it.

    Parameters
    ----------
    role : what it is for: ``force``, ``markers``, ``frame``
    file : name inside the test's folder
    sha256 : hexadecimal
    bytes : size
    """

    role: str
    file: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Instrument:
    """An instrument of a test, by the certificate of its calibration.

    Parameters
    ----------
    channel : of the protocol that it records; ``markers`` for the cameras
    measures : quantities that rest on it, such as ``force``
    certificate : its number
    calibrated : day of the calibration
    due : day on which the next one is due; None where the certificate does not say
    uncertainty : of the scale, expanded, as a ratio; None where the certificate does not say
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
    """Everything known of one processed test: what the store keeps and the report draws.

    Parameters
    ----------
    test : name of the test
    specimen : what was tested
    protocol : name of the protocol
    protocol_yaml : the resolved protocol, defaults filled in
    test_yaml : the test sheet as written
    labpipe_version : the version that made it
    inputs : the exports
    recordings : by role; channels reduced to those the protocol names, marker tracks whole
    aligned, curve, shape : the stages; None where the protocol does not ask for it or it failed
    results : in the order of the protocol
    quality : notes of readers and steps
    display : unit in which people see a quantity, by quantity (``displacement: mm``)
    figures : names of the figures that the protocol asks for
    slips : the slip ledger of the curve
    lines : the straight lines that stiffnesses were read from
    bending : measured moment-curvature; None where the protocol does not ask for it or it failed
    run : key of exports, test sheet, protocol and way of processing, in all files of the test;
        empty in a result from before there were keys
    date : day of the test, of its sheet, else of its exports; None where neither says it
    operator : who made the test, empty where the sheet does not say it
    instruments : those whose certificates the protocol states
    """

    __test__ = False  # not a test of this project, whatever its name suggests to pytest

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
