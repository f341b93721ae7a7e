"""``labpipe process``: exports to results and figures."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path

from labpipe.campaign.executors import default_jobs, process_tests
from labpipe.cli.terminal import (
    compute_name_width,
    count_statuses,
    format_result,
    shorten_path,
    show_completed,
)
from labpipe.messages import format_sentence
from labpipe.process.output_paths import find_tests
from labpipe.process.run import Processed, Refused
from labpipe.records.quality import QualityNote
from labpipe.records.result import Result
from labpipe.report.wording import find_display_unit
from labpipe.store.summaries import build_summary


def run(options: argparse.Namespace) -> int:
    """Process tests; a faulty one does not stop the others."""
    tests = find_tests(options.tests)
    processed, refused = process_all(
        tests,
        out=options.out,
        figures=not options.no_figures,
        png=options.png,
        jobs=options.jobs,
        limit=60.0 * options.limit,
        follow_links=options.follow_links,
    )
    if not processed:
        return 2  # messages are printed already
    if options.json:
        summaries = [build_summary(test.result) for test in processed]
        print(json.dumps(summaries[0] if len(tests) == 1 else summaries, indent=2))
    else:
        print("\n\n".join(format_test(test) for test in processed))
    if refused:
        return 2
    return 1 if any(test.n_failed for test in processed) else 0


def process_all(
    tests: list[Path],
    *,
    out: Path | None,
    figures: bool,
    jobs: int | None,
    limit: float | None = None,
    png: bool = False,
    follow_links: bool = False,
) -> tuple[list[Processed], int]:
    """Process tests, and print why some are refused.

    Returns
    -------
    processed : the processed tests
    refused : number of tests that were refused
    """
    with show_completed("test") as (begin, show):
        begin(len(tests))
        outcomes = process_tests(
            tests,
            out=out,
            figures=figures,
            png=png,
            follow_links=follow_links,
            jobs=jobs or default_jobs(),
            limit=limit,
            on_outcome=lambda test: show(test.parent.name),
        )
    for outcome in outcomes:
        if isinstance(outcome, Refused):
            print(f"labpipe process: {outcome.reason}", file=sys.stderr)
        elif outcome.finished:
            completed = format_sentence("cli.replacement_completed")
            print(f"labpipe process: {outcome.folder}: {completed}", file=sys.stderr)
    processed = [outcome for outcome in outcomes if isinstance(outcome, Processed)]
    return processed, len(outcomes) - len(processed)


def format_test(processed: Processed) -> str:
    """Format the results of one test for a terminal.

    Parameters
    ----------
    processed : the test

    Returns
    -------
    A heading, one line per result, then reasons for doubtful and failed results.
    """
    result = processed.result
    lines, width = (
        [format_headline(processed)],
        compute_name_width(result.name for result in result.results),
    )
    quantities: dict[str, list[Result]] = {}  # energy.1, energy.2, ... together
    for quantity in result.results:
        quantities.setdefault(quantity.name.partition(".")[0], []).append(quantity)
    for cycles in quantities.values():
        lines += _format_quantity(cycles, dict(result.display), width)
    reasons: dict[str, list[str]] = {}
    for quantity in result.results:
        if quantity.reasons:
            reasons.setdefault(f"{quantity.status}: {quantity.reason_text}", []).append(
                quantity.name
            )
    lines += [f"  {reason}  [{', '.join(names)}]" for reason, names in reasons.items()]
    warnings = [note for note in result.quality if note.severity != "info"]
    lines += [f"  {note.severity}: {_format_note(note)}" for note in warnings]
    return "\n".join(lines)


def _format_note(note: QualityNote) -> str:
    """Format a note: its place and message, unless the message begins with the place."""
    has_place = note.message.startswith(note.where.partition(",")[0])
    return note.message if has_place else f"{note.where}: {note.message}"


def format_headline(processed: Processed) -> str:
    """Summarise a test in one line.

    Parameters
    ----------
    processed : the test
    """
    result = processed.result
    counts = count_statuses(result.results)
    return f"{result.test}  ({result.protocol}): {counts}  ->  {shorten_path(processed.folder)}"


def _format_quantity(results: list[Result], display: Mapping[str, str], width: int) -> list[str]:
    """Format a line per cycle; of many cycles, the first ones and the range of the others."""
    max_lines = 8
    if len(results) <= max_lines:
        return [format_result(result, display, width) for result in results]
    remaining = results[max_lines // 2 :]
    values = [result.value for result in remaining if result.value is not None]
    lines = [format_result(result, display, width) for result in results[: max_lines // 2]]
    if values:
        display_scale = find_display_unit(results[0].name, results[0].unit, display)
        low, high = display_scale.factor * min(values), display_scale.factor * max(values)
        span = f"{low:.5g} to {high:.5g} {display_scale.unit}"
        name = f"... to {remaining[-1].name}"
        lines.append(f"  {name:<{width}} {span} ({len(remaining)} more in summary.json)")
    return lines
