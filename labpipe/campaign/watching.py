"""Watch the folder of a campaign, and report each test seconds after its recording ends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

from labpipe.campaign.campaign_folders import CampaignFolders
from labpipe.campaign.catalog_rows import OK, PENDING, REJECTED, STALE
from labpipe.campaign.executors import Executor, Outcome, Task, outcome_of, outcome_of_call
from labpipe.campaign.pairing import (
    Candidate,
    PairingOutcome,
    RawListing,
    list_candidates,
    pair_test,
    plan_of,
)
from labpipe.campaign.quick_look import (
    display_settings,
    failure_lines,
    group_of,
    verdict,
)
from labpipe.campaign.refreshing import open_campaign
from labpipe.campaign.running import read_overview, run_test
from labpipe.campaign.workers import ProcessDied, WorkerProcess
from labpipe.errors import LabpipeError, ProcessingError
from labpipe.messages import format_sentence
from labpipe.process.protocol_match import load_all_protocols
from labpipe.process.run import SUMMARY_FILE, draw_figures
from labpipe.protocol.plans import PLAN_NAME, CampaignPlan

T = TypeVar("T")
_MODULES = (
    "labpipe.process.story",
    "labpipe.process.camera_steps",
    "labpipe.markers.specimen_shape",
    "labpipe.results.moment_curvature",
    "labpipe.store.write",
    "labpipe.report.figures",
    *(f"labpipe.readers.{name}" for name in ("dspace_mat", "motive_takes", "load_frame")),
    "scipy.optimize",
    "scipy.signal",
    "scipy.interpolate",
    "scipy.stats",
)
"""Modules that processing and figures import, besides those of this one."""


class WarmWorker:
    """A process that runs calls in sequence; if it dies, only its call fails.

    Parameters
    ----------
    limit : s, time limit of a call, after which its process is ended
    """

    def __init__(self, *, limit: float = 3600.0) -> None:
        self._limit, self._process = limit, WorkerProcess()
        self._thread = ThreadPoolExecutor(max_workers=1)

    def warm(self) -> None:
        """Start importing the modules of tests, without waiting."""
        self._submit(_import_all)

    def call(self, work: Callable[[], T], *, about: object) -> T:
        """Run a call in the process and wait for it.

        Parameters
        ----------
        work : can be pickled, and so can its result
        about : subject for messages, such as a file

        Raises
        ------
        ProcessingError
            If the process dies, or the call takes too long; the process is replaced.
        LabpipeError
            If the call raises it.
        """
        try:
            return self._submit(work).result()
        except ProcessDied as died:
            raise ProcessingError(str(died.error(about))) from died

    def draw(self, folder: Path) -> None:
        """Start drawing the figures of a processed test, without waiting.

        Parameters
        ----------
        folder : of its results
        """
        self._submit(partial(draw_figures, folder))

    def executor(self, tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        """Process tests without figures; see `labpipe.campaign.executors.Executor`."""
        for task in tasks:
            call = self._submit(partial(outcome_of, replace(task, figures=False)))
            yield outcome_of_call(task, call.result)

    def close(self) -> None:
        """Wait for the started calls, and end the process."""
        try:
            self._thread.shutdown()
        finally:
            self._process.close()

    def _submit(self, work: Callable[[], T]) -> Future[T]:
        return self._thread.submit(self._process.call, work, limit=self._limit)


def _import_all() -> None:
    for name in _MODULES:
        import_module(name)
    load_all_protocols()  # parses protocols and units once


REMINDER_DELAY = 3600.0
"""s after which a growing or locked file is reported again."""


class WatchedCampaign:
    """A watched campaign with its catalog.

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
        """Return the folder of the exports."""
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
        row, outcome = run_test(self._folders, self._executor, label, again=again)
        if row is None:
            raise ProcessingError.about("campaign.test_in_use", label)
        self._rows = {**self._rows, label: row}
        return outcome

    def values_beside(self, sheet: Path) -> dict[str, list[float]]:
        """Return the ok values of each result in the other tests of the group of a test.

        Parameters
        ----------
        sheet : of the test; rejected tests are left out
        """
        label = self._label(sheet)
        group, values = group_of(self._rows[label]), dict[str, list[float]]()
        with open_campaign(self._folders) as sync:
            for folder, row in self._rows.items():
                is_valid = folder != label and row.run and row.state != REJECTED
                if is_valid and group_of(row) == group:
                    for result in sync.catalog.results_of(folder):
                        if result.status == OK and result.value is not None:
                            values.setdefault(result.name, []).append(result.value)
        return values

    def _label(self, sheet: Path) -> str:
        return sheet.parent.relative_to(self._folders.raw).as_posix()


State: TypeAlias = Literal["still", "growing", "locked", "gone"]
Mark: TypeAlias = tuple[int, int] | None
"""Size and time of change of a file; None if it is gone."""
Marks: TypeAlias = tuple[tuple[str, Mark], ...]


@dataclass(slots=True)
class _FileState:
    """State of a file at the last look.

    Parameters
    ----------
    mark : size and time
    since : start of this state, by the clock of the watch (the clock of a drive may differ)
    moving_since : start of the last changes
    was_still : whether it was found unchanged and readable with this mark
    """

    mark: Mark
    since: float
    moving_since: float
    was_still: bool = False


class FileStability:
    """Files under repeated observation.

    Parameters
    ----------
    clock : monotonic, s
    still_for : s without a change, after which a file is still
    """

    def __init__(self, clock: Callable[[], float], still_for: float) -> None:
        self._clock, self.still_for = clock, still_for
        self._seen: dict[Path, _FileState] = {}

    def look(self, path: Path) -> State:
        """Look at a file.

        Parameters
        ----------
        path : of the file

        Returns
        -------
        ``still``: unchanged for long enough and readable; ``growing``: changed recently;
        ``locked``: unchanged, but cannot be opened; ``gone``.
        """
        now, mark, seen = self._clock(), _mark(path), self._seen.get(path)
        if mark is None:
            self._seen.pop(path, None)
            return "gone"
        if seen is None or seen.mark != mark:
            moving_since = now if seen is None or seen.was_still else seen.moving_since
            self._seen[path] = _FileState(mark, now, moving_since)
            return "growing"
        if now - seen.since < self.still_for:
            return "growing"
        seen.was_still = _opens(path)
        return "still" if seen.was_still else "locked"

    def mark(self, path: Path) -> Mark:
        """Return size and time of a file at the last look."""
        return self._seen[path].mark if path in self._seen else None

    def still_since(self, paths: Iterable[Path]) -> float:
        """Return when the last of some files changed; the present without any."""
        times = [self._seen[path].since for path in paths if path in self._seen]
        return max(times, default=self._clock())

    def moving_for(self, path: Path) -> float:
        """Return for how long a file has been changing or locked, s."""
        seen = self._seen.get(path)
        return 0.0 if seen is None else self._clock() - seen.moving_since


def _opens(path: Path) -> bool:
    try:
        _require_readable([path])
    except OSError:
        return False
    return True


def _require_readable(paths: Iterable[Path]) -> None:
    """Raise an `OSError` if files are missing or locked, which is not a fault of their test."""
    for path in paths:
        with path.open("rb") as stream:
            stream.read(1)


def _mark(path: Path) -> Mark:
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_size, about.st_mtime_ns


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
        campaign: WatchedCampaign,
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
        self._say, self._printed = say, set[str]()
        self._tests: dict[Path, _Test] = {}
        self._turn = 0
        self._is_gone = self._has_begun = False

    def look(self) -> bool:
        """Look once, and handle the newest test that is ready.

        Returns
        -------
        Whether more tests are ready, so that there is no pause.
        """
        self._turn += 1
        raw = self._campaign.raw
        try:
            raw.stat()
            self._read_plan()
            ready = self._ready(list_candidates(raw, self.plan, is_skipped=self._is_skipped))
            if ready:
                self._handle(ready[0])
        except OSError as error:
            if not self._is_gone:
                self._is_gone = True
                why = (error.strerror or str(error)).lower()
                self._say(f"{error.filename or raw}: {why}; waiting for it")
            return False
        if self._is_gone:
            self._is_gone = False
            self._say(f"{raw}: available again")
        return len(ready) > 1

    def _say_once(self, text: str) -> None:
        """Print a message unless it was printed before."""
        if text not in self._printed:
            self._printed.add(text)
            self._say(text)

    def _is_skipped(self, folder: Path) -> bool:
        """Return whether a test was handled a while ago and is skipped in this look."""
        # Ten thousand tests are too many to check in every look.
        looks_between = 40
        test = self._tests.get(folder)
        if test is None or not test.done or self._clock() - test.settled < self.plan.patience:
            return False
        return (hash(folder) - self._turn) % looks_between != 0

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
            self._say(f"{error}\n  the last valid {PLAN_NAME} is used")
            return
        self._files.still_for = self.plan.still_for
        self._tests = {
            folder: _Test(test.done, settled=test.settled) for folder, test in self._tests.items()
        }
        self._say(f"{PLAN_NAME} was read again")

    def _ready(self, listed: RawListing) -> list[Candidate]:
        """Return the tests that are ready, the newest first, and not those done before."""
        for path, why in listed.unmatched.items():
            if self._files.look(path) == "still" and self._still_for(path) > self.plan.patience:
                self._say_once(f"{_printable(self._below(path))}: not used: {why}")
        ready = [candidate for candidate in listed.candidates if self._is_ready(candidate)]
        if ready and not self._has_begun:
            self._has_begun = True
            sheets = {candidate.sheet for candidate in ready if candidate.sheet.exists()}
            for sheet in sheets.difference(self._campaign.unprocessed(sheets)):
                (done,) = (candidate for candidate in ready if candidate.sheet == sheet)
                ready.remove(done)
                self._tests[done.folder] = _Test(self._marks(done), settled=-self.plan.patience)
        return sorted(
            ready,
            key=lambda candidate: self._files.still_since(candidate.paths),
            reverse=True,
        )

    def _is_ready(self, candidate: Candidate) -> bool:
        """Return whether all files of a test are still, and were not handled in this state."""
        test = self._tests.setdefault(candidate.folder, _Test())
        states = {path: self._files.look(path) for path in candidate.paths}
        waits = [path for path, state in states.items() if state in {"growing", "locked"}]
        for path in waits:
            self._say_waiting(candidate, path, is_locked=states[path] == "locked")
        if waits or any(states[path] == "gone" for path in candidate.files.values()):
            test.settled = self._clock()
            return False
        marks = self._marks(candidate)
        if marks != test.done:
            test.settled = self._clock()
        return marks != test.done and (marks != test.tried or self._clock() >= test.next_try)

    def _say_waiting(self, candidate: Candidate, path: Path, *, is_locked: bool) -> None:
        moving = self._files.moving_for(path)
        test, file = _printable(candidate.name), _printable(path.name)
        if is_locked and moving > self.plan.patience:
            self._say_once(format_sentence("campaign.locked_file", test=test, file=file))
        if moving > REMINDER_DELAY:
            self._say_once(
                format_sentence(
                    "campaign.long_locked_file" if is_locked else "campaign.long_growing_file",
                    test=test, file=file,
                )
            )  # fmt: skip

    def _handle(self, candidate: Candidate) -> None:
        # s between attempts
        retry_delay = 5.0
        test = self._tests[candidate.folder]
        marks = self._marks(candidate)
        test.tried, test.next_try = marks, self._clock() + retry_delay
        waited = self._clock() - self._files.still_since(candidate.files.values())
        try:
            written = self._pair(candidate, self.plan, waited)
        except LabpipeError as error:
            test.done = marks
            self._say_once(f"{_printable(candidate.name)}: {error}")
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
            self._say_once(f"{_printable(candidate.name)}: {error}")
            return False
        if outcome is not None and outcome.state == "failed":
            test.again = True
            _require_readable([candidate.sheet, *candidate.files.values()])
        test.again = False
        if outcome is not None:
            self._say_verdict(candidate, outcome)
        return True

    def _say_missing(self, candidate: Candidate, test: _Test, written: PairingOutcome) -> None:
        """Report once what a test waits for."""
        label = _printable(candidate.name)
        for name, why in written.unread.items():
            stood = self._still_for(candidate.files.get(name, candidate.folder / name))
            file = _printable(name)
            if stood > self.plan.patience:
                self._say_once(
                    format_sentence("campaign.unread_file", test=label, file=file, why=why)
                )
            if stood > REMINDER_DELAY:
                self._say_once(format_sentence("campaign.long_unread_file", test=label, file=file))
        waits = "" if written.unread else ", ".join(written.missing)
        if waits and waits != test.waits:
            test.waits = waits
            self._say(f"{label}: waits for {waits}")

    def _say_sheet(self, candidate: Candidate, written: PairingOutcome) -> None:
        lines = [*written.messages]
        if written.is_new:
            head = f"{_printable(candidate.name)}: wrote {_printable(self._below(candidate.sheet))}"
            lines = [head, *(f"  {message}" for message in lines)]
        if written.open:
            lines.append(f"  to fill in: {', '.join(written.open)}; it is processed then")
        if lines:
            self._say("\n".join(lines))

    def _say_verdict(self, candidate: Candidate, outcome: Outcome) -> None:
        label = _printable(candidate.name)
        if outcome.state == "failed" or outcome.folder is None:
            lines = failure_lines(label, outcome.code, outcome.reason)
        else:
            summary = json.loads((outcome.folder / SUMMARY_FILE).read_bytes())
            others = self._campaign.values_beside(candidate.sheet)
            lines = verdict(label, summary, others, display_settings(candidate.sheet))
            self._draw(outcome.folder)
        self._say("\n".join(lines))

    def _marks(self, candidate: Candidate) -> Marks:
        return tuple((str(path), self._files.mark(path)) for path in candidate.paths)

    def _still_for(self, path: Path) -> float:
        return self._clock() - self._files.still_since([path])

    def _below(self, path: Path) -> str:
        with suppress(ValueError):
            return path.relative_to(self._campaign.raw).as_posix()
        return str(path)


def _printable(name: str) -> str:
    """Escape a name for a terminal."""
    return name if name.isprintable() else repr(name)[1:-1]


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
        load_all_protocols()  # loads units and grammar before the first verdict
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
