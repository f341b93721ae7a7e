"""Compare groups that differ in a single field: pairs, families, tables and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Difference, Group, Verdict
from labpipe.records.harness_bundle import NONE
from labpipe.report import group_plots, wording
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import N_COLOURS, split_pages
from labpipe.report.page_tables import make_stems
from labpipe.report.plot_records import Axis, LegendEntry, Line, Page, Plot
from labpipe.report.table_records import Cell, Record, Table, tabulate
from labpipe.statistics import group_samples
from labpipe.statistics.group_samples import find_varying_fields, make_field_sort_key

MAX_COMPARED_GROUPS = 6
"""Largest number of groups in a figure; a reader could not distinguish more curves."""

_BUNDLE_CONTEXT_FIELDS = (
    "type", "spool", "composition", "wire", "number", "arrangement", "tape", "taping", "conduit",
    group_samples.BORE,
)  # fmt: skip
"""Fields of bundles that `describe_context` omits, or lists by value without the field's name."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two groups and their differences.

    Parameters
    ----------
    first, second : the groups
    differences : difference of the second group from the first in each number, at least one
    """

    first: Group
    second: Group
    differences: tuple[Difference, ...]

    @property
    def field(self) -> str:
        """Name of the field in which the groups differ; empty if they differ in several fields."""
        return self.differences[0].single_field


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Groups that differ from each other in a single field, which is the same for all.

    Parameters
    ----------
    field : name of the field
    groups : two to `MAX_COMPARED_GROUPS` groups, in the order of the values of the field
    """

    field: str
    groups: tuple[Group, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Value of the field in each group; ``not stated`` if a group has none."""
        return tuple(group.fields.get(self.field, "not stated") for group in self.groups)


def list_single_field_pairs(campaign: Campaign) -> list[Pair]:
    """List the pairs of groups that differ in one field alone, in the order of the differences."""
    groups = {group.name: group for group in campaign.groups}
    differences = (difference for difference in campaign.differences if difference.family)
    by_pair = groupby(differences, key=lambda difference: (difference.first, difference.second))
    return [Pair(groups[first], groups[second], tuple(items)) for (first, second), items in by_pair]


class FieldComparison(NamedTuple):
    """Comparisons of groups that differ in a single field, which is the same for all.

    Parameters
    ----------
    field : name of the field
    pairs : at least one pair of groups
    families : groups that all differ from each other; each pair is in at least one family
    """

    field: str
    pairs: Sequence[Pair]
    families: Sequence[Family]

    @property
    def verdict_table(self) -> Table:
        """Table of the verdicts, a row per pair."""
        headings = ("Comparison", "Verdict", "Difference (95 %, corrected)", "n")
        rows = list(map(make_verdict_cells, self.pairs))
        return Table(f"Verdicts: {name_field(self.field)}", headings, rows)

    @property
    def pair_tables(self) -> list[Table]:
        """Table of each pair, with a row per number."""
        return list(map(make_pair_table, self.pairs))

    @property
    def summary(self) -> tuple[str, str, str, str]:
        """Name, verdict, difference and counts of the pair that differs most.

        With several pairs, the name lists the values of the field, and the verdict is the count of
        each verdict.
        """
        pairs = self.pairs
        largest_pair = max(pairs, key=_make_pair_sort_key)
        name, verdict, difference, counts = make_verdict_cells(largest_pair)
        if len(pairs) == 1:
            return name.text, verdict.text, difference, counts
        values = {value for pair in pairs for value in pair.differences[0].fields[self.field]}
        sorted_values = sorted(values, key=lambda value: make_field_sort_key(self.field, value))
        name_text = f"{name_field(self.field)}: {', '.join(sorted_values)}"
        n_pairs = Counter(pair.differences[0].verdict for pair in pairs)
        verdicts = [f"{str(kind).upper()} {n_pairs[kind]}" for kind in Verdict if n_pairs[kind]]
        difference_text = f"{difference}, largest of {len(pairs)} pairs"
        return name_text, ", ".join(verdicts), difference_text, counts


def _make_pair_sort_key(pair: Pair) -> tuple[bool, float]:
    """Return whether the verdict of a pair is "different", and the size of its relative change.

    On a linear scale, the change is relative to the mean of the first group.
    """
    difference, number = pair.differences[0], pair.first.find_number(pair.differences[0].name)
    change = difference.change
    if change is None:
        reference = 0.0 if number is None else number.mean.chosen.mean
        change = difference.difference.mean / reference if reference else nan
    return difference.verdict is Verdict.DIFFERENT, abs(change) if isfinite(change) else 0.0


def list_field_comparisons(campaign: Campaign) -> list[FieldComparison]:
    """List the fields in which groups are compared, with their pairs and families.

    Parameters
    ----------
    campaign : groups and their differences

    Returns
    -------
    The fields in the order of their pairs. A family of more than `MAX_COMPARED_GROUPS` groups is
    split; its first group, the reference, is in each of the smaller families.
    """
    field_comparisons = []
    for field, items in groupby(list_single_field_pairs(campaign), key=lambda pair: pair.field):
        pairs, families = list(items), list[Family]()
        groups = {group.name: group for pair in pairs for group in (pair.first, pair.second)}
        values = {name: group.fields.get(field, "") for name, group in groups.items()}
        sorted_names = sorted(groups, key=lambda name: make_field_sort_key(field, values[name]))
        linked_pairs = {frozenset((pair.first.name, pair.second.name)) for pair in pairs}
        for names in _collect_linked_sets(sorted_names, linked_pairs):
            reference, *other_groups = (groups[name] for name in names)
            subsets = split_pages(other_groups, MAX_COMPARED_GROUPS - 1)
            families += [Family(field, (reference, *subset)) for subset in subsets]
        field_comparisons.append(FieldComparison(field, pairs, families))
    return field_comparisons


def _collect_linked_sets(names: Sequence[str], links: set[frozenset[str]]) -> Iterator[list[str]]:
    """Yield sets of groups that are linked with each other; each pair is in at least one set.

    Parameters
    ----------
    names : names of all groups, in the order of the sets
    links : pairs of names of groups that are compared with each other

    Notes
    -----
    Each pair that is not in an earlier set is extended to a maximal set: groups are added in order
    if they are linked with all members.
    """
    covered_pairs: set[frozenset[str]] = set()
    for pair in combinations(names, 2):
        if frozenset(pair) not in links - covered_pairs:
            continue
        members = set(pair)
        for name in names:
            if all(frozenset((name, member)) in links for member in members - {name}):
                members.add(name)
        covered_pairs |= set(map(frozenset, combinations(members, 2)))
        yield [name for name in names if name in members]


def name_field(field: str) -> str:
    """Format the name of a field as a heading, such as ``Taping``."""
    return field.replace("_", " ").capitalize()


def name_comparison(pair: Pair) -> str:
    """Name the comparison of a pair, such as ``Taping: half-lap against none``."""
    first, second = pair.differences[0].fields[pair.field]
    return f"{name_field(pair.field)}: {second} against {first}"


def describe_equal_fields(groups: Sequence[Group], field: str) -> str:
    """Describe the fields that are equal in all groups, and name those that vary within a group."""
    varying_fields = dict.fromkeys(
        name
        for group in groups
        for name in find_varying_fields(group)
        if name != field and not (name == "type" and "composition" in _collect_field_names(group))
    )
    context = describe_context(groups, field)
    context_text = f" ({context})" if context else ""
    if not varying_fields:
        return f"all else equal{context_text}"
    names = ", ".join(name.replace("_", " ") for name in varying_fields)
    verb = "varies" if len(varying_fields) == 1 else "vary"
    return f"all else equal{context_text} but for {names}, which {verb} within the groups"


def _collect_field_names(group: Group) -> set[str]:
    """Collect the names of the fields of all samples of a group."""
    return {name for sample in group.samples for name in sample.specimen.fields}


def describe_context(groups: Sequence[Group], field: str) -> str:
    """Describe the common fields of groups, such as ``19 B2, half-lap PVC, corrugated-tube``.

    The text omits the spool, and the sizes of section and bore, which follow from other fields.
    """
    common_fields = {
        name: value
        for name, value in groups[0].fields.items()
        if name != field and all(group.fields.get(name) == value for group in groups)
    }
    named_fields = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in common_fields.items()
        if name not in _BUNDLE_CONTEXT_FIELDS and name not in group_samples.SECTION_SIZES
    ]
    if "composition" not in _collect_field_names(groups[0]):
        return ", ".join(filter(None, [common_fields.get("type", ""), *named_fields]))
    stated_fields = {name: value for name, value in common_fields.items() if value != NONE}
    count_text = f"{stated_fields['number']} wires" if "number" in stated_fields else ""
    wires = stated_fields.get("composition") or stated_fields.get("wire") or count_text
    mixed_groups = [group for group in groups if "&" in group.fields.get("wire", "")]
    arrangements = sorted({group.fields.get("arrangement", "") for group in mixed_groups})
    tape = f"{stated_fields.get('taping', '')} {stated_fields.get('tape', '')}".strip()
    tape = "no tape" if common_fields.get("taping") == NONE else tape
    texts = (wires, *arrangements, tape, stated_fields.get("conduit", ""), *named_fields)
    return ", ".join(filter(None, texts))


def make_pair_table(pair: Pair) -> Table:
    """Make the table of a pair that differs in one field alone.

    Parameters
    ----------
    pair : groups that differ in one field

    Returns
    -------
    Table with a row per number. Its title describes the pair, such as ``Taping: half-lap against
    none, all else equal (19 B2, corrugated-tube)``, and its notes are the caveats of the
    comparison.
    """
    display, rows = wording.get_display(pair.first), list[Record]()
    for difference in pair.differences:
        scale = wording.choose_scale(difference.name, difference.unit, display)
        margin = nan if difference.margin is None else difference.margin
        rows.append({
            "Number": wording.format_heading(difference.name, scale),
            "Difference (95 %, corrected)": _format_difference(difference, display),
            "Irrelevant below": wording.format_number(margin, None, scale.factor, digits=3).value,
            "Verdict": str(difference.verdict),
        })  # fmt: skip
    caveats = (caveat for difference in pair.differences for caveat in difference.caveats)
    notes = tuple(dict.fromkeys(f"{caveat}." for caveat in caveats))
    equal_fields = describe_equal_fields((pair.first, pair.second), pair.field)
    return tabulate(f"{name_comparison(pair)}, {equal_fields}", rows, notes=notes)


def make_verdict_cells(pair: Pair) -> tuple[Cell, Cell, str, str]:
    """Make the cells of the comparison of a pair in its first number.

    Parameters
    ----------
    pair : groups that differ in one field

    Returns
    -------
    Name of the comparison, verdict, difference, and the counts of the values.
    """
    difference = pair.differences[0]
    difference_text = _format_difference(difference, wording.get_display(pair.first))
    first, second = count_values(pair)
    return (
        Cell(name_comparison(pair), describe_context((pair.first, pair.second), pair.field)),
        Cell(str(difference.verdict).upper(), difference.verdict_reason),
        f"{wording.format_label(difference.name)} {difference_text}",
        f"{second} v {first}",
    )


def count_values(pair: Pair) -> list[int]:
    """Count the values of the first number of a pair in its first and its second group."""
    name = pair.differences[0].name
    numbers = (group.find_number(name) for group in (pair.first, pair.second))
    return [0 if number is None else number.mean.chosen.n for number in numbers]


def _format_difference(difference: Difference, display: Mapping[str, str]) -> str:
    """Format a difference in per cent or in its unit, with its corrected interval, if any."""
    max_shown_change = 10.0  # the text of a larger upper end is "more than +1000 %"
    interval, mean_difference, bound_text = difference.interval, difference.difference, ""
    if difference.change is None:
        scale = wording.choose_scale(difference.name, difference.unit, display)
        estimate = mean_difference.distinct_estimate
        mean = mean_difference.mean
        texts = wording.format_number(mean, interval, scale.factor, estimate=estimate)
        unit = f" {scale.unit}".rstrip()
    else:
        if interval is not None and interval.upper > max_shown_change:
            shown_lower = min(interval.lower, max_shown_change)
            interval = Interval(shown_lower, max_shown_change, interval.level)
            bound_text = "more than "
        texts, unit = wording.format_number(difference.change, interval, 100.0), " %"
    interval_text = wording.join_sentences([mean_difference.reason])
    if texts.lower:
        lower, upper = map(_add_plus_sign, (texts.lower, texts.upper))
        lower_text = "" if lower == upper and bound_text else f"{lower}{unit} to "
        interval_text = f"({lower_text}{bound_text}{upper}{unit})"
    return f"{_add_plus_sign(texts.value)}{unit} {interval_text}".strip()


def _add_plus_sign(text: str) -> str:
    """Add a plus before the text of a positive number."""
    is_zero = not text.strip("0.")
    return text if is_zero or text.startswith(("-", "\u2013")) else f"+{text}"


def list_pair_remarks(campaign: Campaign) -> list[str]:
    """List remarks on pairs of groups that the page does not show, or that have no verdict."""
    remarks = []
    if campaign.compared_field:
        name = campaign.compared_field.replace("_", " ")
        if not campaign.differences:
            remarks.append(format_sentence("report.no_pair_differs", field=name))
        option, pairs = campaign.compared_field, _format_pair_count(campaign.pairs_not_shown)
        facts = {"field": name, "option": option, "pairs": pairs}
        remarks.append(format_sentence("report.pairs_left_out", **facts))
    # a difference belongs to a family only if the groups differ in a single field
    unjudged = (difference for difference in campaign.differences if not difference.family)
    unjudged_pairs = {(difference.first, difference.second) for difference in unjudged}
    if unjudged_pairs:
        pairs = _format_pair_count(len(unjudged_pairs))
        remarks.append(format_sentence("report.pairs_without_verdict", pairs=pairs))
    return remarks


def _format_pair_count(count: int) -> str:
    """Format a count of pairs with its verb, such as ``3 pairs are``."""
    return f"{wording.format_count(count, 'pair')} {'is' if count == 1 else 'are'}"


def list_family_figures(campaign: Campaign) -> Iterator[Page]:
    """Yield the figure of each family of groups that differ in one field alone.

    Parameters
    ----------
    campaign : groups and their differences
    """
    field_comparisons = list_field_comparisons(campaign)
    families = [family for comparison in field_comparisons for family in comparison.families]
    contexts = [describe_context(family.groups, family.field) for family in families]
    fields = [family.field for family in families]
    names = make_stems(map("difference {}: {}".format, fields, contexts))
    for family, context, name in zip(families, contexts, names, strict=True):
        panels = make_family_plots(family, has_scaled=True)
        if panels:
            field, labels = name_field(family.field), ", ".join(family.labels)
            equal_fields = describe_equal_fields(family.groups, family.field)
            caption = f"{field}: {labels}; {equal_fields}. Protocol: {family.groups[0].protocol}."
            yield group_plots.make_group_page(
                name, f"{field}  \u00b7  {context}", panels, 3, caption
            )


def make_family_plots(
    family: Family, stems: Mapping[str, str] | None = None, *, has_scaled: bool = False
) -> list[Plot]:
    """Make the plots of a family: mean curves, and the main number of each group.

    Parameters
    ----------
    family : groups that differ in one field
    stems : stem of the links of each group, keyed by its name; None for files
    has_scaled : whether a plot of force over peak force is included
    """
    stems = stems or {group.name: group.name for group in family.groups}
    scaled_plots = _make_curve_plots(family, stems, is_scaled=True) if has_scaled else ()
    return [*_make_curve_plots(family, stems), *scaled_plots, *_make_mean_plots(family, stems)]


def _make_curve_plots(
    family: Family, stems: Mapping[str, str], *, is_scaled: bool = False
) -> Iterator[Plot]:
    """Yield the plot of the mean first loadings of the groups with their bands, if any."""
    display = wording.get_display(family.groups[0])
    x_scale, y_scale = wording.get_scales(display, "displacement", "force")
    y_name, heading = "Force", "First loading"
    if is_scaled:
        y_scale, y_name, heading = plots.PLAIN_NUMBER, "Force / peak force", "Force / peak force"
    lines: list[Line] = []
    legend, bands = [], []
    group_count = wording.format_count(len(family.groups), "group")
    for index, (group, label) in enumerate(zip(family.groups, family.labels, strict=True)):
        band = group.scaled_band if is_scaled else group.band
        if band is not None:
            colour, stem = f"c{index % N_COLOURS}", stems[group.name]
            bands.append(band)
            lines += group_plots.make_band_lines(band, colour, stem)
            lines += group_plots.make_mean_lines(band, colour, stem)
            text = f"{label} (n = {group.band.n})"
            legend.append(LegendEntry(f"mean {colour}", text, "group", stem))
    if not lines:
        return
    max_extension = 0.4  # wide intervals are cut off so that the means remain distinct
    means = np.concatenate([band.mean for band in bands])
    edges = np.concatenate([edge for band in bands for edge in (band.lower, band.upper)])
    y_ends = np.array(plots.clip_range(means, edges, max_extension))
    x = plots.make_axis("Displacement", x_scale, [line.x for line in lines])
    y = plots.make_axis(y_name, y_scale, [y_ends])
    legend += group_plots.list_legend_entries(lines, unlisted=("mean",))
    title, size = f"Mean force against displacement of {group_count}.", (392, 200)
    yield Plot(x, y, lines, heading, legend=legend, kind="means", title=title, size=size)


def choose_main_number(family: Family) -> str:
    """Choose the number by which the groups of a family are compared.

    Parameters
    ----------
    family : groups that differ in one field

    Returns
    -------
    Name of the bending stiffness or, if not all groups have it, of the first number that all groups
    have; empty if there is no such number.
    """
    all_numbers = (group.numbers for group in family.groups)
    names_by_group = [[item.name for item in numbers if item.values] for numbers in all_numbers]
    common_names = set.intersection(*map(set, names_by_group))
    first_name = next((name for name in names_by_group[0] if name in common_names), "")
    return "bending_stiffness" if "bending_stiffness" in common_names else first_name


def _make_mean_plots(family: Family, stems: Mapping[str, str]) -> Iterator[Plot]:
    """Yield the plot of the main number, if any: mean, interval and samples of each group."""
    name, groups = choose_main_number(family), family.groups
    if not name:
        return
    numbers = [next(number for number in group.numbers if number.name == name) for group in groups]
    scale = wording.choose_scale(name, numbers[0].unit, wording.get_display(groups[0]))
    sample_shift = 0.22  # distance of the samples below their mean, in rows
    lines: list[Line] = []
    for row, (number, group) in enumerate(zip(numbers, groups, strict=True)):
        values = [result.value for result in number.values.values() if result.value is not None]
        x = plots.join_with_gaps(np.array(values))
        colour, stem = f"c{row % N_COLOURS}", stems[group.name]
        lines.append(Line(f"sample {colour}", x, np.full(len(x), -row - sample_shift), group=stem))
        mean = number.mean.chosen
        lines += group_plots.make_dot_lines(f"dot {colour}", mean.mean, mean.interval, -row, stem)
    label, count = wording.format_label(name), wording.format_count(len(numbers), "group")
    x_axis = group_plots.make_dot_axis(name, scale, lines)
    y_axis = Axis(low=0.5 - len(numbers), high=0.5, row_names=family.labels)
    heading, title = wording.shorten(label, 40), f"{label} of {count}, with 95 % intervals."
    legend = [LegendEntry("sample", "sample"), LegendEntry("dot", "mean")]
    plot = Plot(x_axis, y_axis, lines, heading, legend=legend, kind="numbers", title=title)
    yield replace(plot, size=(180, 200))
