"""The study of lines: by kind and seed, one JSON line each, in parts.

Seeds were fixed before the first run and are never changed. Lines are made in rounds, one of each
kind. A line says which commit made it and what it rests on; where that has changed since, it is
made again.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from tests.coverage.rests_on import ROOT, digest_of
from tests.coverage.study import line_of, make_lines, read_lines
from tests.line_coverage import predicted_lines
from tests.line_coverage.drawn_lines import KINDS, LineKind

Line = dict[str, Any]
"""Kind, seed, commit, rests_on, seconds, error, and what `predicted_lines.rows` gives."""

FILE = ROOT / "processed" / "line-coverage.jsonl"


@cache
def rests_on() -> str:
    """Digest of the code that makes the numbers."""
    return digest_of("tests.line_coverage.predicted_lines")


def read(file: Path) -> list[Line]:
    """Lines that still hold, each once, in the order of the kinds."""
    return read_lines(file, (kind.name for kind in KINDS), rests_on())


def missing(file: Path) -> list[tuple[LineKind, int]]:
    """Lines that were not made yet, or rest on what has changed, in rounds."""
    done = {(line["kind"], line["seed"]) for line in read(file)}
    rounds = zip(*(kind.seeds for kind in KINDS), strict=True)
    wanted = [each for seeds in rounds for each in zip(KINDS, seeds, strict=True)]
    return [(kind, seed) for kind, seed in wanted if (kind.name, seed) not in done]


def one(kind: LineKind, seed: int) -> Line:
    """Make, calibrate and predict one line; an error that nobody expects is kept in it."""
    return line_of(kind.name, seed, rests_on(), lambda: predicted_lines.rows(kind, seed))


def carry_on(file: Path, *, minutes: float, jobs: int = 2, part: tuple[int, int] = (0, 1)) -> int:
    """Go on with the study for some minutes.

    Parameters
    ----------
    file : of the lines; made if it is not there
    minutes : no line is begun after them
    jobs : processes
    part : which of how many equal parts of the seeds, for several files

    Returns
    -------
    How many lines are still missing.
    """
    which, parts = part
    wanted = [(kind, seed) for kind, seed in missing(file) if seed % parts == which]
    return len(wanted) - make_lines(file, one, wanted, minutes=minutes, jobs=jobs)
