"""Update the catalog of a campaign from the files of its tests, or rebuild it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.campaign.campaign_folders import (
    CampaignFolders,
    OutcomeFiles,
    RawContent,
    find_outcome,
    list_processed,
    list_raw,
)
from labpipe.campaign.catalog import (
    CATALOG,
    Catalog,
    Claim,
    NoCatalog,
    can_write,
    new_catalog,
    open_catalog,
)
from labpipe.campaign.catalog_rows import (
    FAILED,
    NEWER_RESULT,
    PENDING,
    REJECTED,
    RUNNING,
    STALE,
    Entry,
    FileState,
    TestRow,
    as_json,
    encodable,
    read_outcome,
)
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    DecisionFile,
    applicable_decision,
    find_unapplied_decisions,
    read_decisions,
)
from labpipe.campaign.input_keys import HashedInputs, InputReader, describe_changes, parse_inputs
from labpipe.campaign.pairing import list_candidates, read_plan
from labpipe.errors import LabpipeError, StoreError
from labpipe.messages import format_sentence
from labpipe.protocol.load import load_test_sheet
from labpipe.protocol.sheet_grammar import PLAN_NAME, SHEET_NAME
from labpipe.store.replace import locked

_WITHOUT_SHEET = "without test.yaml"


@dataclass(slots=True)
class Overview:
    """State of a campaign.

    Parameters
    ----------
    rows : of all tests, by folder
    claims : of processes at work, by folder of the test
    raw : test sheets and files
    decisions : all of the campaign, in order
    notes : messages, such as on a rebuilt catalog or unreadable decisions
    has_bad_input : whether a note is on a file that needs repair
    has_failed_results : whether any result failed in a test that is not rejected
    """

    rows: dict[str, TestRow]
    claims: dict[str, Claim] = field(default_factory=dict)
    raw: RawContent = field(default_factory=RawContent)
    decisions: tuple[Decision, ...] = ()
    notes: list[str] = field(default_factory=list)
    has_bad_input: bool = False
    has_failed_results: bool = False

    def state_of(self, folder: str) -> str:
        """Return the state of a test, ``running`` if a process works on it.

        Parameters
        ----------
        folder : of the test, one of `rows`
        """
        return RUNNING if folder in self.claims else self.rows[folder].state

    @property
    def unapplied(self) -> list[tuple[Decision, str]]:
        """Return the decisions that are not applied, and why."""
        runs = {folder: row.attempt for folder, row in self.rows.items()}
        return list(find_unapplied_decisions(self.decisions, runs))

    @property
    def counts(self) -> Counter[str]:
        """Return the number of tests by state."""
        return Counter(map(self.state_of, self.rows))


@contextmanager
def open_campaign(campaign: CampaignFolders, *, start_empty: bool = False) -> Iterator[CatalogSync]:
    """Open the catalog of a campaign; make an empty one if there is no usable one.

    Parameters
    ----------
    campaign : its folders
    start_empty : whether to make an empty one in any case

    Raises
    ------
    LabpipeError
        If the catalog was made by a newer labpipe or another program, or cannot be made; with
        `start_empty`, also if a process works on a test.
    """
    notes: list[str] = []
    catalog = _open_or_make_catalog(campaign, notes, start_empty=start_empty)
    try:
        yield CatalogSync(campaign, catalog, notes)
    finally:
        catalog.close()


def _open_or_make_catalog(
    campaign: CampaignFolders, notes: list[str], *, start_empty: bool
) -> Catalog:
    lock_timeout = 30.0  # s to wait for another process that makes the catalog
    folder = campaign.processed
    if not start_empty:
        with suppress(NoCatalog):
            return open_catalog(folder)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    path = folder / CATALOG
    if not can_write(path):
        notes.append(format_sentence("campaign.catalog_in_memory", path=path))
        return new_catalog(folder)
    with locked(folder, patience=lock_timeout):
        try:
            catalog = open_catalog(folder)
        except NoCatalog as why:
            if path.exists():
                notes.append(format_sentence("campaign.catalog_rebuilt", path=path, why=why))
            return new_catalog(folder)
        if not start_empty:
            return catalog  # another process has just made it
        with closing(catalog):
            _refuse_if_running(catalog)
        return new_catalog(folder, keep_old=False)


def _refuse_if_running(catalog: Catalog) -> None:
    for folder, claim in catalog.read_claims().items():
        raise StoreError.about(
            "campaign.process_at_work", catalog.path,
            pid=claim.pid, host=claim.machine, test=folder,
        )  # fmt: skip


class CatalogSync:
    """Keeps the catalog of a campaign up to date with its files.

    Parameters
    ----------
    campaign : its folders
    catalog : open
    notes : messages so far
    """

    def __init__(self, campaign: CampaignFolders, catalog: Catalog, notes: list[str]) -> None:
        self.campaign, self.catalog, self.notes = campaign, catalog, notes
        self._input_reader = InputReader()
        self._decisions = DecisionFile()

    def refresh(self) -> Overview:
        """Update the catalog from all files.

        Returns
        -------
        State of the campaign. Unchanged files are not opened.
        """
        raw, outcomes = list_raw(self.campaign), list_processed(self.campaign)
        rows, states = self.catalog.read_rows(), self.catalog.read_file_states()
        self.read_decisions()
        changed: dict[str, Entry] = {}
        folders = raw.sheets.keys() | outcomes.keys()
        for folder in sorted(folders):
            entry = self._make_new_entry(
                folder, raw.sheets.get(folder), outcomes.get(folder), rows.get(folder),
                states.get(folder),
            )  # fmt: skip
            if entry is not None:
                changed[folder] = entry
        if changed:
            self.catalog.put(changed.values(), states)
        if gone := rows.keys() - folders:
            self.catalog.remove(gone)
        rows |= {folder: entry.row for folder, entry in changed.items()}
        stored = self._decisions
        return Overview(
            {folder: rows[folder] for folder in sorted(folders)},
            self.catalog.read_claims(),
            raw,
            stored.decisions,
            [*self.notes, *stored.faults, *raw.problems],
            has_bad_input=bool(stored.faults or raw.problems),
            has_failed_results=self.catalog.has_failed_results(),
        )

    def refresh_test(self, folder: str) -> TestRow:
        """Update the catalog from the files of one test, and return its row.

        Parameters
        ----------
        folder : of the test
        """
        sheet = self.campaign.raw / folder / SHEET_NAME
        files = find_outcome(self.campaign, folder)
        row = self.catalog.read_rows(folder).get(folder)
        state = self.catalog.read_file_states(folder).get(folder)
        entry = self._make_new_entry(folder, sheet if sheet.is_file() else None, files, row, state)
        if entry is not None:
            self.catalog.put([entry])
            return entry.row
        return row or TestRow(folder)

    def read_inputs(self, folder: str) -> HashedInputs:
        """Read the inputs of a test, and record them in the catalog.

        Parameters
        ----------
        folder : of the test, with a test sheet
        """
        state = self._read_file_state(folder)
        sheet = self.campaign.raw / folder / SHEET_NAME
        inputs = self._input_reader.read_inputs(sheet, parse_inputs(state.content))
        new_state = replace(state, content=inputs.to_json())
        self.catalog.put([Entry(TestRow(folder), new_state, is_row_unchanged=True)])
        return inputs

    def _read_file_state(self, folder: str) -> FileState:
        return self.catalog.read_file_states(folder).get(folder, FileState())

    def list_files(self, folder: str, sheet: Path) -> tuple[str, ...]:
        """List test sheet and exports of a test, relative to its folder.

        Parameters
        ----------
        folder : of the test
        sheet : its test.yaml

        Returns
        -------
        The names of the files; only that of the sheet if it is faulty.
        """
        inputs = parse_inputs(self._read_file_state(folder).content)
        if inputs is not None and inputs.stamps:
            return tuple(inputs.stamps)
        try:
            files = load_test_sheet(sheet).files
        except LabpipeError:
            return (SHEET_NAME,)
        return (SHEET_NAME, *(name for names in files.values() for name in names))

    def read_decisions(self) -> None:
        """Read the decisions of the campaign, for later updates."""
        self._decisions = read_decisions(self.campaign.processed, self.campaign.name)

    def _make_new_entry(
        self,
        folder: str,
        sheet: Path | None,
        files: OutcomeFiles | None,
        row: TestRow | None,
        state: FileState | None,
    ) -> Entry | None:
        """Make the entry of a test; return None if the catalog is up to date."""
        signature = files.signature if files is not None else ""
        stored = parse_inputs(state.content) if state is not None else None
        current = self._input_reader.read_inputs(sheet, stored) if sheet and signature else None
        inputs = current or stored
        new_state = FileState(
            inputs.to_json() if inputs is not None else "",
            signature if sheet is not None else f"{signature} {_WITHOUT_SHEET}",
        )
        has_same_inputs = current is None or (stored is not None and stored.key == current.key)
        has_same_outcome = state is not None and state.outcome == new_state.outcome
        if (
            row is not None
            and has_same_outcome
            and has_same_inputs
            and self._is_current(row, current)
        ):
            return None if inputs == stored else Entry(row, new_state, is_row_unchanged=True)
        outcome = read_outcome(folder, files)
        rejection = self._find_rejection(folder, _last_key(outcome.row))
        return replace(
            outcome, row=_complete_row(outcome, current, rejection), file_state=new_state
        )

    def _is_current(self, row: TestRow, inputs: HashedInputs | None) -> bool:
        """Return whether a row is valid for the current inputs and decisions."""
        if row.state == PENDING:
            return True
        is_stale = inputs is not None and inputs.key != row.attempt
        if is_stale or row.state == STALE:
            return is_stale and row.state == STALE
        decision = self._find_rejection(row.folder, row.attempt)
        if decision is None:
            return row.state != REJECTED
        stated = (decision.because, decision.by, decision.when)
        return row.state == REJECTED and stated == (row.why, row.decided_by, row.decided)

    def _find_rejection(self, folder: str, run: str) -> Decision | None:
        decision = applicable_decision(self._decisions.by_test.get(folder, ()), run=run)
        return decision if decision is not None and decision.decision == REJECT else None


def _last_key(row: TestRow) -> str:
    """Return the key of the last attempt of a test; empty for a failure without a key."""
    return row.failed_run if row.state == FAILED else row.run


def _complete_row(
    outcome: Entry, inputs: HashedInputs | None, rejection: Decision | None
) -> TestRow:
    """Add the facts of the test sheet, outdated inputs and the rejection to the row of a test."""
    row, facts = outcome.row, {} if inputs is None else inputs.facts
    row = replace(row, **{key: getattr(row, key) or encodable(facts[key]) for key in facts})
    row = replace(row, test=row.test or row.folder.rpartition("/")[2])
    if row.specimen == "{}":
        specimen = {key: getattr(row, key) for key in ("type", "spool", "sample")}
        row = replace(row, specimen=as_json(specimen))
    if row.code == NEWER_RESULT or row.state == PENDING:
        return row
    if inputs is not None and inputs.key != _last_key(row):
        changes = describe_changes(
            files=outcome.inputs,
            sheet_sha256=row.sheet,
            protocol_sha256=row.resolved,
            current=inputs,
        )
        return replace(row, state=STALE, why=changes)
    if rejection is None:
        return row
    return replace(
        row, state=REJECTED, why=rejection.because, decided_by=rejection.by, decided=rejection.when
    )


def find_unknown_files(sync: CatalogSync, overview: Overview) -> list[str]:
    """Find the files below the exports of a campaign that belong to no test.

    Parameters
    ----------
    sync : of the catalog
    overview : of the campaign

    Returns
    -------
    Sorted paths below the campaign. The files that a test sheet names, the campaign YAML and the
    exports that it pairs are known.
    """
    raw = sync.campaign.raw
    known_files = {
        f"{folder}/{name}" if folder else name
        for folder, sheet in overview.raw.sheets.items()
        for name in sync.list_files(folder, sheet)
    }
    if (raw / PLAN_NAME).is_file():
        known_files.add(PLAN_NAME)
        with suppress(LabpipeError, OSError):  # `labpipe check` reports the fault of the plan
            for candidate in list_candidates(raw, read_plan(raw)).candidates:
                if candidate.by_role or not candidate.sheet.exists():
                    files = [path for path in candidate.files.values() if path.is_relative_to(raw)]
                    known_files |= {path.relative_to(raw).as_posix() for path in files}
    return sorted(file for file in overview.raw.files if file not in known_files)
