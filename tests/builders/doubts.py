"""What a bench doubts, in a form that tests can look at."""

from __future__ import annotations

from labpipe.pipeline.bench import Bench


def doubted(bench: Bench) -> dict[str, str]:
    """The first reason of each quantity that is in doubt anywhere in the record."""
    found: dict[str, str] = {}
    for doubt in bench.doubts:
        found.setdefault(doubt.quantity, str(doubt.reason))
    return found
