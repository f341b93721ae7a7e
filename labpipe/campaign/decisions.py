"""Decisions of people on tests: accepted or rejected, why, by whom; bound to a result key.

They are stored beside the results, and imported from files that a report page saved.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any, Final

from labpipe.campaign.catalog_rows import ResultRow, encodable
from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.process.output_paths import RESULT_FILE, files_below
from labpipe.store.read import read_run
from labpipe.store.replace import locked, replacing

DECISIONS: Final = "decisions.json"
SCHEMA: Final = 1
ACCEPT, REJECT = "accept", "reject"
NO_SUCH_TEST: Final = "there is no such test"
NEEDS_NEW_DECISION: Final = (
    "needs a new decision: exports, sheet, protocol or labpipe changed since"
)
OTHER_KEY: Final = "exports, sheet, protocol or labpipe changed since the decision"


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision on a test.

    Parameters
    ----------
    test : its folder below the campaign
    run : key of the results; the decision applies to this key only
    decision : ``accept`` or ``reject``
    because, by : reason and person
    when : time of the decision, ISO 8601, as it is written
    note : reason why it was carried over from another key
    """

    test: str
    run: str
    decision: str
    because: str
    by: str
    when: str = ""
    note: str = ""


_FIELDS = fields(Decision)


@dataclass(frozen=True)
class DecisionFile:
    """Content of a file of decisions.

    Parameters
    ----------
    decisions : the readable ones, in order
    faults : what is wrong with the file or with single decisions, as messages
    is_readable : False if the file cannot be read; `decisions` is then empty
    document : parsed JSON of the file
    """

    decisions: tuple[Decision, ...] = ()
    faults: tuple[str, ...] = ()
    is_readable: bool = True
    document: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def by_test(self) -> Mapping[str, tuple[Decision, ...]]:
        """Return the decisions on each test, in order."""
        decisions: dict[str, tuple[Decision, ...]] = {}
        for decision in self.decisions:
            decisions[decision.test] = (*decisions.get(decision.test, ()), decision)
        return decisions


def read_decisions(folder: Path, campaign: str = "") -> DecisionFile:
    """Read the decisions of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : name of the expected campaign; decisions of another one are reported; empty if
        unknown

    Returns
    -------
    The decisions; none without a file. Problems are in `faults`.
    """
    path = folder / DECISIONS
    return read_decision_file(path, campaign) if path.exists() else DecisionFile()


def read_decision_file(path: Path, campaign: str = "") -> DecisionFile:
    """Read decisions from any file.

    Parameters
    ----------
    path : of the file
    campaign : name of the expected campaign; decisions of another one are reported; empty if
        unknown

    Returns
    -------
    The decisions. Problems, including a missing file, are in `faults`.
    """
    max_file_bytes = 50_000_000
    try:
        size = path.stat().st_size
        if size > max_file_bytes:
            return _unreadable(path, "", f"{size} bytes")
        return parse_decisions(path.read_bytes(), path, campaign)
    except OSError as error:
        return _unreadable(path, "", error.strerror or str(error))


def parse_decisions(content: bytes, path: Path, campaign: str = "") -> DecisionFile:
    """Parse decisions.

    Parameters
    ----------
    content : JSON in UTF-8
    path : of its file, for messages
    campaign : name of the expected campaign; decisions of another one are reported; empty if
        unknown

    Returns
    -------
    The decisions. Problems with the content or with single decisions are in `faults`.
    """
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        return _unreadable(path, f"line {error.lineno}, column {error.colno}", error.msg)
    except (ValueError, RecursionError):
        return _unreadable(path, "", "text that is not JSON")
    if not isinstance(document, dict) or not isinstance(document.get("decisions"), list):
        return _unreadable(path, "", "JSON without a list 'decisions'")
    if (schema := document.get("schema")) != SCHEMA:
        return _unreadable(path, "schema", f"{schema!r}; this labpipe reads {SCHEMA}")
    faults, decisions = [], []
    if campaign and (named := document.get("campaign", campaign)) != campaign:
        other = UsageError.about(
            "campaign.other_campaign", path, "campaign", own=campaign, found=named
        )
        faults.append(str(other))
    for number, entry in enumerate(document["decisions"]):
        if fault := _fault_of(entry):
            expected, state = fault
            faults.append(_fault(path, f"decisions.{number}", expected, state))
        else:
            texts = {field.name: encodable(entry.get(field.name) or "") for field in _FIELDS}
            decisions.append(Decision(**texts))
    return DecisionFile(tuple(decisions), tuple(faults), document=document)


def _unreadable(path: Path, place: str, state: str) -> DecisionFile:
    fault = _fault(path, place, "decisions in JSON", state)
    return DecisionFile(faults=(fault,), is_readable=False)


def _fault(path: Path, place: str, expected: str, state: str) -> str:
    error = UsageError.about("campaign.bad_decisions", path, place, what=expected, found=state)
    return str(error)


def _fault_of(entry: Any) -> tuple[str, str] | None:
    """Return what is expected of the entry of a decision, and what it is, or None."""
    if not isinstance(entry, dict):
        return "a decision", repr(entry)[:60]
    required_keys = ("test", "run", "decision", "because", "by")
    missing = [key for key in required_keys if not str(entry.get(key) or "").strip()]
    if missing:
        state = f"missing or empty: {', '.join(missing)}"
        return "test, run, decision, because and by", state
    if entry["decision"] not in {ACCEPT, REJECT}:
        return f"{ACCEPT} or {REJECT}", repr(entry["decision"])[:60]
    return None


def applicable_decision(decisions: Iterable[Decision], *, run: str) -> Decision | None:
    """Return the decision that applies to a test: the last one on its key.

    A test that was rejected on another key stays rejected until a person decides again.

    Parameters
    ----------
    decisions : on the test, in order
    run : key of its results
    """
    newest_first = [*decisions][::-1]
    current = next((decision for decision in newest_first if decision.run == run), None)
    if current is None and newest_first and newest_first[0].decision == REJECT:
        last = newest_first[0]
        return replace(last, because=f"{last.because} ({NEEDS_NEW_DECISION})")
    return current


def unapplied_decisions(
    decisions: Sequence[Decision], runs: Mapping[str, str]
) -> Iterator[tuple[Decision, str]]:
    """Find decisions that are not applied.

    Parameters
    ----------
    decisions : in order
    runs : current key of each test, by test

    Yields
    ------
    Each test's last decision, and why it is not applied.
    """
    last: dict[str, Decision] = {}
    for decision in decisions:
        is_current = decision.test in last and last[decision.test].run == runs.get(decision.test)
        if not is_current or decision.run == runs.get(decision.test):
            last[decision.test] = decision
    for test, decision in last.items():
        if test not in runs:
            yield decision, NO_SUCH_TEST
        elif runs[test] != decision.run:
            yield decision, OTHER_KEY


def add_decisions(folder: Path, campaign: str, decisions: Sequence[Decision]) -> None:
    """Append decisions to those of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign; made if missing
    campaign : its name
    decisions : new ones

    Raises
    ------
    UsageError
        If the existing file cannot be read; it is not changed.
    StoreError
        If it cannot be written, or another process holds the lock.

    Notes
    -----
    All other content of the file is kept, known to this labpipe or not.
    """
    # s to wait for another process that writes
    lock_timeout = 30.0
    with locked(folder, patience=lock_timeout):
        stored = read_decisions(folder)
        if not stored.is_readable:
            raise UsageError("\n".join(stored.faults))
        document = {"schema": SCHEMA, "campaign": campaign, "decisions": [], **stored.document}
        document["decisions"] = [*document["decisions"], *map(decision_entry, decisions)]
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        with replacing(folder / DECISIONS) as temporary:
            temporary.write_bytes(text.encode("utf-8", "surrogatepass"))


def decision_entry(decision: Decision) -> dict[str, str]:
    """Make the entry of a decision in ``decisions.json``.

    Parameters
    ----------
    decision : any
    """
    return {key: text for key, text in asdict(decision).items() if text or key != "note"}


def now() -> str:
    """Return the time in the format of decisions."""
    return datetime.now(tz=UTC).isoformat(timespec="seconds")


def largest_change(before: Sequence[ResultRow], after: Sequence[ResultRow]) -> float:
    """Return the largest relative change between two sets of results of a test.

    Parameters
    ----------
    before, after : earlier and later results

    Returns
    -------
    The largest change of a value, divided by the width of its earlier interval; infinite if a
    result was added or removed, has no value, or changed without an interval.
    """
    if [row.name for row in before] != [row.name for row in after]:
        return inf
    largest = 0.0
    for then, now in zip(before, after, strict=True):
        if then.value == now.value:
            continue
        if then.value is None or now.value is None or then.lower is None or then.upper is None:
            return inf
        width = then.upper - then.lower
        largest = max(largest, abs(now.value - then.value) / width if width > 0.0 else inf)
    return largest


def carry_over(
    decision: Decision, run: str, before: Sequence[ResultRow], after: Sequence[ResultRow]
) -> Decision | None:
    """Carry a decision over to results of a newer labpipe on the same inputs.

    Parameters
    ----------
    decision : on the earlier results
    run : key of the later results
    before, after : earlier and later results

    Returns
    -------
    The same decision on the new key, with a note; None if a value changed by more than a tenth of
    its interval, which needs a new decision.
    """
    max_change = 0.1
    change = largest_change(before, after)
    if change > max_change:
        return None
    note = (
        f"carried over from {decision.run}: only the processing version changed, and no number"
        f" changed by more than {change:.2g} of its interval"
    )
    return replace(decision, run=run, note=note)


def decision_folder(test: Path, shared: Path) -> Path:
    """Find the folder with the decisions on a test.

    Parameters
    ----------
    test : folder of its results
    shared : folder of the campaign, used if no folder above the test contains decisions

    Returns
    -------
    The nearest folder above the test with decisions, resolved.
    """
    parents = test.resolve().parents
    return next((parent for parent in parents if (parent / DECISIONS).is_file()), shared.resolve())


def decisions_on(files: Sequence[Path]) -> dict[Path, tuple[Decision, ...]]:
    """Find the decisions on tests by their result files.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    Decisions on each test by result file, in order and for all keys. Files of campaigns without
    decisions are left out.

    Raises
    ------
    StoreError
        If decisions cannot be read, because a rejected test might then be included.
    """
    decisions: dict[Path, tuple[Decision, ...]] = {}
    read: dict[Path, DecisionFile] = {}
    for file in files:
        test = file.resolve().parent
        home = decision_folder(test, test.parent)
        if not (home / DECISIONS).is_file():
            continue
        stored = read[home] = read.get(home) or read_decisions(home)
        if not stored.is_readable:
            raise StoreError("\n".join(stored.faults))
        decisions[file] = stored.by_test.get(test.relative_to(home).as_posix(), ())
    return decisions


def label_of(file: Path, shared: Path) -> str:
    """Return the label of a test in decisions: its folder below the campaign.

    Parameters
    ----------
    file : a result.h5

    shared : folder of the campaign, used if no folder above the test contains decisions
    """
    test = file.resolve().parent
    home = decision_folder(test, shared)
    return test.relative_to(home).as_posix()


def without_rejected(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Leave out the results of tests that were rejected.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    kept : files of the other tests, in order
    rejected : reason, person and time by file

    Raises
    ------
    LabpipeError
        If all were rejected, or decisions cannot be read.
    """
    rejected = {}
    for file, decisions in decisions_on(files).items():
        decision = applicable_decision(decisions, run=read_run(file)) if decisions else None
        if decision is not None and decision.decision == REJECT:
            rejected[file] = decision_sentence(decision)
    kept = [file for file in files if file not in rejected]
    if not kept:
        raise UsageError("\n".join(f"{file}: rejected: {why}" for file, why in rejected.items()))
    return kept, rejected


def decision_sentence(decision: Decision) -> str:
    """Write reason, person and time of a decision.

    Parameters
    ----------
    decision : any
    """
    return f"{decision.because} ({', '.join(filter(None, (decision.by, decision.when)))})"


@dataclass(slots=True)
class ImportedDecisions:
    """Result of importing decisions.

    Parameters
    ----------
    added : new decisions, in order
    n_known : number of decisions that were stored already
    not_imported : decisions that were not imported, and why
    """

    added: list[Decision] = field(default_factory=list)
    n_known: int = 0
    not_imported: list[tuple[Decision, str]] = field(default_factory=list)


def import_decision_file(
    folder: Path, campaign: str, file: Path
) -> tuple[ImportedDecisions, tuple[str, ...]]:
    """Import the decisions of a file that a page saved.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    file : in the format of ``decisions.json``, with any name

    Returns
    -------
    The result, and messages on faults of the file or of single decisions.

    Raises
    ------
    LabpipeError
        If the file cannot be read, is that of the campaign itself, or decisions cannot be written.
    """
    if not file.is_file():
        raise UsageError.about("campaign.no_saved_file", file)
    if file.resolve() == (folder / DECISIONS).resolve():
        raise UsageError.about("campaign.own_decisions", file)
    read = read_decision_file(file, campaign)
    if not read.is_readable:
        raise UsageError("\n".join(read.faults))
    return import_decisions(folder, campaign, read.decisions), read.faults


def import_decisions(
    folder: Path, campaign: str, decisions: Iterable[Decision]
) -> ImportedDecisions:
    """Add new decisions on the present results to those of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    decisions : in order

    Returns
    -------
    The result.

    Raises
    ------
    LabpipeError
        If stored decisions cannot be read or written.

    Notes
    -----
    Labels are compared with those of existing tests; no path is made from them. Each decision is
    stored where a report reads it: in the nearest ``decisions.json`` above its test.
    """
    files: dict[str, list[Path]] = {}
    for path in files_below(folder, RESULT_FILE):
        for label in {label_of(path, folder), path.parent.relative_to(folder).as_posix()}:
            files.setdefault(label, []).append(path)
    imported = ImportedDecisions()
    at_home: dict[Path, list[Decision]] = {}
    for decision in dict.fromkeys(decisions):
        file, why = _find_decided_result(decision, files.get(decision.test, ()))
        if file is None:
            imported.not_imported.append((decision, why))
            continue
        labelled = replace(decision, test=label_of(file, folder))
        if labelled in decisions_on([file]).get(file, ()):
            imported.n_known += 1
        else:
            imported.added.append(decision)
            at_home.setdefault(decision_folder(file.parent, folder), []).append(labelled)
    for home, new in at_home.items():
        add_decisions(home, campaign, new)
    return imported


def _find_decided_result(decision: Decision, files: Iterable[Path]) -> tuple[Path | None, str]:
    """Find the result of a decision, or return why there is none."""
    try:
        datetime.fromisoformat(decision.when or now())
    except ValueError:
        return None, f"its time {decision.when[:40]!r} is not in the form {now()}"
    why = NO_SUCH_TEST
    for file in files:
        try:
            if read_run(file) == decision.run:
                return file, ""
            why = OTHER_KEY
        except LabpipeError as error:
            why = str(error)
    return None, why
