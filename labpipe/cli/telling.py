"""What the commands say: progress while they work, a table when they are done."""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.numbers import shown_in

if TYPE_CHECKING:
    from labpipe.pipeline.process import Processed
    from labpipe.pipeline.reporting import Reported
    from labpipe.records.group import GroupNumber

_STAGES = ("read", "process", "write", "draw")
_MARK = {Status.OK: " ", Status.DOUBTFUL: "?", Status.FAILED: "!"}
_MOST_CYCLES = 8
_LEAST_WIDTH = 26


@contextmanager
def progress(count: int) -> Iterator[Callable[[Path], Callable[[str], None]]]:
    """Show how far tests are: with a bar on a terminal, with a line each in a pipe.

    Parameters
    ----------
    count : of tests

    Yields
    ------
    begin : to be called with each test; it gives what is to be called with each stage as it begins
    """
    numbers = itertools.count()
    if not sys.stderr.isatty():

        def tell(test: Path) -> Callable[[str], None]:
            print(f"{next(numbers) + 1}/{count} {test.parent.name}", file=sys.stderr)
            return lambda _: None

        yield tell
        return
    from tqdm import tqdm

    with tqdm(total=count * len(_STAGES), unit="stage", leave=False, delay=1.0) as bar:

        def begin(test: Path) -> Callable[[str], None]:
            bar.n = next(numbers) * len(_STAGES)

            def say(stage: str) -> None:
                bar.set_description(f"{test.parent.name}: {stage}")
                bar.update()

            return say

        yield begin


@contextmanager
def reading(count: int) -> Iterator[Callable[[str], None]]:
    """Show on a terminal which test is being read; in a pipe, nothing.

    Parameters
    ----------
    count : of tests

    Yields
    ------
    say : to be called with the name of each test
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from tqdm import tqdm

    with tqdm(total=count + 1, unit="test", leave=False, delay=1.0) as bar:

        def say(name: str) -> None:
            bar.set_description(name)
            bar.update()

        yield say


def report_table(reported: Reported) -> str:
    """Lay out the main numbers of a report for a terminal.

    Parameters
    ----------
    reported : the report

    Returns
    -------
    A heading per group, one line per number with its interval, then where the files are.
    """
    lines: list[str] = []
    for group in reported.campaign.groups:
        spools = {sample.specimen.spool for sample in group.samples}
        count = f"{_several(len(group.samples), 'sample')} from {_several(len(spools), 'spool')}"
        lines.append(f"{group.name}  ({group.protocol}): {count}")
        display = dict(group.samples[0].display) if group.samples else {}
        width = _width(number.name for number in group.numbers)
        lines += [_mean_line(number, display, width) for number in group.numbers]
        lines.append("")
    lines.append(
        f"report: {from_here(reported.files[0])}" if reported.files else "report: nothing written"
    )
    return "\n".join(lines)


def _several(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _mean_line(number: GroupNumber, display: dict[str, str], width: int) -> str:
    mean = number.mean.chosen if number.mean is not None else None
    value = mean.mean if mean is not None else None
    interval = mean.interval if mean is not None else None
    status = Status.FAILED if value is None else Status.OK
    reasons = (Reason("no_samples", "no sample has it"),) if value is None else ()
    as_result = Result(number.name, value, number.unit, interval, status, reasons)
    missing = f"  ({len(number.left_out)} without)" if number.left_out else ""
    return f"{_line(as_result, display, width)}{missing}"


def table(processed: Processed) -> str:
    """Lay out the results of one test for a terminal.

    Parameters
    ----------
    processed : the test

    Returns
    -------
    A heading, one line per result, then what is doubtful or failed with its reasons.
    """
    result = processed.result
    lines, width = [headline(processed)], _width(each.name for each in result.results)
    for several in _by_quantity(result.results):
        lines += _lines(several, dict(result.display), width)
    reasons: dict[str, list[str]] = {}
    for each in result.results:
        if each.reasons:
            reasons.setdefault(f"{each.status}: {each.why}", []).append(each.name)
    lines += [f"  {reason}  [{', '.join(names)}]" for reason, names in reasons.items()]
    warnings = [note for note in result.quality if note.severity != "info"]
    lines += [f"  {note.severity}: {note.where}: {note.message}" for note in warnings]
    return "\n".join(lines)


def headline(processed: Processed) -> str:
    """Say in one line what became of a test.

    Parameters
    ----------
    processed : the test
    """
    result = processed.result
    counts = Counter(each.status for each in result.results)
    said = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    return f"{result.test}  ({result.protocol}): {said}  ->  {from_here(processed.folder)}"


def from_here(path: Path) -> Path:
    """A path as seen from the working folder, if it lies below.

    Parameters
    ----------
    path : absolute or relative
    """
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _width(names: Iterable[str]) -> int:
    """Room for the names of a table."""
    return max(_LEAST_WIDTH, *(len(name) for name in names), 0)


def _by_quantity(results: Sequence[Result]) -> list[list[Result]]:
    """Results of one quantity together: ``energy.1``, ``energy.2``, ..."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.name.partition(".")[0], []).append(result)
    return list(groups.values())


def _lines(results: list[Result], display: dict[str, str], width: int) -> list[str]:
    """One line each; of many cycles only the first ones and the range of the rest."""
    if len(results) <= _MOST_CYCLES:
        return [_line(result, display, width) for result in results]
    rest = results[_MOST_CYCLES // 2 :]
    values = [result.value for result in rest if result.value is not None]
    lines = [_line(result, display, width) for result in results[: _MOST_CYCLES // 2]]
    if values:
        shown = shown_in(results[0].name, results[0].unit, display)
        low, high = shown.factor * min(values), shown.factor * max(values)
        span = f"{low:.5g} to {high:.5g} {shown.unit}"
        name = f"... to {rest[-1].name}"
        lines.append(f"  {name:<{width}} {span} ({len(rest)} more in summary.json)")
    return lines


def _line(result: Result, display: dict[str, str], width: int) -> str:
    factor, unit = shown_in(result.name, result.unit, display)
    mark = _MARK[result.status]
    if result.value is None:
        return f"{mark} {result.name:<{width}}{'-':>12}"
    shown = f"{mark} {result.name:<{width}}{factor * result.value:>12.5g} {unit:<6}"
    if result.interval is None:
        return shown
    low, high = factor * result.interval.lower, factor * result.interval.upper
    return f"{shown} 95 %: {low:.5g} to {high:.5g}"
