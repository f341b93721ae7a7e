"""Watch the folder of a campaign, and report each test seconds after its recording ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from labpipe.campaign.executors import Outcome
from labpipe.campaign.file_stability import FileStability, Mark
from labpipe.campaign.pairing import Candidate, PairingOutcome, RawListing, list_candidates, plan_of
from labpipe.campaign.quick_look import (
    CampaignGroups,
    display_settings,
    failure_lines,
    read_summary,
    verdict,
)
from labpipe.errors import LabpipeError
from labpipe.protocol.campaign_plan import PLAN_NAME, CampaignPlan

REMINDER_DELAY = 3600.0
"""s after which a growing or locked file is reported again."""

Marks = tuple[tuple[str, Mark | None], ...]


class Campaign(Protocol):
    """Interface of a watched campaign."""

    @property
    def raw(self) -> Path:
        """Folder of the exports."""

    def unprocessed(self, sheets: Iterable[Path]) -> list[Path]:
        """Return the test sheets without results for their present exports."""

    def process(self, sheet: Path, *, again: bool = False) -> Outcome | None:
        """Process a test; return its outcome, or None if nothing changed."""

    def results(self) -> Mapping[Path, str]:
        """Return the key of the results of each test that is not rejected, by folder."""


@dataclass(slots=True)
class _Test:
    """State of a test in the watch.

    Parameters
    ----------
    done, tried : size and time of its files when it was handled, and at the last attempt
    settled : time when it was handled
    waits : missing roles in the last message
    next_try : time of the next attempt if nothing changes
    again : whether its files were missing during processing, so that it is processed again
    """

    done: Marks = ()
    tried: Marks = ()
    settled: float = 0.0
    waits: str = ""
    next_try: float = 0.0
    again: bool = False


@dataclass(slots=True)
class _Announcer:
    """Prints messages, on request only once.

    Parameters
    ----------
    say : called with each message
    printed : messages so far
    """

    say: Callable[[str], None]
    printed: set[str] = field(default_factory=set)

    def say_once(self, text: str) -> None:
        """Print a message unless it was printed before."""
        if text not in self.printed:
            self.printed.add(text)
            self.say(text)


class Watcher:
    """Looks at the folder of a campaign repeatedly.

    Parameters
    ----------
    campaign : to watch
    pair : writes the sheet of a test, as `pair_test`
    draw : called with the folder of results after the verdict on a test
    say : called with each message
    clock : monotonic, s
    """

    def __init__(
        self,
        campaign: Campaign,
        *,
        pair: Callable[[Candidate, CampaignPlan, float], PairingOutcome],
        draw: Callable[[Path], None],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._campaign, self._pair, self._draw = campaign, pair, draw
        self._clock = clock
        self.plan = plan_of(campaign.raw)
        self._plan_mark = _mark(campaign.raw / PLAN_NAME)
        self._files = FileStability(clock, self.plan.still_for)
        self._output = _Announcer(say)
        self._tests: dict[Path, _Test] = {}
        self._groups = CampaignGroups()
        self._turn = 0
        self._is_gone = self._has_begun = False

    def prepare(self) -> None:
        """Read the numbers of earlier tests before the first verdict."""
        self._groups.read(self._campaign.results())

    def look(self) -> bool:
        """Look once, and handle the newest test that is ready.

        Returns
        -------
        Whether more tests are ready, so that there is no pause.
        """
        self._turn += 1
        try:
            self._campaign.raw.stat()
            self._read_plan()
            listed = list_candidates(self._campaign.raw, self.plan, is_skipped=self._is_skipped)
            ready = self._ready(listed)
            if ready:
                self._handle(ready[0])
        except OSError as error:
            self._say_gone(error)
            return False
        if self._is_gone:
            self._is_gone = False
            self._output.say(f"{self._campaign.raw}: available again")
        return len(ready) > 1

    def _is_skipped(self, folder: Path) -> bool:
        """Whether a test was handled a while ago and is skipped in this look."""
        # Ten thousand tests are too many to check in every look.
        looks_between = 40
        test = self._tests.get(folder)
        if test is None or not test.done or self._clock() - test.settled < self.plan.patience:
            return False
        return (hash(folder) - self._turn) % looks_between != 0

    def _say_gone(self, error: OSError) -> None:
        if not self._is_gone:
            self._is_gone = True
            why = (error.strerror or str(error)).lower()
            self._output.say(f"{error.filename or self._campaign.raw}: {why}; waiting for it")

    def _ready(self, listed: RawListing) -> list[Candidate]:
        """Return the tests that are ready, the newest first."""
        for path, why in listed.unmatched.items():
            if self._files.look(path) == "still" and self._still_for(path) > self.plan.patience:
                self._output.say_once(f"{_printable(self._below(path))}: not used: {why}")
        ready = [candidate for candidate in listed.candidates if self._is_ready(candidate)]
        if ready and not self._has_begun:
            self._has_begun = True
            ready = self._without_processed(ready)
        return sorted(
            ready, key=lambda candidate: self._files.since(_paths(candidate)), reverse=True
        )

    def _read_plan(self) -> None:
        """Read a changed campaign YAML; report a faulty one and keep the last."""
        path = self._campaign.raw / PLAN_NAME
        mark = _mark(path)
        if mark == self._plan_mark:
            return
        self._plan_mark = mark
        try:
            self.plan = plan_of(self._campaign.raw)
        except LabpipeError as error:
            self._output.say(f"{error}\n  the last valid {PLAN_NAME} is used")
            return
        self._files.still_for = self.plan.still_for
        self._tests = {
            folder: _Test(test.done, settled=test.settled) for folder, test in self._tests.items()
        }
        self._output.say(f"{PLAN_NAME} was read again")

    def _without_processed(self, ready: list[Candidate]) -> list[Candidate]:
        """Leave out tests that were processed before the watch."""
        sheets = {candidate.sheet for candidate in ready if candidate.sheet.exists()}
        unprocessed = set(self._campaign.unprocessed(sheets))
        left = []
        for candidate in ready:
            if candidate.sheet in sheets and candidate.sheet not in unprocessed:
                self._tests[candidate.folder] = _Test(
                    self._marks(candidate), settled=-self.plan.patience
                )
            else:
                left.append(candidate)
        return left

    def _is_ready(self, candidate: Candidate) -> bool:
        """Whether all files of a test are still, and were not handled in this state."""
        test = self._tests.setdefault(candidate.folder, _Test())
        states = {path: self._files.look(path) for path in _paths(candidate)}
        for path, state in states.items():
            self._say_waiting(candidate, path, state)
        waits = [path for path, state in states.items() if state in ("growing", "locked")]
        if waits or any(states[path] == "gone" for path in candidate.files.values()):
            test.settled = self._clock()
            return False
        marks = self._marks(candidate)
        if marks != test.done:
            test.settled = self._clock()
        return marks != test.done and (marks != test.tried or self._clock() >= test.next_try)

    def _say_waiting(self, candidate: Candidate, path: Path, state: str) -> None:
        moving = self._files.moving_for(path)
        name = f"{_label(candidate)}: {_printable(path.name)}"
        if state == "locked" and moving > self.plan.patience:
            self._output.say_once(
                f"{name} cannot be opened, another program uses it; waiting for it"
            )
        if moving > REMINDER_DELAY and state in ("growing", "locked"):
            what = "is still being written" if state == "growing" else "still cannot be opened"
            self._output.say_once(f"{name} {what} after an hour; waiting for it")

    def _handle(self, candidate: Candidate) -> None:
        # s between attempts
        retry_delay = 5.0
        test = self._tests[candidate.folder]
        marks = self._marks(candidate)
        test.tried, test.next_try = marks, self._clock() + retry_delay
        try:
            written = self._pair(candidate, self.plan, self._waited(candidate))
        except LabpipeError as error:
            test.done = marks
            self._output.say_once(f"{_label(candidate)}: {error}")
            return
        if written.sheet is None:
            self._say_missing(candidate, test, written)
            return
        self._say_sheet(candidate, written)
        self._files.look(candidate.sheet)
        if written.open or self._is_processed(candidate):
            test.done, test.settled, test.waits = self._marks(candidate), self._clock(), ""

    def _is_processed(self, candidate: Candidate) -> bool:
        """Process a test; return False if it is to be tried again."""
        test = self._tests[candidate.folder]
        try:
            outcome = self._campaign.process(candidate.sheet, again=test.again)
        except LabpipeError as error:
            self._output.say_once(f"{_label(candidate)}: {error}")
            return False
        test.again = False
        if outcome is not None:
            if outcome.state == "failed":
                test.again = True
                _refuse_vanished(candidate)
                test.again = False
            self._say_verdict(candidate, outcome)
        return True

    def _waited(self, candidate: Candidate) -> float:
        return self._clock() - self._files.since(candidate.files.values())

    def _say_missing(self, candidate: Candidate, test: _Test, written: PairingOutcome) -> None:
        """Report once what a test waits for."""
        for name, why in written.unread.items():
            stood = self._still_for(candidate.files.get(name, candidate.folder / name))
            what = f"{_label(candidate)}: {_printable(name)} cannot be read"
            if stood > self.plan.patience:
                self._output.say_once(f"{what} yet ({why}); waiting for it")
            if stood > REMINDER_DELAY:
                self._output.say_once(f"{what} after an hour; waiting for it")
        waits = "" if written.unread else ", ".join(written.missing)
        if waits and waits != test.waits:
            test.waits = waits
            self._output.say(f"{_label(candidate)}: waits for {waits}")

    def _say_sheet(self, candidate: Candidate, written: PairingOutcome) -> None:
        lines = [
            f"{_label(candidate)}: wrote {_printable(self._below(candidate.sheet))}"
        ] * written.is_new
        lines += [f"{'  ' * written.is_new}{message}" for message in written.messages]
        if written.open:
            lines.append(f"  to fill in: {', '.join(written.open)}; it is processed then")
        if lines:
            self._output.say("\n".join(lines))

    def _say_verdict(self, candidate: Candidate, outcome: Outcome) -> None:
        self._groups.read(self._campaign.results())
        summary = None if outcome.folder is None else read_summary(outcome.folder)
        if outcome.state == "failed" or outcome.folder is None or summary is None:
            lines = failure_lines(_label(candidate), outcome.code, outcome.reason)
        else:
            group, settings = self._groups.group_of(summary), display_settings(candidate.sheet)
            lines = verdict(_label(candidate), outcome.folder, summary, group, settings)
            self._draw(outcome.folder)
        self._output.say("\n".join(lines))

    def _marks(self, candidate: Candidate) -> Marks:
        return tuple((str(path), self._files.mark(path)) for path in _paths(candidate))

    def _still_for(self, path: Path) -> float:
        return self._clock() - self._files.since([path])

    def _below(self, path: Path) -> str:
        with suppress(ValueError):
            return path.relative_to(self._campaign.raw).as_posix()
        return str(path)


def _refuse_vanished(candidate: Candidate) -> None:
    """Raise an `OSError` if exports are missing, which is not a fault of the test."""
    for path in (candidate.sheet, *candidate.files.values()):
        with path.open("rb") as stream:
            stream.read(1)


def _label(candidate: Candidate) -> str:
    return _printable(candidate.name)


def _paths(candidate: Candidate) -> list[Path]:
    return [*sorted(candidate.files.values()), candidate.sheet]


def _mark(path: Path) -> Mark | None:
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_size, about.st_mtime_ns


def _printable(name: str) -> str:
    """Escape a name for a terminal."""
    return name if name.isprintable() else repr(name)[1:-1]
