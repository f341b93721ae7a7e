"""What a command costs as a whole process, and two commands in turn."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
RUNS = 5
_LAUNCH = str(Path(__file__).with_name("launch.py"))
_MAIN = "import sys; from labpipe.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Cost:
    """Seconds on the clock, seconds of all processors, and peak memory in MB."""

    wall: float
    cpu: float
    memory: float = 0.0


@dataclass(frozen=True)
class Paired:
    """Median costs of two commands that ran in turn, and the medians of the ratios of the pairs."""

    one: Cost
    other: Cost
    wall: float
    cpu: float


def labpipe(*arguments: object) -> list[str]:
    """The command line of whichever labpipe PYTHONPATH leads to."""
    return [sys.executable, "-P", "-c", _MAIN, *map(str, arguments)]


def timed(command: Sequence[str], *, tree: Path = REPOSITORY) -> Cost:
    """Run a command with the packages and protocols of a tree, as one process with its children."""
    ran = subprocess.run(
        [sys.executable, "-I", "-S", _LAUNCH, *command],
        check=True,
        capture_output=True,
        text=True,
        cwd=tree,
        env=_as_installed(tree),
    )
    status, *spent = json.loads(ran.stdout)
    if status not in {0, 1} or "Traceback" in ran.stderr:
        message = f"{command} ended with {status}: {ran.stderr}"
        raise RuntimeError(message)
    return Cost(*spent)


@cache
def _as_installed(tree: Path) -> dict[str, str]:
    """The environment of a user, whose modules were compiled when they were first imported."""
    cache_folder = Path(tempfile.gettempdir()) / "labpipe-bench-bytecode"
    settings = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(cache_folder)}
    return os.environ | settings | {"PYTHONPATH": str(tree)}


def in_turn(
    one: Callable[[], Cost], other: Callable[[], Cost], *, runs: int = RUNS, warm: int = 1
) -> Paired:
    """Run two things in turn, each first in every other pair, after some runs that do not count."""
    for _ in range(warm):
        one(), other()
    pairs = []
    for number in range(runs):
        if number % 2:
            last = other()
            pairs.append((one(), last))
        else:
            pairs.append((one(), other()))
    return Paired(
        median([a for a, _ in pairs]),
        median([b for _, b in pairs]),
        statistics.median(a.wall / b.wall for a, b in pairs),
        statistics.median(a.cpu / b.cpu for a, b in pairs),
    )


def paired(one: Sequence[str], other: Sequence[str], *, runs: int = RUNS) -> Paired:
    """Two commands in turn."""
    return in_turn(lambda: timed(one), lambda: timed(other), runs=runs)


def median(costs: Sequence[Cost]) -> Cost:
    """Median times, and the largest memory."""
    return Cost(
        statistics.median(cost.wall for cost in costs),
        statistics.median(cost.cpu for cost in costs),
        max(cost.memory for cost in costs),
    )
