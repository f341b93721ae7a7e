"""Read, apply, store and import decisions to accept or reject tests.

A decision has a reason, a person and the key of the results to which it applies.

A campaign stores decisions in ``decisions.json`` beside its results. A report page saves decisions
in a file, which can be imported.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

from labpipe.campaign.catalog import escape_surrogates
from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.messages import format_sentence
from labpipe.process.output_paths import RESULT_FILE, list_files_below
from labpipe.store.replace import locked, replacing
from labpipe.store.result_files import read_run

DECISIONS_FILE: Final = "decisions.json"
ACCEPT, REJECT = "accept", "reject"
_SCHEMA: Final = 1
_MAX_FILE_BYTES: Final = 50_000_000
"""Maximum size of a file of decisions."""


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision on a test.

    Parameters
    ----------
    test : its folder below the campaign
    run : key of the results; the decision applies to this key only
    decision : ``accept`` or ``reject``
    because, by : reason and person
    when : time of the decision, ISO 8601
    """

    test: str
    run: str
    decision: str
    because: str
    by: str
    when: str = ""

    def describe(self) -> str:
        """Describe a decision by its reason, person and time."""
        return f"{self.because} ({', '.join(filter(None, (self.by, self.when)))})"


_DECISION_KEYS: Final = tuple(entry.name for entry in fields(Decision))


@dataclass(frozen=True)
class DecisionFile:
    """Valid content of a file of decisions, and its faults.

    Parameters
    ----------
    decisions : the valid ones, in order
    faults : messages about faults of the file or of single decisions
    is_readable : whether the file can be read; if not, `decisions` is empty
    document : parsed JSON of the file
    """

    decisions: tuple[Decision, ...] = ()
    faults: tuple[str, ...] = ()
    is_readable: bool = True
    document: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def by_test(self) -> Mapping[str, Sequence[Decision]]:
        """Return the decisions on each test, in order."""
        decisions = defaultdict[str, list[Decision]](list)
        for decision in self.decisions:
            decisions[decision.test].append(decision)
        return decisions


def read_decisions(folder: Path, campaign: str = "") -> DecisionFile:
    """Read the decisions of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : see `parse_decisions`

    Returns
    -------
    The decisions; none without a file. Problems are in `faults`.
    """
    path = folder / DECISIONS_FILE
    return _read_file(path, campaign) if path.exists() else DecisionFile()


def _read_file(path: Path, campaign: str) -> DecisionFile:
    try:
        size = path.stat().st_size
        if size > _MAX_FILE_BYTES:
            return _unreadable_file(path, "", f"{size} bytes")
        return parse_decisions(path.read_bytes(), path, campaign)
    except OSError as error:
        return _unreadable_file(path, "", error.strerror or str(error))


def parse_decisions(content: bytes, path: Path, campaign: str = "") -> DecisionFile:
    """Parse decisions.

    Parameters
    ----------
    content : JSON in UTF-8
    path : of its file, for messages
    campaign : name of the expected campaign, empty if unknown; a file of another campaign has a
        fault, but its decisions are returned

    Returns
    -------
    The decisions. Problems with the content or with single decisions are in `faults`.
    """
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        return _unreadable_file(path, f"line {error.lineno}, column {error.colno}", error.msg)
    except (ValueError, RecursionError):
        return _unreadable_file(path, "", "text that is not JSON")
    if not isinstance(document, dict) or not isinstance(document.get("decisions"), list):
        return _unreadable_file(path, "", "JSON without a list 'decisions'")
    if (schema := document.get("schema")) != _SCHEMA:
        return _unreadable_file(path, "schema", f"{schema!r}; this labpipe reads {_SCHEMA}")
    faults, decisions = [], []
    if campaign and (stated_campaign := document.get("campaign", campaign)) != campaign:
        mismatch = UsageError.about(
            "campaign.other_campaign", path, "campaign", expected=campaign, found=stated_campaign
        )
        faults.append(str(mismatch))
    for number, entry in enumerate(document["decisions"]):
        if fault := _find_entry_fault(entry):
            faults.append(_format_fault(path, f"decisions.{number}", *fault))
        else:
            decisions.append(
                Decision(*(escape_surrogates(entry.get(key) or "") for key in _DECISION_KEYS))
            )
    return DecisionFile(tuple(decisions), tuple(faults), document=document)


def _unreadable_file(path: Path, place: str, found: str) -> DecisionFile:
    fault = _format_fault(path, place, "decisions in JSON", found)
    return DecisionFile(faults=(fault,), is_readable=False)


def _format_fault(path: Path, place: str, expected: str, found: str) -> str:
    error = UsageError.about("campaign.bad_decisions", path, place, expected=expected, found=found)
    return str(error)


def _find_entry_fault(entry: Any) -> tuple[str, str] | None:
    """Return what was expected of an entry and what was found; None for a valid entry."""
    if not isinstance(entry, dict):
        return "a decision", repr(entry)[:60]
    missing = [key for key in _DECISION_KEYS[:-1] if not str(entry.get(key) or "").strip()]
    if missing:
        return "test, run, decision, because and by", f"missing or empty: {', '.join(missing)}"
    if entry["decision"] not in {ACCEPT, REJECT}:
        return f"{ACCEPT} or {REJECT}", repr(entry["decision"])[:60]
    return None


def find_applicable_decision(decisions: Sequence[Decision], *, run: str) -> Decision | None:
    """Find the decision that applies to a test: the last one with the key of its results.

    Parameters
    ----------
    decisions : on the test, in order
    run : key of its present results

    Returns
    -------
    The decision; None if there is none. If the last decision rejected results with another key,
    the test remains rejected until a person decides again, and the reason says so.
    """
    applicable = next((decision for decision in reversed(decisions) if decision.run == run), None)
    if applicable is None and decisions and decisions[-1].decision == REJECT:
        because = f"{decisions[-1].because} ({format_sentence('campaign.needs_new_decision')})"
        return replace(decisions[-1], because=because)
    return applicable


def find_unapplied_decisions(
    decisions: Mapping[str, Sequence[Decision]], runs: Mapping[str, str]
) -> Iterator[tuple[Decision, str]]:
    """Find decisions that are not applied.

    Parameters
    ----------
    decisions : on each test, in order
    runs : key of the present results, by test

    Yields
    ------
    The last decision on each test that has no applicable decision, and why it is not applied.
    """
    for test, test_decisions in decisions.items():
        if test not in runs:
            yield test_decisions[-1], format_sentence("campaign.no_such_test")
        elif all(decision.run != runs[test] for decision in test_decisions):
            yield test_decisions[-1], format_sentence("campaign.other_key")


def add_decisions(folder: Path, campaign: str, decisions: Iterable[Decision]) -> None:
    """Append decisions to those of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign; made if missing
    campaign : its name
    decisions : new ones

    Raises
    ------
    UsageError
        If the existing file cannot be read, or the new file would exceed the maximum size. The file
        is then unchanged.
    StoreError
        If it cannot be written, or another process holds the lock.

    Notes
    -----
    All other content of the file is kept, including keys that this version of labpipe does not
    know.
    """
    lock_timeout = 30.0  # s to wait for another process that writes
    with locked(folder, timeout=lock_timeout):
        stored = read_decisions(folder)
        if not stored.is_readable:
            raise UsageError("\n".join(stored.faults))
        document = {"schema": _SCHEMA, "campaign": campaign, "decisions": [], **stored.document}
        document["decisions"] = [*document["decisions"], *map(asdict, decisions)]
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        content = text.encode("utf-8", "surrogatepass")
        path = folder / DECISIONS_FILE
        if len(content) > _MAX_FILE_BYTES:
            raise UsageError.about(
                "campaign.too_many_decisions", path, limit=_MAX_FILE_BYTES, size=len(content)
            )
        with replacing(path) as temporary:
            temporary.write_bytes(content)


def now() -> str:
    """Return the current time in the format of decisions."""
    return datetime.now(tz=UTC).isoformat(timespec="seconds")


def find_decision_folder(file: Path, default: Path) -> tuple[Path, str]:
    """Find the folder with the decisions on a test, and the label of the test in them.

    Parameters
    ----------
    file : result.h5 of the test
    default : folder of the campaign, used if no folder above the test contains decisions

    Returns
    -------
    decision_folder : the nearest folder above the test with decisions, resolved
    label : folder of the test below it, with slashes
    """
    test = file.resolve().parent
    folders = (parent for parent in test.parents if (parent / DECISIONS_FILE).is_file())
    decision_folder = next(folders, default.resolve())
    return decision_folder, test.relative_to(decision_folder).as_posix()


def read_decisions_by_file(files: Iterable[Path]) -> dict[Path, Sequence[Decision]]:
    """Read the decisions on tests by result file.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    Decisions on each test, in order and for all keys. Result files of campaigns without decisions
    are left out.

    Raises
    ------
    StoreError
        If decisions cannot be read, because a rejected test might then be included.
    """
    decisions: dict[Path, Sequence[Decision]] = {}
    read = cache(read_decisions)
    for file in files:
        decision_folder, label = find_decision_folder(file, file.parent)
        stored = read(decision_folder)
        if not stored.is_readable:
            raise StoreError("\n".join(stored.faults))
        if stored.document:
            decisions[file] = stored.by_test.get(label, ())
    return decisions


def exclude_rejected(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Leave out the results of tests that were rejected.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    included : files of the tests that were not rejected, in order
    rejected : reason, person and time of each rejection, by file

    Raises
    ------
    LabpipeError
        If all tests were rejected, or decisions cannot be read.
    """
    rejected = {}
    for file, decisions in read_decisions_by_file(files).items():
        decision = find_applicable_decision(decisions, run=read_run(file)) if decisions else None
        if decision is not None and decision.decision == REJECT:
            rejected[file] = decision.describe()
    included = [file for file in files if file not in rejected]
    if not included:
        raise UsageError(
            "\n".join(f"{file}: rejected: {reason}" for file, reason in rejected.items())
        )
    return included, rejected


@dataclass(slots=True)
class ImportedDecisions:
    """Result of importing decisions.

    Parameters
    ----------
    added : new decisions, in order
    n_stored_before : number of imported decisions that were stored already
    not_imported : decisions that were not imported, and why
    faults : messages about faults of the imported file or of single decisions
    """

    added: list[Decision] = field(default_factory=list)
    n_stored_before: int = 0
    not_imported: list[tuple[Decision, str]] = field(default_factory=list)
    faults: tuple[str, ...] = ()


def import_decision_file(folder: Path, campaign: str, file: Path) -> ImportedDecisions:
    """Import decisions from a file that a report page saved.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    file : in the format of ``decisions.json``, with any name

    Raises
    ------
    LabpipeError
        If the file cannot be read, is that of the campaign itself, or decisions cannot be written.
    """
    if not file.is_file():
        raise UsageError.about("campaign.no_saved_file", file)
    if file.resolve() == (folder / DECISIONS_FILE).resolve():
        raise UsageError.about("campaign.file_of_campaign", file)
    saved = _read_file(file, campaign)
    if not saved.is_readable:
        raise UsageError("\n".join(saved.faults))
    return replace(import_decisions(folder, campaign, saved.decisions), faults=saved.faults)


def import_decisions(
    folder: Path, campaign: str, decisions: Iterable[Decision]
) -> ImportedDecisions:
    """Add decisions that apply to the present results of a campaign and are not yet stored.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    decisions : in order

    Raises
    ------
    LabpipeError
        If stored decisions cannot be read or written.

    Notes
    -----
    Labels are compared with those of existing tests; no path is made from them. Each decision is
    stored where a report reads it: in the nearest ``decisions.json`` above its test. Each result
    file and each file of decisions is read once, for any number of decisions.
    """
    files = list_files_below(folder, RESULT_FILE)
    decision_folders = {file: find_decision_folder(file, folder) for file in files}
    files_by_label = defaultdict[str, list[Path]](list)
    for file, (_, label) in decision_folders.items():
        for name in {label, file.parent.relative_to(folder).as_posix()}:
            files_by_label[name].append(file)
    stored = {file: set(made) for file, made in read_decisions_by_file(files).items()}
    read_key = cache(_read_key)
    imported = ImportedDecisions()
    added = defaultdict[Path, list[Decision]](list)
    for decision in dict.fromkeys(decisions):
        result_file, reason = _find_result(
            decision, files_by_label.get(decision.test, ()), read_key
        )
        if result_file is None:
            imported.not_imported.append((decision, reason))
            continue
        decision_folder, label = decision_folders[result_file]
        relabelled = replace(decision, test=label)
        if relabelled in stored.get(result_file, ()):
            imported.n_stored_before += 1
        else:
            imported.added.append(decision)
            added[decision_folder].append(relabelled)
    for decision_folder, new in added.items():
        add_decisions(decision_folder, campaign, new)
    return imported


def _find_result(
    decision: Decision, files: Iterable[Path], read_key: Callable[[Path], tuple[str, str]]
) -> tuple[Path | None, str]:
    """Find the result file with the key of a decision, or return why there is none."""
    try:
        datetime.fromisoformat(decision.when or now())
    except ValueError:
        return None, format_sentence("campaign.bad_time", time=decision.when[:40], valid=now())
    reason = format_sentence("campaign.no_such_test")
    for file in files:
        key, fault = read_key(file)
        if key == decision.run:
            return file, ""
        reason = fault or format_sentence("campaign.other_key")
    return None, reason


def _read_key(file: Path) -> tuple[str, str]:
    """Read the key of a result; return an empty key and the message if it cannot be read."""
    try:
        return read_run(file), ""
    except LabpipeError as error:
        return "", str(error)
