"""Import decisions that a report page saved into those of its campaign."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from labpipe.campaign.decisions import (
    DECISIONS,
    NO_SUCH_TEST,
    OTHER_KEY,
    Decision,
    add_decisions,
    decision_folder,
    decisions_on,
    label_of,
    now,
    read_decision_file,
)
from labpipe.errors import LabpipeError, UsageError, error_text
from labpipe.process.output_paths import RESULT_FILE, files_below
from labpipe.store.read import read_run


@dataclass(slots=True)
class ImportedDecisions:
    """Result of importing decisions.

    Parameters
    ----------
    added : new decisions, in order
    n_known : number of decisions that were stored already
    left : decisions that were not imported, and why
    """

    added: list[Decision] = field(default_factory=list)
    n_known: int = 0
    left: list[tuple[Decision, str]] = field(default_factory=list)


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
        state, remedy = ("nothing of that name", "The browser saves it in the downloads folder.")
        raise UsageError(
            error_text(
                file, "", expected="a file saved by a report page", found=state, remedy=remedy
            )
        )
    if file.resolve() == (folder / DECISIONS).resolve():
        state, remedy = "that of the campaign", "Its decisions are applied already."
        raise UsageError(
            error_text(
                file, "", expected="a file saved by a report page", found=state, remedy=remedy
            )
        )
    read = read_decision_file(file, campaign)
    if not read.is_whole:
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
    wanted = list(dict.fromkeys(decisions))
    files = _results(folder)
    named = {file: None for decision in wanted for file in files.get(decision.test, ())}
    stored = {file: {*labelled} for file, labelled in decisions_on([*named]).items()}
    labels = {file: label_of(file, folder) for file in named}
    runs = {file: _run_of(file) for file in named}
    taken = ImportedDecisions()
    at_home: dict[Path, list[Decision]] = {}
    for decision in wanted:
        file, why = _find_decided_result(decision, files.get(decision.test, ()), runs)
        if file is None:
            taken.left.append((decision, why))
            continue
        labelled = replace(decision, test=labels[file])
        if labelled in stored.get(file, ()):
            taken.n_known += 1
        else:
            taken.added.append(decision)
            at_home.setdefault(decision_folder(file.parent, folder), []).append(labelled)
    for home, new in at_home.items():
        add_decisions(home, campaign, new)
    return taken


def _results(folder: Path) -> dict[str, list[Path]]:
    """Find results by label of the test, and by folder below the campaign."""
    results: dict[str, list[Path]] = {}
    for file in files_below(folder, RESULT_FILE):
        for label in {label_of(file, folder), file.parent.relative_to(folder).as_posix()}:
            results.setdefault(label, []).append(file)
    return results


def _run_of(file: Path) -> str | LabpipeError:
    """Read the key of a result, or return the error."""
    try:
        return read_run(file)
    except LabpipeError as error:
        return error


def _find_decided_result(
    decision: Decision, files: Iterable[Path], runs: Mapping[Path, str | LabpipeError]
) -> tuple[Path | None, str]:
    """Find the result of a decision, or return why there is none."""
    if decision.when and not _is_time(decision.when):
        return None, f"its time {decision.when[:40]!r} is not in the form {now()}"
    why = NO_SUCH_TEST
    for file in files:
        if runs[file] == decision.run:
            return file, ""
        why = OTHER_KEY if isinstance(runs[file], str) else str(runs[file])
    return None, why


def _is_time(text: str) -> bool:
    """Return whether a text is an ISO 8601 time."""
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True
