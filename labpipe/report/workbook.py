"""The numbers of a report as a workbook, for people who go on calculating with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from labpipe.records.curve import Interval
from labpipe.records.group import Band, BundlePlace, Campaign, Group, GroupNumber
from labpipe.records.quality import worded
from labpipe.report.concerns import find_concerns
from labpipe.report.group_look import group_scale
from labpipe.report.numbers import display_of, in_words, shown_in
from labpipe.report.place_tables import place_scales
from labpipe.report.question_tables import fields_in_words
from labpipe.report.sheets import Sheet, Value, save_sheets, sheet_name
from labpipe.report.wording import Scale

_ABOUT = (
    "Numbers are in the unit of their row or of their column's heading, with all digits.",
    "Lower and upper are the ends of 95 % intervals. An empty cell: there is no such number.",
    "Of a sample, the interval says how well this one sample was measured. Of a mean, it is based"
    " on Student's t with n - 1 degrees of freedom and holds the mean of all such specimens.",
    "Mean over: samples, or spool means where samples of one spool are too much alike.",
    "Curves: lower and upper hold the mean at one displacement, lower_all and upper_all the whole"
    " mean curve. Only displacements at which every sample has data.",
    "Outliers are marked in 'needs a look'; none was removed. A status 'doubtful' is in the means,"
    " 'failed' is not.",
)

Row: TypeAlias = Sequence[Value]
_Table: TypeAlias = tuple[Sequence[str], list[Row]]


def save_workbook(campaign: Campaign, path: Path) -> None:
    """Write the tables of a report as an xlsx file.

    Parameters
    ----------
    campaign : all of it
    path : of the file

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    save_sheets(_sheets(campaign), path, again="make the report")


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    names: list[str] = []
    for wanted, (heads, rows) in _tables(campaign):
        names.append(sheet_name(wanted, names))
        yield Sheet(names[-1], heads, rows)


def _tables(campaign: Campaign) -> Iterator[tuple[str, _Table]]:
    """Tables below the names that their sheets should have."""
    yield "read me", (("About",), [(line,) for line in _about(campaign)])
    yield "needs a look", _concerns(campaign)
    yield "groups", _groups(campaign)
    yield "spools", _spools(campaign)
    yield "samples", _samples(campaign)
    yield "comparisons", _comparisons(campaign)
    if campaign.places:
        yield "slipping and sticking", _places(campaign)
    for group in campaign.groups:
        yield f"curve {group.name}", _curve(group, group.band, is_scaled=False)
        if group.band_scaled is not None:
            yield f"scaled {group.name}", _curve(group, group.band_scaled, is_scaled=True)


def _about(campaign: Campaign) -> Iterator[str]:
    yield campaign.title
    yield f"Made by labpipe {campaign.labpipe_version}."
    yield from _ABOUT


def _concerns(campaign: Campaign) -> _Table:
    heads = ("kind", "group", "test", "what", "reason", "code")
    rows: list[Row] = [
        (str(each.kind), each.group, each.test, each.what, each.reason, each.code)
        for each in find_concerns(campaign)
    ]
    return heads, rows


def _groups(campaign: Campaign) -> _Table:
    heads = (
        "group", "number", "result", "unit", "mean", "lower", "upper", "standard deviation", "n",
        "mean over", "n samples", "within spools", "between spools", "spools alike, p", "decision",
        "reason",
    )  # fmt: skip
    rows = [_mean(group, number) for group in campaign.groups for number in group.numbers]
    return heads, rows


def _mean(group: Group, number: GroupNumber) -> Row:
    scale = shown_in(number.name, number.unit, display_of(group))
    head = (group.name, in_words(number.name), number.name, scale.unit)
    mean = number.mean
    if mean is None:
        return (*head, *[None] * 10, "", "; ".join(map(worded, number.left_out.values())))
    chosen, up = mean.chosen, scale.factor
    return (
        *head, up * chosen.mean, *_ends(chosen.interval, up), up * chosen.deviation, chosen.n,
        "samples" if mean.is_pooled else "spool means", mean.over_samples.n, up * mean.within,
        up * mean.between, mean.spool_p, str(mean.decision), str(chosen.reason or ""),
    )  # fmt: skip


def _spools(campaign: Campaign) -> _Table:
    heads = (
        "group", "number", "result", "spool", "unit", "mean", "lower", "upper",
        "standard deviation", "n", "reason",
    )  # fmt: skip
    rows: list[Row] = []
    for group in campaign.groups:
        for number in group.numbers:
            scale = shown_in(number.name, number.unit, display_of(group))
            for spool, each in number.mean.spool_means.items() if number.mean is not None else ():
                head = (group.name, in_words(number.name), number.name, spool, scale.unit)
                ends = _ends(each.interval, scale.factor)
                spread = scale.factor * each.deviation
                why = str(each.reason or "")
                rows.append((*head, scale.factor * each.mean, *ends, spread, each.n, why))
    return heads, rows


def _samples(campaign: Campaign) -> _Table:
    heads = (
        "group", "test", "type", "spool", "sample", "protocol", "number", "result", "value",
        "unit", "lower", "upper", "status", "reason", "method",
    )  # fmt: skip
    rows: list[Row] = []
    for group in campaign.groups:
        for sample in group.samples:
            own = sample.specimen
            head = (group.name, sample.test, own.type, own.spool, own.sample, sample.protocol)
            for result in sample.results:
                scale = shown_in(result.name, result.unit, sample.display)
                value = None if result.value is None else scale.factor * result.value
                ends = _ends(result.interval, scale.factor)
                about = (str(result.status), result.why, result.how)
                number = (in_words(result.name), result.name)
                rows.append((*head, *number, value, scale.unit, *ends, *about))
    return heads, rows


def _comparisons(campaign: Campaign) -> _Table:
    heads = (
        "number", "result", "first", "second", "unit", "second minus first", "lower", "upper",
        "does not matter below", "equivalent, p", "verdict", "reason",
    )  # fmt: skip
    displays = {group.name: display_of(group) for group in campaign.groups}
    has_fields = any(each.fields and "type" not in each.fields for each in campaign.differences)
    rows: list[Row] = []
    for each in campaign.differences:
        scale = shown_in(each.name, each.unit, displays.get(each.first, {}))
        found = each.difference
        margin = None if each.margin is None else scale.factor * each.margin
        names = (in_words(each.name), each.name, each.first, each.second, scale.unit)
        ends = _ends(found.interval, scale.factor)
        about = (margin, each.p_equivalent, each.words, str(found.reason or ""))
        fields = (each.question, fields_in_words(each)) if has_fields else ()
        rows.append((*names, scale.factor * found.mean, *ends, *about, *fields))
    return (*heads, *(("question", "differ in") if has_fields else ())), rows


def _places(campaign: Campaign) -> _Table:
    heads = (
        "group", "test", "unit", "bending stiffness", "lower", "upper", "all slips",
        "wires slip", "nothing slips", "least of all directions", "largest of all directions",
        "share", "share lower", "share upper", "reason",
    )  # fmt: skip
    scales = place_scales(campaign)
    rows = [_place(each, scales[each.group]) for each in campaign.places]
    return heads, rows


def _place(place: BundlePlace, scale: Scale) -> Row:
    up = scale.factor
    value = None if place.value is None else up * place.value
    bounds = (up * each for each in (place.low, place.free, place.high, *place.principal))
    ends = (*_ends(place.interval, up), *bounds, place.share, *_ends(place.share_interval, 1.0))
    return (place.group, place.test or "mean", scale.unit, value, *ends, worded(place.reasons))


def _curve(group: Group, band: Band, *, is_scaled: bool) -> _Table:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    unit = "1" if is_scaled else up.unit
    names = ("mean", "lower", "upper", "lower_all", "upper_all")
    heads = (f"displacement ({across.unit})", *(f"{name} ({unit})" for name in names), "n", "over")
    factor = 1.0 if is_scaled else up.factor
    columns = [factor * getattr(band, name) for name in names]
    values = zip(across.factor * band.displacement, *columns, strict=True)
    rows: list[Row] = [(*map(float, row), band.n, band.over) for row in values]
    return heads, rows or [(str(band.reason or ""),)]


def _ends(interval: Interval | None, factor: float) -> tuple[float | None, float | None]:
    if interval is None:
        return None, None
    return factor * interval.lower, factor * interval.upper
