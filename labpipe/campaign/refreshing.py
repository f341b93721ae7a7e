"""Update the catalog from the files of a campaign, or rebuild it."""

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
from labpipe.campaign.content_keys import Content, ContentKeys, describe_changes, parse_content
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    DecisionFile,
    add_decisions,
    applicable_decision,
    carry_over,
    find_unapplied_decisions,
    read_decisions,
)
from labpipe.campaign.pairing import list_candidates, read_plan
from labpipe.errors import LabpipeError, StoreError
from labpipe.protocol.load import load_test_sheet
from labpipe.protocol.plans import PLAN_NAME
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.replace import locked

_WITHOUT_SHEET = "without test.yaml"


@dataclass(slots=True)
class Overview:
    """State of a campaign.

    Parameters
    ----------
    rows : of all tests, by folder
    claims : of processes at work, by folder
    raw : test sheets and files
    decisions : all of the campaign, in order
    notes : messages, such as on a rebuilt catalog or unreadable decisions
    bad_input : whether a note is on a file that needs repair
    has_failed_results : whether any result failed in a test that is not rejected
    """

    rows: dict[str, TestRow]
    claims: dict[str, Claim] = field(default_factory=dict)
    raw: RawContent = field(default_factory=RawContent)
    decisions: tuple[Decision, ...] = ()
    notes: list[str] = field(default_factory=list)
    bad_input: bool = False
    has_failed_results: bool = False

    def state_of(self, folder: str) -> str:
        """Return the state of a test, ``running`` if a process works on it.

        Parameters
        ----------
        folder : of the test
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
    """Open the catalog of a campaign; rebuild it if there is no usable one.

    Parameters
    ----------
    campaign : its folders
    start_empty : whether to rebuild it in any case

    Raises
    ------
    LabpipeError
        If it was made by a newer labpipe, or cannot be made.
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
        notes.append(f"{path}: the folder is read-only: the catalog was made in memory")
        return new_catalog(folder)
    with locked(folder, patience=lock_timeout):
        try:
            catalog = open_catalog(folder)
        except NoCatalog as why:
            if path.exists():
                notes.append(f"{path}: rebuilt from the files of the tests: {why}")
            return new_catalog(folder)
        if not start_empty:
            return catalog  # another process has just made it
        with closing(catalog):
            _refuse_if_running(catalog)
        return new_catalog(folder, keep_old=False)


def _refuse_if_running(catalog: Catalog) -> None:
    for folder, claim in catalog.claims().items():
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
        self._keys = ContentKeys()
        self._decisions = DecisionFile()

    def refresh(self) -> Overview:
        """Update the catalog from all files.

        Returns
        -------
        State of the campaign. Unchanged files are not opened.
        """
        raw, outcomes = list_raw(self.campaign), list_processed(self.campaign)
        rows, seen = self.catalog.rows(), self.catalog.seen()
        self.read_decisions()
        changed: dict[str, Entry] = {}
        folders = raw.sheets.keys() | outcomes.keys()
        for folder in sorted(folders):
            entry = self._new_entry(
                folder, raw.sheets.get(folder), outcomes.get(folder), rows.get(folder),
                seen.get(folder),
            )  # fmt: skip
            if entry is not None:
                changed[folder] = entry
        if changed:
            self.catalog.put(changed.values(), seen)
        if gone := rows.keys() - folders:
            self.catalog.remove(gone)
        rows |= {folder: entry.row for folder, entry in changed.items()}
        stored = self._decisions
        return Overview(
            {folder: rows[folder] for folder in sorted(folders)},
            self.catalog.claims(),
            raw,
            stored.decisions,
            [*self.notes, *stored.faults, *raw.refused],
            bad_input=bool(stored.faults or raw.refused),
            has_failed_results=self.catalog.has_failed_results(),
        )

    def renew(self, folder: str) -> TestRow:
        """Update one test, such as after processing.

        Parameters
        ----------
        folder : of the test
        """
        sheet = self.campaign.raw / folder / SHEET_NAME
        files = find_outcome(self.campaign, folder)
        row = self.catalog.rows(folder).get(folder)
        seen = self.catalog.seen(folder).get(folder)
        entry = self._new_entry(folder, sheet if sheet.is_file() else None, files, row, seen)
        if entry is not None:
            self.catalog.put([entry])
            return entry.row
        return row or TestRow(folder)

    def determine_content(self, folder: str) -> Content:
        """Determine the inputs of a test, and record them.

        Parameters
        ----------
        folder : of the test, with a test sheet
        """
        seen = self._seen(folder)
        sheet = self.campaign.raw / folder / SHEET_NAME
        content = self._keys.determine_content(sheet, parse_content(seen.content))
        renewed = replace(seen, content=content.as_text())
        self.catalog.put([Entry(TestRow(folder), renewed, is_row_unchanged=True)])
        return content

    def _seen(self, folder: str) -> FileState:
        return self.catalog.seen(folder).get(folder, FileState())

    def files_of(self, folder: str, sheet: Path) -> tuple[str, ...]:
        """Return the files that a test names, below its folder; only its sheet if that is faulty.

        Parameters
        ----------
        folder : of the test
        sheet : its test.yaml
        """
        content = parse_content(self._seen(folder).content)
        if content is not None and content.stamps:
            return tuple(content.stamps)
        try:
            files = load_test_sheet(sheet).files
        except LabpipeError:
            return (SHEET_NAME,)
        return (SHEET_NAME, *(name for names in files.values() for name in names))

    def read_decisions(self) -> None:
        """Read the decisions of the campaign, for later updates."""
        self._decisions = read_decisions(self.campaign.processed, self.campaign.name)

    def _new_entry(
        self,
        folder: str,
        sheet: Path | None,
        files: OutcomeFiles | None,
        row: TestRow | None,
        seen: FileState | None,
    ) -> Entry | None:
        """Make the entry of a test; return None if the catalog is up to date."""
        marks = files.marks if files is not None else ""
        stored = parse_content(seen.content) if seen is not None else None
        now = self._keys.determine_content(sheet, stored) if sheet is not None and marks else None
        content = stored if now is None else now
        renewed = FileState(
            "" if content is None else content.as_text(),
            marks if sheet is not None else f"{marks} {_WITHOUT_SHEET}",
        )
        is_same = now is None or (stored is not None and stored.key == now.key)
        looks_same = seen is not None and seen.marks == renewed.marks
        if row is not None and looks_same and is_same and self._is_current(row, now):
            return None if content == stored else Entry(row, renewed, is_row_unchanged=True)
        outcome = read_outcome(folder, files)
        rejection = self._rejection_of(outcome, row)
        return replace(outcome, row=_row(outcome, now, rejection), seen=renewed)

    def _is_current(self, row: TestRow, content: Content | None) -> bool:
        """Return whether a row is still valid for the present content and decisions."""
        if row.state == PENDING:
            return True
        is_stale = content is not None and content.key != row.attempt
        if is_stale or row.state == STALE:
            return is_stale and row.state == STALE
        decision = self._rejection(row.folder, row.attempt)
        if decision is None:
            return row.state != REJECTED
        facts = (decision.because, decision.by, decision.when)
        return row.state == REJECTED and facts == (row.why, row.decided_by, row.decided)

    def _rejection(self, folder: str, run: str) -> Decision | None:
        decision = applicable_decision(self._decisions.by_test.get(folder, ()), run=run)
        return decision if decision is not None and decision.decision == REJECT else None

    def _rejection_of(self, outcome: Entry, row: TestRow | None) -> Decision | None:
        """Return the rejection of a test; carry it over if only the processing version changed."""
        folder, key = outcome.row.folder, _attempt(outcome.row)
        by_run = {made.run: made for made in self._decisions.by_test.get(folder, ())}
        if (
            row is not None
            and row.run in by_run
            and key not in {"", *by_run}
            and outcome.row.state != FAILED
            and self._has_same_inputs(row, outcome)
            and not self.catalog.in_memory
        ):
            before = self.catalog.read_results(folder)
            carried = carry_over(by_run[row.run], key, before, outcome.results)
            if carried is not None:
                add_decisions(self.campaign.processed, self.campaign.name, [carried])
                self.read_decisions()
        return self._rejection(folder, key)

    def _has_same_inputs(self, row: TestRow, outcome: Entry) -> bool:
        """Return whether exports, sheet and protocol of a test are those of its row."""
        texts = (outcome.row.sheet, outcome.row.resolved)
        same = all(texts) and texts == (row.sheet, row.resolved) and not row.failed_run
        return same and self.catalog.read_inputs(row.folder) == outcome.inputs


def _attempt(row: TestRow) -> str:
    """Return the key of the last attempt of a test; empty also for a failure without a key."""
    return row.failed_run if row.state == FAILED else row.run


def _row(outcome: Entry, content: Content | None, rejection: Decision | None) -> TestRow:
    """Make the row of a test from its outcome, the facts of its sheet, and its rejection."""
    row, about = outcome.row, {} if content is None else content.about
    facts = {key: getattr(row, key) or encodable(text) for key, text in about.items()}
    row = replace(row, **facts)
    row = replace(row, test=row.test or row.folder.rpartition("/")[2])
    if row.specimen == "{}":
        specimen = {key: getattr(row, key) for key in ("type", "spool", "sample")}
        row = replace(row, specimen=as_json(specimen))
    if row.code == NEWER_RESULT or row.state == PENDING:
        return row
    if content is not None and content.key != _attempt(row):
        changes = describe_changes(
            inputs=outcome.inputs, sheet=row.sheet, protocol=row.resolved, now=content
        )
        return replace(row, state=STALE, why=changes)
    if rejection is None:
        return row
    return replace(
        row, state=REJECTED, why=rejection.because, decided_by=rejection.by, decided=rejection.when
    )


USED, WAITING, UNKNOWN = "used", "waiting", "unknown"


def list_file_use(sync: CatalogSync, overview: Overview) -> dict[str, list[str]]:
    """Determine the use of each file.

    Parameters
    ----------
    sync : of the catalog
    overview : of the campaign

    Returns
    -------
    Sorted files below the campaign: ``used`` (in results), ``waiting`` (of a test to process),
    ``failed`` (of a failed test) and ``unknown`` (in no test sheet).
    """
    files_by_use: dict[str, list[str]] = {USED: [], WAITING: [], FAILED: [], UNKNOWN: []}
    owner: dict[str, str] = {}
    for folder, sheet in overview.raw.sheets.items():
        state = overview.state_of(folder)
        use = WAITING if state in {PENDING, STALE, RUNNING} else USED
        use = FAILED if state == FAILED else use
        for name in sync.files_of(folder, sheet):
            owner[f"{folder}/{name}" if folder else name] = use
    owner |= {file: use for file, use in _by_plan(sync).items() if file not in owner}
    for file in overview.raw.files:
        files_by_use[owner.get(file, UNKNOWN)].append(file)
    return {use: sorted(files) for use, files in files_by_use.items()}


def _by_plan(sync: CatalogSync) -> dict[str, str]:
    """Return the use of the campaign YAML and of the exports that it pairs."""
    raw = sync.campaign.raw
    if not (raw / PLAN_NAME).is_file():
        return {}
    use_by_file = {PLAN_NAME: USED}
    try:
        listed = list_candidates(raw, read_plan(raw))
    except (LabpipeError, OSError):  # `labpipe check` reports the fault
        return use_by_file
    for candidate in listed.candidates:
        if candidate.by_role or not candidate.sheet.exists():
            use = USED if candidate.sheet.exists() else WAITING
            files = [path for path in candidate.files.values() if path.is_relative_to(raw)]
            use_by_file |= {path.relative_to(raw).as_posix(): use for path in files}
    return use_by_file
