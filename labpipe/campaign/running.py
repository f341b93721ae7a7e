"""Run a campaign: process its new and changed tests, clear failures, record decisions."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.campaign.campaign_folders import CampaignFolders
from labpipe.campaign.catalog_rows import FAILED, PENDING, STALE, TestRow
from labpipe.campaign.decisions import Decision, add_decisions, now
from labpipe.campaign.executors import Executor, Outcome
from labpipe.campaign.refreshing import CatalogSync, Overview, open_campaign
from labpipe.errors import StoreError, UsageError, sort_by_likeness
from labpipe.process.run import Task
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.replace import storing
from labpipe.store.summaries import FAILURE_FILE

_RETRY_DELAY = 1.0
"""Time between attempts to process a test that another process still writes, s."""
_MAX_RETRIES = 60


@dataclass(slots=True)
class RunSummary:
    """Summary of a run.

    Parameters
    ----------
    overview : the campaign after the run
    processed : outcomes of the tests that were processed, by folder
    elsewhere : tests that another labpipe processes
    """

    overview: Overview
    processed: dict[str, Outcome] = field(default_factory=dict)
    elsewhere: list[str] = field(default_factory=list)


def run_campaign(
    campaign: CampaignFolders,
    executor: Executor,
    *,
    only: Collection[str] | None = None,
    forced: Collection[str] = (),
    make_task: Callable[..., Task] = Task,
    begin: Callable[[int], None] = lambda _: None,
    on_outcome: Callable[[str, Outcome], None] = lambda *_: None,
) -> RunSummary:
    """Process the new and changed tests of a campaign.

    Parameters
    ----------
    campaign : its folders
    executor : processes the tests
    only : tests to consider; None for all
    forced : tests to process even if nothing changed
    make_task : makes the task of a test from its sheet, folder of results and key, such as a
        partial of `Task` with figures and links
    begin : called with the number of tests to process
    on_outcome : called with each processed test and its outcome

    Returns
    -------
    The summary. Simultaneous runs share the work: each test is claimed by one of them.

    Raises
    ------
    LabpipeError
        If the catalog is from a newer labpipe, or the folder of results cannot be written.
    """
    with _open_writable(campaign) as sync:
        sync.catalog.release_dead()
        overview = sync.refresh()
        due = [
            folder
            for folder, row in overview.rows.items()
            if folder in overview.raw.sheets
            and (only is None or folder in only)
            and (row.state in {PENDING, STALE} or folder in forced)
        ]
        begin(len(due))
        run = _Run(sync, make_task, on_outcome)
        run.process(executor, due, forced)
        return RunSummary(sync.refresh() if due else overview, run.outcomes, run.elsewhere)


def run_test(
    campaign: CampaignFolders, executor: Executor, folder: str, *, is_forced: bool = False
) -> tuple[TestRow | None, Outcome | None]:
    """Process one test if it is new or changed, without checking all others.

    Parameters
    ----------
    campaign : its folders
    executor : processes the test
    folder : of the test, below the campaign
    is_forced : whether to process it even if nothing changed

    Returns
    -------
    row : of the test; None if another labpipe has claimed it
    outcome : None if it was not processed

    Raises
    ------
    LabpipeError
        As `run_campaign`.
    """
    with _open_writable(campaign) as sync:
        sync.catalog.release_dead()
        sync.read_decisions()
        run = _Run(sync)
        run.process(executor, [folder], [folder] if is_forced else ())
        row = sync.refresh_test(folder)
    return None if folder in run.elsewhere else row, run.outcomes.get(folder)


@contextmanager
def _open_writable(campaign: CampaignFolders) -> Iterator[CatalogSync]:
    """Open a campaign to change it."""
    with open_campaign(campaign) as sync:
        if sync.catalog.in_memory:
            raise StoreError.about("campaign.read_only", campaign.processed)
        yield sync


class _Run:
    """Claims tests when an executor takes them, and records their outcomes."""

    def __init__(
        self,
        sync: CatalogSync,
        make_task: Callable[..., Task] = Task,
        on_outcome: Callable[[str, Outcome], None] = lambda *_: None,
    ) -> None:
        self._sync, self._make_task, self._on_outcome = sync, make_task, on_outcome
        self._claimed: dict[Path, str] = {}
        self._busy: list[str] = []
        self.outcomes: dict[str, Outcome] = {}
        self.elsewhere: list[str] = []

    def process(self, executor: Executor, due: list[str], forced: Collection[str]) -> None:
        """Process tests that no other labpipe has claimed; retry those that are being written."""
        try:
            self._process(executor, due, forced)
            for _ in range(_MAX_RETRIES):
                if not self._busy:
                    break
                time.sleep(_RETRY_DELAY)
                unfinished, self._busy = self._busy, []
                self._process(executor, unfinished, forced)
        finally:
            self._sync.catalog.release(*self._claimed.values())
        self.elsewhere += self._busy

    def _process(self, executor: Executor, due: list[str], forced: Collection[str]) -> None:
        with closing(self._claim_tasks(due, forced)) as tasks:
            for outcome in executor(tasks):
                self._record(outcome)

    def _claim_tasks(self, due: list[str], forced: Collection[str]) -> Generator[Task, None, None]:
        """Claim tests one by one; skip those that another run has processed meanwhile."""
        sync = self._sync
        for folder in due:
            if not sync.catalog.claim(folder):
                self.elsewhere.append(folder)
                continue
            row = sync.refresh_test(folder)
            sheet = sync.campaign.raw / folder / SHEET_NAME
            if (row.state not in {PENDING, STALE} and folder not in forced) or not sheet.is_file():
                sync.catalog.release(folder)
                continue
            self._claimed[sheet] = folder
            key = sync.read_inputs(folder).key
            yield self._make_task(sheet, sync.campaign.processed / folder, run=key)

    def _record(self, outcome: Outcome) -> None:
        """Update the catalog from the outcome of a test, and release the test."""
        folder = self._claimed.pop(outcome.sheet)
        catalog = self._sync.catalog
        if outcome.code == "in_use":  # a process that outlived its killed run
            self._busy.append(folder)
        else:
            self._sync.refresh_test(folder)
            self.outcomes[folder] = outcome
            self._on_outcome(folder, outcome)
        catalog.release(folder)


def read_overview(campaign: CampaignFolders) -> Overview:
    """Read the state of a campaign without processing.

    Parameters
    ----------
    campaign : its folders; they need not be writable
    """
    with open_campaign(campaign) as sync:
        return sync.refresh()


def rebuild(campaign: CampaignFolders) -> Overview:
    """Rebuild the catalog of a campaign from the files of its tests.

    Parameters
    ----------
    campaign : its folders

    Returns
    -------
    State of the campaign.

    Raises
    ------
    LabpipeError
        If a process works on the campaign, or the catalog is from a newer labpipe.
    """
    with open_campaign(campaign, start_empty=True) as sync:
        return sync.refresh()


def clear_failures(campaign: CampaignFolders, code: str = "") -> list[str]:
    """Delete failures, so that their tests are processed again.

    Parameters
    ----------
    campaign : its folders
    code : of the failures; empty for all

    Returns
    -------
    The tests.

    Raises
    ------
    UsageError
        If `code` is not empty and no failure has it.
    """
    with _open_writable(campaign) as sync:
        overview = sync.refresh()
        failed = {folder: row for folder, row in overview.rows.items() if row.state == FAILED}
        chosen = [folder for folder, row in failed.items() if code in {"", row.code}]
        if code and not chosen:
            codes = sorted({row.code for row in failed.values()})
            similar = sort_by_likeness(code, codes, limit=1)
            raise UsageError.about(
                "campaign.no_such_failures", campaign.processed, code=code,
                found=", ".join(codes) or "no failures",
                remedy=f"Nearest: {similar[0]}." if similar else "There is nothing to clear.",
            )  # fmt: skip
        for folder in chosen:
            path = campaign.processed / folder / FAILURE_FILE
            with storing(path):
                path.unlink(missing_ok=True)
            sync.refresh_test(folder)
    return chosen


def decide(campaign: CampaignFolders, test: str, decision: Decision) -> TestRow:
    """Record a decision on a test.

    Parameters
    ----------
    campaign : its folders
    test : its folder below the campaign, or its name
    decision : with reason and person

    Returns
    -------
    The new row of the test.

    Raises
    ------
    LabpipeError
        If there is no such test, it is not processed yet, or the decisions cannot be written.
    """
    with _open_writable(campaign) as sync:
        overview = sync.refresh()
        row = _find_row(campaign, overview, test)
        if not row.attempt:
            raise UsageError.about("campaign.unprocessed_test", test)
        entry = replace(decision, test=row.folder, run=row.attempt, when=now())
        add_decisions(campaign.processed, campaign.name, [entry])
        return sync.refresh().rows[row.folder]


def _find_row(campaign: CampaignFolders, overview: Overview, test: str) -> TestRow:
    """Find the row of a test by its folder, or by its name if only one test has that name."""
    label = test.replace("\\", "/").strip("/")
    if label in overview.rows:
        return overview.rows[label]
    named = [row for row in overview.rows.values() if row.test == test]
    if len(named) == 1:
        return named[0]
    similar = ", ".join(sort_by_likeness(label, [*overview.rows], limit=3))
    raise UsageError.about(
        "campaign.unknown_test", test, campaign=campaign.name, count=len(named) or "none",
        remedy=f"Nearest: {similar}." if similar else "List them with labpipe campaign status.",
    )  # fmt: skip
