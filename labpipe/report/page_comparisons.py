"""Comparisons on the page: mean curves and main number of groups that differ in one field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import isfinite

import numpy as np

from labpipe.records.group import Band, Campaign, Group, GroupNumber
from labpipe.report.comparison_figures import main_number
from labpipe.report.comparisons import (
    Family,
    Pair,
    answer_cells,
    context_words,
    families,
    field_words,
    question_table,
    single_field_pairs,
)
from labpipe.report.group_panels import COLOURS, band_lines, mean_lines
from labpipe.report.group_plots import group_scale
from labpipe.report.group_tables import Table
from labpipe.report.page_plots import Axis, Key, Line, Plot, axis_over
from labpipe.report.wording import as_label, count_of, display_of, shown_in, unit_words


@dataclass(frozen=True, slots=True)
class Comparison:
    """Groups that differ from each other in one field alone.

    Parameters
    ----------
    heading : common fields
    plots : mean curves, and the main number of each
    """

    heading: str
    plots: tuple[Plot, ...]


@dataclass(frozen=True, slots=True)
class Question:
    """Comparisons of a campaign in one field.

    Parameters
    ----------
    field : name
    name : in words
    answers : a row per pair: the first main number
    comparisons : with plots
    tables : of each pair, all main numbers
    notes : caveats against the comparison, each once
    """

    field: str
    name: str
    answers: Table
    comparisons: tuple[Comparison, ...]
    tables: tuple[Table, ...]
    notes: tuple[str, ...]


def questions(campaign: Campaign, stems: Mapping[str, str]) -> list[Question]:
    """Return the comparisons of groups that differ in one field, field by field.

    Parameters
    ----------
    campaign : with its differences
    stems : names of groups in links, by name
    """
    drawn: dict[str, list[Comparison]] = {}
    for family in families(campaign):
        drawn.setdefault(family.field, []).append(_comparison(family, stems))
    return [
        _question(field, list(pairs), drawn.get(field, []))
        for field, pairs in groupby(single_field_pairs(campaign), key=lambda pair: pair.field)
    ]


def _question(field: str, pairs: Sequence[Pair], drawn: Sequence[Comparison]) -> Question:
    heads = ("Comparison", "Verdict", "Difference (95 %, corrected)", "n")
    table = Table(f"Verdicts: {field_words(field)}", heads, tuple(map(answer_cells, pairs)))
    tables = tuple(question_table(pair) for pair in pairs)
    notes = tuple(dict.fromkeys(note for table in tables for note in table.notes))
    bare = tuple(replace(table, notes=()) for table in tables)
    return Question(field, field_words(field), table, tuple(drawn), bare, notes)


def _comparison(family: Family, stems: Mapping[str, str]) -> Comparison:
    plots = [
        plot for plot in (_curve_plot(family, stems), _mean_plot(family, stems)) if plot is not None
    ]
    return Comparison(context_words(family.groups, family.field), tuple(plots))


def _group_looks(family: Family) -> Iterator[tuple[Group, str, str]]:
    """Yield each group with its label and the class of its colour."""
    for number, (group, word) in enumerate(zip(family.groups, family.labels, strict=True)):
        yield group, word, f"c{number % COLOURS}"


def _curve_plot(family: Family, stems: Mapping[str, str]) -> Plot | None:
    """Return the plot of the mean first loading of each group with its band."""
    first = family.groups[0]
    across, up = group_scale(first, "displacement"), group_scale(first, "force")
    drawn = [(group.band, look, stems[group.name]) for group, _, look in _group_looks(family)]
    lines = [
        line
        for band, look, stem in drawn
        for line in (
            *band_lines(band, across.factor, up.factor, look, stem),
            *mean_lines(band, across.factor, up.factor, look, stem),
        )
    ]
    if not lines:
        return None
    keys = [
        Key(f"mean {look}", f"{word} (n = {group.band.n})", "group", stems[group.name])
        for group, word, look in _group_looks(family)
    ]
    x = axis_over("Displacement", unit_words(across.unit), [line.x for line in lines])
    y = _force_axis([band for band, _, _ in drawn], up.factor, unit_words(up.unit))
    title = f"Mean force against displacement of {count_of(len(family.groups), 'group')}."
    return Plot("means", "", title, "", x, y, lines, keys, (392, 200))


def _force_axis(bands: Sequence[Band], factor: float, unit: str) -> Axis:
    """Return an axis with full means, and intervals only as far as the means stay apart."""
    means = axis_over("Force", unit, [factor * band.mean for band in bands])
    edges = [factor * edge for band in bands for edge in (band.lower, band.upper)]
    full_axis = axis_over("Force", unit, edges) if any(map(np.size, edges)) else means
    room = 0.4 * (means.high - means.low)
    low, high = max(full_axis.low, means.low - room), min(full_axis.high, means.high + room)
    return Axis("Force", unit, min(low, means.low), max(high, means.high))


def _mean_plot(family: Family, stems: Mapping[str, str]) -> Plot | None:
    """Return the plot of the main number: a row per group with mean, interval and samples."""
    interval_room = 0.5  # beside the values, of their range
    name = main_number(family)
    if not name:
        return None
    numbers = [
        next(number for number in group.numbers if number.name == name) for group in family.groups
    ]
    unit = shown_in(name, numbers[0].unit, display_of(family.groups[0]))
    lines = []
    rows = zip(numbers, _group_looks(family), strict=True)
    for row, (number, (group, _, look)) in enumerate(rows):
        lines += list(_group_lines(number, -float(row), unit.factor, look, stems[group.name]))
    values = [line.x for line in lines if not line.look.startswith("interval")]
    every = axis_over("", "", [line.x for line in lines])
    tight = axis_over("", "", values)
    room = interval_room * (tight.high - tight.low)
    low, high = max(every.low, tight.low - room), min(every.high, tight.high + room)
    x = Axis(as_label(name), unit_words(unit.unit), low, high)
    y = Axis("", "", 0.5 - len(numbers), 0.5, is_bare=True)
    title = f"{as_label(name)} of {count_of(len(numbers), 'group')}, with 95 % intervals."
    return Plot("numbers", "", title, "", x, y, lines, (), (180, 200))


def _group_lines(
    number: GroupNumber, height: float, factor: float, look: str, stem: str
) -> Iterator[Line]:
    values = [value.value for value in number.values.values() if value.value is not None]
    x = np.array([part for value in values for part in (factor * value, np.nan)])
    yield Line(f"sample {look}", x, np.full(len(x), height - 0.22), group=stem)
    if number.mean is None:
        return
    chosen = number.mean.chosen
    if chosen.interval is not None and isfinite(chosen.interval.upper - chosen.interval.lower):
        ends = factor * np.array([chosen.interval.lower, chosen.interval.upper])
        yield Line(f"interval {look}", ends, np.full(2, height), group=stem)
    yield Line(f"dot {look}", np.array([factor * chosen.mean]), np.array([height]), group=stem)
