"""Watch the exports of a campaign, and process and judge each test soon after its recording.

The verdict on a test gives its status, a comparison with its group and what to check at the bench.
"""

from __future__ import annotations

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
from labpipe.campaign.executors import Executor, Outcome, Outcomes, await_outcome
from labpipe.campaign.pairing import (
    Candidate,
    PairingOutcome,
    list_candidates,
    pair_test,
    read_plan,
)
from labpipe.campaign.queries import escape_controls, join_names
from labpipe.campaign.running import open_campaign, read_overview, run_test
from labpipe.campaign.workers import Pool
from labpipe.errors import LabpipeError, ProcessingError
from labpipe.messages import format_sentence
from labpipe.process.run import RefusedTest, Task, draw_figures, try_to_process
from labpipe.process.sheet_inference import load_all_protocols
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.sheet_grammar import PLAN_NAME, CampaignPlan
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import choose_unit, is_first_cycle
from labpipe.statistics.means import compute_t_quantile

_MAX_RESULTS: Final = 3
"""Largest number of results in a verdict."""

Values: TypeAlias = Mapping[str, Sequence[float]]
"""Values of several tests, keyed by result."""


def describe_test(
    name: str, test: TestResult, group_values: Values, main_names: Sequence[str]
) -> list[str]:
    """Describe a processed test for the person at the bench.

    Parameters
    ----------
    name : name of the test
    test : results of the test
    group_values : values of the results that are ok in the other tests of the group
    main_names : names of the main results in order, by which the protocol compares groups

    Returns
    -------
    Three lines: status, comparison of the main results with the group, and what to check.
    """
    results = _select_main_results(test.results, main_names)
    comparisons = [_compare_with_group(result, group_values, test.display) for result in results]
    outside_names = [comparison.name for comparison in comparisons if comparison.is_outside]
    n_ok, faults = len(test.results), []
    for status in (Status.FAILED, Status.DOUBTFUL):
        names = [result.name for result in test.results if result.status is status]
        n_ok -= len(names)
        faults += [f"{len(names)} {status} ({join_names(names)})"] if names else []
    faults += [f"outside the group: {join_names(outside_names)}"] if outside_names else []
    headline = f"{name}: {'CHECK' if faults else 'OK'}, {', '.join([f'{n_ok} ok', *faults])}"
    group_sizes = list(dict.fromkeys(comparison.group_size for comparison in comparisons))
    if len(group_sizes) == 1:  # the size is written once for all results
        texts = [*(comparison.text for comparison in comparisons), *group_sizes]
    else:
        texts = [f"{entry.text}, {entry.group_size}" for entry in comparisons] or ["no numbers"]
    codes = [code for result in test.results for code in result.codes]
    codes += [note.code for note in test.quality if note.severity is not Severity.INFO]
    actions = describe_actions(codes, is_outside=bool(outside_names))
    return [headline, f"  {'; '.join(texts)}", f"  {actions}"]


def describe_failure(name: str, code: str, reason: str) -> list[str]:
    """Describe a test that could not be processed.

    Parameters
    ----------
    name : name of the test
    code, reason : code of the failure, and its reason as text for a person

    Returns
    -------
    Three lines: status, reason, and what to check.
    """
    first_line = " ".join(reason.splitlines()[0].split()) if reason else code
    return [f"{name}: FAILED ({code})", f"  {first_line}", f"  {describe_actions([code])}"]


def describe_actions(codes: Iterable[str], *, is_outside: bool = False) -> str:
    """Describe in one line what to check while the specimen is mounted.

    Parameters
    ----------
    codes : codes of notes, reasons and failures; the most important code is first
    is_outside : whether a result is outside the prediction interval of its group
    """
    max_actions = 3
    bench_actions = read_actions()
    actions = list(dict.fromkeys(bench_actions[code] for code in codes if code in bench_actions))
    if is_outside:
        actions.append("compare the set-up with that of the other tests before dismounting")
    if not actions:
        return "nothing to check: the specimen can be dismounted"
    n_hidden = len(actions) - max_actions
    suffix = f"; and {n_hidden} more in summary.json" if n_hidden > 0 else ""
    return f"while it is mounted: {'; '.join(actions[:max_actions])}{suffix}"


@cache
def read_actions() -> dict[str, str]:
    """Read the checks at the bench, keyed by the code of a note, reason or failure."""
    text = (files("labpipe.campaign") / "bench_actions.toml").read_text(encoding="utf-8")
    entries = tomllib.loads(text)["action"]
    return {code: entry["do"] for entry in entries for code in entry["codes"]}


class _Comparison(NamedTuple):
    """Comparison of a result with its group.

    Parameters
    ----------
    name : name of the result
    text : value of the result and range of the group, in the display unit
    group_size : number of other tests in the group as text
    is_outside : whether the result is outside the prediction interval of the group
    """

    name: str
    text: str
    group_size: str
    is_outside: bool = False


def _select_main_results(results: Sequence[Result], main_names: Sequence[str]) -> list[Result]:
    """Select at most `_MAX_RESULTS` results: main results first, then others.

    Other results belong to the first cycle or to no particular cycle. Results without a value and
    results of clocks are left out.
    """
    candidates = {
        result.name: result
        for result in results
        if result.value is not None and not result.name.startswith("clock_")
    }
    other_names = (name for name in candidates if is_first_cycle(name))
    ranked_names = dict.fromkeys([*main_names, *other_names])
    return [candidates[name] for name in ranked_names if name in candidates][:_MAX_RESULTS]


def _compare_with_group(
    result: Result, group_values: Values, display: Mapping[str, str]
) -> _Comparison:
    """Compare a result with the other tests of its group by a Student prediction interval.

    In a small group, the text gives the range of the other tests instead, and the result is not
    judged.
    """
    min_group_tests = 6  # the prediction interval of fewer tests is too wide to be of use
    factor, unit = choose_unit(result.name, result.unit, display)
    name, value = result.name, factor * (result.value or 0.0)
    values = factor * np.array(group_values.get(name, ()))
    n, text = len(values), f"{name} {value:.4g} {unit}".rstrip()
    if n == 0:
        return _Comparison(name, text, "first of its group")
    if n < min_group_tests:
        lower, upper = sorted([values.min(), values.max()])
        range_text = f"{lower:.4g}" if n == 1 else f"{lower:.4g} to {upper:.4g}"
        text += f" (so far {range_text})"
        return _Comparison(name, text, f"n = {n} so far, too few to judge")
    false_alarm_rate = 0.05  # rate per test, divided among its results
    quantile = compute_t_quantile(n - 1, false_alarm_rate / _MAX_RESULTS)
    half_width = quantile * float(np.std(values, ddof=1)) * sqrt(1 + 1 / n)
    lower, upper = values.mean() - half_width, values.mean() + half_width
    is_outside = not lower <= value <= upper
    position = "OUTSIDE" if is_outside else "within"
    text += f" ({position} {lower:.4g} to {upper:.4g})"
    return _Comparison(name, text, f"n = {n} so far", is_outside)


def process_in_pool(pool: Pool, tasks: Iterable[Task]) -> Outcomes:
    """Process tests without figures one after another in a pool.

    `functools.partial` of this function and a pool is an `Executor`.

    Parameters
    ----------
    pool : pool of processes
    tasks : tests to process
    """
    for task in tasks:
        call = partial(try_to_process, replace(task, figures=False))
        yield task, await_outcome(task, pool.submit(call, subject=task.source))


class WatchedCampaign:
    """A watched campaign, which processes its tests and reads the results of their groups.

    Parameters
    ----------
    folders : folders of the campaign
    executor : function that processes the tests
    """

    def __init__(self, folders: CampaignFolders, executor: Executor) -> None:
        self._folders, self._executor, self.raw = folders, executor, folders.raw
        rows = read_overview(folders).rows
        self._processed_folders = {folder for folder, row in rows.items() if not row.is_due}

    def was_processed(self, sheet: Path) -> bool:
        """Return whether the present files of a test had been processed when the watch began.

        Parameters
        ----------
        sheet : path of the sheet of the test
        """
        return self._get_folder(sheet) in self._processed_folders

    def process(self, sheet: Path, *, is_forced: bool = False) -> Outcome | None:
        """Process a test and store its row.

        Parameters
        ----------
        sheet : path of the sheet of the test
        is_forced : whether the test is processed even if nothing changed

        Returns
        -------
        Outcome of the attempt; None if nothing changed.

        Raises
        ------
        LabpipeError
            If another labpipe processes the test, or the catalog cannot be written.
        """
        folder = self._get_folder(sheet)
        row, outcome = run_test(self._folders, self._executor, folder, is_forced=is_forced)
        if row is None:
            raise ProcessingError.about("campaign.test_in_use", folder)
        return outcome

    def read_group_values(self, sheet: Path) -> dict[str, list[float]]:
        """Read the values of the other tests of a group, as `Catalog.read_group_values` does.

        Parameters
        ----------
        sheet : path of the sheet of the test
        """
        with open_campaign(self._folders) as sync:
            return sync.catalog.read_group_values(self._get_folder(sheet))

    def _get_folder(self, sheet: Path) -> str:
        """Return the folder of a test relative to the campaign, which identifies the test."""
        return sheet.parent.relative_to(self.raw).as_posix()


Signature: TypeAlias = tuple[int, int] | None
"""Size and modification time of a file; None if the file is missing."""


def _can_open(path: Path) -> bool:
    """Return whether a file exists and is not locked by another program."""
    with suppress(OSError), path.open("rb") as stream:
        stream.read(1)
        return True
    return False


def _read_signature(path: Path) -> Signature:
    """Read the size and the modification time of a file."""
    with suppress(OSError):
        status = path.stat()
        return status.st_size, status.st_mtime_ns
    return None


@dataclass(slots=True)
class _WatchedTest:
    """State of a watched test, or of an unused file; times are on the clock of the watcher.

    Parameters
    ----------
    signatures : signatures of the files in the last scan, or when they were handled
    changed_at : time when a scan detected the last change, s; modification times are not compared
        with the clock, because the drive of the files may have another clock
    next_attempt : time of the next attempt if the files do not change, s; infinite after
        they were handled or their pairing failed
    handled_at : time when the files were handled, s; NaN if they were not
    is_forced : whether the test must be processed again, because files were missing or locked when
        it was refused
    """

    signatures: dict[Path, Signature] = field(default_factory=dict)
    changed_at: float = 0.0
    next_attempt: float = 0.0
    handled_at: float = nan
    is_forced: bool = False


class Watcher:
    """Watcher of a campaign, which scans its folder and handles tests whose files are stable.

    Parameters
    ----------
    campaign : campaign to watch
    pair : function that writes the sheet of a test, as `pair_test` does
    draw : function that draws figures. It is called with the folder of results before the verdict
        on a test is reported, and must therefore return immediately
    show_message : function that is called with each message
    clock : function that returns a monotonic time, s
    """

    def __init__(
        self,
        campaign: WatchedCampaign,
        *,
        pair: Callable[[Candidate, CampaignPlan, float], PairingOutcome],
        draw: Callable[[Path], object],
        show_message: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._campaign, self._pair, self._draw = campaign, pair, draw
        self._show_message, self._clock = show_message, clock
        self._plan_file = campaign.raw / PLAN_NAME
        self._plan_signature = _read_signature(self._plan_file)
        self.plan = read_plan(campaign.raw)
        self._tests = defaultdict[Path, _WatchedTest](_WatchedTest)
        self._reported_messages = set[str]()
        self._n_scans = 0
        self._is_folder_missing = False

    def scan(self) -> bool:
        """Scan the folder once, and handle the newest test that is ready.

        Returns
        -------
        Whether more tests are ready, so that the next scan follows without delay.
        """
        self._n_scans += 1
        raw = self._campaign.raw
        try:
            raw.stat()
            self._read_plan()
            ready_tests = self._find_ready_tests()
            if ready_tests:
                self._handle_test(ready_tests[0])
        except OSError as error:
            if not self._is_folder_missing:
                self._is_folder_missing = True
                reason = (error.strerror or str(error)).lower()
                path = error.filename or raw
                self._show_message(format_sentence("campaign.lost_folder", path=path, why=reason))
            return False
        if self._is_folder_missing:
            self._is_folder_missing = False
            self._show_message(format_sentence("campaign.folder_is_back", path=raw))
        return len(ready_tests) > 1

    def _show_once(self, text: str) -> None:
        """Report a message unless it was reported since the plan was last read."""
        if text not in self._reported_messages:
            self._reported_messages.add(text)
            self._show_message(text)

    def _is_skipped(self, folder: Path) -> bool:
        """Return whether this scan skips a test that was handled long ago."""
        check_interval = 40  # in scans, as a scan cannot check ten thousand tests
        test = self._tests[folder]
        is_recent = self._clock() - test.handled_at < self.plan.patience
        if test.next_attempt < inf or is_recent:
            return False
        return (hash(folder) - self._n_scans) % check_interval != 0

    def _read_plan(self) -> None:
        """Read the campaign YAML if it has changed; report a faulty one, and keep the last plan."""
        signature = _read_signature(self._plan_file)
        if signature == self._plan_signature:
            return
        self._plan_signature = signature
        try:
            self.plan = read_plan(self._campaign.raw)
        except LabpipeError as error:
            self._show_message(format_sentence("campaign.faulty_plan", error=error, file=PLAN_NAME))
            return
        self._reported_messages.clear()
        for test in self._tests.values():
            test.next_attempt = 0.0 if isnan(test.handled_at) else inf
        self._show_message(format_sentence("campaign.plan_read_again", file=PLAN_NAME))

    def _find_ready_tests(self) -> list[Candidate]:
        """Find the tests that are ready, the newest first, and report files that are not used."""
        listing = list_candidates(self._campaign.raw, self.plan, is_skipped=self._is_skipped)
        for path, reason in listing.unused_files.items():
            if self._measure_stable_time(path, [path]) > self.plan.patience:
                file = self._format_path(path)
                self._show_once(format_sentence("campaign.unused_file", file=file, why=reason))
        tests = [candidate for candidate in listing.candidates if self._is_ready(candidate)]
        stable_times = {candidate.folder: self._get_stable_time(candidate) for candidate in tests}
        return sorted(tests, key=lambda candidate: stable_times[candidate.folder])

    def _measure_stable_time(self, key: Path, paths: Iterable[Path]) -> float:
        """Read the signatures of files, and measure the time since they last changed, s."""
        test, signatures = self._tests[key], {path: _read_signature(path) for path in paths}
        if test.signatures != signatures:
            test.signatures, test.changed_at = signatures, self._clock()
            test.next_attempt, test.handled_at = 0.0, nan
        return self._clock() - test.changed_at

    def _get_stable_time(self, candidate: Candidate) -> float:
        """Return the time since the last known change of the files of a test, s."""
        return self._clock() - self._tests[candidate.folder].changed_at

    def _is_ready(self, candidate: Candidate) -> bool:
        """Return whether the files of a test are complete, stable, not locked and due.

        Files are due unless they were handled in this state, before or during the watch, or the
        next attempt is later. Files that remain locked are reported.
        """
        is_new = not self._tests[candidate.folder].signatures
        stable_time = self._measure_stable_time(candidate.folder, candidate.paths)
        test = self._tests[candidate.folder]
        if is_new and self._campaign.was_processed(candidate.sheet):
            test.next_attempt, test.handled_at = inf, -self.plan.patience
        is_complete = all(test.signatures[path] for path in candidate.files.values())
        is_due = self._clock() >= test.next_attempt and stable_time >= self.plan.still_for
        if not (is_complete and is_due):
            return False
        paths = [path for path, signature in test.signatures.items() if signature is not None]
        locked_files = [path for path in paths if not _can_open(path)]
        for path in locked_files if stable_time > self.plan.patience else ():
            label, file = escape_controls(candidate.name), escape_controls(path.name)
            self._show_once(format_sentence("campaign.locked_file", test=label, file=file))
        return not locked_files

    def _handle_test(self, candidate: Candidate) -> None:
        """Write the sheet of a test, process it and report the verdict, if no file is missing."""
        retry_delay = 5.0  # s
        test = self._tests[candidate.folder]
        test.next_attempt = self._clock() + retry_delay
        try:
            pairing = self._pair(candidate, self.plan, self._get_stable_time(candidate))
        except LabpipeError as error:
            test.next_attempt = inf
            self._show_once(f"{escape_controls(candidate.name)}: {error}")
            return
        if pairing.sheet is None:
            self._show_missing_files(candidate, pairing)
            return
        self._show_sheet(candidate, pairing)
        # The signatures are taken before processing, because exports may change during processing.
        signatures = test.signatures | {candidate.sheet: _read_signature(candidate.sheet)}
        if pairing.open_keys or self._process_test(candidate):
            test.signatures, test.next_attempt = signatures, inf
            test.handled_at = self._clock()

    def _process_test(self, candidate: Candidate) -> bool:
        """Process a test and report the verdict; return False if the attempt must be repeated."""
        test = self._tests[candidate.folder]
        try:
            outcome = self._campaign.process(candidate.sheet, is_forced=test.is_forced)
        except LabpipeError as error:
            self._show_once(f"{escape_controls(candidate.name)}: {error}")
            return False
        if isinstance(outcome, RefusedTest):
            test.is_forced = not all(map(_can_open, [candidate.sheet, *candidate.files.values()]))
            if test.is_forced:
                return False
        test.is_forced = False
        if outcome is not None:
            self._show_verdict(candidate, outcome)
        return True

    def _show_missing_files(self, candidate: Candidate, pairing: PairingOutcome) -> None:
        """Report once which files of a test are missing, or which cannot be read."""
        label = escape_controls(candidate.name)
        for name, reason in pairing.read_errors.items():
            if self._get_stable_time(candidate) > self.plan.patience:
                file = escape_controls(name)
                texts = {"test": label, "file": file, "why": reason}
                self._show_once(format_sentence("campaign.unread_file", **texts))
        if pairing.missing_files and not pairing.read_errors:
            names = ", ".join(pairing.missing_files)
            self._show_once(format_sentence("campaign.missing_files", test=label, files=names))

    def _show_sheet(self, candidate: Candidate, pairing: PairingOutcome) -> None:
        """Report the sheet of a test if the sheet is new, its messages and its open keys."""
        lines = [*pairing.messages]
        if pairing.is_new:
            label = escape_controls(candidate.name)
            headline = f"{label}: wrote {self._format_path(candidate.sheet)}"
            lines = [headline, *(f"  {message}" for message in lines)]
        if pairing.open_keys:
            keys = ", ".join(pairing.open_keys)
            lines.append(format_sentence("campaign.keys_to_fill_in", keys=keys))
        if lines:
            self._show_message("\n".join(lines))

    def _show_verdict(self, candidate: Candidate, outcome: Outcome) -> None:
        """Report the verdict on a test, and start to draw its figures."""
        label = escape_controls(candidate.name)
        if isinstance(outcome, RefusedTest):
            lines = describe_failure(label, outcome.code, outcome.reason)
        else:
            main_names = parse_protocol(outcome.result.protocol_yaml, label).groups.main
            values = self._campaign.read_group_values(candidate.sheet)
            lines = describe_test(label, outcome.result, values, main_names)
            self._draw(outcome.folder)
        self._show_message("\n".join(lines))

    def _format_path(self, path: Path) -> str:
        """Write a path as printable text, relative to the campaign if it is inside."""
        raw = self._campaign.raw
        shown_path = path.relative_to(raw) if path.is_relative_to(raw) else path
        return escape_controls(shown_path.as_posix())


def watch(folders: CampaignFolders, *, figures: bool, show_message: Callable[[str], None]) -> None:
    """Watch a campaign until the user interrupts it.

    Parameters
    ----------
    folders : folders of the campaign
    figures : whether figures are drawn, in the worker process after a test is processed
    show_message : function that is called with each message

    Raises
    ------
    LabpipeError
        If the campaign YAML has a fault, or the catalog cannot be used.
    """
    max_duration = 3600.0  # longest duration of a call in the worker process, s
    with Pool(1, timeout=max_duration) as pool:

        def pair(candidate: Candidate, plan: CampaignPlan, stable_time: float) -> PairingOutcome:
            # The worker process runs this call, because a damaged export may crash a process.
            call = partial(pair_test, candidate, plan, stable_time)
            return pool.submit(call, subject=candidate.folder).result()

        def draw(folder: Path) -> None:
            if figures:
                pool.submit(partial(draw_figures, folder), subject=folder)

        pool.submit(load_all_protocols, subject="labpipe")  # imports most of what tests need
        campaign = WatchedCampaign(folders, partial(process_in_pool, pool))
        watcher = Watcher(campaign, pair=pair, draw=draw, show_message=show_message)
        show_message(f"watching {folders.name}; press Ctrl+C to stop")
        load_all_protocols()  # loads units and grammar before the first verdict
        while True:
            start_time = time.monotonic()
            if not watcher.scan():  # scans of a slow drive take at most a third of the time
                time.sleep(max(watcher.plan.look_every, 2.0 * (time.monotonic() - start_time)))
