"""The tables of a report: of each group, and of the whole campaign."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labpipe.records.group import Campaign, Decision, Group, GroupNumber, NestedMean, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.concerns import (
    Concern,
    Kind,
    decision_words,
    sentence,
    sentences,
)
from labpipe.report.ranked_causes import Cause, find_notes
from labpipe.report.wording import (
    count_of,
    display_of,
    heading,
    in_words,
    shown_in,
    unit_words,
    with_names_in_words,
    write_mean,
    write_number,
)

if TYPE_CHECKING:
    from markupsafe import Markup

DASH = "\u2013"
_COLUMNS = 4
"""Numbers side by side in a table of samples: as many as a page and a phone can take."""


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


_KEY_NUMBERS = 3
"""Numbers of a group that stand at the top of a page."""


def key_number_tables(campaign: Campaign) -> list[Table]:
    """Make a table for each protocol: a row per group, its first numbers with their intervals.

    Parameters
    ----------
    campaign : in its groups, what the protocol calls main comes first
    """
    protocols = dict.fromkeys(group.protocol for group in campaign.groups if group.numbers)
    return [
        _key_numbers(each, [group for group in campaign.groups if group.protocol == each])
        for each in protocols
    ]


def _key_numbers(protocol: str, groups: Sequence[Group]) -> Table:
    every = [each for group in groups for each in group.numbers if _is_key(each)]
    shown = list(dict.fromkeys(each.name for each in every))[:_KEY_NUMBERS]
    heads = [_key_heading(name, groups) for name in shown]
    rows = tuple(
        (_group_cell(group), *(_key_cell(group, name) for name in shown)) for group in groups
    )
    return Table(f"Key numbers ({protocol})", ("Group", *heads), rows)


def _is_key(number: GroupNumber) -> bool:
    """Of the specimen, and of the first cycle where there are several."""
    return not number.is_set_by_rig and number.name.partition(".")[2] in {"", "1"}


def _key_heading(name: str, groups: Sequence[Group]) -> str:
    group, number = next(
        (group, each) for group in groups for each in group.numbers if each.name == name
    )
    return heading(name, shown_in(name, number.unit, display_of(group)).unit)


def _group_cell(group: Group) -> Cell:
    return Cell(group.name, f"n = {len(group.samples)}")


def _key_cell(group: Group, name: str) -> Cell:
    number = next((each for each in group.numbers if each.name == name), None)
    if number is None or number.mean is None:
        return Cell(DASH)
    factor = shown_in(name, number.unit, display_of(group)).factor
    chosen = number.mean.chosen
    written = write_mean(chosen, factor, number.mean.spool_means.values())
    fewer = "" if chosen.n == len(group.samples) else f"over {_over(number)}"
    return Cell(written.value, "; ".join(filter(None, (written.interval, fewer))))


def means_of(group: Group) -> Table:
    """Make the table of means: interval, what was averaged, standard deviation."""
    rows = tuple(_mean_row(group, each) for each in group.numbers)
    heads = ("Number", "Mean", "95 % interval", "Mean over", "Standard deviation")
    notes = (*_no_intervals(group), *_why_so_wide(group))
    return Table(f"{group.name}: means", heads, rows, notes)


def _why_so_wide(group: Group) -> Iterator[str]:
    """Why a mean over two spool means is so unsure, and what would help."""
    if any(_is_over_two_spools(each) for each in group.numbers):
        yield (
            "Intervals over two spool means are wide because two values leave one degree of"
            " freedom, where Student's t is 12.7. More samples of these spools would hardly help;"
            " a third spool brings t down to 4.3, a fourth to 3.2."
        )


def _is_over_two_spools(number: GroupNumber) -> bool:
    mean = number.mean
    return mean is not None and not mean.is_pooled and mean.chosen.n == 2


def _no_intervals(group: Group) -> tuple[str, ...]:
    """Why means have no interval; those that share a reason stand together."""
    reasons: dict[Reason, list[str]] = {}
    for each in group.numbers:
        if each.mean is not None and each.mean.chosen.reason:
            reasons.setdefault(each.mean.chosen.reason, []).append(in_words(each.name))
    return tuple(
        f"No interval: {sentence(why.message)} ({'; '.join(names)})"
        for why, names in reasons.items()
    )


def _mean_row(group: Group, number: GroupNumber) -> tuple[Cell, ...]:
    shown = shown_in(number.name, number.unit, display_of(group))
    head = Cell(heading(number.name, shown.unit), number.name)
    if number.mean is None:
        return head, Cell(DASH), Cell(DASH), Cell("no sample has it"), Cell(DASH)
    chosen = number.mean.chosen
    written = write_mean(chosen, shown.factor, number.mean.spool_means.values())
    deviation = write_number(chosen.deviation, None, shown.factor, digits=3)
    return (
        head,
        Cell(written.value),
        Cell(written.interval or DASH),
        Cell(_over(number), "; ".join(filter(None, (_missing(number), _set_words(number))))),
        Cell(deviation.value),
    )


def _over(number: GroupNumber) -> str:
    mean = number.mean
    if mean is None:
        return DASH
    return count_of(mean.chosen.n, "sample" if mean.is_pooled else "spool mean")


def _set_words(number: GroupNumber) -> str:
    return "set by the rig: no outliers are looked for" if number.is_set_by_rig else ""


def _missing(number: GroupNumber) -> str:
    return f"without {', '.join(number.left_out)}" if number.left_out else ""


def spool_means(group: Group) -> Table:
    """Make the table of spool means, with the decision how to average them in words.

    What all decisions have in common stands once, below the table.
    """
    spools = tuple(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    own = [each for each in group.numbers if each.mean is not None]
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
    shared = [each for each in clauses[0] if all(each in own for own in clauses)] if means else []
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
        written = write_mean(mean, shown.factor)
        cells.append(Cell(written.value, f"{written.interval} n = {mean.n}".strip()))
    return Cell(heading(number.name, shown.unit)), *cells


def sample_tables(group: Group) -> list[Table]:
    """Make tables with a row per sample and a column per number, a few numbers in each."""
    own = list(group.numbers)
    parts = [own[start : start + _COLUMNS] for start in range(0, len(own), _COLUMNS)]
    return [_sample_table(group, part, len(parts), at) for at, part in enumerate(parts, start=1)]


def _sample_table(group: Group, numbers: list[GroupNumber], parts: int, at: int) -> Table:
    display = display_of(group)
    shown = [shown_in(number.name, number.unit, display) for number in numbers]
    heads = [heading(number.name, scale.unit) for number, scale in zip(numbers, shown, strict=True)]
    rows = tuple(_sample_row(group, sample, numbers) for sample in group.samples)
    which = f", part {at} of {parts}" if parts > 1 else ""
    notes = tuple(dict.fromkeys(_sample_notes(group, numbers)))
    return Table(f"{group.name}: every sample{which}", ("Sample", *heads), rows, notes)


def _sample_row(group: Group, sample: Sample, numbers: list[GroupNumber]) -> tuple[Cell, ...]:
    specimen = sample.specimen
    head = Cell(sample.test, f"spool {specimen.spool}, sample {specimen.sample}")
    display = display_of(group)
    results = {result.name: result for result in sample.results}
    cells = []
    for number in numbers:
        shown = shown_in(number.name, number.unit, display)
        cells.append(_result_cell(results.get(number.name), shown.factor))
    return head, *cells


def _result_cell(result: Result | None, factor: float) -> Cell:
    if result is None:
        return Cell(DASH, "not asked for")
    if result.value is None:
        return Cell(DASH, result.reasons[0].code.replace("_", " "))
    written = write_number(result.value, result.interval, factor, apart=result.apart)
    mark = "?" if result.status is Status.DOUBTFUL else ""
    return Cell(written.value, written.interval, mark)


def _sample_notes(group: Group, numbers: list[GroupNumber]) -> Iterator[str]:
    names = {number.name for number in numbers}
    for sample in group.samples:
        for result in sample.results:
            if result.name in names and result.status is not Status.OK:
                sign = DASH if result.status is Status.FAILED else "?"
                yield f"{sign} {sample.test}: {sentences(result.reasons)}"


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
    whom: str
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
            _HEADINGS[each.kind],
            each.sentence,
            each.whom,
            "" if each.effect is None else each.effect.words,
            Table(
                f"{each.kind} ({len(each.concerns)})",
                ("Test", "What", "Why"),
                tuple(_concern_row(one) for one in each.concerns),
            ),
        )
        for each in causes
    ]


def note_table(campaign: Campaign) -> Table | None:
    """Make the table of notes of which nothing follows, a row for each kind; None without any."""
    rows = tuple(
        (
            Cell(each.code),
            Cell(str(len(each.concerns))),
            Cell(each.whom),
            Cell(each.concerns[0].reason),
        )
        for each in find_notes(campaign)
    )
    heads = ("Note", "How many", "Where", "The first")
    return Table("Notes of which nothing follows", heads, rows) if rows else None


def _concern_row(concern: Concern) -> tuple[Cell, ...]:
    whom = concern.test or ", ".join(concern.tests) or "the whole group"
    return Cell(whom, concern.group), Cell(concern.what or DASH), Cell(concern.reason, concern.code)


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
        (Cell(in_words(name), name), Cell(with_names_in_words("; ".join(each)) or _NO_METHOD))
        for name, each in methods.items()
    )
    return Table(f"Protocol {protocol}: how each number was made", ("Number", "Method"), rows)


def table_of_tests(campaign: Campaign) -> Table:
    """Make the list of tests: what was tested, by which protocol, where the result is."""
    rows = []
    for group in campaign.groups:
        across = shown_in("", "m", display_of(group))
        for sample in group.samples:
            sizes = ", ".join(
                f"{name.replace('_', ' ')} {across.factor * size:.4g} {unit_words(across.unit)}"
                for name, size in sample.specimen.dimensions.items()
            )
            specimen = sample.specimen
            rows.append(
                (
                    Cell(sample.test),
                    Cell(specimen.type, f"spool {specimen.spool}, sample {specimen.sample}"),
                    Cell(sizes or DASH),
                    Cell(sample.protocol),
                    Cell(sample.source or DASH),
                )
            )
    heads = ("Test", "Specimen", "Dimensions", "Protocol", "Read from")
    return Table("Tests in this report", heads, tuple(rows))
