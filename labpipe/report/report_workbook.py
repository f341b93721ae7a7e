"""Tables as the sheets of a workbook, and the workbook of a report."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast
from zipfile import ZipFile

from labpipe.errors import StoreError, complaint
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.group import Band, BundlePlace, Campaign, Group, GroupNumber
from labpipe.records.quality import worded
from labpipe.report.bundle_figures import place_scales
from labpipe.report.group_plots import group_scale
from labpipe.report.questions import fields_in_words
from labpipe.report.ranked_causes import find_causes, find_notes
from labpipe.report.wording import Scale, display_of, in_words, printable, shown_in
from labpipe.statistics.group_budgets import group_budget

if TYPE_CHECKING:
    from openpyxl.cell import Cell
    from openpyxl.styles import NamedStyle
    from openpyxl.workbook import Workbook


_HEADING = "heading of a column"
_NARROWEST, _WIDEST = 11, 60
_SHEET_NAME = 31
_NOT_IN_A_NAME = re.compile(r"[\\/*?:\[\]\x00-\x1f']")
_RESERVED = "history"
"""Excel's own sheet of tracked changes, in any case of letters."""

Value: TypeAlias = str | float | None
Column: TypeAlias = tuple[str, Iterable[Any]]
FREE: Column = ("", ())
"""A column that is left free."""


class Sheet(NamedTuple):
    """A sheet before it is written.

    Parameters
    ----------
    name : free of what a sheet's name may not hold, and no other sheet's
    heads : headings
    rows : below them
    frozen : cell above and left of which all stays in view
    links : text of the first column -> name of the sheet that it leads to
    """

    name: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Value]]
    frozen: str = "A2"
    links: Mapping[str, str] = {}


def save_sheets(sheets: Iterable[Sheet], path: Path, *, again: str, active: int = 0) -> None:
    """Write sheets as an xlsx file.

    Parameters
    ----------
    sheets : in their order; each is written and let go before the next
    path : of the file
    again : how to make the file again, for a message
    active : number of the sheet that is seen first, from 0

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    Text stays text: a sample that is called ``=1+1`` is not a formula. Numbers that are not finite
    are empty cells. Characters that a workbook cannot hold are shown as U+FFFD.
    """
    from openpyxl import Workbook

    try:
        with path.open("wb") as file:  # first: a book that was begun has to be saved
            # cells go to disk as they come: hundreds of sheets take less time and memory
            book = Workbook(write_only=True)
            book.add_named_style(_heading())
            numbers = [_add(book, sheet) for sheet in sheets]
            book.active = active
            frame = io.BytesIO()
            book.save(frame)
            paths = [page.path.lstrip("/") for page in book.worksheets]
            _fill_in(frame, dict(zip(paths, numbers, strict=True)), file)
    except OSError as error:
        message = complaint(
            path,
            "",
            expected="a workbook that can be written",
            found=str(error),
            remedy=f"Make room, change the permissions, or close it where it is open, and {again}"
            " again.",
        )
        raise StoreError(message) from error


def sheet_of_columns(name: str, columns: Iterable[Column]) -> Sheet:
    """Put columns of any lengths beside each other.

    Parameters
    ----------
    name : of the sheet
    columns : heading and values of each; `FREE` for one without anything
    """
    heads, values = zip(*columns, strict=True)
    return Sheet(name, heads, list(zip_longest(*values)))


def column(words: str, scale: Scale, values: Floats) -> Column:
    """Column of numbers in a display unit, below a heading with that unit."""
    return scale.label(words), (scale.factor * values).tolist()


def sheet_name(wanted: str, taken: Sequence[str]) -> str:
    """Turn any text into a name that a sheet may have and that no other sheet has.

    Parameters
    ----------
    wanted : text
    taken : names of the other sheets

    Returns
    -------
    At most 31 characters, none of which is forbidden, and not ``History``, which Excel keeps for
    itself.

    Examples
    --------
    >>> sheet_name("curve a/b", ["read me"])
    'curve a-b'
    >>> sheet_name("read me", ["Read me"])
    'read me 2'
    """
    plain = _begin(_NOT_IN_A_NAME.sub("-", printable(wanted)), _SHEET_NAME).strip() or "sheet"
    known = {_RESERVED, *(name.casefold() for name in taken)}
    name, number = plain, 1
    while name.casefold() in known:
        number += 1
        tail = f" {number}"
        name = _begin(plain, _SHEET_NAME - len(tail)) + tail
    return name


def _begin(text: str, most: int) -> str:
    """Take as much of a text as there is room for, as Excel counts: in units of UTF-16."""
    return text.encode("utf-16-le")[: 2 * most].decode("utf-16-le", "ignore")


def _add(book: Workbook, sheet: Sheet) -> str:
    """Write a sheet: bold headings that stay in view, columns as wide as their text.

    Returns
    -------
    Rows that are still to be filled in: all below the heading where they are numbers alone.
    """
    from openpyxl.utils import get_column_letter

    page: Any = book.create_sheet(sheet.name)
    page.freeze_panes = sheet.frozen
    for number, width in enumerate(_widths(sheet), start=1):
        page.column_dimensions[get_column_letter(number)].width = width
    heads = [_text(page, head) for head in sheet.heads]
    for cell in heads:
        cell.style = _HEADING
    page.append(heads)
    if not any(isinstance(value, str) for row in sheet.rows for value in row):
        return _rows_of_numbers(sheet)
    for first, *others in sheet.rows:
        link = sheet.links.get(str(first), "")
        page.append([_cell(page, first, link), *(_cell(page, value) for value in others)])
    return ""


def _rows_of_numbers(sheet: Sheet) -> str:
    """Rows below the heading, as they stand in a sheet's file: cell by cell is five times slower.

    Office Open XML, ECMA-376 part 1, 18.3: rows ``row``, cells ``c``, values ``v``.
    """
    from openpyxl.utils import get_column_letter

    columns = [get_column_letter(at) for at in range(1, len(sheet.heads) + 1)]
    rows = cast("Sequence[Sequence[float | None]]", sheet.rows)
    written = []
    for number, row in enumerate(rows, start=2):
        cells = [
            f'<c r="{column}{number}"><v>{value:.16g}</v></c>'
            for column, value in zip(columns, row, strict=True)
            if value is not None and math.isfinite(value)
        ]
        written.append(f'<row r="{number}">{"".join(cells)}</row>')
    return "".join(written)


def _fill_in(frame: IO[bytes], rows: Mapping[str, str], file: IO[bytes]) -> None:
    """Write a book again with the rows that its sheets still want, by the path of each sheet."""
    with ZipFile(frame) as book, ZipFile(file, "w") as whole:
        for part in book.infolist():
            text = book.read(part)
            wanted = rows.get(part.filename, "").encode()
            whole.writestr(part, text.replace(b"</sheetData>", wanted + b"</sheetData>"))


def _heading() -> NamedStyle:
    from openpyxl.styles import Alignment, Font, NamedStyle

    wrapped = Alignment(wrap_text=True, vertical="top")
    return NamedStyle(_HEADING, font=Font(bold=True), alignment=wrapped)


def _widths(sheet: Sheet) -> list[int]:
    """Width of each column: of its longest text; headings are broken into lines."""
    widths = [max(_NARROWEST, *map(len, head.split(" "))) for head in sheet.heads]
    for row in sheet.rows:
        for at, value in enumerate(row):
            if isinstance(value, str):
                widths[at] = max(widths[at], len(value))
    return [min(width + 2, _WIDEST) for width in widths]


def _cell(page: Any, value: Value, link: str = "") -> Cell | float | None:
    if isinstance(value, str):
        return _text(page, value, link)
    return None if value is None or not math.isfinite(value) else value


def _text(page: Any, text: str, link: str = "") -> Cell:
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.worksheet.hyperlink import Hyperlink

    cell: Cell = WriteOnlyCell(page, printable(text))
    if cell.data_type != "s":  # begins like a formula, or is called like an error
        cell.data_type = "s"
        cell.quotePrefix = True
    if link:
        cell.hyperlink = Hyperlink(ref="A1", location=f"'{link}'!A1")
        cell.style = "Hyperlink"
    return cell


_ABOUT = (
    "Numbers are in the unit of their row or of their column's heading, with all digits.",
    "Lower and upper are the ends of 95 % intervals. An empty cell: there is no such number.",
    "Of a sample, the interval says how well this one sample was measured. Of a mean, it is based"
    " on Student's t with n - 1 degrees of freedom, with what all tests of a rig share, and holds"
    " the mean of all such specimens. On the scale 'log' its ends are mean / exp(h / mean) and"
    " mean x exp(h / mean), on 'linear' mean - h and mean + h; without what tests share, h ="
    " T.INV.2T(0.05;n-1) x standard deviation / SQRT(n).",
    "Budgets: what one standard uncertainty of each cause changes, and its share of the variance."
    " 'yes': all tests of a rig share the cause, so it does not average out. Where an estimate is"
    " given, the interval is that of the estimate, and may leave the plain value out.",
    "Mean over: samples, or spool means where samples of one spool are too much alike.",
    "Curves: lower and upper hold the mean at one displacement, lower_all and upper_all the whole"
    " mean curve. Only displacements at which every sample has data.",
    "Comparisons: 'lower' and 'upper' are Welch's 95 % interval of one difference alone, p-values"
    " are those of one alone, too; 'corrected' ends are of the share (0.38 for +38 %), or without"
    " one of the difference, at the level that Holm's correction for the family leaves. Without a"
    " family nobody asked.",
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
    for name, made in (("budgets", _budgets), ("budgets of groups", _group_budgets)):
        table = made(campaign)
        if table[1]:
            yield name, table
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
    heads = (
        "rank",
        "kind",
        "group",
        "test",
        "what",
        "reason",
        "code",
        "largest effect of the cause",
    )
    causes = [
        *enumerate(find_causes(campaign), start=1),
        *((None, each) for each in find_notes(campaign)),
    ]
    rows: list[Row] = [
        (
            *(rank, str(each.kind), each.group, each.test or ", ".join(each.tests)),
            *(each.what, each.reason, each.code),
            "" if cause.effect is None else cause.effect.words,
        )
        for rank, cause in causes
        for each in cause.concerns
    ]
    return heads, rows


def _groups(campaign: Campaign) -> _Table:
    heads = (
        "group", "number", "result", "unit", "mean", "lower", "upper", "scale",
        "standard deviation", "n", "mean over", "n samples", "within spools", "between spools",
        "spools alike, p", "decision", "reason",
    )  # fmt: skip
    rows = [_mean(group, number) for group in campaign.groups for number in group.numbers]
    return heads, rows


def _mean(group: Group, number: GroupNumber) -> Row:
    scale = shown_in(number.name, number.unit, display_of(group))
    head = (group.name, in_words(number.name), number.name, scale.unit)
    mean = number.mean
    if mean is None:
        return (*head, *[None] * 11, "", "; ".join(map(worded, number.left_out.values())))
    chosen, up = mean.chosen, scale.factor
    return (
        *head, up * chosen.mean, *_ends(chosen.interval, up), "log" if chosen.is_log else "linear",
        up * chosen.deviation, chosen.n, "samples" if mean.is_pooled else "spool means",
        mean.over_samples.n, up * mean.within, up * mean.between, mean.spool_p,
        str(mean.decision), str(chosen.reason or ""),
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
        "unit", "lower", "upper", "estimate", "status", "reason", "method",
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
                estimate = None if result.estimate is None else scale.factor * result.estimate
                rows.append((*head, *number, value, scale.unit, *ends, estimate, *about))
    return heads, rows


def _budgets(campaign: Campaign) -> _Table:
    heads = (
        "group", "test", "number", "result", "unit", "cause", "change", "share", "all tests share",
    )  # fmt: skip
    rows: list[Row] = []
    for group in campaign.groups:
        for sample in group.samples:
            for result in sample.results:
                scale = shown_in(result.name, result.unit, sample.display)
                head = (group.name, sample.test, in_words(result.name), result.name, scale.unit)
                for each, share in zip(result.budget, result.shares, strict=True):
                    change = scale.factor * each.change
                    rows.append((*head, each.cause, change, share, yes(each.is_common)))
    return heads, rows


def _group_budgets(campaign: Campaign) -> _Table:
    heads = (
        "group", "number", "result", "unit", "cause", "median share of tests",
        "change of the mean", "share of its interval", "all tests share",
    )  # fmt: skip
    rows: list[Row] = []
    for group in campaign.groups:
        for number in group.numbers:
            scale = shown_in(number.name, number.unit, display_of(group))
            head = (group.name, in_words(number.name), number.name, scale.unit)
            own, mean = group_budget(number), number.mean
            common = {} if mean is None else {each.cause: each for each in mean.chosen.common}
            for cause in dict.fromkeys([*own.of_tests, *own.of_mean]) if own.of_tests else ():
                change = scale.factor * common[cause].change if cause in common else None
                shares = own.of_tests.get(cause), change, own.of_mean.get(cause)
                rows.append((*head, cause, *shares, yes(cause in common)))
    return heads, rows


def yes(value: bool) -> str:
    """Word a truth value for a cell."""
    return "yes" if value else "no"


def _comparisons(campaign: Campaign) -> _Table:
    heads = (
        "number", "result", "first", "second", "unit", "second minus first", "lower", "upper",
        "does not matter below", "different, p", "equivalent, p", "family", "in family",
        "share", "corrected lower", "corrected upper", "level", "verdict", "reason",
    )  # fmt: skip
    displays = {group.name: display_of(group) for group in campaign.groups}
    has_fields = any(each.fields for each in campaign.differences)
    rows: list[Row] = []
    for each in campaign.differences:
        scale = shown_in(each.name, each.unit, displays.get(each.first, {}))
        found = each.difference
        margin = None if each.margin is None else scale.factor * each.margin
        names = (in_words(each.name), each.name, each.first, each.second, scale.unit)
        ends = _ends(found.interval, scale.factor)
        chances = (each.p, each.p_equivalent, each.family, each.tests or None)
        factor = scale.factor if each.share is None else 1.0
        level = None if each.interval is None else each.interval.level
        corrected = (each.share, *_ends(each.interval, factor), level)
        about = (margin, *chances, *corrected, each.words, str(found.reason or ""))
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
