"""Read, apply, store and import decisions to accept or reject tests.

A decision has a reason, a person and the key of the results to which it applies.

A campaign stores decisions in ``decisions.json`` beside its results. A report page saves decisions
in a file, which can be imported.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.messages import format_sentence
from labpipe.process.output_paths import RESULT_FILE, list_files_below
from labpipe.store.replace import lock, replace_file
from labpipe.store.result_files import read_run

DECISIONS_FILE: Final = "decisions.json"
ACCEPT, REJECT = "accept", "reject"
_SCHEMA: Final = 1


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision on a test.

    Parameters
    ----------
    test : folder of the test relative to the campaign, with slashes
    run : key of the results that were judged; later results have another key and need a new
        decision, and until then a rejection remains in force
    decision : ``accept`` or ``reject``
    because, by : reason of the decision, and person who made it
    when : time of the decision, ISO 8601; empty if unknown
    """

    test: str
    run: str
    decision: str
    because: str
    by: str
    when: str = ""

    def describe(self) -> str:
        """Write the reason, the person and the time of the decision as text."""
        return f"{self.because} ({', '.join(filter(None, (self.by, self.when)))})"


_DECISION_KEYS: Final = tuple(entry.name for entry in fields(Decision))


@dataclass(frozen=True)
class DecisionFile:
    """Valid content of a file of decisions, and its faults.

    Parameters
    ----------
    decisions : valid decisions, in the order of the file
    faults : messages about faults of the file or of single decisions
    is_readable : whether the file can be read; if not, `decisions` is empty
    document : parsed JSON of the file; empty if there is no file or it cannot be read
    """

    decisions: tuple[Decision, ...] = ()
    faults: tuple[str, ...] = ()
    is_readable: bool = True
    document: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def decisions_by_test(self) -> Mapping[str, Sequence[Decision]]:
        """Decisions on each test in the order of the file, keyed by folder of the test."""
        decisions = defaultdict[str, list[Decision]](list)
        for decision in self.decisions:
            decisions[decision.test].append(decision)
        return decisions


def read_decisions(folder: Path, campaign: str = "") -> DecisionFile:
    """Read the decisions of a campaign.

    Parameters
    ----------
    folder : folder of the results of the campaign
    campaign : name of the expected campaign, as for `parse_decisions`

    Returns
    -------
    Decisions and faults of the file; both are empty if there is no file.
    """
    path = folder / DECISIONS_FILE
    return _read_decision_file(path, campaign) if os.path.lexists(path) else DecisionFile()


def _read_decision_file(path: Path, campaign: str) -> DecisionFile:
    """Read a file of decisions that exists; a broken link, a folder or a pipe has a fault."""
    if not path.is_file():
        return _make_unreadable_file(path, "", "a folder, a pipe or a broken link")
    try:
        return parse_decisions(path.read_bytes(), path, campaign)
    except OSError as error:
        return _make_unreadable_file(path, "", error.strerror or str(error))


def parse_decisions(content: bytes, path: Path, campaign: str = "") -> DecisionFile:
    """Parse the content of a file of decisions.

    Parameters
    ----------
    content : JSON in UTF-8
    path : path of the file, for messages
    campaign : name of the expected campaign, empty if unknown; a file of another campaign has a
        fault, but its decisions are returned

    Returns
    -------
    Valid decisions, and the faults of the content and of the first 100 faulty decisions.
    """
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        return _make_unreadable_file(path, f"line {error.lineno}, column {error.colno}", error.msg)
    except (ValueError, RecursionError):
        return _make_unreadable_file(path, "", "text that is not JSON")
    if not isinstance(document, dict) or not isinstance(document.get("decisions"), list):
        return _make_unreadable_file(path, "", "JSON without a list 'decisions'")
    if (schema := document.get("schema")) != _SCHEMA:
        found = f"{repr(schema)[:60]}; this labpipe reads {_SCHEMA}"
        return _make_unreadable_file(path, "schema", found)
    from labpipe.campaign.catalog import escape_surrogates  # not needed without decisions

    faults = []
    if campaign and (stated_campaign := document.get("campaign", campaign)) != campaign:
        mismatch = UsageError.about(
            "campaign.other_campaign", path, "campaign", expected=campaign, found=stated_campaign
        )
        faults.append(str(mismatch))
    entries, max_faults = document["decisions"], 100  # a million messages would take minutes
    entry_faults = [_find_entry_fault(entry) for entry in entries]
    decisions = tuple(
        Decision(*(escape_surrogates(entry.get(key) or "") for key in _DECISION_KEYS))
        for entry, fault in zip(entries, entry_faults, strict=True)
        if fault is None
    )
    numbered_faults = [(index, fault) for index, fault in enumerate(entry_faults) if fault]
    for index, fault in numbered_faults[:max_faults]:
        faults.append(_format_fault(path, f"decisions.{index}", *fault))
    if (n_unlisted := len(numbered_faults) - max_faults) > 0:
        found = f"{n_unlisted} more faulty ones"
        faults.append(_format_fault(path, "decisions", "valid decisions", found))
    return DecisionFile(decisions, tuple(faults), document=document)


def _make_unreadable_file(path: Path, place: str, found: str) -> DecisionFile:
    """Return the content of a file that cannot be read: no decisions, and one fault."""
    fault = _format_fault(path, place, "decisions in JSON", found)
    return DecisionFile(faults=(fault,), is_readable=False)


def _format_fault(path: Path, place: str, expected: str, found: str) -> str:
    """Format the message of a fault of a file of decisions, or of one of its entries."""
    error = UsageError.about("campaign.bad_decisions", path, place, expected=expected, found=found)
    return str(error)


def _find_entry_fault(entry: Any) -> tuple[str, str] | None:
    """Find the fault of an entry: what is expected and what was found; None for a valid entry."""
    if not isinstance(entry, dict):
        return "a decision", repr(entry)[:60]
    values = {key: entry.get(key) for key in _DECISION_KEYS[:-1]}
    if empty_keys := [key for key, value in values.items() if not str(value or "").strip()]:
        return "test, run, decision, because and by", f"missing or empty: {', '.join(empty_keys)}"
    if other_keys := [key for key, value in values.items() if not isinstance(value, str)]:
        return "text", f"another value of {', '.join(other_keys)}"
    if entry["decision"] not in {ACCEPT, REJECT}:
        return f"{ACCEPT} or {REJECT}", repr(entry["decision"])[:60]
    return None


def find_decision_in_force(decisions: Sequence[Decision], *, run: str) -> Decision | None:
    """Find the decision in force: the last one on the present results, or an earlier rejection.

    Parameters
    ----------
    decisions : decisions on the test, in the order of the file
    run : key of the present results of the test

    Returns
    -------
    The last decision with the key `run`. If no decision has this key and the last decision of all
    is a rejection, it remains in force until a person decides again, and its reason says so. None
    if no decision is in force.
    """
    last_match = next((decision for decision in reversed(decisions) if decision.run == run), None)
    if last_match is None and decisions and decisions[-1].decision == REJECT:
        because = f"{decisions[-1].because} ({format_sentence('campaign.needs_new_decision')})"
        return replace(decisions[-1], because=because)
    return last_match


def find_outdated_decisions(
    decisions: Mapping[str, Sequence[Decision]], runs: Mapping[str, str]
) -> Iterator[tuple[Decision, str]]:
    """Find the last decisions on tests that have no decision for their present results.

    Parameters
    ----------
    decisions : decisions on each test in the order of the file, keyed by folder of the test
    runs : key of the present results of each test, keyed by folder of the test

    Yields
    ------
    The last decision on each test that has no decision for its present results, and why it does
    not apply to them: no such test, or results with another key.
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
    folder : folder of the results of the campaign; it is made if it does not exist
    campaign : name of the campaign
    decisions : new decisions

    Raises
    ------
    UsageError
        If the existing file cannot be read; it is then unchanged.
    StoreError
        If the file cannot be written, or another process holds the lock.

    Notes
    -----
    All other content of the file is kept, including keys that this version of labpipe does not
    know.
    """
    lock_timeout = 30.0  # s to wait for another process that writes
    with lock(folder, timeout=lock_timeout):
        file = read_decisions(folder)
        if not file.is_readable:
            raise UsageError("\n".join(file.faults))
        document = {"schema": _SCHEMA, "campaign": campaign, "decisions": [], **file.document}
        document["decisions"] = [*document["decisions"], *map(asdict, decisions)]
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        with replace_file(folder / DECISIONS_FILE) as temporary_file:
            temporary_file.write_bytes(text.encode("utf-8", "surrogatepass"))


def format_current_time() -> str:
    """Format the current time as the time of a decision."""
    return datetime.now(tz=UTC).isoformat(timespec="seconds")


def find_decision_folder(file: Path, default_folder: Path) -> tuple[Path, str]:
    """Find the folder with the decisions on a test, and the label of the test in them.

    Parameters
    ----------
    file : result.h5 of the test
    default_folder : folder of the campaign, used if no folder above the test contains decisions

    Returns
    -------
    decision_folder : absolute path of the nearest folder above the test that contains decisions, or
        of `default_folder`
    label : folder of the test relative to `decision_folder`, with slashes
    """
    test = file.parent.resolve()  # decisions are also found if the folder of the test is a link
    for folder in test.parents:
        if os.path.lexists(folder / DECISIONS_FILE):
            return folder, test.relative_to(folder).as_posix()
    label = os.path.relpath(file.parent, default_folder)
    return default_folder.resolve(), label.replace(os.sep, "/")


def read_decisions_by_file(files: Iterable[Path]) -> dict[Path, Sequence[Decision]]:
    """Read the decisions on tests.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    Decisions on each test for its present and earlier results, in the order of their file, keyed by
    result file. A result file without a file of decisions in a folder above it has no entry.

    Raises
    ------
    StoreError
        If a file of decisions cannot be read; without it, a rejected test might be included.
    """
    decisions: dict[Path, Sequence[Decision]] = {}
    read_decisions_once = cache(read_decisions)
    for file in files:
        decision_folder, label = find_decision_folder(file, file.parent)
        content = read_decisions_once(decision_folder)
        if not content.is_readable:
            raise StoreError("\n".join(content.faults))
        if content.document:
            decisions[file] = content.decisions_by_test.get(label, ())
    return decisions


def exclude_rejected_tests(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Exclude the result files of tests that were rejected.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    included_files : files of the tests that were not rejected, in the order of `files`
    rejections : reason, person and time of each rejection, keyed by file

    Raises
    ------
    LabpipeError
        If all tests were rejected, or decisions cannot be read.
    """
    rejections = {}
    for file, decisions in read_decisions_by_file(files).items():
        decision = find_decision_in_force(decisions, run=read_run(file)) if decisions else None
        if decision is not None and decision.decision == REJECT:
            rejections[file] = decision.describe()
    included_files = [file for file in files if file not in rejections]
    if not included_files:
        raise UsageError(
            "\n".join(f"{file}: rejected: {reason}" for file, reason in rejections.items())
        )
    return included_files, rejections


@dataclass(slots=True)
class ImportedDecisions:
    """Result of importing decisions.

    Parameters
    ----------
    added : decisions that were added, in the order of import
    n_stored_before : number of imported decisions that were stored already
    not_imported : decisions that were not imported, each with the reason
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
    folder : folder of the results of the campaign
    campaign : name of the campaign
    file : file with the format of ``decisions.json`` and any name

    Returns
    -------
    Decisions that were added, stored before or not imported, and the faults of `file`.

    Raises
    ------
    LabpipeError
        If the file does not exist, cannot be read or is that of the campaign itself, or if stored
        decisions cannot be read or written.
    """
    if not file.is_file():
        raise UsageError.about("campaign.no_saved_file", file)
    if file.resolve() == (folder / DECISIONS_FILE).resolve():
        raise UsageError.about("campaign.file_of_campaign", file)
    content = _read_decision_file(file, campaign)
    if not content.is_readable:
        raise UsageError("\n".join(content.faults))
    return replace(import_decisions(folder, campaign, content.decisions), faults=content.faults)


def import_decisions(
    folder: Path, campaign: str, decisions: Iterable[Decision]
) -> ImportedDecisions:
    """Add decisions that apply to the present results of a campaign and are not yet stored.

    Parameters
    ----------
    folder : folder of the results of the campaign
    campaign : name of the campaign
    decisions : decisions to add, in the order in which they were made

    Returns
    -------
    Decisions that were added, stored before or not imported, without faults of a file.

    Raises
    ------
    LabpipeError
        If stored decisions cannot be read or written.

    Notes
    -----
    The label of a decision is compared with those of existing tests and is never used as a path.
    Each decision is added to the nearest ``decisions.json`` above its test, where a report reads
    it. If there is none, it is added to that of the campaign. The key of each result file and each
    file of decisions are read at most once.
    """
    files = list_files_below(folder, RESULT_FILE)
    decision_folders = {file: find_decision_folder(file, folder) for file in files}
    files_by_label = defaultdict[str, list[Path]](list)
    for file, (_, label) in decision_folders.items():
        for name in {label, file.parent.relative_to(folder).as_posix()}:
            files_by_label[name].append(file)
    stored = {file: set(entries) for file, entries in read_decisions_by_file(files).items()}
    read_key = cache(_read_key)
    imported = ImportedDecisions()
    added_by_folder = defaultdict[Path, list[Decision]](list)
    for decision in dict.fromkeys(decisions):
        result_file, reason = _find_result(
            decision, files_by_label.get(decision.test, ()), read_key
        )
        if result_file is None:
            imported.not_imported.append((decision, reason))
            continue
        decision_folder, label = decision_folders[result_file]
        relabelled_decision = replace(decision, test=label)
        if relabelled_decision in stored.get(result_file, ()):
            imported.n_stored_before += 1
        else:
            imported.added.append(decision)
            added_by_folder[decision_folder].append(relabelled_decision)
    for decision_folder, added_decisions in added_by_folder.items():
        add_decisions(decision_folder, campaign, added_decisions)
    return imported


def _find_result(
    decision: Decision, files: Iterable[Path], read_key: Callable[[Path], tuple[str, str]]
) -> tuple[Path | None, str]:
    """Find the result file to which a decision applies.

    Parameters
    ----------
    decision : decision to import
    files : result files of the tests with the label of the decision
    read_key : function that returns the key of a result file, or an empty key and a fault

    Returns
    -------
    result_file : first file with the key of the decision; None if there is none, or if the time of
        the decision is not valid
    reason : reason for the lack of a file; empty if there is one
    """
    try:
        datetime.fromisoformat(decision.when or format_current_time())
    except ValueError:
        time, example_time = decision.when[:40], format_current_time()
        return None, format_sentence("campaign.bad_time", time=time, valid=example_time)
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
