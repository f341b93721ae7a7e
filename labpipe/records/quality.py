"""Reasons and quality notes: what a careful person would want to know about a test."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Self

from labpipe.messages import find_code, find_template, format_sentence


class Severity(StrEnum):
    """How much a quality note matters."""

    INFO = "info"
    """Worth knowing; changes nothing."""
    WARNING = "warning"
    """Results that depend on it are doubtful, or were repaired."""
    ERROR = "error"
    """Something asked for is not available."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a number is doubtful, is not available, or has no interval.

    Parameters
    ----------
    code : stable, snake case, such as ``not_reached``: what programs go by
    message : one sentence with the numbers and their units, for people
    """

    code: str
    message: str

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"

    @classmethod
    def of(cls, name: str, /, **facts: object) -> Self:
        """Make a reason from a template of a room.

        Parameters
        ----------
        name, facts : see `labpipe.messages.format_sentence`
        """
        return cls(find_code(name), format_sentence(name, **facts))


def join_reasons(reasons: Iterable[Reason]) -> str:
    """Join reasons into one line for people: codes and sentences; empty if there are none.

    Examples
    --------
    >>> join_reasons([Reason("drift", "the zero drifts"), Reason("gap", "4 samples are missing")])
    'drift: the zero drifts; gap: 4 samples are missing'
    """
    return "; ".join(map(str, reasons))


@dataclass(frozen=True, slots=True)
class QualityNote:
    """One remark on a recording or a test: gap, drift, saturation, repaired marker.

    Parameters
    ----------
    code : stable, snake case, such as ``time_holes``
    severity : how much it matters
    where : role, channel or marker it speaks of, with time or frames where it has them
    message : one sentence with the numbers and their units
    stretches : s, the stretches of the recording that it speaks of; none where it speaks of all.
        For those who draw conclusions while a test is processed; not stored.
    tests : the tests of a group that it speaks of; none where it speaks of all; not stored
    """

    code: str
    severity: Severity
    where: str
    message: str
    stretches: tuple[tuple[float, float], ...] = field(default=(), compare=False)
    tests: tuple[str, ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, name: str, where: str, /, *stretches: tuple[float, float], **facts: object) -> Self:
        """Make a note from a template of a room.

        Parameters
        ----------
        name, facts : see `labpipe.messages.format_sentence`
        where, stretches : see the class
        """
        severity = Severity(find_template(name)["severity"].partition(" or ")[0])
        return cls(find_code(name), severity, where, format_sentence(name, **facts), stretches)


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why results that rest on a quantity are doubtful.

    Parameters
    ----------
    quantity : ``force``, ``displacement``, ``clock``, ``start``, or the name of another channel
    reason : why
    during : s, stretch of the record that is touched, on the clock `clock`; None for all. Results
        of other stretches are left alone, unless the zero was taken there
    clock : that `during` is counted on; empty for that of the curve
    """

    quantity: str
    reason: Reason
    during: tuple[float, float] | None = None
    clock: str = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding about a test and its consequences.

    Parameters
    ----------
    note : for people
    doubts : what it makes doubtful
    blocks : whether later stages are not available because of it
    """

    note: QualityNote
    doubts: tuple[Doubt, ...] = ()
    blocks: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        where: str,
        /,
        *quantities: str,
        during: tuple[float, float] | None = None,
        clock: str = "",
        blocks: bool = False,
        **facts: object,
    ) -> Self:
        """Make a finding from a template of a room.

        Parameters
        ----------
        name, where, facts : see `QualityNote.of`
        quantities, during, clock : what it makes doubtful, see `Doubt`
        blocks : see the class
        """
        note = QualityNote.of(name, where, **facts)
        reason = Reason(note.code, note.message)
        doubts = tuple(Doubt(quantity, reason, during, clock) for quantity in quantities)
        return cls(note, doubts, blocks)

    @property
    def code(self) -> str:
        """Return the code of the note."""
        return self.note.code


def doubt_stretches(
    quantity: str, note: QualityNote, clock: str, *, max_stretches: int = 100
) -> Finding:
    """Doubt a quantity in the stretches that a note speaks of, or in all of the record.

    Parameters
    ----------
    quantity : see `Doubt`
    note : with stretches on the clock named `clock`, or without any
    clock : role of the recording
    max_stretches : stretches; more of them are taken as one, from the first to the last
    """
    stretches = note.stretches
    if len(stretches) > max_stretches:
        stretches = ((stretches[0][0], stretches[-1][1]),)
    note, reason = replace(note, severity=Severity.WARNING), Reason(note.code, note.message)
    return Finding(
        note, tuple(Doubt(quantity, reason, stretch, clock) for stretch in stretches or (None,))
    )


@dataclass(frozen=True, slots=True)
class Findings:
    """All findings of a test in order.

    Parameters
    ----------
    entries : in order of the checks; duplicates are counted once
    """

    entries: tuple[Finding, ...] = ()

    def __add__(self, more: Iterable[Finding]) -> Findings:
        return Findings((*self.entries, *more))

    def without(self, code: str) -> Findings:
        """Omit findings that another one explains."""
        return Findings(tuple(finding for finding in self.entries if finding.code != code))

    @property
    def notes(self) -> tuple[QualityNote, ...]:
        """Return the notes, each once."""
        return tuple(dict.fromkeys(finding.note for finding in self.entries))

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Return the doubts, each once."""
        return tuple(dict.fromkeys(doubt for finding in self.entries for doubt in finding.doubts))

    @property
    def blocked(self) -> Reason | None:
        """Return the first finding by which later stages are not available, or None."""
        return next(
            (
                Reason(finding.code, finding.note.message)
                for finding in self.entries
                if finding.blocks
            ),
            None,
        )
