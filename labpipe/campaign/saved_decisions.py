"""Decisions that the page of a report saved, taken into those of its campaign."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.campaign.decisions import (
    DECISIONS,
    NO_SUCH_TEST,
    OTHER_KEY,
    Decision,
    add_decisions,
    decisions_on,
    home_of,
    read_decision_file,
)
from labpipe.errors import LabpipeError, UsageError, complaint
from labpipe.process.targets import RESULT_FILE, files_below
from labpipe.store.read import read_run


@dataclass(slots=True)
class TakenIn:
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


def take_in_file(folder: Path, campaign: str, file: Path) -> tuple[TakenIn, tuple[str, ...]]:
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
    if file.resolve() == (home_of(folder) / DECISIONS).resolve():
        found, remedy = "the campaign's own", "What stands in it counts already."
        raise UsageError(
            complaint(file, "", expected="a file that a page saved", found=found, remedy=remedy)
        )
    read = read_decision_file(file, campaign)
    if not read.is_whole:
        raise UsageError("\n".join(read.faults))
    return take_in(folder, campaign, read.decisions), read.faults


def take_in(folder: Path, campaign: str, decisions: Iterable[Decision]) -> TakenIn:
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
    Labels of tests are looked up among the tests that there are; no path is made of them. They
    count from the folder, or from the one around it that has decisions. Each decision goes where a
    report looks for it: to the nearest ``decisions.json`` around its test.
    """
    files = _results(home_of(folder)) | _results(folder)
    wanted = list(dict.fromkeys(decisions))
    standing = decisions_on([files[each.test] for each in wanted if each.test in files])
    taken = TakenIn()
    at_home: dict[Path, list[Decision]] = {}
    for each in wanted:
        file = files.get(each.test)
        why = NO_SUCH_TEST if file is None else _why_not(file, each)
        if file is None or why:
            taken.left.append((each, why))
            continue
        home = _home(file, folder)
        own = replace(each, test=file.parent.relative_to(home).as_posix())
        if own in standing.get(file, ()):
            taken.known += 1
        else:
            taken.added.append(each)
            at_home.setdefault(home, []).append(own)
    for home, new in at_home.items():
        add_decisions(home, campaign, new)
    return taken


def _results(folder: Path) -> dict[str, Path]:
    """Results of the tests, by their label."""
    here = folder.resolve()
    found = files_below(here, RESULT_FILE)
    return {file.parent.relative_to(here).as_posix(): file for file in found}


def _home(file: Path, folder: Path) -> Path:
    """Where a report looks for decisions on a test; the campaign where there are none yet."""
    home = home_of(file.parent.parent)
    return home if (home / DECISIONS).is_file() else folder.resolve()


def _why_not(file: Path, decision: Decision) -> str:
    try:
        run = read_run(file)
    except LabpipeError as error:
        return str(error)
    return "" if run == decision.run else OTHER_KEY
