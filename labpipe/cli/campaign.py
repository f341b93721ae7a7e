"""``labpipe campaign``: process many tests, query their results, and decide on them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from functools import partial
from typing import Any

from labpipe.campaign.campaign_files import CampaignFolders, find_campaign
from labpipe.campaign.catalog import FAILED, PENDING, REJECTED, RUNNING, STALE, STATES, TestRow
from labpipe.campaign.decisions import Decision, import_decision_file
from labpipe.campaign.executors import parse_executor
from labpipe.campaign.queries import (
    escape_controls,
    format_query_result,
    join_names,
    query_results,
    write_workbook,
)
from labpipe.campaign.running import (
    Overview,
    clear_failures,
    find_unknown_files,
    open_campaign,
    rebuild_catalog,
    record_decision,
    run_campaign,
)
from labpipe.cli.terminal import shorten_path, show_completion
from labpipe.errors import UsageError
from labpipe.process.run import Task
from labpipe.report.wording import format_count
from labpipe.store.replace import replace_file

_MAX_LISTED = 20
"""Largest number of tests or files in a printed list."""


def run(options: argparse.Namespace) -> int:
    """Run an action on a campaign."""
    return int(_ACTIONS[options.action](options, find_campaign(options.folder)))


def _run(
    options: argparse.Namespace, campaign: CampaignFolders, forced_folders: Sequence[str] = ()
) -> int:
    """Process new and changed tests, and the tests in `forced_folders`."""
    executor = parse_executor(options.executor, jobs=options.jobs, timeout=options.timeout)
    make_task = partial(
        Task, figures=not options.no_figures, png=options.png, follow_links=options.follow_links
    )
    with show_completion("test") as (begin, show):
        summary = run_campaign(
            campaign,
            executor,
            forced_folders=forced_folders,
            make_task=make_task,
            on_start=begin,
            on_outcome=lambda folder, state: show(f"{escape_controls(folder)}: {state}"),
        )
    overview, folders = summary.overview, summary.skipped_folders
    lines = [f"  processed {len(summary.processed_folders)} of {len(overview.rows)}"]
    if folders:
        lines.append(f"  {len(folders)} in use by another labpipe process: {join_names(folders)}")
    failed_rows = [row for row in overview.rows.values() if row.state == FAILED]
    failures = [f"{row.folder}  {row.code}: {row.reason}" for row in failed_rows]
    lines += _list_section(FAILED, failures)
    return _print_overview(campaign, overview, [*lines, *_list_unapplied_decisions(overview)])


def _status(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Print the states of the tests."""
    with open_campaign(campaign) as sync:
        overview = sync.refresh()
        unknown_files = find_unknown_files(sync, overview)
    if options.json:
        _print_to_stderr(overview.notes)
        print(json.dumps(_build_json(campaign, overview, unknown_files), indent=2))
        return _choose_exit_status(overview)
    descriptions: dict[str, Callable[[TestRow], str]] = {
        FAILED: lambda row: f"{row.code}: {row.reason}",
        STALE: lambda row: row.why,
        PENDING: lambda row: row.why,
        RUNNING: lambda row: "process {0.pid} on {0.machine}".format(overview.claims[row.folder]),
        REJECTED: lambda row: f"{row.why} ({row.decided_by}, {row.decided})",
    }
    lines: list[str] = []
    for state, describe in descriptions.items():
        rows = [row for row in overview.rows.values() if overview.get_state(row.folder) == state]
        lines += _list_section(state, [f"{row.folder}  {describe(row)}".rstrip() for row in rows])
    lines += [*_list_unapplied_decisions(overview), *_list_section("unknown files", unknown_files)]
    return _print_overview(campaign, overview, lines)


def _query(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Print or write the results that match the condition."""
    if options.out == "xlsx" and options.file is None:
        raise UsageError.about("cli.no_workbook_file", "--out xlsx")
    with open_campaign(campaign) as sync:
        _print_to_stderr(sync.refresh().notes)
        query_result = query_results(sync.catalog, options.where)
    if options.out == "xlsx":
        write_workbook(query_result, options.file)
    elif options.file is None:
        print(format_query_result(query_result, options.out), end="")
    else:
        text = format_query_result(query_result, options.out)
        with replace_file(options.file) as temporary:
            temporary.write_bytes(text.encode("utf-8", "backslashreplace"))
    print(format_count(len(query_result.rows), "row"), file=sys.stderr)
    return 0


def _replay(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Process failed tests again."""
    folders = clear_failures(campaign, options.failure_code)
    print(f"{format_count(len(folders), 'failure')} cleared", file=sys.stderr)
    return _run(options, campaign, folders)


def _decide(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Record a decision on a test, or import decisions from a file."""
    if options.decision_file is not None:
        return _import_decisions(options, campaign)
    if not options.test or not options.decision:
        raise UsageError.about("cli.no_decision", "labpipe campaign decide")
    for key in ("because", "by"):
        if not getattr(options, key).strip():
            raise UsageError.about("cli.no_reason", f"--{key}", option=f"--{key}")
    decision = Decision("", "", options.decision, options.because.strip(), options.by.strip())
    row = record_decision(campaign, options.test, decision)
    print(f"{escape_controls(row.folder)}: {row.state}")
    return 0


def _import_decisions(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Import the decisions that a report page saved."""
    if options.test:
        raise UsageError.about("cli.test_and_file", "--from", test=options.test)
    imported = import_decision_file(campaign.processed, campaign.name, options.decision_file)
    _print_to_stderr(imported.faults)
    for decision in imported.added:
        print(escape_controls(f"{decision.test}: {decision.decision}: {decision.describe()}"))
    for decision, reason in imported.not_imported:
        message = f"{decision.test}: {decision.decision} not imported: {reason}"
        print(escape_controls(message), file=sys.stderr)
    count = format_count(len(imported.added), "decision")
    print(f"{count} imported, {imported.n_stored_before} already recorded")
    return 2 if imported.faults or imported.not_imported else 0


def _watch(options: argparse.Namespace, campaign: CampaignFolders) -> int:
    """Process tests as their exports arrive."""
    from labpipe.campaign.watching import watch

    def show_message(text: str) -> None:
        print(f"{datetime.now():%H:%M:%S}  {text}", flush=True)

    watch(campaign, figures=not options.no_figures, show_message=show_message)
    return 0


_ACTIONS: dict[str, Callable[[argparse.Namespace, CampaignFolders], int]] = {
    "run": _run,
    "status": _status,
    "query": _query,
    "replay": _replay,
    "decide": _decide,
    "rebuild": lambda _, campaign: _print_overview(campaign, rebuild_catalog(campaign), []),
    "watch": _watch,
}
"""Functions of the actions, keyed by name of the action."""


def _print_to_stderr(messages: Iterable[str]) -> None:
    """Print messages to the standard error stream."""
    for message in messages:
        print(f"labpipe campaign: {escape_controls(message)}", file=sys.stderr)


def _print_overview(campaign: CampaignFolders, overview: Overview, lines: list[str]) -> int:
    """Print the notes, the number of tests in each state and `lines`; return the exit status."""
    _print_to_stderr(overview.notes)
    counts = overview.counts
    totals = ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])
    headline = f"{campaign.name}: {totals or 'no tests'}  ->  {shorten_path(campaign.processed)}"
    print("\n".join(map(escape_controls, [headline, *lines])))
    return _choose_exit_status(overview)


def _choose_exit_status(overview: Overview) -> int:
    """Return the exit status: 2 for failed tests or bad files, 1 for failed results, or 0."""
    if overview.has_bad_input or overview.counts[FAILED]:
        return 2
    return 1 if overview.has_failed_results else 0


def _list_unapplied_decisions(overview: Overview) -> list[str]:
    """List the decisions that are not applied, because the test changed or no longer exists."""
    lines = [
        f"{decision.test}  {decision.decision} ({decision.by}, {decision.when}): {reason}"
        for decision, reason in overview.unapplied_decisions
    ]
    return _list_section("decisions not applied", lines)


def _list_section(heading: str, lines: list[str]) -> list[str]:
    """Return a heading and the first `_MAX_LISTED` lines; an empty list if there are no lines."""
    if not lines:
        return []
    last_lines = [f"  ... {len(lines) - _MAX_LISTED} more"] if len(lines) > _MAX_LISTED else []
    first_lines = (f"  {line}" for line in lines[:_MAX_LISTED])
    return [f"{heading} ({len(lines)})", *first_lines, *last_lines]


def _build_json(
    campaign: CampaignFolders, overview: Overview, unknown_files: list[str]
) -> dict[str, Any]:
    """Build the content of ``labpipe campaign status --json``."""
    keys = ("test", "why", "code", "reason", "decided_by", "decided", "run")
    return {
        "campaign": campaign.name,
        "counts": {state: overview.counts[state] for state in STATES},
        "tests": {
            folder: {"state": overview.get_state(folder)} | {key: getattr(row, key) for key in keys}
            for folder, row in overview.rows.items()
        },
        "running": {
            folder: {"host": claim.machine, "pid": claim.pid, "since": claim.since}
            for folder, claim in overview.claims.items()
        },
        "decisions_not_applied": [
            {"test": decision.test, "decision": decision.decision, "by": decision.by, "why": reason}
            for decision, reason in overview.unapplied_decisions
        ],
        "unknown_files": unknown_files,
        "notes": overview.notes,
    }
