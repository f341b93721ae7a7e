"""Watch the exports of a campaign, and process and judge each test soon after its recording.

The verdict on a test has its status, a comparison with its group, and what to check at the bench.
"""

from __future__ import annotations

import json
import re
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.resources import files
from math import inf, isnan, nan, sqrt
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from labpipe.campaign.campaign_files import CampaignFolders
from labpipe.campaign.catalog import OK, REJECTED, TestRow
from labpipe.campaign.executors import Attempt, Attempts, Executor, await_attempt
from labpipe.campaign.pairing import (
    Candidate,
    PairingOutcome,
    list_candidates,
    pair_test,
    read_plan,
)
from labpipe.campaign.queries import escape_controls
from labpipe.campaign.running import open_campaign, read_overview, run_test
from labpipe.campaign.workers import Pool
from labpipe.errors import LabpipeError, ProcessingError
from labpipe.messages import format_sentence
from labpipe.process.run import Refused, Task, attempt, draw_figures
from labpipe.process.sheet_inference import load_all_protocols
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.sheet_grammar import PLAN_NAME, CampaignPlan
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import find_display_unit
from labpipe.statistics.means import compute_t_quantile

MAX_NUMBERS: Final = 3
"""Largest number of results in a verdict."""

Values: TypeAlias = Mapping[str, Sequence[float]]
"""Values of several tests by result."""


def make_group_key(row: TestRow) -> str:
    """Make the key of the group of a test from its protocol and specimen.

    Parameters
    ----------
    row : of the test; spool, sample and uncertainty of its specimen are left out
    """
    ignored_fields = ("spool", "sample", "uncertainty")  # these may differ within a group
    specimen = json.loads(row.specimen)
    fields = {key: value for key, value in specimen.items() if key not in ignored_fields}
    return json.dumps([row.protocol, fields], sort_keys=True)


def describe_test(
    name: str, test: TestResult, group_values: Values, main: Sequence[str]
) -> list[str]:
    """Describe a processed test for the person at the bench.

    Parameters
    ----------
    name : of the test
    test : its results
    group_values : values of each result in the other tests of its group, if ok
    main : names of the main results, by which the protocol compares groups, in order

    Returns
    -------
    Three lines: status, comparison of the main results with the group, and what to check.
    """
    chosen = _select_main_results(test.results, main)
    numbers = [_compare_with_group(result, group_values, test.display) for result in chosen]
    outside = [number.name for number in numbers if number.is_outside]
    names = {
        status: [result.name for result in test.results if result.status is status]
        for status in (Status.FAILED, Status.DOUBTFUL)
    }
    n_ok = len(test.results) - sum(map(len, names.values()))
    parts = [f"{len(bad)} {status} ({_join_names(bad)})" for status, bad in names.items() if bad]
    parts += [f"outside the group: {_join_names(outside)}"] if outside else []
    headline = f"{name}: {'CHECK' if parts else 'OK'}, {', '.join([f'{n_ok} ok', *parts])}"
    group_sizes = list(dict.fromkeys(number.group_size for number in numbers))
    if len(group_sizes) == 1:  # written once for all
        texts = [*(number.text for number in numbers), *group_sizes]
    else:
        texts = [f"{number.text}, {number.group_size}" for number in numbers] or ["no numbers"]
    codes = [code for result in test.results for code in result.codes]
    codes += [note.code for note in test.quality if note.severity is not Severity.INFO]
    actions = describe_actions(codes, outside=bool(outside))
    return [headline, f"  {'; '.join(texts)}", f"  {actions}"]


def describe_failure(name: str, code: str, reason: str) -> list[str]:
    """Describe a test that could not be processed.

    Parameters
    ----------
    name : of the test
    code, reason : of the failure

    Returns
    -------
    Three lines, as of `describe_test`.
    """
    first_line = " ".join(reason.splitlines()[0].split()) if reason else code
    return [f"{name}: FAILED ({code})", f"  {first_line}", f"  {describe_actions([code])}"]


def describe_actions(codes: Iterable[str], *, outside: bool = False) -> str:
    """Describe what to check while the specimen is mounted.

    Parameters
    ----------
    codes : of notes, reasons and failures, most important first
    outside : whether a result is outside the prediction interval of its group

    Returns
    -------
    One line.
    """
    max_actions = 3
    bench_actions = read_actions()
    chosen = list(dict.fromkeys(bench_actions[code] for code in codes if code in bench_actions))
    chosen += ["compare the set-up with that of the other tests before dismounting"] * outside
    if not chosen:
        return "nothing to check: the specimen can be dismounted"
    n_hidden = len(chosen) - max_actions
    more = f"; and {n_hidden} more in summary.json" if n_hidden > 0 else ""
    return f"while it is mounted: {'; '.join(chosen[:max_actions])}{more}"


@cache
def read_actions() -> dict[str, str]:
    """Read the checks at the bench by code of a note, reason or failure."""
    text = (files("labpipe.campaign") / "bench_actions.toml").read_text(encoding="utf-8")
    entries = tomllib.loads(text)["action"]
    return {code: entry["do"] for entry in entries for code in entry["codes"]}


class _Comparison(NamedTuple):
    """A result by name and as text, the size of its group, and whether it is outside the group."""

    name: str
    text: str
    group_size: str
    is_outside: bool = False


def _select_main_results(results: Sequence[Result], main: Sequence[str]) -> list[Result]:
    """Select at most `MAX_NUMBERS` results: main results first, then others.

    The others belong to the first cycle or to no particular cycle. Results without a value and
    those of clocks are left out.
    """
    available = (result for result in results if result.value is not None)
    candidates = {entry.name: entry for entry in available if not entry.name.startswith("clock_")}
    of_first_cycle = [name for name in candidates if not re.search(r"\.(?!1$)\d+$", name)]
    ranked = dict.fromkeys([*(name for name in main if name in candidates), *of_first_cycle])
    return [candidates[name] for name in ranked][:MAX_NUMBERS]


def _compare_with_group(
    result: Result, group_values: Values, display: Mapping[str, str]
) -> _Comparison:
    """Compare a result with the other tests of its group.

    The comparison is by a Student prediction interval. In a small group the text states the range
    of the other tests instead, and the result is not judged.
    """
    min_group_tests = 6  # for a prediction interval; below, the range is shown
    name, value = result.name, result.value or 0.0
    factor, unit = find_display_unit(name, result.unit, display)
    values = factor * np.array(group_values.get(name, ()))
    n, text = len(values), f"{name} {factor * value:.4g} {unit}".rstrip()
    if n == 0:
        return _Comparison(name, text, "first of its group")
    if n < min_group_tests:
        low, high = sorted([values.min(), values.max()])
        range_text = f"{low:.4g}" if n == 1 else f"{low:.4g} to {high:.4g}"
        return _Comparison(
            name, f"{text} (so far {range_text})", f"n = {n} so far, too few to judge"
        )
    false_alarm_rate = 0.05  # per verdict, shared by its numbers
    quantile = compute_t_quantile(n - 1, false_alarm_rate / MAX_NUMBERS)
    half_width = quantile * float(np.std(values, ddof=1)) * sqrt(1 + 1 / n)
    low, high = values.mean() - half_width, values.mean() + half_width
    is_outside = not low <= factor * value <= high
    position = "OUTSIDE" if is_outside else "within"
    text += f" ({position} {low:.4g} to {high:.4g})"
    return _Comparison(name, text, f"n = {n} so far", is_outside)


def _join_names(names: Sequence[str]) -> str:
    max_names = 4
    more = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + more


def process_in_pool(pool: Pool, tasks: Iterable[Task]) -> Attempts:
    """Process tests without figures one after another in a pool; a partial is an `Executor`.

    Parameters
    ----------
    pool : of processes
    tasks : the tests
    """
    for task in tasks:
        call = partial(attempt, replace(task, figures=False))
        yield task, await_attempt(task, pool.submit(call, subject=task.sheet))


class WatchedCampaign:
    """A watched campaign: processes its tests and reads the results of their groups.

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

    def is_processed(self, sheet: Path) -> bool:
        """Return whether the present files of a test have been processed."""
        row = self._rows.get(self._label(sheet))
        return row is not None and not row.is_due

    def process(self, sheet: Path, *, is_forced: bool = False) -> Attempt | None:
        """Process a test and keep its row.

        Parameters
        ----------
        sheet : of the test
        is_forced : whether to process it even if nothing changed

        Returns
        -------
        What came of it; None if nothing changed.

        Raises
        ------
        LabpipeError
            If another labpipe works on it, or the catalog cannot be written.
        """
        label = self._label(sheet)
        row, attempted = run_test(self._folders, self._executor, label, is_forced=is_forced)
        if row is None:
            raise ProcessingError.about("campaign.test_in_use", label)
        self._rows = {**self._rows, label: row}
        return attempted

    def read_group_values(self, sheet: Path) -> dict[str, list[float]]:
        """Read the values of each result, if ok, in the other tests of the group of a test.

        Parameters
        ----------
        sheet : of the test; rejected tests are left out
        """
        label = self._label(sheet)
        group, values = make_group_key(self._rows[label]), defaultdict[str, list[float]](list)
        with open_campaign(self._folders) as sync:
            for folder, row in self._rows.items():
                is_valid = folder != label and row.run and row.state != REJECTED
                if is_valid and make_group_key(row) == group:
                    for result in sync.catalog.read_results(folder):
                        if result.status == OK and result.value is not None:
                            values[result.name].append(result.value)
        return values

    def _label(self, sheet: Path) -> str:
        return sheet.parent.relative_to(self._folders.raw).as_posix()


Signature: TypeAlias = tuple[int, int] | None
"""Size and time of change of a file; None if it is missing."""


def _can_open(path: Path) -> bool:
    """Return whether a file exists and is not locked by another program."""
    with suppress(OSError), path.open("rb") as stream:
        stream.read(1)
        return True
    return False


def _read_signature(path: Path) -> Signature:
    with suppress(OSError):
        status = path.stat()
        return status.st_size, status.st_mtime_ns
    return None


@dataclass(slots=True)
class _WatchedTest:
    """State of a watched test, or of a file that belongs to no test.

    Parameters
    ----------
    files : signatures of its files in the last scan, or when it was handled
    changed_at : when a change was seen; not the time of the file, as a drive may have another clock
    next_try : time of the next attempt if its files do not change; infinite once it was handled or
        its pairing failed
    handled_at : time when its files were handled; NaN if they were not
    is_forced : whether it must be processed again, because files were missing or locked when it was
        refused
    """

    files: dict[Path, Signature] = field(default_factory=dict)
    changed_at: float = 0.0
    next_try: float = 0.0
    handled_at: float = nan
    is_forced: bool = False


class Watcher:
    """Scans the folder of a campaign repeatedly, and handles tests whose files are stable.

    Parameters
    ----------
    campaign : to watch
    pair : writes the sheet of a test, as `pair_test`
    draw : draws figures; called with the folder of results before the verdict on a test is
        reported, and must therefore return at once
    say : called with each message
    clock : monotonic, s
    """

    def __init__(
        self,
        campaign: WatchedCampaign,
        *,
        pair: Callable[[Candidate, CampaignPlan, float], PairingOutcome],
        draw: Callable[[Path], object],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._campaign, self._pair, self._draw, self._say = campaign, pair, draw, say
        self._clock, self._plan_file = clock, campaign.raw / PLAN_NAME
        self._plan_signature = _read_signature(self._plan_file)
        self.plan = read_plan(campaign.raw)
        self._tests = defaultdict[Path, _WatchedTest](_WatchedTest)
        self._printed = set[str]()
        self._n_scans = 0
        self._is_folder_missing = self._has_found_ready = False

    def scan(self) -> bool:
        """Scan the folder once, and handle the newest test that is ready.

        Returns
        -------
        Whether more tests are ready, so that the next scan must not wait.
        """
        self._n_scans += 1
        raw = self._campaign.raw
        try:
            raw.stat()
            self._read_plan()
            ready = self._find_ready()
            if ready:
                self._handle(ready[0])
        except OSError as error:
            if not self._is_folder_missing:
                self._is_folder_missing = True
                reason = (error.strerror or str(error)).lower()
                path = error.filename or raw
                self._say(format_sentence("campaign.lost_folder", path=path, why=reason))
            return False
        if self._is_folder_missing:
            self._is_folder_missing = False
            self._say(format_sentence("campaign.folder_is_back", path=raw))
        return len(ready) > 1

    def _say_once(self, text: str) -> None:
        """Report a message unless it was reported since the plan was last read."""
        if text not in self._printed:
            self._printed.add(text)
            self._say(text)

    def _is_skipped(self, folder: Path) -> bool:
        """Return whether this scan skips a test that was handled long ago."""
        scans_between_checks = 40  # ten thousand tests are too many to check in every scan
        test = self._tests[folder]
        is_recent = self._clock() - test.handled_at < self.plan.patience
        if test.next_try < inf or is_recent:
            return False
        return (hash(folder) - self._n_scans) % scans_between_checks != 0

    def _read_plan(self) -> None:
        """Read a changed campaign YAML; if it is faulty, report it and keep the last plan."""
        signature = _read_signature(self._plan_file)
        if signature == self._plan_signature:
            return
        self._plan_signature = signature
        try:
            self.plan = read_plan(self._campaign.raw)
        except LabpipeError as error:
            self._say(format_sentence("campaign.faulty_plan", error=error, file=PLAN_NAME))
            return
        self._printed.clear()
        for test in self._tests.values():
            test.next_try = 0.0 if isnan(test.handled_at) else inf
        self._say(format_sentence("campaign.plan_read_again", file=PLAN_NAME))

    def _find_ready(self) -> list[Candidate]:
        """Find the tests that are ready, the newest first, and report files that are not used.

        The first scan that finds any test leaves out those whose results are up to date.
        """
        listing = list_candidates(self._campaign.raw, self.plan, is_skipped=self._is_skipped)
        for path, reason in listing.unmatched.items():
            if self._measure_stable_time(path, [path]) > self.plan.patience:
                file = self._format_path(path)
                self._say_once(format_sentence("campaign.unused_file", file=file, why=reason))
        ready = [candidate for candidate in listing.candidates if self._is_ready(candidate)]
        if ready and not self._has_found_ready:
            self._has_found_ready = True
            for candidate in [*ready]:
                if candidate.sheet.exists() and self._campaign.is_processed(candidate.sheet):
                    ready.remove(candidate)
                    test = self._tests[candidate.folder]
                    test.next_try, test.handled_at = inf, -self.plan.patience
        stable_times = {candidate.folder: self._read_stable_time(candidate) for candidate in ready}
        return sorted(ready, key=lambda candidate: stable_times[candidate.folder])

    def _measure_stable_time(self, key: Path, paths: Iterable[Path]) -> float:
        """Read the signatures of files; return for how long they have not changed, s."""
        test, files = self._tests[key], {path: _read_signature(path) for path in paths}
        if test.files != files:
            test.files, test.changed_at, test.next_try = files, self._clock(), 0.0
            test.handled_at = nan
        return self._clock() - test.changed_at

    def _read_stable_time(self, candidate: Candidate) -> float:
        """Return the time since a change in the files of a test was last seen, s."""
        return self._clock() - self._tests[candidate.folder].changed_at

    def _is_ready(self, candidate: Candidate) -> bool:
        """Return whether the files of a test are complete, stable, not locked and due.

        Files are due unless they were handled in this state or the next attempt is later. Files
        that stay locked are reported.
        """
        stable_time = self._measure_stable_time(candidate.folder, candidate.paths)
        test = self._tests[candidate.folder]
        is_complete = all(test.files[path] for path in candidate.files.values())
        is_due = self._clock() >= test.next_try and stable_time >= self.plan.still_for
        if not (is_complete and is_due):
            return False
        paths = [path for path, signature in test.files.items() if signature is not None]
        locked = [path for path in paths if not _can_open(path)]
        for path in locked if stable_time > self.plan.patience else ():
            label, file = escape_controls(candidate.name), escape_controls(path.name)
            self._say_once(format_sentence("campaign.locked_file", test=label, file=file))
        return not locked

    def _handle(self, candidate: Candidate) -> None:
        """Write the sheet of a test, process it and report the verdict, if its files permit."""
        retry_delay = 5.0  # s
        test = self._tests[candidate.folder]
        test.next_try = self._clock() + retry_delay
        try:
            pairing = self._pair(candidate, self.plan, self._read_stable_time(candidate))
        except LabpipeError as error:
            test.next_try = inf
            self._say_once(f"{escape_controls(candidate.name)}: {error}")
            return
        if pairing.sheet is None:
            self._say_missing(candidate, pairing)
            return
        self._say_sheet(candidate, pairing)
        # exports may change while they are processed
        files = test.files | {candidate.sheet: _read_signature(candidate.sheet)}
        if pairing.open_keys or self._process(candidate):
            test.files, test.next_try, test.handled_at = files, inf, self._clock()

    def _process(self, candidate: Candidate) -> bool:
        """Process a test and report the verdict; return False if it must be tried again."""
        test = self._tests[candidate.folder]
        try:
            attempted = self._campaign.process(candidate.sheet, is_forced=test.is_forced)
        except LabpipeError as error:
            self._say_once(f"{escape_controls(candidate.name)}: {error}")
            return False
        if isinstance(attempted, Refused):
            test.is_forced = not all(map(_can_open, [candidate.sheet, *candidate.files.values()]))
            if test.is_forced:
                return False
        test.is_forced = False
        if attempted is not None:
            self._say_verdict(candidate, attempted)
        return True

    def _say_missing(self, candidate: Candidate, pairing: PairingOutcome) -> None:
        """Report once which files a test waits for, or which cannot be read."""
        label = escape_controls(candidate.name)
        for name, reason in pairing.unreadable.items():
            if self._read_stable_time(candidate) > self.plan.patience:
                file = escape_controls(name)
                self._say_once(
                    format_sentence("campaign.unread_file", test=label, file=file, why=reason)
                )
        if pairing.missing and not pairing.unreadable:
            names = ", ".join(pairing.missing)
            self._say_once(format_sentence("campaign.missing_files", test=label, files=names))

    def _say_sheet(self, candidate: Candidate, pairing: PairingOutcome) -> None:
        lines = [*pairing.messages]
        if pairing.is_new:
            headline = (
                f"{escape_controls(candidate.name)}: wrote {self._format_path(candidate.sheet)}"
            )
            lines = [headline, *(f"  {message}" for message in lines)]
        if pairing.open_keys:
            keys = ", ".join(pairing.open_keys)
            lines.append(format_sentence("campaign.keys_to_fill_in", keys=keys))
        if lines:
            self._say("\n".join(lines))

    def _say_verdict(self, candidate: Candidate, attempted: Attempt) -> None:
        label = escape_controls(candidate.name)
        if isinstance(attempted, Refused):
            lines = describe_failure(label, attempted.code, attempted.reason)
        else:
            main = parse_protocol(attempted.result.protocol_yaml, label).groups.main
            values = self._campaign.read_group_values(candidate.sheet)
            lines = describe_test(label, attempted.result, values, main)
            self._draw(attempted.folder)
        self._say("\n".join(lines))

    def _format_path(self, path: Path) -> str:
        """Return a path below the campaign, or the whole path, as printable text."""
        raw = self._campaign.raw
        return escape_controls(
            (path.relative_to(raw) if path.is_relative_to(raw) else path).as_posix()
        )


def watch(folders: CampaignFolders, *, figures: bool, say: Callable[[str], None]) -> None:
    """Watch a campaign until interrupted.

    Parameters
    ----------
    folders : of the campaign
    figures : whether figures are drawn, in the worker process after a test is processed
    say : called with each message

    Raises
    ------
    LabpipeError
        If the campaign YAML has a fault, or the catalog cannot be used.
    """
    max_duration = 3600.0  # s, of a call in the worker process
    with Pool(1, limit=max_duration) as pool:

        def pair(candidate: Candidate, plan: CampaignPlan, waited: float) -> PairingOutcome:
            # in the worker process, since a damaged export may crash it
            work = partial(pair_test, candidate, plan, waited=waited)
            return pool.submit(work, subject=candidate.folder).result()

        def draw(folder: Path) -> None:
            if figures:
                pool.submit(partial(draw_figures, folder), subject=folder)

        pool.submit(load_all_protocols, subject="labpipe")  # imports most of what tests need
        campaign = WatchedCampaign(folders, partial(process_in_pool, pool))
        watcher = Watcher(campaign, pair=pair, draw=draw, say=say)
        say(f"watching {folders.name}; press Ctrl+C to stop")
        load_all_protocols()  # loads units and grammar before the first verdict
        while True:
            start_time = time.monotonic()
            if not watcher.scan():  # scans of a slow drive take at most a third of the time
                time.sleep(max(watcher.plan.look_every, 2.0 * (time.monotonic() - start_time)))
