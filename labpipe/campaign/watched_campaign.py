"""Watch a campaign with its catalog."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from labpipe.campaign.campaign_folders import CampaignFolders
from labpipe.campaign.catalog import PENDING, REJECTED, STALE
from labpipe.campaign.executors import Executor, Outcome
from labpipe.campaign.pairing import Candidate, PairingOutcome, pair_test
from labpipe.campaign.running import read_overview, run_tests
from labpipe.campaign.warm_worker import WarmWorker
from labpipe.campaign.watching import Watcher
from labpipe.errors import ProcessingError, error_text
from labpipe.process.protocol_match import all_protocols
from labpipe.protocol.campaign_plan import CampaignPlan


class WatchedCampaign:
    """A watched campaign with its catalog; see `labpipe.campaign.watching.Campaign`.

    Parameters
    ----------
    folders : of the campaign
    executor : processes the tests
    """

    def __init__(self, folders: CampaignFolders, executor: Executor) -> None:
        self._folders, self._executor = folders, executor
        self._rows = read_overview(folders).rows

    @property
    def raw(self) -> Path:
        """Folder of the exports."""
        return self._folders.raw

    def unprocessed(self, sheets: Iterable[Path]) -> list[Path]:
        """Return the test sheets without results for their present exports."""
        rows = {sheet: self._rows.get(self._label(sheet)) for sheet in sheets}
        due = {PENDING, STALE}
        return [sheet for sheet, row in rows.items() if row is None or row.state in due]

    def process(self, sheet: Path, *, again: bool = False) -> Outcome | None:
        """Process a test, and store its row.

        Parameters
        ----------
        sheet : of the test
        again : whether to process it even if nothing changed

        Returns
        -------
        The outcome; None if nothing changed.

        Raises
        ------
        LabpipeError
            If another labpipe works on it, or the catalog cannot be written.
        """
        label = self._label(sheet)
        outcomes: list[Outcome] = []
        rows = run_tests(
            self._folders,
            self._executor,
            [label],
            again=[label] if again else (),
            on_outcome=lambda _, outcome: outcomes.append(outcome),
        )
        row = rows[label]
        if row is None:
            expected, state = ("a free test", "one that another labpipe processes")
            remedy = "The watch tries again."
            message = error_text(label, "", expected=expected, found=state, remedy=remedy)
            raise ProcessingError(message, code="in_use")
        self._rows = {**self._rows, label: row}
        return outcomes[0] if outcomes else None

    def results(self) -> dict[Path, str]:
        """Return the key of the results of each test that is not rejected, by folder."""
        rows = {folder: row for folder, row in self._rows.items() if row.state != REJECTED}
        return {self._folders.processed / folder: row.run for folder, row in rows.items()}

    def _label(self, sheet: Path) -> str:
        return sheet.parent.relative_to(self._folders.raw).as_posix()


def watch(folders: CampaignFolders, *, figures: bool, say: Callable[[str], None]) -> None:
    """Watch a campaign until interrupted.

    Parameters
    ----------
    folders : of the campaign
    figures : whether figures are drawn, after the verdict on a test
    say : called with each message

    Raises
    ------
    LabpipeError
        If the campaign YAML has a fault, or the catalog cannot be used.
    """
    worker = WarmWorker()
    worker.warm()
    try:
        campaign = WatchedCampaign(folders, worker.executor)
        pair = partial(_pair_in, worker)
        draw = worker.draw if figures else (lambda _: None)
        watcher = Watcher(campaign, pair=pair, draw=draw, say=say)
        say(f"watching {folders.name}; press Ctrl+C to stop")
        watcher.prepare()
        all_protocols()  # loads units and grammar before the first verdict
        while True:
            began = time.monotonic()
            if not watcher.look():  # on a slow drive, at most a third of the time
                time.sleep(max(watcher.plan.look_every, 2.0 * (time.monotonic() - began)))
    finally:
        worker.close()


def _pair_in(
    worker: WarmWorker, candidate: Candidate, plan: CampaignPlan, waited: float
) -> PairingOutcome:
    """Pair a test in the worker, which a damaged export may crash."""
    work = partial(pair_test, candidate, plan, waited=waited)
    return worker.call(work, about=candidate.folder)
