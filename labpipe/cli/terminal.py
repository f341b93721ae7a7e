"""Show progress, and format paths and results, for several commands."""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from labpipe.records.result import Result, Status
from labpipe.report.wording import choose_unit, format_number

if TYPE_CHECKING:
    from tqdm import tqdm

_STATUS_MARKS = {Status.OK: " ", Status.DOUBTFUL: "?", Status.FAILED: "!"}


@contextmanager
def show_progress_bar(unit: str, total: int | None = None) -> Iterator[tqdm[NoReturn]]:
    """Show a progress bar on a terminal; it is disabled if the output is a pipe.

    Parameters
    ----------
    unit : noun for a counted item, such as ``test``
    total : number of items; None if it is not known yet
    """
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, leave=False, delay=1.0, disable=None) as bar:
        yield bar


@contextmanager
def show_completion(
    unit: str, total: int | None = None, *, in_pipe: bool = True
) -> Iterator[tuple[Callable[[int], None], Callable[[str], None]]]:
    """Show completed items, such as tests: a bar on a terminal, a line per item in a pipe.

    Parameters
    ----------
    unit : noun for an item, such as ``test``
    total : number of items; None if it is not known yet
    in_pipe : whether a line per item is printed in a pipe; otherwise nothing is shown there

    Yields
    ------
    begin : function that sets the number of items, if it was not known before
    show : function to call with the name of an item when it is completed
    """
    counter = itertools.count(1)
    with show_progress_bar(unit, total) as bar:

        def show(text: str) -> None:
            if bar.disable and in_pipe:
                print(f"{next(counter)}/{bar.total} {text}", file=sys.stderr)
            bar.set_description(text)
            bar.update()

        yield bar.reset, show


def shorten_path(path: Path) -> Path:
    """Return a path relative to the working folder if it is below that folder.

    Parameters
    ----------
    path : absolute or relative path
    """
    folder = Path.cwd()
    return path.relative_to(folder) if path.is_relative_to(folder) else path


def compute_name_width(names: Iterable[str]) -> int:
    """Compute the width of a column of names, in characters."""
    min_width = 26  # the columns of most tests are then aligned with each other
    return max(min_width, *(len(name) for name in names), 0)


def format_statuses(results: Iterable[Result]) -> str:
    """Format the number of results of each status, such as ``20 ok, 1 doubtful``.

    Parameters
    ----------
    results : results of a test or a harness
    """
    counts = Counter(result.status for result in results)
    return ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])


def format_result(result: Result, display: Mapping[str, str], width: int) -> str:
    """Format a result with its interval and the largest cause of its uncertainty.

    Parameters
    ----------
    result : result of a test, or the mean of a group
    display : display unit of each quantity, keyed by quantity
    width : width of the column of names, in characters
    """
    interval_width = 26  # characters
    factor, unit = choose_unit(result.name, result.unit, display)
    mark = _STATUS_MARKS[result.status]
    if result.value is None:
        return f"{mark} {result.name:<{width}}{'-':>12}"
    estimate = result.distinct_estimate
    texts = format_number(result.value, result.interval, factor, digits=5, estimate=estimate)
    line = f"{mark} {result.name:<{width}}{texts.value:>12} {unit:<6}"
    if result.interval is None:
        return line
    interval = f"95 %: {texts.lower} to {texts.upper}"
    if texts.estimate:
        interval = f"estimate {texts.estimate}, {interval}"
    if result.largest_cause is None:
        return f"{line} {interval}"
    cause, share = result.largest_cause
    return f"{line} {interval:<{interval_width}} {cause} {100.0 * share:.0f} %"
