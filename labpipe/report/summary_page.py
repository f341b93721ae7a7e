"""Page one of a report: verdicts, key numbers and open decisions on one screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Campaign, Group, GroupNumber, MeanInterval, Verdict
from labpipe.records.result import Result
from labpipe.report.comparisons import Pair, answer_cells, field_words, single_field_pairs
from labpipe.report.group_plots import first_loading
from labpipe.report.group_tables import DASH, Cell, Line, Table, cause_lines
from labpipe.report.issues import Cause, Kind
from labpipe.report.page_facts import PageTest, PageTests, samples_of
from labpipe.report.page_plots import mean_strip, sparkline
from labpipe.report.plot_thinning import simplify_line
from labpipe.report.wording import (
    count_of,
    display_of,
    heading,
    is_first_cycle,
    mean_with_interval,
    shown_in,
    with_interval,
)
from labpipe.statistics.group_fields import in_order

if TYPE_CHECKING:
    from markupsafe import Markup

_KINDS_TO_DECIDE = (Kind.FAILED, Kind.DOUBTFUL, Kind.OUTLIER)


@dataclass(frozen=True, slots=True)
class Answer:
    """Verdict on all pairs of groups that differ in one field.

    Parameters
    ----------
    field : that the groups differ in
    question : in words
    verdict : of a single pair; for several, the number of pairs per verdict
    difference : of the pair with the largest one
    counts : numbers of values of its means
    pairs : a row per pair
    """

    field: str
    question: str
    verdict: str
    difference: str
    counts: str
    pairs: Table


def answers(campaign: Campaign) -> list[Answer]:
    """Collect the verdicts on pairs of groups by field.

    Parameters
    ----------
    campaign : with its differences; the first main number of each pair is used
    """
    return [
        _answer(field, list(pairs))
        for field, pairs in groupby(single_field_pairs(campaign), key=lambda pair: pair.field)
    ]


def _answer(field: str, pairs: Sequence[Pair]) -> Answer:
    rows = tuple(answer_cells(pair) for pair in pairs)
    largest = max(range(len(pairs)), key=lambda number: _rank_of_pair(pairs[number]))
    verdicts = Counter(pair.differences[0].verdict for pair in pairs)
    if len(pairs) == 1:
        question, verdict = rows[0][0].text, rows[0][1].text
    else:
        every = {word for pair in pairs for word in pair.differences[0].fields[field]}
        values = sorted(every, key=lambda word: in_order(field, word))
        question = f"{field_words(field)}: {', '.join(values)}"
        verdict = ", ".join(f"{str(verdict_kind).upper()} {verdicts[verdict_kind]}"
                            for verdict_kind in Verdict if verdicts[verdict_kind])  # fmt: skip
    of_several = f", largest of {len(pairs)} pairs" if len(pairs) > 1 else ""
    table = Table("", ("Comparison", "Verdict", "Difference (95 %, corrected)", "n"), rows)
    counts = rows[largest][3].text
    return Answer(field, question, verdict, rows[largest][2].text + of_several, counts, table)


def _rank_of_pair(pair: Pair) -> tuple[bool, float]:
    """Rank a pair: differing pairs first, then by the size of the difference."""
    difference = pair.differences[0]
    size = difference.share if difference.share is not None else difference.difference.mean
    return difference.verdict is Verdict.DIFFERENT, abs(size) if isfinite(size) else 0.0


@dataclass(frozen=True, slots=True)
class KeyRow:
    """A group on the first screen.

    Parameters
    ----------
    name, stem : the stem is used in links
    n : samples
    strip : drawing of the first number with its interval, if any
    numbers : cells
    sparkline : drawing of its curves, if any
    """

    name: str
    stem: str
    n: int
    strip: Markup | None
    numbers: tuple[Cell, ...]
    sparkline: Markup | None


@dataclass(frozen=True, slots=True)
class KeyBlock:
    """The groups of a protocol.

    Parameters
    ----------
    heads : of its key numbers
    rows : one per group
    """

    heads: tuple[str, ...]
    rows: tuple[KeyRow, ...]


def key_blocks(campaign: Campaign, stems: Sequence[str]) -> list[KeyBlock]:
    """Return the key numbers of each group by protocol.

    Parameters
    ----------
    campaign : with the main numbers of the protocol first in each group
    stems : of its groups
    """
    by_protocol: dict[str, list[tuple[Group, str]]] = {}
    for group, stem in zip(campaign.groups, stems, strict=True):
        by_protocol.setdefault(group.protocol, []).append((group, stem))
    return [_key_block(protocol_groups) for protocol_groups in by_protocol.values()]


def _key_block(groups: Sequence[tuple[Group, str]]) -> KeyBlock:
    every = [
        (number, group)
        for group, _ in groups
        for number in group.numbers
        if is_first_cycle(number.name) and not number.is_set_by_rig
    ]
    numbers_by_name = {number.name: (number, group) for number, group in reversed(every)}
    names = list(dict.fromkeys(number.name for number, _ in every))[:3]
    heads = tuple(_heading(*numbers_by_name[name]) for name in names)
    ends = _ends([first for group, _ in groups if (first := _number(group, names[:1])) is not None])
    rows = tuple(_key_row(group, stem, names, ends) for group, stem in groups)
    return KeyBlock(heads, rows)


def _heading(number: GroupNumber, group: Group) -> str:
    return heading(number.name, shown_in(number.name, number.unit, display_of(group)).unit)


def _number(group: Group, names: Sequence[str]) -> GroupNumber | None:
    return next((number for number in group.numbers if number.name in names), None)


def _ends(numbers: Sequence[GroupNumber]) -> tuple[float, float]:
    """Return the scale of a column: full means, intervals only as far as the means stay apart."""
    chosen = [number.mean.chosen for number in numbers if number.mean is not None]
    means = [mean.mean for mean in chosen] or [0.0, 1.0]
    ends = [end for mean in chosen if mean.interval is not None
            for end in (mean.interval.lower, mean.interval.upper) if isfinite(end)]  # fmt: skip
    low, high = min(means), max(means)
    room = (high - low) or 0.5 * abs(high) or 1.0
    return max(min([low, *ends]), low - room), min(max([high, *ends]), high + room)


def _key_row(group: Group, stem: str, names: Sequence[str], ends: tuple[float, float]) -> KeyRow:
    first = _number(group, names[:1])
    drawn = None
    if first is not None and first.mean is not None:
        source, _ = _interval_source(first.mean.chosen, first)
        drawn = mean_strip(ends, source.interval, first.mean.chosen.mean)
    numbers = tuple(_key_cell(group, name) for name in names)
    return KeyRow(group.name, stem, len(group.samples), drawn, numbers, _group_sparkline(group))


def _key_cell(group: Group, name: str) -> Cell:
    number = _number(group, [name])
    if number is None or number.mean is None:
        return Cell(DASH, tip="no sample has this number")
    factor = shown_in(name, number.unit, display_of(group)).factor
    chosen = number.mean.chosen
    source, whose = _interval_source(chosen, number)
    tip = (
        whose
        if source.distinct_estimate is None
        else f"interval of the {_estimate_text(chosen, factor)}"
    )
    return Cell(with_interval(chosen.mean, source.interval, factor), tip=tip)


def _interval_source(mean: MeanInterval, number: GroupNumber) -> tuple[MeanInterval | Result, str]:
    """Return the mean or the single test that has the interval of a number, and a note on it."""
    if mean.interval is None and len(number.values) == 1:
        return next(iter(number.values.values())), "one test: uncertainty of its measurement"
    return mean, ""


def _estimate_text(mean: MeanInterval, factor: float) -> str:
    """Write the estimate that differs from a mean, such as ``estimate 1.23``."""
    return mean_with_interval(mean, factor).partition("(")[2].partition(",")[0]


def _group_sparkline(group: Group) -> Markup | None:
    band = group.band
    if len(band.displacement) and band.n > 1:
        return sparkline([_spark_points(band.displacement, band.mean)])
    first = next(
        (curve for sample in group.samples if (curve := first_loading(sample)) is not None), None
    )
    return None if first is None else sparkline([_spark_points(first.displacement, first.force)])


def _spark_points(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    rows = simplify_line(x, y, points=24, tolerance=0.01)
    return np.asarray(x[rows]), np.asarray(y[rows])


@dataclass(frozen=True, slots=True)
class OpenDecision:
    """A cause that requires a decision.

    Parameters
    ----------
    line : the cause, with its sentence and effect
    tests : affected and not yet decided
    """

    line: Line
    tests: tuple[PageTest, ...]


def open_decisions(causes: Sequence[Cause], tests: PageTests) -> list[OpenDecision]:
    """List the causes that require a decision: doubtful, failed, marked as outliers.

    Parameters
    ----------
    causes : ranked
    tests : decided ones are left out
    """
    decisions = []
    for cause in causes:
        if cause.kind in _KINDS_TO_DECIDE:
            undecided = tuple(dict.fromkeys(_undecided(cause, tests)))
            if undecided:
                (line,) = cause_lines([cause])
                decisions.append(OpenDecision(line, undecided))
    return decisions


def _undecided(cause: Cause, tests: PageTests) -> Iterator[PageTest]:
    for issue in cause.issues:
        test = tests.by_name.get(issue.test)
        if test is not None and not test.sample.decided:
            yield test


def count_words(campaign: Campaign, open_ones: Sequence[OpenDecision]) -> str:
    """Count tests and open decisions, such as ``24 tests · 1 rejected · 2 to decide``."""
    tests = len(samples_of(campaign))
    undecided = len({test.number for open_one in open_ones for test in open_one.tests})
    parts = [
        count_of(tests, "test"),
        f"{len(campaign.rejected)} rejected",
        *([f"{len(campaign.left_out)} not read"] if campaign.left_out else []),
        f"{undecided} to decide",
    ]
    return " \u00b7 ".join(parts)


@dataclass(frozen=True, slots=True)
class Folds:
    """Numbers of lines of each part on the first screen; further lines are folded.

    Parameters
    ----------
    answers, groups, decisions : lines
    """

    answers: int
    groups: int
    decisions: int


def fold(answered: int, blocks: Sequence[KeyBlock], decisions: int) -> Folds:
    """Return the numbers of lines of each part that fit on the first screen.

    Parameters
    ----------
    answered, decisions : available lines
    blocks : of groups
    """
    max_answers, max_decisions = 8, 4
    # pixels, of a screen of 900
    screen_height, row_height, group_height, decision_height = 690, 24, 21, 54
    answers, open_ones = min(answered, max_answers), min(decisions, max_decisions)
    other_lines = 1 + len(blocks) + (answered > answers) + (decisions > 0) + (decisions > open_ones)
    room = screen_height - row_height * (answers + other_lines) - decision_height * open_ones
    return Folds(answers, max(room // group_height, 3), open_ones)
