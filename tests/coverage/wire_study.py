"""The study of calibrations: campaigns by seed, one JSON line each, in parts.

Seeds were fixed before the first run and are never changed. Campaigns are drawn in rounds, so that
after any time all kinds have about the same share of theirs. A line says which commit made it and
what it rests on; where that has changed since, the campaign is made again.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from tests.coverage import wire_campaigns
from tests.coverage.rests_on import ROOT, digest_of
from tests.coverage.study import line_of, make_lines, read_lines
from tests.coverage.wire_campaigns import KINDS, WireKind

Line = dict[str, Any]
"""Of one campaign: kind, seed, commit, rests_on, seconds, error, and what `rows` gives."""

FILE = ROOT / "processed" / "wire-coverage.jsonl"


@cache
def rests_on() -> str:
    """Digest of the code that makes the numbers."""
    return digest_of("tests.coverage.wire_campaigns")


def read(file: Path) -> list[Line]:
    """Campaigns that still hold, each once, in the order of the kinds."""
    return read_lines(file, (kind.name for kind in KINDS), rests_on())


def missing(file: Path, kinds: Iterable[WireKind] = KINDS) -> list[tuple[WireKind, int]]:
    """Campaigns that were not made yet, or rest on what has changed.

    In rounds: of each kind, the one with the smallest share of its seeds behind it comes first.
    """
    done = {(line["kind"], line["seed"]) for line in read(file)}
    wanted = [
        (number / kind.campaigns, kind, seed)
        for kind in kinds
        for number, seed in enumerate(kind.seeds)
        if (kind.name, seed) not in done
    ]
    return [(kind, seed) for _, kind, seed in sorted(wanted, key=lambda each: each[0])]


def one(kind: WireKind, seed: int) -> Line:
    """Make and calibrate one campaign; an error that nobody expects is kept in its line."""
    return line_of(kind.name, seed, rests_on(), lambda: wire_campaigns.rows(kind, seed))


def carry_on(
    file: Path, *, minutes: float, jobs: int = 2, kinds: Iterable[WireKind] = KINDS
) -> int:
    """Go on with the study for some minutes.

    Parameters
    ----------
    file : of the lines; made if it is not there
    minutes : no campaign is begun after them
    jobs : processes
    kinds : which campaigns

    Returns
    -------
    How many campaigns are still missing.
    """
    wanted = missing(file, kinds)
    return len(wanted) - make_lines(file, one, wanted, minutes=minutes, jobs=jobs)
