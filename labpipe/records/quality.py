"""Define reasons, quality notes, and findings about a test with their consequences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Self

from labpipe.messages import format_sentence, get_code, get_template


class Severity(StrEnum):
    """Severity of a quality note."""

    INFO = "info"
    """Information without consequences."""
    WARNING = "warning"
    """Dependent results are doubtful, or data were repaired."""
    ERROR = "error"
    """A requested result is not available."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a result is doubtful, not available, or without an interval.

    Parameters
    ----------
    code : stable name for programs in snake case, such as ``not_reached``
    message : one sentence for people, with values and their units
    """

    code: str
    message: str

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"

    @classmethod
    def of(cls, name: str, /, **facts: object) -> Self:
        """Make a reason from a message template.

        Parameters
        ----------
        name, facts : see `labpipe.messages.format_sentence`
        """
        return cls(get_code(name), format_sentence(name, **facts))


def join_reasons(reasons: Iterable[Reason]) -> str:
    """Join the codes and sentences of reasons, with each sentence once; empty without reasons.

    Parameters
    ----------
    reasons : reasons in order; several may have the same sentence

    Examples
    --------
    >>> join_reasons([Reason("drift", "the zero drifts"), Reason("gap", "4 samples are missing")])
    'drift: the zero drifts; gap: 4 samples are missing'
    """
    codes_by_message: dict[str, dict[str, None]] = {}
    for reason in reasons:
        codes_by_message.setdefault(reason.message, {})[reason.code] = None
    return "; ".join(f"{', '.join(codes)}: {text}" for text, codes in codes_by_message.items())


@dataclass(frozen=True, slots=True)
class QualityNote:
    """Note on the quality of a recording, a test or a group, such as a gap or a drift.

    Parameters
    ----------
    code : stable name for programs in snake case, such as ``time_holes``
    severity : severity of the note
    where : role, channel, marker or key concerned, with times or frames if the note has any
    message : one sentence with values and their units
    stretches : start and end of each stretch of the recording concerned, s; empty for the whole
        recording. Stretches are not stored
    tests : names of the tests of a group that are concerned; empty for all tests. Names of tests
        are not stored
    """

    code: str
    severity: Severity
    where: str
    message: str
    stretches: tuple[tuple[float, float], ...] = field(default=(), compare=False)
    tests: tuple[str, ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, name: str, where: str, /, *stretches: tuple[float, float], **facts: object) -> Self:
        """Make a note from a message template.

        Parameters
        ----------
        name, facts : see `labpipe.messages.format_sentence`
        where, stretches : see the class
        """
        severity = Severity(get_template(name)["severity"].partition(" or ")[0])
        code, message = get_code(name), format_sentence(name, **facts)
        return cls(code, severity, where, message, stretches=stretches)


@dataclass(frozen=True, slots=True)
class Doubt:
    """Doubt about all results that depend on a quantity.

    Parameters
    ----------
    quantity : ``force``, ``displacement``, ``clock``, ``start``, ``force_zero``, ``force_sign``,
        ``displacement_sign``, or the name of another channel
    reason : reason of the doubt
    period : start and end of the doubtful stretch of the record, s on the clock `clock`; None for
        the whole record. Results from other stretches are not doubtful, unless the zero was taken
        in this stretch
    clock : name of the clock of `period`; empty for that of the curve
    """

    quantity: str
    reason: Reason
    period: tuple[float, float] | None = None
    clock: str = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding about a test and its consequences.

    Parameters
    ----------
    note : note that describes the finding
    doubts : doubts about the quantities that the finding affects
    is_blocking : whether later stages of processing are unavailable because of the finding
    """

    note: QualityNote
    doubts: tuple[Doubt, ...] = ()
    is_blocking: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        where: str,
        /,
        *quantities: str,
        period: tuple[float, float] | None = None,
        clock: str = "",
        is_blocking: bool = False,
        **facts: object,
    ) -> Self:
        """Make a finding from a message template.

        Parameters
        ----------
        name, where, facts : see `QualityNote.of`
        quantities, period, clock : doubtful quantities, see `Doubt`
        is_blocking : see the class
        """
        note = QualityNote.of(name, where, **facts)
        reason = Reason(note.code, note.message)
        doubts = tuple(Doubt(quantity, reason, period, clock) for quantity in quantities)
        return cls(note, doubts, is_blocking)

    @property
    def code(self) -> str:
        """Code of the note."""
        return self.note.code


def make_stretch_finding(
    quantity: str, note: QualityNote, clock: str, *, max_stretches: int = 100
) -> Finding:
    """Make a finding that a quantity is doubtful in the stretches of a note.

    Parameters
    ----------
    quantity : doubtful quantity, see `Doubt`
    note : note with stretches on the clock `clock`; without stretches, the whole record is doubtful
    clock : role of the recording that has this clock
    max_stretches : largest number of doubts; more stretches than this are merged into one, from the
        start of the first to the end of the last
    """
    stretches = note.stretches
    if len(stretches) > max_stretches:
        stretches = ((stretches[0][0], stretches[-1][1]),)
    note, reason = replace(note, severity=Severity.WARNING), Reason(note.code, note.message)
    doubts = tuple(Doubt(quantity, reason, stretch, clock) for stretch in stretches or (None,))
    return Finding(note, doubts)


@dataclass(frozen=True, slots=True)
class Findings:
    """All findings of a test in order.

    Parameters
    ----------
    entries : findings in the order of the checks; they may contain duplicates
    """

    entries: tuple[Finding, ...] = ()

    def __add__(self, findings: Iterable[Finding]) -> Findings:
        return Findings((*self.entries, *findings))

    def remove_code(self, code: str) -> Findings:
        """Return the findings without those of a code."""
        return Findings(tuple(finding for finding in self.entries if finding.code != code))

    @property
    def notes(self) -> tuple[QualityNote, ...]:
        """Notes of the findings, each once."""
        return tuple(dict.fromkeys(finding.note for finding in self.entries))

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Doubts of the findings, each once."""
        return tuple(dict.fromkeys(doubt for finding in self.entries for doubt in finding.doubts))

    @property
    def blocking_reason(self) -> Reason | None:
        """Reason of the first finding that blocks later stages; None without one."""
        finding = next((finding for finding in self.entries if finding.is_blocking), None)
        return None if finding is None else Reason(finding.code, finding.note.message)
