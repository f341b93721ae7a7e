"""Watch the exports of a campaign: process and judge each test seconds after its recording ends."""

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
from labpipe.campaign.executors import Executor, Outcome, await_outcome, process_task
from labpipe.campaign.pairing import (
    Candidate,
    CandidateListing,
    PairingOutcome,
    list_candidates,
    pair_test,
    read_plan,
)
from labpipe.campaign.quick_look import (
    describe_failure,
    describe_test,
    make_group_key,
    read_display_settings,
)
from labpipe.campaign.refreshing import open_campaign
from labpipe.campaign.running import read_overview, run_test
from labpipe.campaign.workers import ProcessDied, WorkerProcess
from labpipe.errors import LabpipeError, ProcessingError
from labpipe.messages import format_sentence
from labpipe.process.run import SUMMARY_FILE, Task, draw_figures
from labpipe.process.sheet_inference import load_all_protocols
from labpipe.protocol.sheet_grammar import PLAN_NAME, CampaignPlan

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
"""Modules that processing and figures need, besides those that this module imports."""


class WarmWorker:
    """A process that has imported all modules and runs calls one after another.

    Parameters
    ----------
    limit : time limit of a call, s, after which its process is killed
    """

    def __init__(self, *, limit: float = 3600.0) -> None:
        self._limit, self._process = limit, WorkerProcess()
        self._thread = ThreadPoolExecutor(max_workers=1)

    def warm(self) -> None:
        """Start to import the modules that tests need; do not wait."""
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
        """Start to draw the figures of a processed test; do not wait.

        Parameters
        ----------
        folder : of its results
        """
        self._submit(partial(draw_figures, folder))

    def executor(self, tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        """Process tests without figures; an `labpipe.campaign.executors.Executor`."""
        for task in tasks:
            call = self._submit(partial(process_task, replace(task, figures=False)))
            yield await_outcome(task, call.result)

    def close(self) -> None:
        """Wait for all submitted calls, and end the process."""
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


class WatchedCampaign:
    """The campaign of a watch: processes its tests and knows the values of the others.

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
        """Return the test sheets without results for their present files."""
        rows = {sheet: self._rows.get(self._label(sheet)) for sheet in sheets}
        return [
            sheet for sheet, row in rows.items() if row is None or row.state in {PENDING, STALE}
        ]

    def process(self, sheet: Path, *, is_forced: bool = False) -> Outcome | None:
        """Process a test, and store its row.

        Parameters
        ----------
        sheet : of the test
        is_forced : whether to process it even if nothing changed

        Returns
        -------
        The outcome; None if nothing changed.

        Raises
        ------
        LabpipeError
            If another labpipe works on it, or the catalog cannot be written.
        """
        label = self._label(sheet)
        row, outcome = run_test(self._folders, self._executor, label, is_forced=is_forced)
        if row is None:
            raise ProcessingError.about("campaign.test_in_use", label)
        self._rows = {**self._rows, label: row}
        return outcome

    def read_group_values(self, sheet: Path) -> dict[str, list[float]]:
        """Read the ok values of each result in the other tests of the group of a test.

        Parameters
        ----------
        sheet : of the test; rejected tests are left out
        """
        label = self._label(sheet)
        group, values = make_group_key(self._rows[label]), dict[str, list[float]]()
        with open_campaign(self._folders) as sync:
            for folder, row in self._rows.items():
                is_valid = folder != label and row.run and row.state != REJECTED
                if is_valid and make_group_key(row) == group:
                    for result in sync.catalog.read_results(folder):
                        if result.status == OK and result.value is not None:
                            values.setdefault(result.name, []).append(result.value)
        return values

    def _label(self, sheet: Path) -> str:
        return sheet.parent.relative_to(self._folders.raw).as_posix()


FileStatus: TypeAlias = Literal["stable", "growing", "locked", "missing"]
Signature: TypeAlias = tuple[int, int] | None
"""Size and time of change of a file; None if it is missing."""
Signatures: TypeAlias = tuple[tuple[str, Signature], ...]


class FileStability:
    """Tells whether files are still being written, from repeated looks at them.

    Parameters
    ----------
    clock : monotonic, s
    still_for : time without a change, s, after which a file is stable
    """

    def __init__(self, clock: Callable[[], float], still_for: float) -> None:
        self._clock, self.still_for = clock, still_for
        # The time is that of the watch, since the clock of a drive may differ.
        self._files: dict[Path, tuple[Signature, float]] = {}

    def look(self, path: Path) -> FileStatus:
        """Look at a file.

        Parameters
        ----------
        path : of the file

        Returns
        -------
        ``stable``: unchanged for long enough and readable; ``growing``: changed recently;
        ``locked``: unchanged, but cannot be opened; ``missing``.
        """
        now, signature = self._clock(), _read_signature(path)
        if signature is None:
            self._files.pop(path, None)
            return "missing"
        known_signature, since = self._files.get(path, (None, now))
        if known_signature != signature:
            self._files[path] = signature, now
            return "growing"
        if now - since < self.still_for:
            return "growing"
        return "stable" if _can_open(path) else "locked"

    def signature(self, path: Path) -> Signature:
        """Return the signature of a file at the last look."""
        return self._files[path][0] if path in self._files else None

    def last_change(self, paths: Iterable[Path]) -> float:
        """Return when the last of some files changed; the present time without any."""
        times = [self._files[path][1] for path in paths if path in self._files]
        return max(times, default=self._clock())


def _can_open(path: Path) -> bool:
    try:
        _require_readable([path])
    except OSError:
        return False
    return True


def _require_readable(paths: Iterable[Path]) -> None:
    """Raise an `OSError` if files are missing or locked, which is no fault of their test."""
    for path in paths:
        with path.open("rb") as stream:
            stream.read(1)


def _read_signature(path: Path) -> Signature:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


@dataclass(slots=True)
class _WatchedTest:
    """A test in the watch.

    Parameters
    ----------
    done, tried : signatures of its files when it was handled, and at the last attempt
    handled_at : time when it was handled, or its files changed
    missing : missing roles in the last message
    next_try : time of the next attempt if nothing changes
    is_forced : whether its files were missing during processing, so that it is processed again
    """

    done: Signatures = ()
    tried: Signatures = ()
    handled_at: float = 0.0
    missing: str = ""
    next_try: float = 0.0
    is_forced: bool = False


class Watcher:
    """Looks at the folder of a campaign repeatedly, and handles tests whose files are stable.

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
        self.plan = read_plan(campaign.raw)
        self._plan_signature = _read_signature(campaign.raw / PLAN_NAME)
        self._files = FileStability(clock, self.plan.still_for)
        self._say, self._printed = say, set[str]()
        self._tests: dict[Path, _WatchedTest] = {}
        self._n_looks = 0
        self._is_folder_missing = self._has_begun = False

    def look(self) -> bool:
        """Look once, and handle the newest test that is ready.

        Returns
        -------
        Whether more tests are ready, so that there is no pause.
        """
        self._n_looks += 1
        raw = self._campaign.raw
        try:
            raw.stat()
            self._read_plan()
            ready = self._find_ready(list_candidates(raw, self.plan, is_skipped=self._is_skipped))
            if ready:
                self._handle(ready[0])
        except OSError as error:
            if not self._is_folder_missing:
                self._is_folder_missing = True
                why = (error.strerror or str(error)).lower()
                path = error.filename or raw
                self._say(format_sentence("campaign.lost_folder", path=path, why=why))
            return False
        if self._is_folder_missing:
            self._is_folder_missing = False
            self._say(format_sentence("campaign.folder_is_back", path=raw))
        return len(ready) > 1

    def _say_once(self, text: str) -> None:
        """Print a message unless it was printed before."""
        if text not in self._printed:
            self._printed.add(text)
            self._say(text)

    def _is_skipped(self, folder: Path) -> bool:
        """Return whether a test that was handled a while ago is skipped in this look."""
        looks_between = 40  # ten thousand tests are too many to check in every look
        test = self._tests.get(folder)
        if test is None or not test.done or self._clock() - test.handled_at < self.plan.patience:
            return False
        return (hash(folder) - self._n_looks) % looks_between != 0

    def _read_plan(self) -> None:
        """Read a changed campaign YAML; report a faulty one and keep the last."""
        path = self._campaign.raw / PLAN_NAME
        signature = _read_signature(path)
        if signature == self._plan_signature:
            return
        self._plan_signature = signature
        try:
            self.plan = read_plan(self._campaign.raw)
        except LabpipeError as error:
            self._say(format_sentence("campaign.faulty_plan", error=error, file=PLAN_NAME))
            return
        self._files.still_for = self.plan.still_for
        self._tests = {
            folder: _WatchedTest(test.done, handled_at=test.handled_at)
            for folder, test in self._tests.items()
        }
        self._say(format_sentence("campaign.plan_read_again", file=PLAN_NAME))

    def _find_ready(self, listing: CandidateListing) -> list[Candidate]:
        """Find the tests that are ready, the newest first.

        The first look leaves out tests whose results are up to date.
        """
        for path, why in listing.unmatched.items():
            is_stable = self._files.look(path) == "stable"
            if is_stable and self._stable_for(path) > self.plan.patience:
                file = _printable(self._below(path))
                self._say_once(format_sentence("campaign.unused_file", file=file, why=why))
        ready = [candidate for candidate in listing.candidates if self._is_ready(candidate)]
        if ready and not self._has_begun:
            self._has_begun = True
            sheets = {candidate.sheet: candidate for candidate in ready if candidate.sheet.exists()}
            for sheet in sheets.keys() - self._campaign.unprocessed(sheets):
                done = sheets[sheet]
                ready.remove(done)
                self._tests[done.folder] = _WatchedTest(
                    self._list_signatures(done), handled_at=-self.plan.patience
                )
        return sorted(
            ready, key=lambda candidate: self._files.last_change(candidate.paths), reverse=True
        )

    def _is_ready(self, candidate: Candidate) -> bool:
        """Return whether all files of a test are stable, and were not handled in this state."""
        test = self._tests.setdefault(candidate.folder, _WatchedTest())
        states = {path: self._files.look(path) for path in candidate.paths}
        for path, state in states.items():
            if state == "locked" and self._stable_for(path) > self.plan.patience:
                label, file = _printable(candidate.name), _printable(path.name)
                self._say_once(format_sentence("campaign.locked_file", test=label, file=file))
        is_unstable = not {"growing", "locked"}.isdisjoint(states.values())
        if is_unstable or any(states[path] == "missing" for path in candidate.files.values()):
            test.handled_at = self._clock()
            return False
        signatures = self._list_signatures(candidate)
        if signatures != test.done:
            test.handled_at = self._clock()
        return signatures != test.done and (
            signatures != test.tried or self._clock() >= test.next_try
        )

    def _handle(self, candidate: Candidate) -> None:
        """Pair a test, process it and report the verdict, as far as its files permit."""
        retry_delay = 5.0  # s
        test = self._tests[candidate.folder]
        signatures = self._list_signatures(candidate)
        test.tried, test.next_try = signatures, self._clock() + retry_delay
        waited = self._clock() - self._files.last_change(candidate.files.values())
        try:
            pairing = self._pair(candidate, self.plan, waited)
        except LabpipeError as error:
            test.done = signatures
            self._say_once(f"{_printable(candidate.name)}: {error}")
            return
        if pairing.sheet is None:
            self._say_missing(candidate, test, pairing)
            return
        self._say_sheet(candidate, pairing)
        self._files.look(candidate.sheet)
        if pairing.open_keys or self._process(candidate):
            test.done, test.handled_at = self._list_signatures(candidate), self._clock()
            test.missing = ""

    def _process(self, candidate: Candidate) -> bool:
        """Process a test and report the verdict; return False if it must be tried again."""
        test = self._tests[candidate.folder]
        try:
            outcome = self._campaign.process(candidate.sheet, is_forced=test.is_forced)
        except LabpipeError as error:
            self._say_once(f"{_printable(candidate.name)}: {error}")
            return False
        if outcome is not None and outcome.state == "failed":
            test.is_forced = True
            _require_readable([candidate.sheet, *candidate.files.values()])
        test.is_forced = False
        if outcome is not None:
            self._say_verdict(candidate, outcome)
        return True

    def _say_missing(
        self, candidate: Candidate, test: _WatchedTest, pairing: PairingOutcome
    ) -> None:
        """Report once which files a test waits for."""
        label = _printable(candidate.name)
        for name, why in pairing.unreadable.items():
            path = candidate.files.get(name, candidate.folder / name)
            if self._stable_for(path) > self.plan.patience:
                file = _printable(name)
                self._say_once(
                    format_sentence("campaign.unread_file", test=label, file=file, why=why)
                )
        missing = "" if pairing.unreadable else ", ".join(pairing.missing)
        if missing and missing != test.missing:
            test.missing = missing
            self._say(format_sentence("campaign.missing_files", test=label, files=missing))

    def _say_sheet(self, candidate: Candidate, pairing: PairingOutcome) -> None:
        lines = [*pairing.messages]
        if pairing.is_new:
            head = f"{_printable(candidate.name)}: wrote {_printable(self._below(candidate.sheet))}"
            lines = [head, *(f"  {message}" for message in lines)]
        if pairing.open_keys:
            lines.append(
                format_sentence("campaign.keys_to_fill_in", keys=", ".join(pairing.open_keys))
            )
        if lines:
            self._say("\n".join(lines))

    def _say_verdict(self, candidate: Candidate, outcome: Outcome) -> None:
        label = _printable(candidate.name)
        if outcome.state == "failed" or outcome.folder is None:
            lines = describe_failure(label, outcome.code, outcome.reason)
        else:
            summary = json.loads((outcome.folder / SUMMARY_FILE).read_bytes())
            group_values = self._campaign.read_group_values(candidate.sheet)
            lines = describe_test(
                label, summary, group_values, read_display_settings(candidate.sheet)
            )
            self._draw(outcome.folder)
        self._say("\n".join(lines))

    def _list_signatures(self, candidate: Candidate) -> Signatures:
        return tuple((str(path), self._files.signature(path)) for path in candidate.paths)

    def _stable_for(self, path: Path) -> float:
        """Return for how long a file has not changed, s."""
        return self._clock() - self._files.last_change([path])

    def _below(self, path: Path) -> str:
        with suppress(ValueError):
            return path.relative_to(self._campaign.raw).as_posix()
        return str(path)


def _printable(name: str) -> str:
    """Escape a name that a terminal cannot show."""
    return name if name.isprintable() else repr(name)[1:-1]


def watch(folders: CampaignFolders, *, figures: bool, say: Callable[[str], None]) -> None:
    """Watch a campaign until an interrupt.

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
            if not watcher.look():  # looks at a slow drive take at most a third of the time
                time.sleep(max(watcher.plan.look_every, 2.0 * (time.monotonic() - began)))
    finally:
        worker.close()


def _pair_in(
    worker: WarmWorker, candidate: Candidate, plan: CampaignPlan, waited: float
) -> PairingOutcome:
    """Pair a test in the worker, since a damaged export may crash the process."""
    work = partial(pair_test, candidate, plan, waited=waited)
    return worker.call(work, about=candidate.folder)
