"""What the commands say: progress while they work, a table when they are done."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from labpipe.pipeline.process import Processed
from labpipe.records.result import Result, Status
from labpipe.units import si_factor

_STAGES = ("read", "process", "write", "draw")
_MARK = {Status.OK: " ", Status.DOUBTFUL: "?", Status.FAILED: "!"}
_QUANTITY = {"m": "displacement", "N": "force", "N/m": "stiffness", "J": "energy", "s": "time"}


def progress(tests: list[Path]) -> Iterator[tuple[Path, Callable[[str], None]]]:
    """Go through tests with a bar on a terminal, and with a line each in a pipe.

    Parameters
    ----------
    tests : test.yaml or result.h5 files

    Yields
    ------
    test : one of them
    say : to be called with each stage as it begins
    """
    if not sys.stderr.isatty():
        for number, test in enumerate(tests, start=1):
            print(f"{number}/{len(tests)} {test.parent.name}", file=sys.stderr)
            yield test, lambda _: None
        return
    from tqdm import tqdm

    with tqdm(total=len(tests) * len(_STAGES), unit="stage", leave=False, delay=1.0) as bar:
        for number, test in enumerate(tests):
            bar.n = number * len(_STAGES)

            def say(stage: str, name: str = test.parent.name) -> None:
                bar.set_description(f"{name}: {stage}")
                bar.update()

            yield test, say


def table(processed: Processed) -> str:
    """Lay out the results of one test for a terminal.

    Parameters
    ----------
    processed : the test

    Returns
    -------
    A heading, one line per result, then what is doubtful or failed with its reason.
    """
    result = processed.result
    counts = Counter(each.status for each in result.results)
    said = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    lines = [f"{result.test}  ({result.protocol}): {said}  ->  {processed.folder}"]
    lines += [_line(each, dict(result.display)) for each in result.results]
    reasons: dict[str, list[str]] = {}
    for each in result.results:
        if each.reason:
            reasons.setdefault(f"{each.status}: {each.reason}", []).append(each.name)
    lines += [f"  {reason}  [{', '.join(names)}]" for reason, names in reasons.items()]
    warnings = [note for note in result.quality if note.severity != "info"]
    lines += [f"  {note.severity}: {note.where}: {note.message}" for note in warnings]
    return "\n".join(lines)


def _line(result: Result, display: dict[str, str]) -> str:
    unit, factor = result.unit, 1.0
    if result.name == "clock_drift":
        unit, factor = "ppm", 1e6
    elif (wanted := display.get(_QUANTITY.get(result.unit, ""))) is not None:
        unit, factor = wanted, si_factor(result.unit, wanted)
    mark = _MARK[result.status]
    if result.value is None:
        return f"{mark} {result.name:<26}{'-':>12}"
    shown = f"{mark} {result.name:<26}{factor * result.value:>12.5g} {unit:<6}"
    if result.interval is None:
        return shown
    low, high = factor * result.interval.lower, factor * result.interval.upper
    return f"{shown} 95 %: {low:.5g} to {high:.5g}"
