"""What people decide of tests: accepted or rejected, why, by whom; bound to what was tested."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from labpipe.campaign.outcome_rows import ResultRow, plain
from labpipe.errors import StoreError, UsageError, error_text
from labpipe.store.read import read_run
from labpipe.store.replace import locked, replacing

DECISIONS: Final = "decisions.json"
SCHEMA: Final = 1
ACCEPT, REJECT = "accept", "reject"
NO_SUCH_TEST: Final = "there is no such test"
OPEN_AGAIN: Final = "open again: exports, sheet, protocol or labpipe changed since"
OTHER_KEY: Final = "it was made on another key: exports, sheet, protocol or labpipe changed"
_TEXTS = ("test", "run", "decision", "because", "by", "when")
_NEEDED = ("test", "run", "decision", "because", "by")
_MOST_BYTES = 50_000_000
_PATIENCE = 30.0
"""s: how long another process may be writing."""
_SHARE = 0.1
"""Share of an interval that a number may move by before a decision on it is asked for again."""
_MEND = "Mend the file, or move it away and decide again; nothing in it was changed."


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision on a test.

    Parameters
    ----------
    test : its folder below the campaign
    run : key of what was decided on; a decision counts for that key and no other
    decision : ``accept`` or ``reject``
    because, by : why, and who decided
    when : time of the decision, ISO 8601, as it is written
    note : where it was carried over from another key, why
    """

    test: str
    run: str
    decision: str
    because: str
    by: str
    when: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True)
class DecisionFile:
    """What a file of decisions holds.

    Parameters
    ----------
    decisions : those that can be read, in order
    faults : what is wrong with the file or with single decisions, as messages
    is_whole : whether the file as such could be read; no decision of it is known otherwise
    document : all of it, as it was
    """

    decisions: tuple[Decision, ...] = ()
    faults: tuple[str, ...] = ()
    is_whole: bool = True
    document: Mapping[str, Any] = field(default_factory=dict)


def read_decisions(folder: Path, campaign: str = "") -> DecisionFile:
    """Read the decisions of a campaign.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name; a file of another one is said. Empty for not known

    Returns
    -------
    The decisions; none where there is no file. Whatever is wrong is said in `faults`.
    """
    path = folder / DECISIONS
    return read_decision_file(path, campaign) if path.exists() else DecisionFile()


def read_decision_file(path: Path, campaign: str = "") -> DecisionFile:
    """Read decisions, whatever their file is called and wherever it lies.

    Parameters
    ----------
    path : of the file
    campaign : its name; a file of another one is said. Empty for not known

    Returns
    -------
    The decisions. Whatever is wrong, also that there is no such file, is said in `faults`.
    """
    document = _document(path)
    if isinstance(document, str):
        return DecisionFile(faults=(document,), is_whole=False)
    return decisions_in(document, path, campaign)


def decisions_in(document: Mapping[str, Any], path: Path, campaign: str = "") -> DecisionFile:
    """Take the decisions out of a document.

    Parameters
    ----------
    document : with a list ``decisions``
    path : of where it stands, for messages
    campaign : its name; a document of another one is said. Empty for not known

    Returns
    -------
    The decisions. What is wrong with single ones is said in `faults`.
    """
    faults = []
    if campaign and document.get("campaign", campaign) != campaign:
        faults.append(
            error_text(
                path,
                "campaign",
                expected=f"decisions of {campaign!r}",
                found=f"those of {document['campaign']!r}",
                remedy="Those that were made on the same exports, sheet and protocol count.",
            )
        )
    read = [_decision(path, number, key) for number, key in enumerate(document["decisions"])]
    faults += [each for each in read if isinstance(each, str)]
    decisions = tuple(each for each in read if isinstance(each, Decision))
    return DecisionFile(decisions, tuple(faults), document=document)


def _document(path: Path) -> dict[str, Any] | str:
    """The content of the file, or what is wrong with it."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            return _broken(path, "", f"{path.stat().st_size} bytes")
        document = json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        return _broken(path, f"line {error.lineno}, column {error.colno}", error.msg)
    except (OSError, ValueError, RecursionError) as error:
        return _broken(path, "", getattr(error, "strerror", None) or "text that is no JSON")
    return checked_document(document, path)


def checked_document(document: object, path: Path) -> dict[str, Any] | str:
    """Check that something is a document of decisions.

    Parameters
    ----------
    document : as JSON gives it
    path : of where it stands, for messages

    Returns
    -------
    The document, or what is wrong with it.
    """
    if not isinstance(document, dict) or not isinstance(document.get("decisions"), list):
        return _broken(path, "", "JSON without a list 'decisions'")
    if document.get("schema") != SCHEMA:
        found = f"{document.get('schema')!r}, where this labpipe knows {SCHEMA}"
        return _broken(path, "schema", found)
    return document


def _broken(path: Path, place: str, found: str) -> str:
    return error_text(path, place, expected="decisions in JSON", found=found, remedy=_MEND)


def _decision(path: Path, number: int, said: object) -> Decision | str:
    """One decision, or what is wrong with it."""
    place = f"decisions.{number}"
    if not isinstance(said, dict):
        return error_text(path, place, expected="a decision", found=repr(said)[:60], remedy=_MEND)
    missing = [key for key in _NEEDED if not str(said.get(key) or "").strip()]
    if missing:
        found = f"none of {', '.join(missing)}"
        return error_text(path, place, expected="test, run, decision, because and by", found=found,
                         remedy=_MEND)  # fmt: skip
    if said["decision"] not in {ACCEPT, REJECT}:
        found = repr(said["decision"])[:60]
        expected = f"{ACCEPT} or {REJECT}"
        return error_text(path, place, expected=expected, found=found, remedy=_MEND)
    texts = {key: plain(said.get(key) or "") for key in (*_TEXTS, "note")}
    return Decision(**texts)


def by_test_and_run(decisions: Iterable[Decision]) -> dict[tuple[str, str], Decision]:
    """Find the decision that counts for each test and key: the last one.

    Parameters
    ----------
    decisions : in order
    """
    return {(decision.test, decision.run): decision for decision in decisions}


def in_force(decisions: Iterable[Decision], *, run: str) -> Decision | None:
    """Find the decision that counts for a test: the last one on its key.

    A test that was rejected on another key stays out until a person decides again.

    Parameters
    ----------
    decisions : on the test, in order
    run : key of its results
    """
    newest_first = [*decisions][::-1]
    own = next((decision for decision in newest_first if decision.run == run), None)
    if own is None and newest_first and newest_first[0].decision == REJECT:
        last = newest_first[0]
        return replace(last, because=f"{last.because} ({OPEN_AGAIN})")
    return own


def not_applied(
    decisions: Sequence[Decision], runs: Mapping[str, str]
) -> Iterator[tuple[Decision, str]]:
    """Find decisions that count for nothing now.

    Parameters
    ----------
    decisions : in order
    runs : key of each test as it stands, by test

    Yields
    ------
    Each test's last decision and why it is not applied, if it is not.
    """
    last: dict[str, Decision] = {}
    for decision in decisions:
        counts = decision.test in last and last[decision.test].run == runs.get(decision.test)
        if not counts or decision.run == runs.get(decision.test):
            last[decision.test] = decision
    for test, each in last.items():
        if test not in runs:
            yield each, NO_SUCH_TEST
        elif runs[test] != each.run:
            yield each, OTHER_KEY


def add_decisions(folder: Path, campaign: str, decisions: Sequence[Decision]) -> None:
    """Write decisions behind those that there are.

    Parameters
    ----------
    folder : of the results of the campaign; made if it is not there
    campaign : its name
    decisions : new ones

    Raises
    ------
    UsageError
        If the file that is there cannot be read: it stays as it is.
    StoreError
        If it cannot be written, or another process is at work in the folder.

    Notes
    -----
    What else the file holds, also what this labpipe does not understand, stays in it.
    """
    with locked(folder, patience=_PATIENCE):
        known = read_decisions(folder)
        if not known.is_whole:
            raise UsageError("\n".join(known.faults))
        document = {"schema": SCHEMA, "campaign": campaign, "decisions": [], **known.document}
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
    texts = {key: getattr(decision, key) for key in _TEXTS}
    return texts | ({"note": decision.note} if decision.note else {})


def now() -> str:
    """The time, as decisions state it."""
    return datetime.now(tz=UTC).isoformat(timespec="seconds")


def largest_move(before: Sequence[ResultRow], after: Sequence[ResultRow]) -> float:
    """Compare the numbers of a test before and after.

    Parameters
    ----------
    before, after : results

    Returns
    -------
    How far the number that moved most did, in widths of its interval before; infinite where a
    result came, went, failed, or moved and has no interval.
    """
    if [result_row.name for result_row in before] != [result_row.name for result_row in after]:
        return float("inf")
    return max(map(_move, before, after), default=0.0)


def _move(before: ResultRow, after: ResultRow) -> float:
    if before.value == after.value:
        return 0.0
    known = (before.value, before.lower, before.upper, after.value)
    if any(number is None for number in known):
        return float("inf")
    value, lower, upper, other = (float(number or 0.0) for number in known)
    return abs(other - value) / (upper - lower) if upper > lower else float("inf")


def carried_over(
    decision: Decision, run: str, before: Sequence[ResultRow], after: Sequence[ResultRow]
) -> Decision | None:
    """Carry a decision over to a test that was only processed by a newer labpipe.

    Parameters
    ----------
    decision : on the results before
    run : key of the results after
    before, after : the results

    Returns
    -------
    The same decision on the new key, with a note; None where a number moved by more than a tenth of
    its interval: then it has to be decided again.
    """
    moved = largest_move(before, after)
    if moved > _SHARE:
        return None
    note = (
        f"carried over from {decision.run}: only the processing version changed, and no number"
        f" moved by more than {moved:.2g} of its interval"
    )
    return Decision(
        decision.test, run, decision.decision, decision.because, decision.by, decision.when, note
    )


def home_of(test: Path, shared: Path) -> Path:
    """Find the folder that has the decisions on a test.

    Parameters
    ----------
    test : folder of its results
    shared : folder that counts as that of the campaign where none has decisions yet

    Returns
    -------
    The nearest around the test that has decisions, resolved.
    """
    around = test.resolve().parents
    return next((each for each in around if (each / DECISIONS).is_file()), shared.resolve())


def decisions_on(files: Sequence[Path]) -> dict[Path, tuple[Decision, ...]]:
    """Find what was decided on tests, by their results.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    By file, the decisions on that test, in order and of whatever key; only of campaigns that have
    decisions.

    Raises
    ------
    StoreError
        If the decisions cannot be read: a rejected test must not slip in.
    """
    decisions: dict[Path, tuple[Decision, ...]] = {}
    read: dict[Path, dict[str, list[Decision]]] = {}
    for file in files:
        test = file.resolve().parent
        home = home_of(test, test.parent)
        if not (home / DECISIONS).is_file():
            continue
        if home not in read:
            known = read_decisions(home)
            if not known.is_whole:
                raise StoreError("\n".join(known.faults))
            read[home] = {}
            for decision in known.decisions:
                read[home].setdefault(decision.test, []).append(decision)
        decisions[file] = tuple(read[home].get(test.relative_to(home).as_posix(), ()))
    return decisions


def label_of(file: Path, shared: Path) -> str:
    """Name a test as decisions on it do: by its folder below that of its campaign.

    Parameters
    ----------
    file : a result.h5
    shared : folder that counts as that of the campaign where none has decisions yet
    """
    test = file.resolve().parent
    home = home_of(test, shared)
    return test.relative_to(home).as_posix()


def without_rejected(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Leave out the results of tests that were rejected.

    Parameters
    ----------
    files : result.h5 files

    Returns
    -------
    left : those that count, in order
    rejected : by file, why one does not, by whom and when

    Raises
    ------
    LabpipeError
        If all were rejected, or decisions cannot be read.
    """
    rejected = {}
    for file, decisions in decisions_on(files).items():
        found = in_force(decisions, run=read_run(file)) if decisions else None
        if found is not None and found.decision == REJECT:
            rejected[file] = decision_sentence(found)
    left = [file for file in files if file not in rejected]
    if not left:
        raise UsageError("\n".join(f"{file}: rejected: {why}" for file, why in rejected.items()))
    return left, rejected


def decision_sentence(decision: Decision) -> str:
    """Say why, by whom and when something was decided.

    Parameters
    ----------
    decision : any
    """
    return f"{decision.because} ({', '.join(filter(None, (decision.by, decision.when)))})"
