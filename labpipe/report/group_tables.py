"""The tables of a report: of each group, and of the whole campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labpipe.records.group import Campaign, Decision, Group, GroupNumber, NestedMean, Sample
from labpipe.report.issues import Cause, Issue, Kind, decision_words, find_notes
from labpipe.report.wording import (
    as_label,
    display_of,
    heading,
    replace_names,
    shown_in,
    unit_words,
    write_number,
)

if TYPE_CHECKING:
    from markupsafe import Markup

DASH = "\u2013"


@dataclass(frozen=True, slots=True)
class Cell:
    """Contents of a cell.

    Parameters
    ----------
    text : large
    small : below it
    mark : behind the text: ``?`` for doubtful
    tip : sentence or code shown on hover
    sort : value by which the column is sorted, SI; None for the text
    drawing : in place of the text
    link : address on the page
    test : number of the test that the cell decides on, if any
    """

    text: str
    small: str = ""
    mark: str = ""
    tip: str = ""
    sort: float | None = None
    drawing: Markup | None = None
    link: str = ""
    test: int | None = None


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the page; the first cell of a row is its heading.

    Parameters
    ----------
    caption : title
    heads : one per column
    rows : cells
    notes : sentences below it
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def spool_mean_table(group: Group) -> Table:
    """Return the table of spool means and of the decisions how to average them.

    A text common to all decisions is written once, below the table.
    """
    spools = tuple(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    numbers = [number for number in group.numbers if number.mean is not None]
    decisions, shared = _decisions([number.mean for number in numbers if number.mean is not None])
    rows = [_spool_row(group, number, spools) for number in numbers]
    heads = ("Number", *(f"Spool {spool}" for spool in spools))
    title = f"{group.name}: spool means and their averaging"
    if not any(decisions):
        return Table(title, heads, tuple(rows), shared)
    ends = [Cell(decision or "As below.") for decision in decisions]
    decided = tuple((*row, end) for row, end in zip(rows, ends, strict=True))
    return Table(title, (*heads, "Decision"), decided, shared)


def _decisions(means: Sequence[NestedMean]) -> tuple[list[str], tuple[str, ...]]:
    """Split decisions into the clauses of each and those common to all."""
    clauses = [_clauses(mean.decision) for mean in means]
    shared = (
        [clause for clause in clauses[0] if all(clause in one for one in clauses)] if means else []
    )
    special = [_join_clauses([clause for clause in one if clause not in shared]) for one in clauses]
    if not any(special):
        return special, (_join_clauses(shared),) if shared else ()
    every = "; ".join(clause.removesuffix(":") for clause in shared)
    return special, (f"Every number: {every[0].lower()}{every[1:]}.",) if shared else ()


def _clauses(decision: Decision) -> list[str]:
    return [f"{decision.done}:", *decision.because] if decision.because else [decision.done]


def _join_clauses(clauses: Sequence[str]) -> str:
    joined = "; ".join(clauses).replace(":; ", ": ").removesuffix(":")
    return f"{joined[:1].upper()}{joined[1:]}." if joined else ""


def _spool_row(group: Group, number: GroupNumber, spools: Sequence[str]) -> tuple[Cell, ...]:
    unit = shown_in(number.name, number.unit, display_of(group))
    if number.mean is None:
        return ()
    cells = []
    for spool in spools:
        mean = number.mean.spool_means.get(spool)
        if mean is None:
            cells.append(Cell(DASH, "no number"))
            continue
        written = write_number(
            mean.mean, mean.interval, unit.factor, estimate=mean.distinct_estimate
        )
        cells.append(Cell(written.value, f"{written.interval} n = {mean.n}".strip()))
    return Cell(heading(number.name, unit.unit)), *cells


def slip_table(group: Group) -> Table | None:
    """Return the slip table of a group; None without slips."""
    display = display_of(group)
    across, up = shown_in("", "m", display), shown_in("", "N", display)
    rows = []
    for sample in group.samples:
        for slip in sample.slips:
            place = write_number(slip.position, slip.position_interval, across.factor)
            lost = write_number(slip.drop, slip.drop_interval, up.factor)
            decision = decision_words(slip.decision)
            cells = (
                Cell(place.value, place.interval),
                Cell(lost.value, lost.interval),
                Cell(decision),
            )
            rows.append((Cell(sample.test), *cells))
    heads = (
        "Sample",
        f"Displacement ({unit_words(across.unit)})",
        f"Force lost ({unit_words(up.unit)})",
        "Treatment",
    )
    return Table(f"{group.name}: slips in the grips", heads, tuple(rows)) if rows else None


_NO_METHOD = "No sample has this number."


_HEADINGS = {
    Kind.UNREADABLE: "Not read",
    Kind.REJECTED: "Rejected",
    Kind.UNLIKE: "Other processing",
    Kind.FAILED: "Failed",
    Kind.DOUBTFUL: "Doubtful",
    Kind.LEFT_OUT: "Left out",
    Kind.OUTLIER: "Outlier",
    Kind.SLIP: "Slips",
    Kind.WARNING: "Warning",
    Kind.NO_INTERVAL: "No interval",
    Kind.NOTE: "Note",
}
"""Short heading for the line of a cause."""


@dataclass(frozen=True, slots=True)
class Line:
    """A cause on the page: one line with its details.

    Parameters
    ----------
    head : kind of the cause
    reason : a sentence
    subject : test or group, or their number
    effect : on the number that it changes most; empty if unknown
    details : a row per issue with this cause
    """

    head: str
    reason: str
    subject: str
    effect: str
    details: Table


def cause_lines(causes: Sequence[Cause]) -> list[Line]:
    """Return a line for each cause.

    Parameters
    ----------
    causes : ranked
    """
    return [
        Line(
            _HEADINGS[cause.kind],
            cause.sentence,
            cause.subject,
            "" if cause.effect is None else cause.effect.text,
            Table(
                f"{cause.kind} ({len(cause.issues)})",
                ("Test", "What", "Why"),
                tuple(_issue_row(one) for one in cause.issues),
            ),
        )
        for cause in causes
    ]


def note_table(campaign: Campaign) -> Table | None:
    """Return the table of notes without consequences, a row per kind; None without notes."""
    rows = tuple(
        (
            Cell(note.issues[0].reason, tip=note.code),
            Cell(str(len(note.issues))),
            Cell(note.subject),
        )
        for note in find_notes(campaign)
    )
    heads = ("Note (first of its kind)", "Number", "Where")
    return Table("Notes without consequences", heads, rows) if rows else None


def _issue_row(issue: Issue) -> tuple[Cell, ...]:
    subject = issue.test or ", ".join(issue.tests) or "the whole group"
    why = Cell(issue.reason, tip=issue.code)
    return Cell(subject, issue.group), Cell(issue.what or DASH), why


def method_tables(campaign: Campaign) -> list[Table]:
    """Return a table per protocol of the methods of each number and its interval."""
    samples: dict[str, list[Sample]] = {}
    for group in campaign.groups:
        samples.setdefault(group.protocol, []).extend(group.samples)
    return [_method_table(protocol, chosen) for protocol, chosen in samples.items() if chosen]


def _method_table(protocol: str, samples: Sequence[Sample]) -> Table:
    methods: dict[str, dict[str, None]] = {}
    for sample in samples:
        for result in sample.results:
            methods_of_number = methods.setdefault(result.name, {})
            if result.method:
                methods_of_number[result.method] = None
    rows = tuple(
        (Cell(as_label(name), tip=name), Cell(replace_names("; ".join(method)) or _NO_METHOD))
        for name, method in methods.items()
    )
    return Table(f"Protocol {protocol}: method of each number", ("Number", "Method"), rows)
