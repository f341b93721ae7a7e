"""What is doubted of a test, in a form that tests can look at."""

from __future__ import annotations

from collections.abc import Iterable

from labpipe.records.quality import Finding, Findings
from labpipe.results.evidence import Evidence


def doubted(found: Evidence | Iterable[Finding]) -> dict[str, str]:
    """The first reason of each quantity that is in doubt anywhere in the record."""
    findings = found.findings if isinstance(found, Evidence) else Findings() + found
    reasons: dict[str, str] = {}
    for doubt in findings.doubts:
        reasons.setdefault(doubt.quantity, str(doubt.reason))
    return reasons
