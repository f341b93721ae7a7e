"""Page one of a report: answers, key numbers, what is to be decided; all on one screen."""

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
from labpipe.report.comparisons import Pair, answer_cells, answering_pairs, field_words
from labpipe.report.group_plots import first_loading
from labpipe.report.group_tables import DASH, Cell, Line, Table, cause_lines
from labpipe.report.issue_ranking import Cause
from labpipe.report.issues import Kind
from labpipe.report.page_facts import PageTest, PageTests, samples_of
from labpipe.report.page_numbers import mean_with_interval, with_interval
from labpipe.report.page_plots import sparkline, strip
from labpipe.report.plot_thinning import bends
from labpipe.report.wording import count_of, display_of, heading, shown_in
from labpipe.statistics.group_fields import in_order

if TYPE_CHECKING:
    from markupsafe import Markup

_KEY_NUMBERS = 3
"""Numbers of a group on the first screen."""
_SPARK_POINTS = 24
_MOST_ANSWERS, _MOST_DECISIONS = 8, 4
_ROOM, _ROW, _ROW_OF_GROUP, _ROW_OF_DECISION = 690, 24, 21, 54
"""Points of a screen of 900 for answers, groups and decisions, and for a line of each."""
_TO_DECIDE = (Kind.FAILED, Kind.DOUBTFUL, Kind.OUTLIER)


@dataclass(frozen=True, slots=True)
class Answer:
    """All pairs of groups that answer one question.

    Parameters
    ----------
    field : that the groups differ in
    question : in words
    verdict : of the only pair; of several, how many pairs have which
    difference : of the pair with the largest one
    counts : values behind each of its means
    pairs : one row each
    """

    field: str
    question: str
    verdict: str
    difference: str
    counts: str
    pairs: Table


def answers(campaign: Campaign) -> list[Answer]:
    """Fold the pairs of groups by the question that they answer.

    Parameters
    ----------
    campaign : with its differences; the first main number of each pair counts
    """
    return [
        _answer(field, list(pairs))
        for field, pairs in groupby(answering_pairs(campaign), key=lambda pair: pair.field)
    ]


def _answer(field: str, pairs: Sequence[Pair]) -> Answer:
    rows = tuple(answer_cells(pair) for pair in pairs)
    largest = max(range(len(pairs)), key=lambda at: _weight(pairs[at]))
    verdicts = Counter(pair.differences[0].verdict for pair in pairs)
    if len(pairs) == 1:
        question, verdict = rows[0][0].text, rows[0][1].text
    else:
        every = {word for pair in pairs for word in pair.differences[0].fields[field]}
        words = sorted(every, key=lambda word: in_order(field, word))
        question = f"{field_words(field)}: {', '.join(words)}"
        verdict = ", ".join(f"{str(each).upper()} {verdicts[each]}"
                            for each in Verdict if verdicts[each])  # fmt: skip
    of_several = f", largest of {len(pairs)} pairs" if len(pairs) > 1 else ""
    table = Table("", ("Question", "Answer", "Difference (95 %, corrected)", "n"), rows)
    counts = rows[largest][3].text
    return Answer(field, question, verdict, rows[largest][2].text + of_several, counts, table)


def _weight(pair: Pair) -> tuple[bool, float]:
    """Pairs that differ before others, then by the size of the difference."""
    asked = pair.differences[0]
    size = asked.share if asked.share is not None else asked.difference.mean
    return asked.verdict is Verdict.DIFFERENT, abs(size) if isfinite(size) else 0.0


@dataclass(frozen=True, slots=True)
class KeyRow:
    """A group on the first screen.

    Parameters
    ----------
    name, stem : and the name in links
    n : samples
    strip : the first number with its interval, on the scale of its column; None for none
    numbers : cells
    sparkline : its curves; None without any
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
    """Make the key numbers of each group, protocol by protocol.

    Parameters
    ----------
    campaign : in its groups, what the protocol calls main comes first
    stems : of its groups
    """
    by_protocol: dict[str, list[tuple[Group, str]]] = {}
    for group, stem in zip(campaign.groups, stems, strict=True):
        by_protocol.setdefault(group.protocol, []).append((group, stem))
    return [_key_block(own) for own in by_protocol.values()]


def _key_block(groups: Sequence[tuple[Group, str]]) -> KeyBlock:
    every = [(number, group) for group, _ in groups for number in group.numbers if _is_key(number)]
    found = {number.name: (number, group) for number, group in reversed(every)}
    names = list(dict.fromkeys(number.name for number, _ in every))[:_KEY_NUMBERS]
    heads = tuple(_heading(*found[name]) for name in names)
    ends = _ends([own for group, _ in groups if (own := _number(group, names[:1])) is not None])
    rows = tuple(_key_row(group, stem, names, ends) for group, stem in groups)
    return KeyBlock(heads, rows)


def _is_key(number: GroupNumber) -> bool:
    """Of the specimen, and of the first cycle where there are several."""
    return not number.is_set_by_rig and number.name.partition(".")[2] in {"", "1"}


def _heading(number: GroupNumber, group: Group) -> str:
    return heading(number.name, shown_in(number.name, number.unit, display_of(group)).unit)


def _number(group: Group, names: Sequence[str]) -> GroupNumber | None:
    return next((number for number in group.numbers if number.name in names), None)


def _ends(numbers: Sequence[GroupNumber]) -> tuple[float, float]:
    """Scale of a column: all means in full, intervals as far as they leave the means apart."""
    chosen = [number.mean.chosen for number in numbers if number.mean is not None]
    means = [each.mean for each in chosen] or [0.0, 1.0]
    ends = [end for each in chosen if each.interval is not None
            for end in (each.interval.lower, each.interval.upper) if isfinite(end)]  # fmt: skip
    low, high = min(means), max(means)
    room = (high - low) or 0.5 * abs(high) or 1.0
    return max(min([low, *ends]), low - room), min(max([high, *ends]), high + room)


def _key_row(group: Group, stem: str, names: Sequence[str], ends: tuple[float, float]) -> KeyRow:
    first = _number(group, names[:1])
    drawn = None
    if first is not None and first.mean is not None:
        shown, _ = _shown(first.mean.chosen, first)
        drawn = strip(ends, shown.interval, first.mean.chosen.mean)
    numbers = tuple(_key_cell(group, name) for name in names)
    return KeyRow(group.name, stem, len(group.samples), drawn, numbers, _spark(group))


def _key_cell(group: Group, name: str) -> Cell:
    number = _number(group, [name])
    if number is None or number.mean is None:
        return Cell(DASH, tip="no sample has it")
    factor = shown_in(name, number.unit, display_of(group)).factor
    chosen = number.mean.chosen
    shown, whose = _shown(chosen, number)
    tip = whose if shown.apart is None else f"interval of the {_estimate(chosen, factor)}"
    return Cell(with_interval(chosen.mean, shown.interval, factor), tip=tip)


def _shown(mean: MeanInterval, number: GroupNumber) -> tuple[MeanInterval | Result, str]:
    """What has the interval of a number: the mean, or the only test of a group, and whose it is."""
    if mean.interval is None and len(number.values) == 1:
        return next(iter(number.values.values())), "one test: how well it was measured"
    return mean, ""


def _estimate(mean: MeanInterval, factor: float) -> str:
    """The estimate that stands apart from a mean, such as ``estimate 1.23``."""
    return mean_with_interval(mean, factor).partition("(")[2].partition(",")[0]


def _spark(group: Group) -> Markup | None:
    band = group.band
    if len(band.displacement) and band.n > 1:
        return sparkline([_thinned(band.displacement, band.mean)])
    first = next(
        (own for sample in group.samples if (own := first_loading(sample)) is not None), None
    )
    return None if first is None else sparkline([_thinned(first.displacement, first.force)])


def _thinned(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    kept = bends(x, y, points=_SPARK_POINTS, tolerance=0.01)
    return np.asarray(x[kept]), np.asarray(y[kept])


@dataclass(frozen=True, slots=True)
class OpenDecision:
    """A cause that somebody has to decide on.

    Parameters
    ----------
    line : the cause, with its sentence and effect
    tests : it touches that are not decided yet
    """

    line: Line
    tests: tuple[PageTest, ...]


def to_decide(causes: Sequence[Cause], tests: PageTests) -> list[OpenDecision]:
    """List the causes that are for a person to decide: doubtful, failed, marked as outliers.

    Parameters
    ----------
    causes : ranked
    tests : those of them that somebody decided on are left out
    """
    found = []
    for cause in causes:
        if cause.kind in _TO_DECIDE:
            own = tuple(dict.fromkeys(_undecided(cause, tests)))
            if own:
                (line,) = cause_lines([cause])
                found.append(OpenDecision(line, own))
    return found


def _undecided(cause: Cause, tests: PageTests) -> Iterator[PageTest]:
    for concern in cause.concerns:
        test = tests.by_name.get(concern.test)
        if test is not None and not test.sample.decided:
            yield test


def count_words(campaign: Campaign, open_ones: Sequence[OpenDecision]) -> str:
    """Count what is on the page, such as ``24 tests · 1 rejected · 2 to decide``."""
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
    """How many lines of each part the first screen holds; the rest is folded.

    Parameters
    ----------
    answers, groups, decisions : lines
    """

    answers: int
    groups: int
    decisions: int


def fold(answered: int, blocks: Sequence[KeyBlock], decisions: int) -> Folds:
    """Find how many lines of each part go on the first screen.

    Parameters
    ----------
    answered, decisions : lines that there are
    blocks : of groups
    """
    shown, open_ones = min(answered, _MOST_ANSWERS), min(decisions, _MOST_DECISIONS)
    other_lines = 1 + len(blocks) + (answered > shown) + (decisions > 0) + (decisions > open_ones)
    room = _ROOM - _ROW * (shown + other_lines) - _ROW_OF_DECISION * open_ones
    return Folds(shown, max(room // _ROW_OF_GROUP, 3), open_ones)
