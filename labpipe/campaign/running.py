"""The tests of a campaign that are new or changed, processed: once each, by whoever comes first."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.campaign.campaign_folders import CampaignFolders
from labpipe.campaign.catalog import FAILED, PENDING, STALE, TestRow
from labpipe.campaign.decisions import Decision, add_decisions, now
from labpipe.campaign.executors import Executor, Outcome, Task
from labpipe.campaign.refreshing import CatalogSync, Overview, opened_campaign
from labpipe.errors import StoreError, UsageError, error_text, nearest
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.failure_file import FAILURE_FILE
from labpipe.store.replace import storing

_PAUSE, _TRIES = 1.0, 60
"""s between two looks at a folder that another process still writes, and how many there are."""


@dataclass(slots=True)
class RunSummary:
    """What a run did.

    Parameters
    ----------
    overview : the campaign after it
    processed : outcomes of the tests that were processed, by folder
    elsewhere : tests that another labpipe was at work on
    """

    overview: Overview
    processed: dict[str, Outcome] = field(default_factory=dict)
    elsewhere: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Drawing:
    """What is drawn of each test.

    Parameters
    ----------
    figures : whether figures are drawn, as SVG
    png : whether as PNG, too
    """

    figures: bool = True
    png: bool = False


def run_campaign(
    campaign: CampaignFolders,
    executor: Executor,
    *,
    only: Collection[str] | None = None,
    again: Collection[str] = (),
    drawing: Drawing = Drawing(),
    follow_links: bool = False,
    begin: Callable[[int], None] = lambda _: None,
    told: Callable[[str, Outcome], None] = lambda *_: None,
) -> RunSummary:
    """Process what is new or changed in a campaign, and nothing else.

    Parameters
    ----------
    campaign : its folders
    executor : processes the tests
    only : tests to look at; None for all
    again : tests to process even if nothing changed
    drawing : what is drawn of them
    follow_links : whether exports may be links out of the folder of their test
    begin : is given the number of tests that are to be processed
    told : is given each test that was processed and what became of it

    Returns
    -------
    What was done. Two runs at a time share the work: each test is claimed by one of them.

    Raises
    ------
    LabpipeError
        If the catalog is of a newer labpipe, or the folder of results cannot be written.
    """
    with opened_campaign(campaign) as keeper:
        if keeper.catalog.in_memory:
            raise _cannot_write(campaign)
        run = _Run(keeper, drawing, follow_links=follow_links, told=told)
        return run.all(executor, only, again, begin)


def run_some(
    campaign: CampaignFolders,
    executor: Executor,
    folders: Collection[str],
    *,
    again: Collection[str] = (),
    told: Callable[[str, Outcome], None] = lambda *_: None,
) -> dict[str, TestRow | None]:
    """Process some tests if they are new or changed, without a look at all the others.

    Parameters
    ----------
    campaign : its folders
    executor : processes the tests
    folders : of the tests, below the campaign
    again : those to process even if nothing changed
    told : is given each test that was processed and what became of it

    Returns
    -------
    Row of each test; None for one that another labpipe is at work on.

    Raises
    ------
    LabpipeError
        As `run_campaign`.
    """
    with opened_campaign(campaign) as keeper:
        if keeper.catalog.in_memory:
            raise _cannot_write(campaign)
        keeper.catalog.release_dead()
        keeper.read_decisions()
        run = _Run(keeper, Drawing(), follow_links=False, told=told)
        elsewhere = run.some(executor, list(folders), again)
        rows = {folder: keeper.renew(folder) for folder in folders}
    return {folder: None if folder in elsewhere else row for folder, row in rows.items()}


class _Run:
    """A run at work: it claims tests as an executor takes them, and settles them as they end."""

    def __init__(
        self,
        keeper: CatalogSync,
        drawing: Drawing,
        *,
        follow_links: bool,
        told: Callable[[str, Outcome], None],
    ) -> None:
        self._keeper, self._drawing, self._told = keeper, drawing, told
        self._follow_links = follow_links
        self._at_work: dict[Path, str] = {}
        self._in_use: list[str] = []
        self._ran = RunSummary(Overview({}))

    def all(
        self,
        executor: Executor,
        only: Collection[str] | None,
        again: Collection[str],
        begin: Callable[[int], None],
    ) -> RunSummary:
        """Process all that is due."""
        keeper = self._keeper
        keeper.catalog.release_dead()
        overview = keeper.refresh()
        due = [
            folder
            for folder, row in overview.rows.items()
            if folder in overview.raw.sheets
            and (only is None or folder in only)
            and (row.state in {PENDING, STALE} or folder in again)
        ]
        begin(len(due))
        self.some(executor, due, again)
        if due:
            overview = keeper.refresh()
        self._ran.overview = overview
        return self._ran

    def some(
        self, executor: Executor, due: list[str], again: Collection[str] = ()
    ) -> Sequence[str]:
        """Process some tests; gives those that another labpipe is at work on."""
        try:
            self._process(executor, due, again)
            for _ in range(_TRIES):
                if not self._in_use:
                    break
                time.sleep(_PAUSE)
                left, self._in_use = self._in_use, []
                self._process(executor, left, again)
        finally:
            for folder in self._at_work.values():
                self._keeper.catalog.release(folder)
        self._ran.elsewhere += self._in_use
        return self._ran.elsewhere

    def _process(self, executor: Executor, due: list[str], again: Collection[str]) -> None:
        with closing(self._tasks(due, again)) as tasks:
            for outcome in executor(tasks):
                self._settle(outcome)

    def _tasks(self, due: list[str], again: Collection[str]) -> Generator[Task, None, None]:
        """Claim tests one by one; one that another run has done meanwhile is left out."""
        keeper = self._keeper
        for folder in due:
            if not keeper.catalog.claim(folder):
                self._ran.elsewhere.append(folder)
                continue
            row = keeper.renew(folder)
            sheet = keeper.campaign.raw / folder / SHEET_NAME
            if (row.state not in {PENDING, STALE} and folder not in again) or not sheet.is_file():
                keeper.catalog.release(folder)
                continue
            self._at_work[sheet] = folder
            yield Task(
                sheet,
                keeper.campaign.processed / folder,
                figures=self._drawing.figures,
                png=self._drawing.png,
                follow_links=self._follow_links,
                run=keeper.content_of(folder).key,
            )

    def _settle(self, outcome: Outcome) -> None:
        folder = self._at_work.pop(outcome.sheet)
        catalog = self._keeper.catalog
        if outcome.code == "in_use":  # of a process that outlived its run, such as a killed one
            self._in_use.append(folder)
        else:
            self._keeper.renew(folder)
            catalog.put_time(folder, now(), outcome.seconds)
            self._ran.processed[folder] = outcome
            self._told(folder, outcome)
        catalog.release(folder)


def _cannot_write(campaign: CampaignFolders) -> StoreError:
    return StoreError(
        error_text(
            campaign.processed,
            "",
            expected="a folder to write in",
            found="one that cannot be written",
            remedy="Change its permissions; nothing was processed.",
        )
    )


def look(campaign: CampaignFolders) -> Overview:
    """Tell how a campaign stands, without processing anything.

    Parameters
    ----------
    campaign : its folders; they need not be writable
    """
    with opened_campaign(campaign) as keeper:
        return keeper.refresh()


def rebuild(campaign: CampaignFolders) -> Overview:
    """Make the catalog of a campaign anew from the files of its tests.

    Parameters
    ----------
    campaign : its folders

    Returns
    -------
    The campaign as it stands.

    Raises
    ------
    LabpipeError
        If a process is at work on the campaign, or the catalog is of a newer labpipe.
    """
    with opened_campaign(campaign, anew=True) as keeper:
        return keeper.refresh()


def clear_failures(campaign: CampaignFolders, code: str = "") -> list[str]:
    """Take failures away, so that their tests are processed again.

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
        If no failure has that code.
    """
    with opened_campaign(campaign) as keeper:
        if keeper.catalog.in_memory:
            raise _cannot_write(campaign)
        overview = keeper.refresh()
        failed = {folder: row for folder, row in overview.rows.items() if row.state == FAILED}
        chosen = [folder for folder, row in failed.items() if code in {"", row.code}]
        if code and not chosen:
            known = sorted({row.code for row in failed.values()})
            found = ", ".join(known) if known else "no failure at all"
            near = nearest(code, known, most=1)
            remedy = f"Nearest: {near[0]}." if near else "There is nothing to do."
            raise UsageError(
                error_text(campaign.processed, "", expected=f"failures of the code {code!r}",
                          found=found, remedy=remedy)
            )  # fmt: skip
        for folder in chosen:
            path = campaign.processed / folder / FAILURE_FILE
            with storing(path):
                path.unlink(missing_ok=True)
            keeper.renew(folder)
    return chosen


def decide(campaign: CampaignFolders, test: str, said: Decision) -> TestRow:
    """Decide on a test.

    Parameters
    ----------
    campaign : its folders
    test : its folder below the campaign, or its name
    said : decision, reason and who decides

    Returns
    -------
    The row of the test after it.

    Raises
    ------
    LabpipeError
        If there is no such test, it was not processed yet, or the decisions cannot be written.
    """
    with opened_campaign(campaign) as keeper:
        if keeper.catalog.in_memory:
            raise _cannot_write(campaign)
        overview = keeper.refresh()
        row = _row_called(campaign, overview, test)
        if not row.attempt:
            found, remedy = "one that was not", "Process it first: labpipe campaign run."
            raise UsageError(
                error_text(test, "", expected="a test that was processed", found=found,
                          remedy=remedy)
            )  # fmt: skip
        entry = Decision(row.folder, row.attempt, said.decision, said.because, said.by, now())
        add_decisions(campaign.processed, campaign.name, [entry])
        return keeper.refresh().rows[row.folder]


def _row_called(campaign: CampaignFolders, overview: Overview, test: str) -> TestRow:
    """The row of a test by its folder, or by its name where only one has it."""
    label = test.replace("\\", "/").strip("/")
    if label in overview.rows:
        return overview.rows[label]
    named = [row for row in overview.rows.values() if row.test == test]
    if len(named) == 1:
        return named[0]
    known = nearest(label, [*overview.rows], most=3)
    found = f"{len(named)} of that name" if named else "none of that name"
    expected = f"a test of {campaign.name!r}"
    remedy = f"Nearest: {', '.join(known)}." if known else "Look with labpipe campaign status."
    raise UsageError(error_text(test, "", expected=expected, found=found, remedy=remedy))
