"""A campaign with its catalog as a watch sees it, and the watch itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from labpipe.campaign.campaign_folders import CampaignFolders
from labpipe.campaign.catalog import PENDING, REJECTED, STALE
from labpipe.campaign.executors import Executor, Outcome
from labpipe.campaign.pairing import Candidate, Written, pair_test
from labpipe.campaign.running import look, run_some
from labpipe.campaign.warm_worker import WarmWorker
from labpipe.campaign.watching import Watcher
from labpipe.errors import ProcessingError, error_text
from labpipe.process.protocol_match import all_protocols
from labpipe.protocol.campaign_plan import CampaignPlan


class WatchedCampaign:
    """What a watch asks of a campaign, by its catalog; see `labpipe.campaign.watching.Campaign`.

    Parameters
    ----------
    folders : of the campaign
    executor : processes the tests
    """

    def __init__(self, folders: CampaignFolders, executor: Executor) -> None:
        self._folders, self._executor = folders, executor
        self._rows = look(folders).rows

    @property
    def raw(self) -> Path:
        """Folder of the exports."""
        return self._folders.raw

    def unprocessed(self, sheets: Iterable[Path]) -> list[Path]:
        """Of some test sheets, those whose results are not there or are of other exports."""
        known = {sheet: self._rows.get(self._label(sheet)) for sheet in sheets}
        due = {PENDING, STALE}
        return [sheet for sheet, row in known.items() if row is None or row.state in due]

    def process(self, sheet: Path, *, again: bool = False) -> Outcome | None:
        """Process a test, and remember what became of it.

        Parameters
        ----------
        sheet : of the test
        again : whether to process it even if nothing changed since it last was

        Returns
        -------
        None where nothing changed.

        Raises
        ------
        LabpipeError
            If another labpipe is at work on it, or the catalog cannot be written.
        """
        label = self._label(sheet)
        outcomes: list[Outcome] = []
        rows = run_some(
            self._folders,
            self._executor,
            [label],
            again=[label] if again else (),
            told=lambda _, outcome: outcomes.append(outcome),
        )
        row = rows[label]
        if row is None:
            expected, found = "a test that nobody else processes", "another labpipe at work on it"
            remedy = "It is tried again."
            message = error_text(label, "", expected=expected, found=found, remedy=remedy)
            raise ProcessingError(message, code="in_use")
        self._rows = {**self._rows, label: row}
        return outcomes[0] if outcomes else None

    def results(self) -> dict[Path, str]:
        """Key of the results of each test that has some and was not rejected, by their folder."""
        kept = {folder: row for folder, row in self._rows.items() if row.state != REJECTED}
        return {self._folders.processed / folder: row.run for folder, row in kept.items()}

    def _label(self, sheet: Path) -> str:
        return sheet.parent.relative_to(self._folders.raw).as_posix()


def watch(folders: CampaignFolders, *, figures: bool, say: Callable[[str], None]) -> None:
    """Watch a campaign until it is interrupted.

    Parameters
    ----------
    folders : of the campaign
    figures : whether figures are drawn, after the verdict on a test
    say : is given each message

    Raises
    ------
    LabpipeError
        If the campaign YAML is wrong, or the catalog cannot be used.
    """
    worker = WarmWorker()
    worker.warm()
    try:
        campaign = WatchedCampaign(folders, worker.executor)
        pair = partial(_pair_in, worker)
        draw = worker.draw if figures else (lambda _: None)
        watcher = Watcher(campaign, pair=pair, draw=draw, say=say)
        say(f"watching {folders.name}; Ctrl-C ends it")
        watcher.prepare()
        all_protocols()  # with units and grammar, so that the first verdict need not wait for them
        while True:
            began = time.monotonic()
            if not watcher.look():  # of a drive that is slow, not more than a third of the time
                time.sleep(max(watcher.plan.look_every, 2.0 * (time.monotonic() - began)))
    finally:
        worker.leave()


def _pair_in(
    worker: WarmWorker, candidate: Candidate, plan: CampaignPlan, waited: float
) -> Written:
    """Pair a test in the process that may die of a damaged export."""
    work = partial(pair_test, candidate, plan, waited=waited)
    return worker.call(work, about=candidate.folder)
