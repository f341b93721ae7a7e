"""``labpipe process``: process exports into results and figures."""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labpipe.campaign.executors import choose_default_jobs, process_tests
from labpipe.cli.terminal import (
    compute_name_width,
    format_result,
    format_statuses,
    shorten_path,
    show_completion,
)
from labpipe.messages import format_sentence
from labpipe.process.output_paths import find_tests
from labpipe.process.run import ProcessedTest, RefusedTest
from labpipe.records.result import Result
from labpipe.report.wording import choose_unit
from labpipe.store.summaries import build_summary


def run(options: argparse.Namespace) -> int:
    """Process tests; return 2 if a test is refused, 1 if a result failed, otherwise 0."""
    tests = find_tests(options.tests)
    processed_tests, n_refused = process_all(
        tests, options, out=options.out, timeout=options.timeout, follow_links=options.follow_links
    )
    if not processed_tests:
        return 2  # `process_all` has printed the reasons
    if options.json:
        summaries = [build_summary(test.result) for test in processed_tests]
        print(json.dumps(summaries[0] if len(tests) == 1 else summaries, indent=2))
    else:
        print("\n\n".join(map(format_test, processed_tests)))
    return 2 if n_refused else int(any(test.n_failed for test in processed_tests))


def process_all(
    tests: list[Path], options: argparse.Namespace, **arguments: Any
) -> tuple[list[ProcessedTest], int]:
    """Process tests; print the reasons for refused tests, and completed replacements of files.

    Parameters
    ----------
    tests : path of the test.yaml or result.h5 of each test
    options : options of a command, including those for figures and jobs
    arguments : further keyword arguments of `process_tests`

    Returns
    -------
    processed : processed tests
    n_refused : number of tests that were refused
    """
    with show_completion("test") as (begin, show):
        begin(len(tests))
        outcomes = process_tests(
            tests,
            figures=not options.no_figures,
            png=options.png,
            jobs=options.jobs or choose_default_jobs(),
            on_outcome=lambda source: show(source.parent.name),
            **arguments,
        )
    for outcome in outcomes:
        if isinstance(outcome, RefusedTest):
            print(f"labpipe process: {outcome.reason}", file=sys.stderr)
        elif outcome.has_completed_replacement:
            completed = format_sentence("cli.replacement_completed")
            print(f"labpipe process: {outcome.folder}: {completed}", file=sys.stderr)
    processed = [outcome for outcome in outcomes if isinstance(outcome, ProcessedTest)]
    return processed, len(outcomes) - len(processed)


def format_test(processed: ProcessedTest) -> str:
    """Format the results of one test for a terminal.

    Parameters
    ----------
    processed : processed test

    Returns
    -------
    A heading, the results, the reasons for doubtful and failed results, and the notes that are
    warnings or errors.
    """
    test = processed.result
    width = compute_name_width(result.name for result in test.results)
    # Results of one quantity in several cycles, such as energy.1 and energy.2, are grouped.
    results_by_quantity = defaultdict[str, list[Result]](list)
    names_by_reason = defaultdict[str, list[str]](list)
    for result in test.results:
        results_by_quantity[result.name.partition(".")[0]].append(result)
        if result.reasons:
            names_by_reason[f"{result.status}: {result.reason_text}"].append(result.name)
    lines = [format_headline(processed)]
    for results in results_by_quantity.values():
        lines += _format_cycles(results, dict(test.display), width)
    lines += [f"  {reason}  [{', '.join(names)}]" for reason, names in names_by_reason.items()]
    for note in test.quality:
        if note.severity != "info":
            names_location = note.message.startswith(note.where.partition(",")[0])
            location = "" if names_location else f"{note.where}: "
            lines.append(f"  {note.severity}: {location}{note.message}")
    return "\n".join(lines)


def format_headline(processed: ProcessedTest) -> str:
    """Format the name, protocol, numbers of results and results folder of a test in one line.

    Parameters
    ----------
    processed : processed test
    """
    result = processed.result
    counts = format_statuses(result.results)
    return f"{result.test}  ({result.protocol}): {counts}  ->  {shorten_path(processed.folder)}"


def _format_cycles(results: list[Result], display: Mapping[str, str], width: int) -> list[str]:
    """Format a line per cycle; of more than 8 cycles, format the first 4 and the others' range."""
    max_lines = 8
    n_listed = len(results) if len(results) <= max_lines else max_lines // 2
    lines = [format_result(result, display, width) for result in results[:n_listed]]
    if other_results := results[n_listed:]:
        factor, unit = choose_unit(results[0].name, results[0].unit, display)
        values = [factor * result.value for result in other_results if result.value is not None]
        range_text = f"{min(values):.5g} to {max(values):.5g} {unit}" if values else "no value"
        name, n_others = f"... to {other_results[-1].name}", len(other_results)
        lines.append(f"  {name:<{width}} {range_text} ({n_others} more in summary.json)")
    return lines
