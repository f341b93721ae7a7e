"""Reasons and quality notes: what a careful person would want to know about a test."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum


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


def worded(reasons: Iterable[Reason]) -> str:
    """Word reasons for people: codes and sentences in one line, empty where there are none.

    Examples
    --------
    >>> worded([Reason("drift", "the zero drifts"), Reason("gap", "4 samples are missing")])
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
    """

    code: str
    severity: Severity
    where: str
    message: str
    stretches: tuple[tuple[float, float], ...] = field(default=(), compare=False)
