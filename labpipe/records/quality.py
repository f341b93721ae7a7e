"""Quality notes: what a careful person would want to know about a test."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Severity(StrEnum):
    """How much a quality note matters."""

    INFO = "info"
    """Worth knowing; changes nothing."""
    WARNING = "warning"
    """Results that depend on it are doubtful, or were repaired."""
    ERROR = "error"
    """Something asked for could not be had."""


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
