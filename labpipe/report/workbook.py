"""The numbers of a report as a workbook, for people who go on calculating with them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from labpipe.records.curve import Interval
from labpipe.records.group import Band, Campaign, Group, GroupNumber
from labpipe.report.concerns import find_concerns
from labpipe.report.group_look import group_scale
from labpipe.report.numbers import display_of, in_words, shown_in

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook
    from openpyxl.worksheet.worksheet import Worksheet

_WIDEST, _NARROWEST = 60, 9
_SHEET_NAME = 31
_NOT_IN_A_NAME = re.compile(r"[\\/*?:\[\]\x00-\x1f']")
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

Row: TypeAlias = Sequence[str | float | None]


def save_workbook(campaign: Campaign, path: Path) -> None:
    """Write the tables of a report as an xlsx file.

    Parameters
    ----------
    campaign : all of it
    path : of the file

    Raises
    ------
    OSError
        If it cannot be written.

    Notes
    -----
    Text stays text: a sample that is called ``=1+1`` is not a formula. Numbers that are not finite
    are empty cells. Characters that a workbook cannot hold are shown as U+FFFD.
    """
    from openpyxl import Workbook

    book = Workbook()
    book.remove(book.worksheets[0])
    _add(book, "read me", ("About",), [(line,) for line in _about(campaign)])
    _add(book, "needs a look", *_concerns(campaign))
    _add(book, "groups", *_groups(campaign))
    _add(book, "spools", *_spools(campaign))
    _add(book, "samples", *_samples(campaign))
    _add(book, "comparisons", *_comparisons(campaign))
    for group in campaign.groups:
        _add(book, f"curve {group.name}", *_curve(group, group.band, is_scaled=False))
        if group.band_scaled is not None:
            _add(book, f"scaled {group.name}", *_curve(group, group.band_scaled, is_scaled=True))
    book.save(path)


def _about(campaign: Campaign) -> Iterator[str]:
    yield campaign.title
    yield f"Made by labpipe {campaign.labpipe_version}."
    yield from _ABOUT


def _concerns(campaign: Campaign) -> tuple[Row, list[Row]]:
    heads = ("kind", "group", "test", "what", "reason", "code")
    rows: list[Row] = [
        (str(each.kind), each.group, each.test, each.what, each.reason, each.code)
        for each in find_concerns(campaign)
    ]
    return heads, rows


def _groups(campaign: Campaign) -> tuple[Row, list[Row]]:
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
        return (*head, *[None] * 10, "", "; ".join(number.left_out.values()))
    chosen, up = mean.chosen, scale.factor
    return (
        *head, up * chosen.mean, *_ends(chosen.interval, up), up * chosen.deviation, chosen.n,
        "samples" if mean.is_pooled else "spool means", mean.over_samples.n, up * mean.within,
        up * mean.between, mean.spool_p, mean.decision, chosen.reason,
    )  # fmt: skip


def _spools(campaign: Campaign) -> tuple[Row, list[Row]]:
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
                rows.append((*head, scale.factor * each.mean, *ends, spread, each.n, each.reason))
    return heads, rows


def _samples(campaign: Campaign) -> tuple[Row, list[Row]]:
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
                about = (str(result.status), result.reason, result.method)
                number = (in_words(result.name), result.name)
                rows.append((*head, *number, value, scale.unit, *ends, *about))
    return heads, rows


def _comparisons(campaign: Campaign) -> tuple[Row, list[Row]]:
    heads = (
        "number", "result", "first", "second", "unit", "second minus first", "lower", "upper",
        "does not matter below", "equivalent, p", "verdict", "reason",
    )  # fmt: skip
    displays = {group.name: display_of(group) for group in campaign.groups}
    rows: list[Row] = []
    for each in campaign.differences:
        scale = shown_in(each.name, each.unit, displays.get(each.first, {}))
        found = each.difference
        margin = None if each.margin is None else scale.factor * each.margin
        names = (in_words(each.name), each.name, each.first, each.second, scale.unit)
        ends = _ends(found.interval, scale.factor)
        about = (margin, each.p_equivalent, each.verdict, found.reason)
        rows.append((*names, scale.factor * found.mean, *ends, *about))
    return heads, rows


def _curve(group: Group, band: Band, *, is_scaled: bool) -> tuple[Row, list[Row]]:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    unit = "1" if is_scaled else up.unit
    names = ("mean", "lower", "upper", "lower_all", "upper_all")
    heads = (f"displacement ({across.unit})", *(f"{name} ({unit})" for name in names), "n", "over")
    factor = 1.0 if is_scaled else up.factor
    columns = [factor * getattr(band, name) for name in names]
    values = zip(across.factor * band.displacement, *columns, strict=True)
    rows: list[Row] = [(*map(float, row), band.n, band.over) for row in values]
    return heads, rows or [(band.reason,)]


def _ends(interval: Interval | None, factor: float) -> tuple[float | None, float | None]:
    if interval is None:
        return None, None
    return factor * interval.lower, factor * interval.upper


def _add(book: Workbook, name: str, heads: Row, rows: Iterable[Row]) -> None:
    """Add a sheet: bold headings that stay in view, columns as wide as their text."""
    from openpyxl.styles import Alignment, Font
    from openpyxl.utils import get_column_letter

    sheet = book.create_sheet(sheet_name(name, [each.title for each in book.worksheets]))
    every = [heads, *rows]
    for number, row in enumerate(every, start=1):
        _write(sheet, number, row)
    for cell in sheet[1]:
        cell.font, cell.alignment = Font(bold=True), Alignment(wrap_text=True, vertical="top")
    sheet.freeze_panes = "A2"
    for column in range(len(heads)):
        texts = [len(str(row[column])) for row in every if _is_text(row, column)]
        width = min(max([_NARROWEST, *texts]) + 2, _WIDEST)
        sheet.column_dimensions[get_column_letter(column + 1)].width = width


def _is_text(row: Row, column: int) -> bool:
    return len(row) > column and isinstance(row[column], str)


def sheet_name(wanted: str, taken: Sequence[str]) -> str:
    """Turn any text into a name that a sheet may have and that no other sheet has.

    Parameters
    ----------
    wanted : text
    taken : names of the other sheets

    Returns
    -------
    At most 31 characters, none of which is forbidden.

    Examples
    --------
    >>> sheet_name("curve a/b", ["read me"])
    'curve a-b'
    >>> sheet_name("read me", ["Read me"])
    'read me 2'
    """
    plain = _NOT_IN_A_NAME.sub("-", wanted)[:_SHEET_NAME].strip() or "sheet"
    known = {name.casefold() for name in taken}
    name, number = plain, 1
    while name.casefold() in known:
        number += 1
        tail = f" {number}"
        name = plain[: _SHEET_NAME - len(tail)] + tail
    return name


def _write(sheet: Worksheet, number: int, row: Row) -> None:
    for column, value in enumerate(row, start=1):
        if isinstance(value, float) and not math.isfinite(value):
            continue
        if isinstance(value, str):
            _write_text(sheet, number, column, value)
        else:
            sheet.cell(number, column, value)


def _write_text(sheet: Worksheet, row: int, column: int, text: str) -> None:
    from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE

    cell = sheet.cell(row, column, ILLEGAL_CHARACTERS_RE.sub("\ufffd", text))
    if cell.data_type != "s":  # begins like a formula, or is called like an error
        cell.data_type = "s"
        cell.quotePrefix = True
