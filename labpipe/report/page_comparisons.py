"""Comparisons on the page: mean curves and main number of groups that differ in one field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from labpipe.records.group import Band, Campaign
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
from labpipe.report.group_panels import (
    COLOURS,
    DotRow,
    band_lines,
    clipped_axis,
    dot_with_bar,
    mean_lines,
)
from labpipe.report.group_tables import Table
from labpipe.report.page_plots import Axis, Key, Line, Plot, axis_over
from labpipe.report.wording import Scale, as_label, count_of, display_of, group_scale, shown_in


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
    plots = family_plots(family, stems)
    return Comparison(context_words(family.groups, family.field), tuple(plots))


def family_plots(
    family: Family, stems: Mapping[str, str] | None = None, *, has_scaled: bool = False
) -> list[Plot]:
    """Return the plots of a family: mean curves, and the main number of each group.

    Parameters
    ----------
    family : of groups
    stems : names of groups in links, by name; None for files
    has_scaled : include force over peak force
    """
    names = stems or {group.name: group.name for group in family.groups}
    plots = [
        _curve_plot(family, names),
        _curve_plot(family, names, is_scaled=True) if has_scaled else None,
        _mean_plot(family, names),
    ]
    return [plot for plot in plots if plot is not None]


def _curve_plot(
    family: Family, stems: Mapping[str, str], *, is_scaled: bool = False
) -> Plot | None:
    """Return the plot of the mean first loading of each group with its band."""
    first = family.groups[0]
    across, up = group_scale(first, "displacement"), group_scale(first, "force")
    if is_scaled:
        up = Scale(1.0, "")
    lines, keys, bands = [], [], []
    for at, (group, label) in enumerate(zip(family.groups, family.labels, strict=True)):
        band = group.band_scaled if is_scaled else group.band
        if band is None:
            continue
        look, stem = f"c{at % COLOURS}", stems[group.name]
        bands.append(band)
        lines += [
            *band_lines(band, across.factor, up.factor, look, stem),
            *mean_lines(band, across.factor, up.factor, look, stem),
        ]
        keys.append(Key(f"mean {look}", f"{label} (n = {group.band.n})", "group", stem))
    if not lines:
        return None
    kinds = {line.look.partition(" ")[0] for line in lines}
    keys += [Key(kind, label) for kind, label in _SIGNS.items() if kind in kinds]
    x = axis_over("Displacement", across.unit, [line.x for line in lines])
    y = _force_axis("Force / peak force" if is_scaled else "Force", bands, up)
    title = f"Mean force against displacement of {count_of(len(family.groups), 'group')}."
    heading = "Force / peak force" if is_scaled else "First loading"
    return Plot("means", "", title, "", x, y, lines, keys, (392, 200), heading)


_SIGNS = {"interval": "95 % interval of the mean", "band": "95 % band, pointwise"}


def _force_axis(name: str, bands: Sequence[Band], scale: Scale) -> Axis:
    """Return an axis with full means, and intervals only as far as the means stay apart."""
    means = axis_over(name, scale.unit, [scale.factor * band.mean for band in bands])
    edges = [scale.factor * edge for band in bands for edge in (band.lower, band.upper)]
    whole = axis_over(name, scale.unit, edges) if any(map(np.size, edges)) else means
    room = 0.4 * (means.high - means.low)
    low, high = max(whole.low, means.low - room), min(whole.high, means.high + room)
    return replace(means, low=min(low, means.low), high=max(high, means.high))


def main_number(family: Family) -> str:
    """Return the number by which groups are compared: bending stiffness or the first common one.

    Parameters
    ----------
    family : of groups

    Returns
    -------
    Empty without a common number.
    """
    has = [{number.name for number in group.numbers if number.mean} for group in family.groups]
    shared = [
        number.name
        for number in family.groups[0].numbers
        if all(number.name in names for names in has)
    ]
    return "bending_stiffness" if "bending_stiffness" in shared else next(iter(shared), "")


def _mean_plot(family: Family, stems: Mapping[str, str]) -> Plot | None:
    """Return the plot of the main number: a row per group with mean, interval and samples."""
    name = main_number(family)
    if not name:
        return None
    numbers = [
        next(number for number in group.numbers if number.name == name) for group in family.groups
    ]
    scale = shown_in(name, numbers[0].unit, display_of(family.groups[0]))
    lines: list[Line] = []
    for row, (number, group) in enumerate(zip(numbers, family.groups, strict=True)):
        values = [value.value for value in number.values.values() if value.value is not None]
        x = np.array([part for value in values for part in (scale.factor * value, np.nan)])
        look, stem = f"c{row % COLOURS}", stems[group.name]
        lines.append(Line(f"sample {look}", x, np.full(len(x), -row - 0.22), group=stem))
        if number.mean is not None:
            mean = number.mean.chosen
            place = DotRow(-row, scale.factor, look, stem)
            lines += dot_with_bar("dot", mean.mean, mean.interval, place)
    shown = [line.x for line in lines if not line.look.startswith("interval")]
    x_axis = clipped_axis(as_label(name), scale, lines, shown)
    y_axis = Axis("", "", 0.5 - len(numbers), 0.5, family.labels)
    title = f"{as_label(name)} of {count_of(len(numbers), 'group')}, with 95 % intervals."
    keys = [Key("sample", "sample"), Key("dot", "mean")]
    heading = as_label(name)
    return Plot("numbers", "", title, "", x_axis, y_axis, lines, keys, (180, 200), heading)
