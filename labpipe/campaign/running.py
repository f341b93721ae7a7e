"""Update the catalog of a campaign from its files, and process new and changed tests."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from labpipe.campaign.campaign_files import (
    NO_OUTCOME,
    CampaignFolders,
    HashedInputs,
    InputReader,
    OutcomeFiles,
    RawContent,
    describe_changes,
    find_outcome,
    hash_text,
    list_processed,
    list_raw,
    parse_inputs,
)
from labpipe.campaign.catalog import (
    FAILED,
    NEWER_RESULT,
    PENDING,
    REJECTED,
    RUNNING,
    STALE,
    Catalog,
    Claim,
    Entry,
    FileState,
    TestRow,
    open_catalog,
    read_outcome,
    write_json,
)
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    DecisionFile,
    add_decisions,
    find_decision_in_force,
    find_outdated_decisions,
    format_current_time,
    read_decisions,
)
from labpipe.campaign.executors import Executor, Outcome
from labpipe.campaign.pairing import list_candidates, read_plan
from labpipe.errors import LabpipeError, StoreError, UsageError, sort_by_likeness
from labpipe.process.output_paths import list_duplicates
from labpipe.process.run import RefusedTest, Task
from labpipe.protocol.load import load_test_sheet
from labpipe.protocol.sheet_grammar import PLAN_NAME, SHEET_NAME, NamePair
from labpipe.store.replace import map_errors
from labpipe.store.summaries import FAILURE_FILE

_RETRY_DELAY = 1.0
"""Time between attempts to process a test while another process writes its results, s."""
_MAX_RETRIES = 60


@dataclass(slots=True)
class Overview:
    """State of a campaign.

    Parameters
    ----------
    rows : rows of all tests, keyed by folder
    claims : claims of live processes, keyed by folder of the test
    raw : test sheets and files in the folder of exports
    decisions : decisions on each test in order, keyed by folder
    notes : messages, for example about a rebuilt catalog or unreadable decisions
    has_bad_input : whether a note is about a file that must be repaired
    has_failed_results : whether any result failed in a test that is not rejected
    """

    rows: dict[str, TestRow]
    claims: dict[str, Claim]
    raw: RawContent
    decisions: Mapping[str, Sequence[Decision]]
    notes: list[str]
    has_bad_input: bool
    has_failed_results: bool

    def get_state(self, folder: str) -> str:
        """Return the state of a test; it is ``running`` while a process has a claim on the test.

        Parameters
        ----------
        folder : folder of the test in `rows`
        """
        return RUNNING if folder in self.claims else self.rows[folder].state

    @property
    def unapplied_decisions(self) -> list[tuple[Decision, str]]:
        """Decisions that are not applied, with the reason."""
        runs = {folder: row.attempt_key for folder, row in self.rows.items()}
        return list(find_outdated_decisions(self.decisions, runs))

    @property
    def counts(self) -> Counter[str]:
        """Number of tests in each state."""
        return Counter(map(self.get_state, self.rows))


@contextmanager
def open_campaign(campaign: CampaignFolders, *, for_writing: bool = False) -> Iterator[CatalogSync]:
    """Open the catalog of a campaign; make an empty catalog if there is none that is usable.

    Parameters
    ----------
    campaign : folders of the campaign
    for_writing : whether the campaign will be changed; its folder of results must then be writable

    Raises
    ------
    LabpipeError
        If the catalog was made by a newer labpipe or another program, is in use, or cannot be
        opened or made; with `for_writing`, also if the folder of results is not writable.
    """
    notes: list[str] = []
    with closing(open_catalog(campaign.processed, notes)) as catalog:
        if for_writing and catalog.is_in_memory:
            raise StoreError.about("campaign.read_only", campaign.processed)
        yield CatalogSync(campaign, catalog, notes)


class CatalogSync:
    """Synchronisation of the catalog of a campaign with its files.

    Parameters
    ----------
    campaign : folders of the campaign
    catalog : open catalog
    notes : messages from opening the catalog
    """

    def __init__(self, campaign: CampaignFolders, catalog: Catalog, notes: list[str]) -> None:
        self.campaign, self.catalog, self.notes = campaign, catalog, notes
        self._input_reader = InputReader()
        self._recent_inputs: dict[str, HashedInputs] = {}
        self._decisions: DecisionFile | None = None

    def refresh(self) -> Overview:
        """Update the catalog from the files of all tests.

        Returns
        -------
        State of the campaign. Files of tests are opened only if they may have changed.
        """
        raw, outcomes = list_raw(self.campaign), list_processed(self.campaign)
        rows, states = self.catalog.read_rows(), self.catalog.read_file_states()
        decisions = read_decisions(self.campaign.processed, self.campaign.name)
        self._decisions = decisions
        new_entries: dict[str, Entry] = {}
        folders = sorted(raw.sheets.keys() | outcomes.keys())
        for folder in folders:
            sheet, files = raw.sheets.get(folder), outcomes.get(folder, NO_OUTCOME)
            entry = self._make_new_entry(folder, sheet, files, states.get(folder))
            if entry is not None:
                new_entries[folder] = entry
        if new_entries:
            self.catalog.write_entries(new_entries.values(), states)
        if missing_folders := rows.keys() - folders:
            self.catalog.remove_tests(missing_folders)
        rows |= {folder: entry.row for folder, entry in new_entries.items()}
        named_sheets = [
            (row.test, raw.sheets[folder])
            for folder, row in sorted(rows.items())
            if row.run and row.state != REJECTED and folder in raw.sheets
        ]
        faults = [*decisions.faults, *raw.problems, *list_duplicates(named_sheets, "name")]
        return Overview(
            {folder: rows[folder] for folder in folders},
            self.catalog.read_claims(),
            raw,
            decisions.decisions_by_test,
            [*self.notes, *faults],
            has_bad_input=bool(faults),
            has_failed_results=self.catalog.has_failed_results(),
        )

    def refresh_test(self, folder: str) -> TestRow:
        """Update the catalog from the files of one test, and return the row of the test.

        Parameters
        ----------
        folder : folder of the test, relative to the campaign
        """
        if self._decisions is None:
            self._decisions = read_decisions(self.campaign.processed, self.campaign.name)
        sheet = self.get_sheet_path(folder)
        files = find_outcome(self.campaign, folder)
        state = self.catalog.read_file_states(folder).get(folder)
        entry = self._make_new_entry(folder, sheet if sheet.is_file() else None, files, state)
        if entry is None:
            return self.catalog.read_rows(folder)[folder]
        self.catalog.write_entries([entry])
        return entry.row

    def read_due_key(self, folder: str, *, is_forced: bool) -> str:
        """Read the key of the inputs of a test if the test must be processed.

        The next update of the test reads only the files that have changed since then.

        Parameters
        ----------
        folder : folder of the test, relative to the campaign
        is_forced : whether the test must be processed even if nothing changed

        Returns
        -------
        The key; empty if the test need not be processed or its sheet is missing.
        """
        is_due = self.refresh_test(folder).is_due or is_forced
        if not is_due or not self.get_sheet_path(folder).is_file():
            return ""
        text = self.catalog.read_file_states(folder).get(folder, FileState()).inputs_json
        inputs = self._input_reader.read_inputs(self.get_sheet_path(folder), parse_inputs(text))
        self._recent_inputs[folder] = inputs
        return inputs.key

    def get_sheet_path(self, folder: str) -> Path:
        """Return the path of the sheet of a test, which may be missing.

        Parameters
        ----------
        folder : folder of the test, relative to the campaign
        """
        return self.campaign.raw / folder / SHEET_NAME

    def _make_new_entry(
        self, folder: str, sheet: Path | None, files: OutcomeFiles, state: FileState | None
    ) -> Entry | None:
        """Make the entry of a test; return None if the catalog is up to date."""
        stored_inputs = parse_inputs(state.inputs_json) if state is not None else None
        inputs, key = self._recent_inputs.pop(folder, stored_inputs), ""
        if sheet is not None and files.signature:
            inputs = self._input_reader.read_inputs(sheet, inputs)
            key = inputs.key
        decisions = self._decisions.decisions_by_test.get(folder, ()) if self._decisions else ()
        decisions_hash = hash_text(repr(decisions)) if decisions else ""
        # Without outcome files, inputs are not read; the fingerprint shows if there is a sheet.
        fingerprint = f"{files.signature} {key or sheet is not None} {decisions_hash}"
        if state is not None and state.fingerprint == fingerprint and inputs == stored_inputs:
            return None
        entry = read_outcome(folder, files)
        decision = find_decision_in_force(decisions, run=_get_last_key(entry.row))
        row = _complete_row(entry, inputs if key else None, decision)
        json_text = inputs.to_json() if inputs is not None else ""
        return entry._replace(row=row, file_state=FileState(json_text, fingerprint))


def _get_last_key(row: TestRow) -> str:
    """Return the key of the last attempt of a test; it is empty if a failure has no key."""
    return row.failed_run if row.state == FAILED else row.run


def _complete_row(
    outcome: Entry, inputs: HashedInputs | None, decision: Decision | None
) -> TestRow:
    """Complete the row of a test with facts of its sheet, and mark it if it is stale or rejected.

    Parameters
    ----------
    outcome : entry of the test from its outcome files
    inputs : present inputs of the test; None if they were not read
    decision : decision that applies to the test; None if there is none
    """
    row, facts = outcome.row, {} if inputs is None else inputs.facts
    row = row._replace(**{key: getattr(row, key) or facts[key] for key in facts})
    row = row._replace(test=row.test or row.folder.rpartition("/")[2])
    if row.specimen == "{}":
        specimen = {key: getattr(row, key) for key in ("type", "spool", "sample")}
        row = row._replace(specimen=write_json(specimen))
    if row.code == NEWER_RESULT or row.state == PENDING:
        return row
    if inputs is not None and inputs.key != _get_last_key(row):
        why = describe_changes(outcome.source_hashes, inputs.source_hashes)
        return row._replace(state=STALE, why=why)
    if decision is None or decision.decision != REJECT:
        return row
    row = row._replace(state=REJECTED, why=decision.because)
    return row._replace(decided_by=decision.by, decided=decision.when)


def find_unknown_files(sync: CatalogSync, overview: Overview) -> list[str]:
    """Find the files in the folder of exports of a campaign that belong to no test.

    Parameters
    ----------
    sync : synchronisation of the catalog
    overview : state of the campaign

    Returns
    -------
    Sorted paths relative to the campaign. Test sheets and the exports that they name are known, and
    so are the campaign YAML and the exports that it assigns by role or to tests without a sheet.
    """
    raw, states = sync.campaign.raw, sync.catalog.read_file_states()
    known_files = {
        f"{folder}/{name}" if folder else name
        for folder, sheet in overview.raw.sheets.items()
        for name in _list_names(sheet, parse_inputs(states.get(folder, FileState()).inputs_json))
    }
    if (raw / PLAN_NAME).is_file():
        known_files.add(PLAN_NAME)
        with suppress(LabpipeError, OSError):  # `labpipe check` reports the fault of the plan
            plan = read_plan(raw)
            for candidate in list_candidates(raw, plan).candidates:
                if isinstance(plan.pair, NamePair) or not candidate.sheet.exists():
                    files = [path for path in candidate.files.values() if path.is_relative_to(raw)]
                    known_files |= {path.relative_to(raw).as_posix() for path in files}
    return sorted(file for file in overview.raw.files if file not in known_files)


def _list_names(sheet: Path, inputs: HashedInputs | None) -> list[str]:
    """List the names of the sheet and the exports of a test; only the sheet if it is faulty."""
    if inputs is not None and inputs.stamps:
        return [*inputs.stamps]
    with suppress(LabpipeError):
        files = load_test_sheet(sheet).files
        return [SHEET_NAME, *(name for names in files.values() for name in names)]
    return [SHEET_NAME]


@dataclass(slots=True)
class RunSummary:
    """Summary of a run.

    Parameters
    ----------
    overview : state of the campaign after the run
    processed_folders : folders of the tests that this run processed
    skipped_folders : folders of the tests that another labpipe process has claimed, or whose
        results it writes
    """

    overview: Overview
    processed_folders: list[str]
    skipped_folders: list[str]


def run_campaign(
    campaign: CampaignFolders,
    executor: Executor,
    *,
    forced_folders: Collection[str] = (),
    make_task: Callable[..., Task] = Task,
    on_start: Callable[[int], None] = lambda _: None,
    on_outcome: Callable[[str, str], None] = lambda *_: None,
) -> RunSummary:
    """Process the new and changed tests of a campaign.

    Parameters
    ----------
    campaign : folders of the campaign
    executor : function that processes the tests
    forced_folders : folders of the tests that are processed even if nothing changed
    make_task : function that makes the task of a test from its sheet, folder of results and key,
        such as a partial of `Task`
    on_start : function that is called once with the number of tests to process
    on_outcome : function that is called with the folder and the state of each processed test

    Returns
    -------
    Summary of the run. Simultaneous runs divide the tests among them: each test is claimed by one
    run.

    Raises
    ------
    LabpipeError
        If the catalog was made by a newer labpipe, or the folder of results cannot be written.
    """
    with open_campaign(campaign, for_writing=True) as sync:
        overview = sync.refresh()
        due_folders = [
            folder
            for folder, row in overview.rows.items()
            if folder in overview.raw.sheets and (row.is_due or folder in forced_folders)
        ]
        on_start(len(due_folders))
        outcomes, skipped_folders = _process_tests(
            sync, executor, due_folders, forced_folders, make_task=make_task, on_outcome=on_outcome
        )
        overview = sync.refresh() if due_folders else overview
        return RunSummary(overview, [*outcomes], skipped_folders)


def run_test(
    campaign: CampaignFolders, executor: Executor, folder: str, *, is_forced: bool = False
) -> tuple[TestRow | None, Outcome | None]:
    """Process one test if it is new or changed, without checking the other tests.

    Parameters
    ----------
    campaign : folders of the campaign
    executor : function that processes the test
    folder : folder of the test, relative to the campaign
    is_forced : whether the test is processed even if nothing changed

    Returns
    -------
    row : row of the test; None if another labpipe has claimed the test
    outcome : outcome of the attempt; None if the test was not processed

    Raises
    ------
    LabpipeError
        As `run_campaign`.
    """
    with open_campaign(campaign, for_writing=True) as sync:
        forced_folders = [folder] if is_forced else []
        outcomes, skipped_folders = _process_tests(sync, executor, [folder], forced_folders)
        return None if skipped_folders else sync.refresh_test(folder), outcomes.get(folder)


def _process_tests(
    sync: CatalogSync,
    executor: Executor,
    due_folders: list[str],
    forced_folders: Collection[str],
    *,
    make_task: Callable[..., Task] = Task,
    on_outcome: Callable[[str, str], None] = lambda *_: None,
) -> tuple[dict[str, Outcome], list[str]]:
    """Process tests that no other labpipe has claimed; retry those whose results are in use.

    Returns
    -------
    outcomes : outcome of each processed test, keyed by folder
    skipped_folders : folders of the tests that another labpipe process has claimed, or whose
        results it writes
    """
    claimed_folders: dict[Path, str] = {}
    outcomes: dict[str, Outcome] = {}
    skipped_folders: list[str] = []
    n_retries = 0

    def claim_tasks() -> Generator[Task, None, None]:
        """Claim tests one by one; skip those that another run has processed in the meantime."""
        for folder in due_folders:
            if not sync.catalog.claim_test(folder):
                skipped_folders.append(folder)
                continue
            sheet = sync.get_sheet_path(folder)
            claimed_folders[sheet] = folder
            if key := sync.read_due_key(folder, is_forced=folder in forced_folders):
                yield make_task(sheet, sync.campaign.processed / folder, run=key)
            else:
                sync.catalog.release_tests(claimed_folders.pop(sheet))

    try:
        while due_folders and n_retries <= _MAX_RETRIES:
            time.sleep(_RETRY_DELAY if n_retries else 0.0)
            postponed_folders = []
            with closing(claim_tasks()) as tasks:
                for task, outcome in executor(tasks):
                    folder = claimed_folders.pop(task.source)
                    failure = outcome.code if isinstance(outcome, RefusedTest) else ""
                    if failure == "in_use":  # another process still writes the results
                        postponed_folders.append(folder)
                    else:
                        row, outcomes[folder] = sync.refresh_test(folder), outcome
                        on_outcome(folder, FAILED if failure else row.state)
                    sync.catalog.release_tests(folder)
            due_folders, n_retries = postponed_folders, n_retries + 1
    finally:
        sync.catalog.release_tests(*claimed_folders.values())
    return outcomes, skipped_folders + due_folders


def read_overview(campaign: CampaignFolders) -> Overview:
    """Read the state of a campaign without processing.

    Parameters
    ----------
    campaign : folders of the campaign, which need not be writable
    """
    with open_campaign(campaign) as sync:
        return sync.refresh()


def rebuild_catalog(campaign: CampaignFolders) -> Overview:
    """Rebuild the catalog of a campaign from the files of its tests.

    Parameters
    ----------
    campaign : folders of the campaign

    Returns
    -------
    State of the campaign.

    Raises
    ------
    LabpipeError
        If a process has a claim on a test, or the catalog was made by a newer labpipe.
    """
    with open_campaign(campaign) as sync:
        for folder, claim in sync.catalog.read_claims().items():
            raise StoreError.about(
                "campaign.process_at_work", sync.catalog.path,
                pid=claim.pid, host=claim.machine, test=folder,
            )  # fmt: skip
        sync.catalog.remove_tests(sync.catalog.read_rows())
        return sync.refresh()


def clear_failures(campaign: CampaignFolders, code: str = "") -> list[str]:
    """Delete the stored failures of tests, so that these tests are processed again.

    Parameters
    ----------
    campaign : folders of the campaign
    code : code of the failures; empty for all failures

    Returns
    -------
    Folders of the tests.

    Raises
    ------
    UsageError
        If `code` is not empty and no failure has this code.
    """
    with open_campaign(campaign, for_writing=True) as sync:
        rows = sync.refresh().rows
        failed_rows = {folder: row for folder, row in rows.items() if row.state == FAILED}
        folders = [folder for folder, row in failed_rows.items() if code in {"", row.code}]
        if code and not folders:
            codes = sorted({row.code for row in failed_rows.values()})
            matches = sort_by_likeness(code, codes, limit=1)
            raise UsageError.about(
                "campaign.no_such_failures", campaign.processed, code=code,
                found=", ".join(codes) or "no failures",
                remedy=f"Nearest: {matches[0]}." if matches else "There is nothing to clear.",
            )  # fmt: skip
        for folder in folders:
            path = campaign.processed / folder / FAILURE_FILE
            with map_errors(path):
                path.unlink(missing_ok=True)
            sync.refresh_test(folder)
    return folders


def record_decision(campaign: CampaignFolders, test: str, decision: Decision) -> TestRow:
    """Record a decision on a test.

    Parameters
    ----------
    campaign : folders of the campaign
    test : folder of the test relative to the campaign, or name of the test
    decision : decision with its reason and person

    Returns
    -------
    The new row of the test.

    Raises
    ------
    LabpipeError
        If the test does not exist or has not been processed, or the decisions cannot be written.
    """
    with open_campaign(campaign, for_writing=True) as sync:
        row = _find_row(campaign, sync.refresh(), test)
        if not row.attempt_key:
            raise UsageError.about("campaign.unprocessed_test", test)
        entry = replace(decision, test=row.folder, run=row.attempt_key, when=format_current_time())
        add_decisions(campaign.processed, campaign.name, [entry])
        return sync.refresh().rows[row.folder]


def _find_row(campaign: CampaignFolders, overview: Overview, test: str) -> TestRow:
    """Find the row of a test by its folder, or by its name if only one test has that name."""
    folder = test.replace("\\", "/").strip("/")
    if folder in overview.rows:
        return overview.rows[folder]
    rows = [row for row in overview.rows.values() if row.test == test]
    if len(rows) == 1:
        return rows[0]
    matches = ", ".join(sort_by_likeness(folder, [*overview.rows], limit=3))
    raise UsageError.about(
        "campaign.unknown_test", test, campaign=campaign.name, count=len(rows) or "none",
        remedy=f"Nearest: {matches}." if matches else "List them with labpipe campaign status.",
    )  # fmt: skip
