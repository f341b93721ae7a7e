"""Watching the folder of a campaign: a verdict on each test seconds after its recording ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from labpipe.campaign.executors import Outcome
from labpipe.campaign.file_stability import FileStability, Mark
from labpipe.campaign.pairing import Candidate, RawListing, Written, list_candidates, plan_of
from labpipe.campaign.quick_look import GroupsSoFar, read_summary, refused, shown_by, verdict
from labpipe.errors import LabpipeError
from labpipe.protocol.campaign_plan import PLAN_NAME, CampaignPlan

LONG = 3600.0
"""s, after which a file that still grows or is still locked is said once more."""
_TURNS = 40
"""Looks until a test that was dealt with a while ago is looked at again: ten thousand tests are too
many for a look each quarter of a second, above all on a network drive."""
_AGAIN = 5.0
"""s, between two tries to read exports that could not be read."""

Marks = tuple[tuple[str, Mark | None], ...]


class Campaign(Protocol):
    """What a watch asks of the campaign that it watches."""

    @property
    def raw(self) -> Path:
        """Folder of the exports."""

    def unprocessed(self, sheets: Iterable[Path]) -> list[Path]:
        """Of some test sheets, those whose results are not there or are of other exports."""

    def process(self, sheet: Path, *, again: bool = False) -> Outcome | None:
        """Process a test and remember what became of it; None where nothing changed."""

    def results(self) -> Mapping[Path, str]:
        """Key of the results of each test that counts, by their folder; none that is rejected."""


@dataclass(slots=True)
class _Test:
    """A test as the watch has seen it.

    Parameters
    ----------
    done, tried : size and time of its files when it was dealt with, and when that was last tried
    settled : when it was dealt with
    waits : what was last said that it waits for
    next_try : when it is dealt with again, by the clock, if nothing changes
    again : whether it failed because its files were gone, and is to be processed all the same
    """

    done: Marks = ()
    tried: Marks = ()
    settled: float = 0.0
    waits: str = ""
    next_try: float = 0.0
    again: bool = False


@dataclass(slots=True)
class _Announcer:
    """Says everything once.

    Parameters
    ----------
    say : is given each line
    """

    say: Callable[[str], None]
    said: set[str] = field(default_factory=set)

    def once(self, text: str) -> None:
        """Say a line, unless it was said before."""
        if text not in self.said:
            self.said.add(text)
            self.say(text)


class Watcher:
    """Looks at a folder again and again.

    Parameters
    ----------
    campaign : that is watched
    pair : writes the sheet of a test, as `pair_test`
    draw : is handed the folder of results once the verdict on a test is said
    say : is given each line
    clock : gives seconds that never go back
    """

    def __init__(
        self,
        campaign: Campaign,
        *,
        pair: Callable[[Candidate, CampaignPlan, float], Written],
        draw: Callable[[Path], None],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._campaign, self._pair, self._draw = campaign, pair, draw
        self._clock = clock
        self.plan = plan_of(campaign.raw)
        self._plan_mark = _mark(campaign.raw / PLAN_NAME)
        self._files = FileStability(clock, self.plan.still_for)
        self._voice = _Announcer(say)
        self._tests: dict[Path, _Test] = {}
        self._groups = GroupsSoFar()
        self._turn = 0
        self._is_gone = self._has_begun = False

    def prepare(self) -> None:
        """Read the numbers of the tests so far, so that the first verdict need not wait for it."""
        self._groups.read(self._campaign.results())

    def look(self) -> bool:
        """Look once, and deal with the newest test that is ready.

        Returns
        -------
        Whether more tests are ready: then there is no reason to pause.
        """
        self._turn += 1
        try:
            self._campaign.raw.stat()
            self._read_plan()
            listed = list_candidates(self._campaign.raw, self.plan, rests=self._rests)
            ready = self._ready(listed)
            if ready:
                self._deal_with(ready[0])
        except OSError as error:
            self._say_gone(error)
            return False
        if self._is_gone:
            self._is_gone = False
            self._voice.say(f"{self._campaign.raw}: is there again")
        return len(ready) > 1

    def _rests(self, folder: Path) -> bool:
        """Whether a test was dealt with a while ago and it is not its turn."""
        test = self._tests.get(folder)
        if test is None or not test.done or self._clock() - test.settled < self.plan.patience:
            return False
        return (hash(folder) - self._turn) % _TURNS != 0

    def _say_gone(self, error: OSError) -> None:
        if not self._is_gone:
            self._is_gone = True
            why = (error.strerror or str(error)).lower()
            self._voice.say(f"{error.filename or self._campaign.raw}: {why}; waited for")

    def _ready(self, listed: RawListing) -> list[Candidate]:
        """Tests that can be dealt with, the newest first."""
        for path, why in listed.strangers.items():
            if self._files.look(path) == "still" and self._stood(path) > self.plan.patience:
                self._voice.once(f"{_shown(self._below(path))}: not used, {why}")
        ready = [candidate for candidate in listed.candidates if self._is_ready(candidate)]
        if ready and not self._has_begun:
            self._has_begun = True
            ready = self._without_processed(ready)
        return sorted(ready, key=lambda each: self._files.since(_paths(each)), reverse=True)

    def _read_plan(self) -> None:
        """Read the campaign YAML again where it changed; a wrong one is said, the last one kept."""
        path = self._campaign.raw / PLAN_NAME
        mark = _mark(path)
        if mark == self._plan_mark:
            return
        self._plan_mark = mark
        try:
            self.plan = plan_of(self._campaign.raw)
        except LabpipeError as error:
            self._voice.say(f"{error}\n  the last {PLAN_NAME} that was right still counts")
            return
        self._files.still_for = self.plan.still_for
        self._tests = {
            folder: _Test(test.done, settled=test.settled) for folder, test in self._tests.items()
        }
        self._voice.say(f"{PLAN_NAME} was read again")

    def _without_processed(self, ready: list[Candidate]) -> list[Candidate]:
        """Leave out the tests that were processed before the watch began."""
        sheets = {candidate.sheet for candidate in ready if candidate.sheet.exists()}
        unprocessed = set(self._campaign.unprocessed(sheets))
        left = []
        for each in ready:
            if each.sheet in sheets and each.sheet not in unprocessed:
                self._tests[each.folder] = _Test(self._marks(each), settled=-self.plan.patience)
            else:
                left.append(each)
        return left

    def _is_ready(self, candidate: Candidate) -> bool:
        """Whether all files of a test stand still, and were not dealt with as they are."""
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
        name = f"{_called(candidate)}: {_shown(path.name)}"
        if state == "locked" and moving > self.plan.patience:
            self._voice.once(f"{name} cannot be opened, another program holds it; waited for")
        if moving > LONG and state in ("growing", "locked"):
            what = "is still being written" if state == "growing" else "still cannot be opened"
            self._voice.once(f"{name} {what} after an hour; waited for")

    def _deal_with(self, candidate: Candidate) -> None:
        test = self._tests[candidate.folder]
        marks = self._marks(candidate)
        test.tried, test.next_try = marks, self._clock() + _AGAIN
        try:
            written = self._pair(candidate, self.plan, self._waited(candidate))
        except LabpipeError as error:
            test.done = marks
            self._voice.once(f"{_called(candidate)}: {error}")
            return
        if written.sheet is None:
            self._say_missing(candidate, test, written)
            return
        self._say_sheet(candidate, written)
        self._files.look(candidate.sheet)
        if written.open or self._is_processed(candidate):
            test.done, test.settled, test.waits = self._marks(candidate), self._clock(), ""

    def _is_processed(self, candidate: Candidate) -> bool:
        """Have a test processed; False where it is to be tried again."""
        test = self._tests[candidate.folder]
        try:
            outcome = self._campaign.process(candidate.sheet, again=test.again)
        except LabpipeError as error:
            self._voice.once(f"{_called(candidate)}: {error}")
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

    def _say_missing(self, candidate: Candidate, test: _Test, written: Written) -> None:
        """Say once what a test waits for; it is dealt with again when a file comes, or later."""
        for name, why in written.unread.items():
            stood = self._stood(candidate.files.get(name, candidate.folder / name))
            what = f"{_called(candidate)}: {_shown(name)} cannot be read"
            if stood > self.plan.patience:
                self._voice.once(f"{what} yet ({why}); waited for")
            if stood > LONG:
                self._voice.once(f"{what} after an hour; waited for")
        waits = "" if written.unread else ", ".join(written.missing)
        if waits and waits != test.waits:
            test.waits = waits
            self._voice.say(f"{_called(candidate)}: waits for {waits}")

    def _say_sheet(self, candidate: Candidate, written: Written) -> None:
        lines = [
            f"{_called(candidate)}: wrote {_shown(self._below(candidate.sheet))}"
        ] * written.is_new
        lines += [f"{'  ' * written.is_new}{sentence}" for sentence in written.said]
        if written.open:
            lines.append(f"  to be filled in: {', '.join(written.open)}; it is processed then")
        if lines:
            self._voice.say("\n".join(lines))

    def _say_verdict(self, candidate: Candidate, outcome: Outcome) -> None:
        self._groups.read(self._campaign.results())
        summary = None if outcome.folder is None else read_summary(outcome.folder)
        if outcome.state == "failed" or outcome.folder is None or summary is None:
            lines = refused(_called(candidate), outcome.code, outcome.reason)
        else:
            group, shown = self._groups.group_of(summary), shown_by(candidate.sheet)
            lines = verdict(_called(candidate), outcome.folder, summary, group, shown)
            self._draw(outcome.folder)
        self._voice.say("\n".join(lines))

    def _marks(self, candidate: Candidate) -> Marks:
        return tuple((str(path), self._files.mark(path)) for path in _paths(candidate))

    def _stood(self, path: Path) -> float:
        return self._clock() - self._files.since([path])

    def _below(self, path: Path) -> str:
        with suppress(ValueError):
            return path.relative_to(self._campaign.raw).as_posix()
        return str(path)


def _refuse_vanished(candidate: Candidate) -> None:
    """Raise what the system refuses where exports are gone: that is no fault of the test."""
    for path in (candidate.sheet, *candidate.files.values()):
        with path.open("rb") as stream:
            stream.read(1)


def _called(candidate: Candidate) -> str:
    return _shown(candidate.name)


def _paths(candidate: Candidate) -> list[Path]:
    return [*sorted(candidate.files.values()), candidate.sheet]


def _mark(path: Path) -> Mark | None:
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_size, about.st_mtime_ns


def _shown(name: str) -> str:
    """A name as a terminal can show it."""
    return name if name.isprintable() else repr(name)[1:-1]
