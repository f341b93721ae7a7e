"""Write workbooks: sheets with a table, filters, fixed headings, charts and a print layout.

The file ``workbooks.toml`` describes each workbook and its sheets.
"""

from __future__ import annotations

import io
import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.report.figure_page import writing
from labpipe.report.wording import find_last_place, replace_unprintable, shorten

_WRAPPED_WIDTH = 46
"""Characters of a column with wrapped text."""
_LINE_HEIGHT = 15.0
"""Height of a line of text, points."""
_FILTER_WIDTH = 3
"""Characters that the button of a filter covers."""
_RISKY = frozenset("=+-@#")
"""First characters of a text that becomes a formula or an error when a person edits it."""
_MADE = datetime(2000, 1, 1)
"""Date of creation in each file: the same sheets give the same bytes."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's, as in the figures."""
_DASHES = ("solid", "dash", "square_dot", "dash_dot")


class Line(NamedTuple):
    """Line of a chart.

    Parameters
    ----------
    name : in the legend
    rows : first and last row of the sheet, from 0 below the headings
    x_column, y_column : numbers of the columns of x and y, from 0
    """

    name: str
    rows: tuple[int, int]
    x_column: int
    y_column: int


class Chart(NamedTuple):
    """Chart of cells of a sheet.

    Parameters
    ----------
    title : above the chart; may be empty
    x_label, y_label : labels of the axes with units
    lines : of which the first 12 are drawn
    is_log : make both axes logarithmic
    """

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    is_log: bool = False


class Sheet(NamedTuple):
    """Contents of a sheet.

    Parameters
    ----------
    name : valid in a spreadsheet, and unique
    heads : headings with units
    rows : as many cells as headings
    frozen : number of columns at the left that stay in view, as the headings do
    links : target by the text of the first column, such as ``'laws'!A12``
    question : that the sheet answers
    charts : below the table, or to the right of a long one
    wrapped : headings of the columns whose text is wrapped
    """

    name: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Value]]
    frozen: int = 0
    links: Mapping[str, str] = {}
    question: str = ""
    charts: Sequence[Chart] = ()
    wrapped: Sequence[str] = ()


def unite_heads(records: Iterable[Record]) -> list[str]:
    """List the headings of records in the order in which they appear."""
    return list(dict.fromkeys(head for record in records for head in record))


def make_sheet(
    book: str, name: str, records: Iterable[Record], *, heads: Sequence[str] = (), **cells: Any
) -> Sheet:
    """Make a sheet of records, a column per heading, with the layout of ``workbooks.toml``.

    Parameters
    ----------
    book, name : of the workbook and the sheet in ``workbooks.toml``
    records : cells by heading; a missing one is empty
    heads : headings in order; those of the records if empty
    cells : links and charts of the sheet
    """
    rows = list(records)
    heads = heads or unite_heads(rows) or ["no rows"]
    layout = _descriptions()[book]["sheets"][name]
    values = [[row.get(head) for head in heads] for row in rows]
    return Sheet(name, heads, values, **layout, **cells)


def how_to_read(book: str) -> list[str]:
    """Return the paragraphs of ``workbooks.toml`` on how to read a workbook."""
    return list(_descriptions()[book]["about"])


@cache
def _descriptions() -> dict[str, Any]:
    text = (files("labpipe.report") / "workbooks.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def stack_blocks(
    blocks: Mapping[str, list[Record]],
) -> tuple[list[Record], dict[str, tuple[int, int]]]:
    """Join blocks of records to the rows of one sheet.

    Parameters
    ----------
    blocks : records by the name of their block

    Returns
    -------
    All records, and the first and the last row of each block by its name, from 0; an empty block
    has no rows.
    """
    rows: list[Record] = []
    ends = {}
    for name, block in blocks.items():
        if block:
            ends[name] = len(rows), len(rows) + len(block) - 1
        rows += block
    return rows, ends


def make_records(head: Record, columns: Mapping[str, Floats | Ints]) -> list[Record]:
    """Make a record per element of arrays.

    Parameters
    ----------
    head : first cells, the same in each record
    columns : arrays of one length by heading
    """
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{**head, **dict(zip(columns, row, strict=True))} for row in values]


class About(NamedTuple):
    """Description of a workbook.

    Parameters
    ----------
    title : of the workbook
    lines : paragraphs on how to read it
    footer : of each printed page; the title if empty
    """

    title: str
    lines: Sequence[str]
    footer: str = ""


READ_ME = "read me"
"""Name of the first sheet."""


def save_book(about: About, sheets: Sequence[Sheet], path: Path) -> None:
    """Write sheets as an xlsx file, after the sheet `READ_ME`, which describes and links them.

    Parameters
    ----------
    about : contents of the first sheet
    sheets : in order; a spreadsheet program opens the first of them
    path : of the file

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    A text such as ``=1+1`` is no formula. Numbers that are not finite are empty cells. Unprintable
    characters are replaced by U+FFFD. The same sheets give the same bytes.
    """
    memory = io.BytesIO()
    book = _WorkbookWriter(memory, about)
    book.read_me(about, sheets)
    for number, sheet in enumerate(sheets):
        book.add(sheet, is_first=not number)
    book.book.close()
    with writing(path, "a workbook"):
        path.write_bytes(memory.getvalue())


class _WorkbookWriter:
    """A workbook that is being written."""

    def __init__(self, file: io.BytesIO, about: About) -> None:
        from xlsxwriter import Workbook

        self.book = Workbook(file, {"in_memory": True})
        self.book.set_properties({"title": replace_unprintable(about.title), "created": _MADE})
        self.forms: dict[str, Any] = {}
        footer = shorten(replace_unprintable(about.footer or about.title), 90)
        self.footer = f"&L&8{footer.replace('&', '&&')}&C&8&A&R&8page &P of &N"
        self.head = self.form(bold=True, text_wrap=True, bottom=1, align="left")

    def form(self, number: str = "", **look: Any) -> Any:
        """Return the format of a cell, created once."""
        key = f"{number} {sorted(look)}" if look else number
        if key not in self.forms:
            properties = {"valign": "top", **({"num_format": number} if number else {}), **look}
            self.forms[key] = self.book.add_format(properties)
        return self.forms[key]

    def read_me(self, about: About, sheets: Sequence[Sheet]) -> None:
        """Write how to read the workbook, and the question of each sheet."""
        page = self.book.add_worksheet(READ_ME)
        page.set_column(0, 0, 26)
        page.set_column(1, 1, 100)
        _write_text(page, 0, 0, about.title, self.head)
        wrapped = self.form(text_wrap=True)
        for row, line in enumerate(about.lines, start=1):
            page.merge_range(row, 0, row, 1, "", wrapped)
            _write_text(page, row, 0, line, wrapped)
            page.set_row(row, _LINE_HEIGHT * math.ceil(len(line) / 115))
        start = len(about.lines) + 2
        for column, word in enumerate(("Sheet", "Question")):
            _write_text(page, start, column, word, self.head)
        for row, sheet in enumerate(sheets, start=start + 1):
            page.write_url(row, 0, f"internal:'{sheet.name}'!A1", string=sheet.name)
            _write_text(page, row, 1, sheet.question, wrapped)
        self._set_up_print(page)

    def add(self, sheet: Sheet, *, is_first: bool) -> None:
        """Write one sheet: its table, charts and print layout."""
        page = self.book.add_worksheet(sheet.name)
        if is_first:
            page.activate()
        widths = _column_widths(sheet)
        for i, width in enumerate(widths):
            page.set_column(i, i, width)
        self._write_table(page, sheet)
        page.freeze_panes(1, sheet.frozen)
        self._set_up_print(page)
        page.repeat_rows(0)
        if sheet.charts:
            self._draw(page, sheet)

    def _write_table(self, page: Any, sheet: Sheet) -> None:
        heads = make_unique_heads(sheet.heads)
        if not sheet.rows:
            for i, head in enumerate(heads):
                _write_text(page, 0, i, head, self.head)
            return
        columns = [{"header": head, "header_format": self.head} for head in heads]
        table_options = {"columns": columns, "style": "Table Style Light 1"}
        page.add_table(0, 0, len(sheet.rows), len(heads) - 1, table_options)
        places = [find_column_place(column) for column in zip(*sheet.rows, strict=True)]
        wrapped = [head in sheet.wrapped for head in sheet.heads]
        for number, row in enumerate(sheet.rows, start=1):
            for i, value in enumerate(row):
                if isinstance(value, str):
                    self._write_word(page, (number, i), value, is_wrapped=wrapped[i])
                elif value is not None:
                    self._write_number(page, (number, i), value, places[i])
            if (place := sheet.links.get(str(row[0]))) is not None:
                page.write_url(
                    number, 0, f"internal:{place}", string=replace_unprintable(str(row[0]))
                )

    def _write_number(
        self, page: Any, at: tuple[int, int], value: float | NumberCell, place: int | None
    ) -> None:
        number = value.value if isinstance(value, NumberCell) else value
        if math.isfinite(number):
            page.write_number(*at, number, self.form(format_in_column(value, place).form))

    def _write_word(
        self, page: Any, place: tuple[int, int], word: str, *, is_wrapped: bool
    ) -> None:
        if not word:
            return
        cell_format: dict[str, Any] = {"quote_prefix": True} if word[0] in _RISKY else {}
        cell_format |= {"text_wrap": True} if is_wrapped else {"align": "left", "indent": 1}
        _write_text(page, *place, word, self.form(**cell_format))

    def _draw(self, page: Any, sheet: Sheet) -> None:
        """Place the charts in rows of two, below the table or beside a long one."""
        long_table, width, height, gap = 80, 704, 436, 16  # rows; pixels
        top, left = len(sheet.rows) + 2, 0
        if len(sheet.rows) > long_table:
            top, left = 1, len(sheet.heads) + 1
            page.print_area(0, 0, len(sheet.rows), len(sheet.heads) - 1)
        for number, chart in enumerate(sheet.charts):
            row, column = divmod(number, 2)
            drawn = _chart(self.book, sheet.name, chart)
            drawn.set_size({"width": width - gap, "height": height - gap})
            offset = {"x_offset": column * width, "y_offset": row * height, "object_position": 3}
            page.insert_chart(top, left, drawn, offset)

    def _set_up_print(self, page: Any) -> None:
        page.set_landscape()
        page.set_paper(9)  # A4
        page.set_margins(left=0.4, right=0.4, top=0.5, bottom=0.6)
        page.set_footer(self.footer)
        page.fit_to_pages(1, 0)


def make_unique_heads(heads: Sequence[str]) -> list[str]:
    """Make headings of a table unique regardless of case, not empty, and at most 250 long."""
    make_unique_heads: list[str] = []
    taken: set[str] = set()
    for head in heads:
        plain = replace_unprintable(head)[:250] or "column"
        name, number = plain, 1
        while name.casefold() in taken:
            number += 1
            name = f"{plain} {number}"
        taken.add(name.casefold())
        make_unique_heads.append(name)
    return make_unique_heads


def _write_text(page: Any, row: int, column: int, text: str, form: Any) -> None:
    page.write_string(row, column, _cell_text(text), form)


@lru_cache(maxsize=256)  # the same names stand in many rows
def _cell_text(text: str) -> str:
    max_units = 32_767  # of UTF-16, the limit of Excel
    return (
        replace_unprintable(text).encode("utf-16-le")[: 2 * max_units].decode("utf-16-le", "ignore")
    )


def _column_widths(sheet: Sheet) -> list[int]:
    """Return the width of each column in characters, that of its longest text or heading word."""
    widths = [max(8, *map(len, head.split(" "))) + _FILTER_WIDTH for head in sheet.heads]
    for row in sheet.rows:
        for i, value in enumerate(row):
            if isinstance(value, str):
                widths[i] = max(widths[i], len(value) + 1)
    max_widths = [_WRAPPED_WIDTH if head in sheet.wrapped else 34 for head in sheet.heads]
    return [min(pair) for pair in zip(widths, max_widths, strict=True)]


def _chart(book: Any, name: str, chart: Chart) -> Any:
    drawn = book.add_chart({"type": "scatter", "subtype": "straight"})
    for number, line in enumerate(chart.lines[:12]):
        first, last = (row + 1 for row in line.rows)
        colour = COLOURS[number % len(COLOURS)]
        dash = _DASHES[number // len(COLOURS) % len(_DASHES)]
        drawn.add_series({
            "name": _escape_formula(line.name),
            "categories": [name, first, line.x_column, last, line.x_column],
            "values": [name, first, line.y_column, last, line.y_column],
            "line": {"color": colour, "width": 1.5, "dash_type": dash},
        })  # fmt: skip
    axis_options: dict[str, Any] = {
        "name_font": {"bold": False, "size": 10}, "num_font": {"size": 9}, "num_format": "General",
        "major_gridlines": {"visible": True, "line": {"color": "#e0e0e0", "width": 0.5}},
    }  # fmt: skip
    axis_options |= {"log_base": 10, "crossing": "min"} if chart.is_log else {}
    drawn.set_x_axis({"name": _escape_formula(chart.x_label), **axis_options})
    drawn.set_y_axis({"name": _escape_formula(chart.y_label), **axis_options})
    title = {"name": _escape_formula(chart.title), "name_font": {"bold": False, "size": 11}}
    drawn.set_title(title if chart.title else {"none": True})
    drawn.set_legend({"position": "right", "font": {"size": 9}})
    return drawn


def _escape_formula(text: str) -> str:
    """Escape a text of a chart that begins like a formula."""
    return re.sub("^=", "\u200a=", replace_unprintable(text))


class NumberCell(NamedTuple):
    """A number with all its digits, and its number format.

    Parameters
    ----------
    value : in the unit of its column or row
    form : number format of Excel
    """

    value: float
    form: str


Value: TypeAlias = str | float | NumberCell | None
Record: TypeAlias = dict[str, Value]
"""Cells of a row by their headings."""


def make_number_cell(
    value: float | None, interval: Interval | None, factor: float = 1.0
) -> NumberCell | None:
    """Make a cell that displays a number to the second digit of half its interval.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cell

    Returns
    -------
    None without a number.
    """
    if value is None or not math.isfinite(value):
        return None
    place = find_last_place(value, interval, factor)
    return NumberCell(factor * value, choose_number_format(factor * value, place))


def make_interval_cells(
    value: float | None, interval: Interval | None, factor: float = 1.0, *, name: str = "value"
) -> Record:
    """Make cells that display a number and the ends of its interval to the same digit.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cells
    name : heading of the number; those of the ends are ``lower`` and ``upper``

    Returns
    -------
    Three cells by heading; a missing number is None.
    """
    cells: Record = {name: make_number_cell(value, interval, factor), "lower": None, "upper": None}
    if interval is not None:
        lower, upper = sorted((factor * interval.lower, factor * interval.upper))
        place = find_last_place(interval.lower if value is None else value, interval, factor)
        cells["lower"] = NumberCell(lower, choose_number_format(lower, place))
        cells["upper"] = NumberCell(upper, choose_number_format(upper, place))
    return cells


def make_percent_cell(share: float | Interval | None, part: str = "") -> NumberCell | None:
    """Make the cell of a share in per cent, such as 38.2% for 0.382.

    Parameters
    ----------
    share : or an interval of shares; None and NaN give None
    part : field of the interval, such as ``lower``
    """
    value = getattr(share, part) if isinstance(share, Interval) else share
    return None if value is None or not math.isfinite(value) else NumberCell(value, "0.0%")


def choose_number_format(value: float, place: int) -> str:
    """Choose the number format that displays a number down to a power of ten.

    Parameters
    ----------
    value : of the cell
    place : power of ten of the last digit

    Examples
    --------
    >>> choose_number_format(52.284, -1)
    '0.0'
    >>> choose_number_format(3.1e-5, -6)
    '0.000000'
    >>> choose_number_format(3.1e-7, -8)
    '0.0E+00'
    """
    plain_below, last_plain_place = 1e7, -6  # beyond these, with a power of ten
    if value and (abs(value) >= plain_below or place < last_plain_place):
        behind = math.floor(math.log10(abs(value))) - place
        return _decimals(behind) + "E+00"
    return _decimals(-place)


@cache
def _decimals(count: int) -> str:
    return f"0.{'0' * min(count, 15)}" if count > 0 else "0"


def find_column_place(column: Sequence[Value]) -> int | None:
    """Find the power of ten of the last digit of the numbers of a column without a format.

    Parameters
    ----------
    column : its integers, texts and cells with a format do not count

    Returns
    -------
    The largest number has five digits; None if there is no number other than zero.
    """
    column_digits = 5
    plain = [abs(x) for x in column if isinstance(x, float) and math.isfinite(x)]
    if not any(plain):
        return None
    return find_last_place(max(plain), None, digits=column_digits)


def format_in_column(value: float | NumberCell, place: int | None) -> NumberCell:
    """Give a number the format of its column, or one of its own if it is too small for that.

    Parameters
    ----------
    value : a cell with a format keeps it
    place : power of ten of the last digit of the column, from `find_column_place`
    """
    min_digits = 3  # of a small number that would have fewer in its column
    if isinstance(value, NumberCell):
        return value
    if isinstance(value, int) or place is None:
        return NumberCell(value, "0")
    is_small = 0.0 < abs(value) < 10.0 ** (place + min_digits - 1)
    last_place = find_last_place(value, None, digits=min_digits) if is_small else place
    return NumberCell(value, choose_number_format(value, last_place))
