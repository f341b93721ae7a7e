"""Decisions that the page of a report saved, taken into those of its campaign."""

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
    decisions_on,
    home_of,
    label_of,
    now,
    read_decision_file,
)
from labpipe.errors import LabpipeError, UsageError, error_text
from labpipe.process.output_paths import RESULT_FILE, files_below
from labpipe.store.read import read_run


@dataclass(slots=True)
class ImportedDecisions:
    """What became of decisions that were handed in.

    Parameters
    ----------
    added : those that are new, in order
    known : number of those that stood there already
    left : those that do not count, and why
    """

    added: list[Decision] = field(default_factory=list)
    known: int = 0
    left: list[tuple[Decision, str]] = field(default_factory=list)


def take_in_file(
    folder: Path, campaign: str, file: Path
) -> tuple[ImportedDecisions, tuple[str, ...]]:
    """Take in the decisions of a file that a page saved.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    file : of the form of ``decisions.json``, whatever its name

    Returns
    -------
    What became of them, and what is wrong with the file or with single decisions, as messages.

    Raises
    ------
    LabpipeError
        If the file cannot be read, is that of the campaign itself, or nothing can be written.
    """
    if not file.is_file():
        found, remedy = "nothing of that name", "A page saves it in the folder of downloads."
        raise UsageError(
            error_text(file, "", expected="a file that a page saved", found=found, remedy=remedy)
        )
    if file.resolve() == (folder / DECISIONS).resolve():
        found, remedy = "the campaign's own", "What stands in it counts already."
        raise UsageError(
            error_text(file, "", expected="a file that a page saved", found=found, remedy=remedy)
        )
    read = read_decision_file(file, campaign)
    if not read.is_whole:
        raise UsageError("\n".join(read.faults))
    return take_in(folder, campaign, read.decisions), read.faults


def take_in(folder: Path, campaign: str, decisions: Iterable[Decision]) -> ImportedDecisions:
    """Add decisions to those of a campaign: the new ones that were made on results as they stand.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    decisions : in order

    Returns
    -------
    What became of them.

    Raises
    ------
    LabpipeError
        If decisions that are there cannot be read or written.

    Notes
    -----
    Labels of tests are looked up among the tests that there are; no path is made of them. Each
    decision goes where a report looks for it: to the nearest ``decisions.json`` around its test.
    """
    wanted = list(dict.fromkeys(decisions))
    files = _results(folder)
    named = {file: None for each in wanted for file in files.get(each.test, ())}
    standing = {file: {*own} for file, own in decisions_on([*named]).items()}
    labels = {file: label_of(file, folder) for file in named}
    runs = {file: _run_of(file) for file in named}
    taken = ImportedDecisions()
    at_home: dict[Path, list[Decision]] = {}
    for each in wanted:
        file, why = _meant(each, files.get(each.test, ()), runs)
        if file is None:
            taken.left.append((each, why))
            continue
        own = replace(each, test=labels[file])
        if own in standing.get(file, ()):
            taken.known += 1
        else:
            taken.added.append(each)
            at_home.setdefault(home_of(file.parent, folder), []).append(own)
    for home, new in at_home.items():
        add_decisions(home, campaign, new)
    return taken


def _results(folder: Path) -> dict[str, list[Path]]:
    """Results of the tests by their label, and by their folder below the campaign."""
    results: dict[str, list[Path]] = {}
    for file in files_below(folder, RESULT_FILE):
        for label in {label_of(file, folder), file.parent.relative_to(folder).as_posix()}:
            results.setdefault(label, []).append(file)
    return results


def _run_of(file: Path) -> str | LabpipeError:
    """Key of a result, or why it cannot be read."""
    try:
        return read_run(file)
    except LabpipeError as error:
        return error


def _meant(
    decision: Decision, files: Iterable[Path], runs: Mapping[Path, str | LabpipeError]
) -> tuple[Path | None, str]:
    """The result that a decision was made on, or why there is none."""
    if decision.when and not _is_time(decision.when):
        return None, f"its time {decision.when[:40]!r} is none such as {now()}"
    why = NO_SUCH_TEST
    for file in files:
        if runs[file] == decision.run:
            return file, ""
        why = OTHER_KEY if isinstance(runs[file], str) else str(runs[file])
    return None, why


def _is_time(text: str) -> bool:
    """Check whether a text is a time of ISO 8601, as decisions state it."""
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True
