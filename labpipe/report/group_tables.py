"""The tables of a report: of each group, and of the whole campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labpipe.records.group import Campaign, Decision, Group, GroupNumber, NestedMean, Sample
from labpipe.report.issue_ranking import Cause, find_notes
from labpipe.report.issues import (
    Issue,
    Kind,
    decision_words,
)
from labpipe.report.wording import (
    display_of,
    heading,
    in_words,
    shown_in,
    unit_words,
    with_names_in_words,
    write_number,
)

if TYPE_CHECKING:
    from markupsafe import Markup

DASH = "\u2013"


@dataclass(frozen=True, slots=True)
class Cell:
    """What stands in a cell.

    Parameters
    ----------
    text : large
    small : below it
    mark : behind it: ``?`` for doubtful
    tip : sentence or code that is shown when somebody points at it
    sort : what the column is sorted by, in SI; None for the text
    drawing : in place of the text
    link : address on the page
    test : number of the test that it decides on; None for none
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
    caption : what it shows
    heads : one per column
    rows : cells
    notes : sentences below it
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def spool_means(group: Group) -> Table:
    """Make the table of spool means, with the decision how to average them in words.

    What all decisions have in common stands once, below the table.
    """
    spools = tuple(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    own = [number for number in group.numbers if number.mean is not None]
    decisions, shared = _decisions([each.mean for each in own if each.mean is not None])
    rows = [_spool_row(group, each, spools) for each in own]
    heads = ("Number", *(f"Spool {spool}" for spool in spools))
    title = f"{group.name}: spool means, and how they are averaged"
    if not any(decisions):
        return Table(title, heads, tuple(rows), shared)
    ends = [Cell(decision or "As below.") for decision in decisions]
    decided = tuple((*row, end) for row, end in zip(rows, ends, strict=True))
    return Table(title, (*heads, "Decision"), decided, shared)


def _decisions(means: Sequence[NestedMean]) -> tuple[list[str], tuple[str, ...]]:
    """What is special in each decision, and what is said in all of them."""
    clauses = [_clauses(mean.decision) for mean in means]
    shared = (
        [clause for clause in clauses[0] if all(clause in own for own in clauses)] if means else []
    )
    special = [_sentence([each for each in own if each not in shared]) for own in clauses]
    if not any(special):
        return special, (_sentence(shared),) if shared else ()
    every = "; ".join(clause.removesuffix(":") for clause in shared)
    return special, (f"Every number: {every[0].lower()}{every[1:]}.",) if shared else ()


def _clauses(decision: Decision) -> list[str]:
    return [f"{decision.done}:", *decision.because] if decision.because else [decision.done]


def _sentence(clauses: Sequence[str]) -> str:
    joined = "; ".join(clauses).replace(":; ", ": ").removesuffix(":")
    return f"{joined[:1].upper()}{joined[1:]}." if joined else ""


def _spool_row(group: Group, number: GroupNumber, spools: Sequence[str]) -> tuple[Cell, ...]:
    shown = shown_in(number.name, number.unit, display_of(group))
    if number.mean is None:
        return ()
    cells = []
    for spool in spools:
        mean = number.mean.spool_means.get(spool)
        if mean is None:
            cells.append(Cell(DASH, "no number"))
            continue
        written = write_number(mean.mean, mean.interval, shown.factor, apart=mean.apart)
        cells.append(Cell(written.value, f"{written.interval} n = {mean.n}".strip()))
    return Cell(heading(number.name, shown.unit)), *cells


def slip_table(group: Group) -> Table | None:
    """Make the slip ledger of a group; None where nothing slipped."""
    display = display_of(group)
    across, up = shown_in("", "m", display), shown_in("", "N", display)
    rows = []
    for sample in group.samples:
        for slip in sample.slips:
            at = write_number(slip.position, slip.position_interval, across.factor)
            lost = write_number(slip.drop, slip.drop_interval, up.factor)
            words = decision_words(slip.decision)
            cells = Cell(at.value, at.interval), Cell(lost.value, lost.interval), Cell(words)
            rows.append((Cell(sample.test), *cells))
    heads = (
        "Sample",
        f"Displacement ({unit_words(across.unit)})",
        f"Force lost ({unit_words(up.unit)})",
        "What was done",
    )
    return Table(f"{group.name}: slips in the grips", heads, tuple(rows)) if rows else None


_NO_METHOD = "No sample has this number."


_HEADINGS = {
    Kind.UNREADABLE: "Not read",
    Kind.REJECTED: "Rejected",
    Kind.UNLIKE: "Not alike",
    Kind.FAILED: "Failed",
    Kind.DOUBTFUL: "Doubtful",
    Kind.LEFT_OUT: "Left out",
    Kind.OUTLIER: "Outlier",
    Kind.SLIP: "Slips",
    Kind.WARNING: "Warning",
    Kind.NO_INTERVAL: "No interval",
    Kind.NOTE: "Note",
}
"""One word or two for the line of a cause."""


@dataclass(frozen=True, slots=True)
class Line:
    """A cause on the page: one line, and what folds out of it.

    Parameters
    ----------
    head : kind of the cause
    said : its reason, a sentence
    whom : which test or group, or how many
    effect : on the number that it moves most; empty where that is not known
    details : a row for each that shares the cause
    """

    head: str
    said: str
    subject: str
    effect: str
    details: Table


def cause_lines(causes: Sequence[Cause]) -> list[Line]:
    """Make a line for each cause.

    Parameters
    ----------
    causes : ranked
    """
    return [
        Line(
            _HEADINGS[cause.kind],
            cause.sentence,
            cause.subject,
            "" if cause.effect is None else cause.effect.words,
            Table(
                f"{cause.kind} ({len(cause.concerns)})",
                ("Test", "What", "Why"),
                tuple(_concern_row(one) for one in cause.concerns),
            ),
        )
        for cause in causes
    ]


def note_table(campaign: Campaign) -> Table | None:
    """Make the table of notes of which nothing follows, a row for each kind; None without any."""
    rows = tuple(
        (
            Cell(note.concerns[0].reason, tip=note.code),
            Cell(str(len(note.concerns))),
            Cell(note.subject),
        )
        for note in find_notes(campaign)
    )
    heads = ("Note, the first of its kind", "How many", "Where")
    return Table("Notes of which nothing follows", heads, rows) if rows else None


def _concern_row(concern: Issue) -> tuple[Cell, ...]:
    subject = concern.test or ", ".join(concern.tests) or "the whole group"
    why = Cell(concern.reason, tip=concern.code)
    return Cell(subject, concern.group), Cell(concern.what or DASH), why


def method_tables(campaign: Campaign) -> list[Table]:
    """Make a table per protocol that says how each number and its interval were made."""
    samples: dict[str, list[Sample]] = {}
    for group in campaign.groups:
        samples.setdefault(group.protocol, []).extend(group.samples)
    return [_method_table(protocol, own) for protocol, own in samples.items() if own]


def _method_table(protocol: str, samples: Sequence[Sample]) -> Table:
    methods: dict[str, dict[str, None]] = {}
    for sample in samples:
        for result in sample.results:
            known = methods.setdefault(result.name, {})
            if result.method:
                known[result.method] = None
    rows = tuple(
        (Cell(in_words(name), tip=name), Cell(with_names_in_words("; ".join(method)) or _NO_METHOD))
        for name, method in methods.items()
    )
    return Table(f"Protocol {protocol}: how each number was made", ("Number", "Method"), rows)
