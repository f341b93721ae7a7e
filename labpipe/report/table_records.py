"""Describe the tables of pages and workbooks, format their numbers, and write workbooks.

The template ``tables.html`` shows a `Table` on a page. `save_tables` writes several tables as the
sheets of a workbook. ``workbooks.toml`` describes each workbook and the layout of its sheets.
"""

from __future__ import annotations

import io
import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Severity
from labpipe.report.figure_page import convert_write_errors
from labpipe.report.plot_records import MeanStrip
from labpipe.report.wording import compute_last_place, replace_unprintable, shorten

DASH = "\u2013"
"""Text of a cell without a value."""


class Cell(NamedTuple):
    """Text of a cell.

    Parameters
    ----------
    text : first line
    subtext : second line, in smaller type
    mark : mark after the text: ``?`` for doubtful, ``!`` for an outlier
    tooltip : sentence or code that the page shows when the pointer is over the cell
    sort_value : value by which the column is sorted, SI; None to sort by the text
    drawing : drawing instead of the text; None to show the text
    link : address to which the text links, on the page or in the workbook
    """

    text: str
    subtext: str = ""
    mark: str = ""
    tooltip: str = ""
    sort_value: float | None = None
    drawing: MeanStrip | None = None
    link: str = ""


class NumberCell(NamedTuple):
    """A number with all its digits, and the format in which a workbook displays the number.

    Parameters
    ----------
    value : number in the unit of its column or row
    number_format : number format of Excel
    """

    value: float
    number_format: str


Value: TypeAlias = str | float | Cell | NumberCell | None
"""Content of a cell; None for an empty cell."""
Record: TypeAlias = dict[str, Value]
"""Cells of a row, keyed by their headings."""


class Chart(NamedTuple):
    """Chart of a table in a workbook.

    Parameters
    ----------
    title : title above the chart; may be empty
    x, y : headings of the columns that the chart draws
    lines : indices of the first and the last row of each line, keyed by the name of the line; only
        the first 12 lines are drawn
    is_log : whether both axes are logarithmic
    """

    title: str
    x: str
    y: str
    lines: Mapping[str, tuple[int, int]]
    is_log: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A table of a page, or a sheet of a workbook; the first cell of a row is its heading.

    Parameters
    ----------
    title : title above the table, or name of the sheet
    headings : headings with units, one per column
    rows : cells of each row, in the order of the headings
    notes : sentences below the table of a page
    charts : charts of a sheet, below the table or to the right of a long one
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = ()
    charts: Sequence[Chart] = ()


def tabulate(
    title: str, records: Iterable[Record], headings: Iterable[str] = (), **settings: Any
) -> Table:
    """Make a table of records with a column per heading.

    Parameters
    ----------
    title : title of the table
    records : cells of each row, keyed by heading; a missing cell is empty
    headings : headings in order; if there are none, those of the records in the order in which they
        first occur
    settings : fields `notes` and `charts` of the table
    """
    all_records = list(records)
    names = list(headings) or list(dict.fromkeys(name for record in all_records for name in record))
    rows = [[record.get(name) for name in names] for record in all_records]
    return Table(title, names, rows, **settings)


def make_records(common_cells: Record, columns: Mapping[str, Floats | Ints]) -> list[Record]:
    """Make a record per row of the columns.

    Parameters
    ----------
    common_cells : first cells, which are the same in each record
    columns : arrays of shape (n_records,), keyed by heading
    """
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{**common_cells, **dict(zip(columns, row, strict=True))} for row in rows]


def sort_notes(notes: Iterable[tuple[str, QualityNote]]) -> list[tuple[str, QualityNote]]:
    """Sort pairs of a subject and its note, the most severe note first."""
    severities = list(reversed(Severity))
    return sorted(notes, key=lambda pair: severities.index(pair[1].severity))


def make_note_records(heading: str, notes: Iterable[tuple[str, QualityNote]]) -> list[Record]:
    """Make a record per note, the most severe first.

    Parameters
    ----------
    heading : heading of the subjects of the notes
    notes : pairs of the subject of a note and the note
    """
    return [
        {
            heading: subject,
            "kind": str(note.severity),
            "where": note.where,
            "what": note.message,
            "code": note.code,
        }
        for subject, note in sort_notes(notes)
    ]


def tabulate_curves(
    title: str,
    charts: Iterable[tuple[str, Mapping[str, list[Record]]]],
    x: str,
    *y: str,
    headings: Iterable[str] = (),
    start: int = 0,
    is_log: bool = False,
) -> Table:
    """Make a table of the points of curves, with charts of the curves.

    Parameters
    ----------
    title, headings : see `tabulate`
    charts : pairs of a title and the records of the lines, keyed by the name of the line; a line of
        one point is not drawn
    x, y : headings of the columns that a chart draws; there is a chart for each heading of `y`.
        With several headings, a chart has the title of its column
    start : index of the first point of each line in the charts
    is_log : whether both axes are logarithmic
    """
    records, sheet_charts = list[Record](), list[Chart]()
    for common_title, records_by_line in charts:
        lines: dict[str, tuple[int, int]] = {}
        for line_name, line_records in records_by_line.items():
            first, last = len(records) + start, len(records) + len(line_records) - 1
            records += line_records
            if first < last:
                lines[line_name] = first, last
        for heading in y if lines else ():
            chart_title = common_title if len(y) == 1 else heading.partition(" (")[0].capitalize()
            sheet_charts.append(Chart(chart_title, x, heading, lines, is_log=is_log))
    return tabulate(title, records, headings, charts=sheet_charts)


def make_number_cell(
    value: float | None, interval: Interval | None = None, factor: float = 1.0
) -> NumberCell | None:
    """Make a cell that displays a number to the second digit of the half-width of its interval.

    Parameters
    ----------
    value : number, SI; None if there is no number
    interval : interval of the number, SI; None if there is no interval
    factor : factor from SI to the unit of the cell

    Returns
    -------
    The cell; None if the number is missing or not finite.
    """
    if value is None or not math.isfinite(value):
        return None
    last_place = compute_last_place(value, interval, factor)
    return NumberCell(factor * value, choose_number_format(factor * value, last_place))


def make_interval_cells(
    value: float | None, interval: Interval | None, factor: float = 1.0, *, name: str = "value"
) -> Record:
    """Make cells that display a number and the ends of its interval to the same digit.

    Parameters
    ----------
    value : number, SI; None if there is no number
    interval : interval of the number, SI; None if there is no interval
    factor : factor from SI to the unit of the cells
    name : heading of the number; those of the ends are ``lower`` and ``upper``

    Returns
    -------
    Three cells, keyed by heading; a missing number is None.
    """
    cells: Record = {name: make_number_cell(value, interval, factor), "lower": None, "upper": None}
    if interval is not None:
        number = interval.lower if value is None else value
        last_place = compute_last_place(number, interval, factor)
        ends = sorted((factor * interval.lower, factor * interval.upper))
        for heading, end in zip(("lower", "upper"), ends, strict=True):
            cells[heading] = NumberCell(end, choose_number_format(end, last_place))
    return cells


def make_percent_cell(ratio: float | Interval | None, field: str = "") -> NumberCell | None:
    """Make the cell of a ratio in per cent, such as 38.2% for 0.382.

    Parameters
    ----------
    ratio : ratio, or interval of a ratio; there is no cell if it is missing or not finite
    field : name of the field of the interval that the cell shows, such as ``lower``
    """
    value = getattr(ratio, field) if isinstance(ratio, Interval) else ratio
    return None if value is None or not math.isfinite(value) else NumberCell(value, "0.0%")


def choose_number_format(value: float, last_place: int) -> str:
    """Choose the number format that displays a number down to a power of ten.

    Parameters
    ----------
    value : number of the cell
    last_place : power of ten of the last digit

    Examples
    --------
    >>> choose_number_format(52.284, -1)
    '0.0'
    >>> choose_number_format(3.1e-5, -6)
    '0.000000'
    >>> choose_number_format(3.1e-7, -8)
    '0.0E+00'
    """
    # numbers that are larger, or have digits that are smaller, are displayed with a power of ten
    max_plain_value, min_plain_place = 1e7, -6
    if value and (abs(value) >= max_plain_value or last_place < min_plain_place):
        return _format_decimals(math.floor(math.log10(abs(value))) - last_place) + "E+00"
    return _format_decimals(-last_place)


def _format_decimals(count: int) -> str:
    """Return the number format with `count` decimals, at most 15, which is all that Excel shows."""
    return f"0.{'0' * min(count, 15)}" if count > 0 else "0"


def compute_column_place(column: Sequence[Value]) -> int | None:
    """Compute the power of ten of the last displayed digit of the plain numbers of a column.

    Parameters
    ----------
    column : cells; integers, texts and cells with a format are ignored

    Returns
    -------
    Power of ten with which the largest number has five digits; None if there is no number other
    than zero.
    """
    magnitudes = [abs(cell) for cell in column if isinstance(cell, float) and math.isfinite(cell)]
    return compute_last_place(max(magnitudes), None, digits=5) if any(magnitudes) else None


def format_in_column(value: float | NumberCell, column_place: int | None) -> NumberCell:
    """Format a number as its column is formatted; a number that is too small has another format.

    Parameters
    ----------
    value : number, or a cell with a format, which is kept
    column_place : power of ten of the last digit of the column, from `compute_column_place`
    """
    min_digits = 3  # a number that would show fewer digits has another format
    if isinstance(value, NumberCell):
        return value
    if isinstance(value, int) or column_place is None:
        return NumberCell(value, "0")
    is_small = 0.0 < abs(value) < 10.0 ** (column_place + min_digits - 1)
    last_place = compute_last_place(value, None, digits=min_digits) if is_small else column_place
    return NumberCell(value, choose_number_format(value, last_place))


READ_ME = "read me"
"""Name of the first sheet of a workbook."""
_CHART_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours of Okabe and Ito, as in the figures."""
_CHART_DASHES = ("solid", "dash", "square_dot", "dash_dot")
"""Dashes of lines in charts; each repetition of the colours has the next dash."""


def save_tables(
    tables: Iterable[Table],
    path: Path,
    *,
    book: str,
    title: str,
    facts: Iterable[str] = (),
    footer: str = "",
) -> None:
    """Write tables as an xlsx file, after the sheet `READ_ME`, which describes and links to them.

    Parameters
    ----------
    tables : tables in the order of their sheets; a spreadsheet program opens the first of them
    path : path of the file
    book : name of the workbook in ``workbooks.toml``
    title : title of the workbook
    facts : paragraphs of the first sheet, before those on how to read the workbook
    footer : footer of each printed page; the title if empty

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    A text such as ``=1+1`` does not become a formula. Numbers that are not finite give empty cells.
    Unprintable characters are replaced with U+FFFD. Equal tables give equal bytes.
    """
    text = (files("labpipe.report") / "workbooks.toml").read_text(encoding="utf-8")
    description, all_tables, buffer = tomllib.loads(text)[book], list(tables), io.BytesIO()
    layouts = {table.title: description["sheets"].get(table.title, {}) for table in all_tables}
    writer = _WorkbookWriter(buffer, title, footer or title)
    writer.add_read_me([title, *facts, *description["about"]], layouts)
    for index, table in enumerate(all_tables):
        writer.add_table(table, layouts[table.title], is_first=not index)
    writer.book.close()
    with convert_write_errors(path, "a workbook"):
        path.write_bytes(buffer.getvalue())


class _WorkbookWriter:
    """Writer of a workbook, sheet by sheet."""

    def __init__(self, buffer: io.BytesIO, title: str, footer: str) -> None:
        from xlsxwriter import Workbook

        self.book = Workbook(buffer, {"in_memory": True})
        created = datetime(2000, 1, 1)  # a constant date, so that equal tables give equal bytes
        self.book.set_properties({"title": replace_unprintable(title), "created": created})
        self.formats: dict[str, Any] = {}
        text = shorten(replace_unprintable(footer), 90).replace("&", "&&")
        # codes of Excel: 8 points; text on the left, sheet in the middle, page on the right
        self.footer = f"&L&8{text}&C&8&A&R&8page &P of &N"
        self.heading_format = self.get_format(bold=True, text_wrap=True, bottom=1, align="left")

    def get_format(self, number_format: str = "", **settings: Any) -> Any:
        """Return the format of a cell; equal formats are added to the workbook once."""
        key = f"{number_format} {sorted(settings.items())}" if settings else number_format
        if key not in self.formats:
            settings |= {"num_format": number_format} if number_format else {}
            self.formats[key] = self.book.add_format({"valign": "top", **settings})
        return self.formats[key]

    def add_sheet(self, name: str) -> Any:
        """Add a sheet with its print layout."""
        sheet = self.book.add_worksheet(name)
        sheet.set_landscape()
        sheet.set_paper(9)  # A4
        sheet.set_margins(left=0.4, right=0.4, top=0.5, bottom=0.6)
        sheet.set_footer(self.footer)
        sheet.fit_to_pages(1, 0)
        return sheet

    def add_read_me(self, texts: Sequence[str], layouts: Mapping[str, Mapping[str, Any]]) -> None:
        """Add the sheet that describes the workbook and lists its sheets with their questions.

        Parameters
        ----------
        texts : title of the workbook, and paragraphs that describe the workbook
        layouts : sections of the sheets in ``workbooks.toml``, keyed by the name of the sheet
        """
        points_per_line, characters_per_line = 15.0, 115
        sheet, wrapped = self.add_sheet(READ_ME), self.get_format(text_wrap=True)
        sheet.set_column(0, 0, 26)
        sheet.set_column(1, 1, 100)
        _write_text(sheet, 0, 0, texts[0], self.heading_format)
        for row, text in enumerate(texts[1:], start=1):
            sheet.merge_range(row, 0, row, 1, "", wrapped)
            _write_text(sheet, row, 0, text, wrapped)
            sheet.set_row(row, points_per_line * math.ceil(len(text) / characters_per_line))
        heading_row = len(texts) + 1
        for column, heading in enumerate(("Sheet", "Question")):
            _write_text(sheet, heading_row, column, heading, self.heading_format)
        for row, (name, layout) in enumerate(layouts.items(), start=heading_row + 1):
            sheet.write_url(row, 0, f"internal:'{name}'!A1", string=name)
            _write_text(sheet, row, 1, layout.get("question", ""), wrapped)

    def add_table(self, table: Table, layout: Mapping[str, Any], *, is_first: bool) -> None:
        """Add the sheet of a table with its charts.

        Parameters
        ----------
        table : content of the sheet
        layout : section of the sheet in ``workbooks.toml``
        is_first : whether a spreadsheet program shows this sheet when it opens the workbook
        """
        sheet, wrapped_headings = self.add_sheet(table.title), layout.get("wrapped", ())
        headings = make_unique_headings(table.headings or ["no rows"])
        if is_first:
            sheet.activate()
        for index, width in enumerate(_compute_widths(table, wrapped_headings)):
            sheet.set_column(index, index, width)
        columns = [{"header": name, "header_format": self.heading_format} for name in headings]
        if table.rows:
            table_options = {"columns": columns, "style": "Table Style Light 1"}
            sheet.add_table(0, 0, len(table.rows), len(headings) - 1, table_options)
        for index, heading in enumerate(() if table.rows else headings):
            _write_text(sheet, 0, index, heading, self.heading_format)
        for index, column in enumerate(zip(*table.rows, strict=True)):
            is_wrapped = table.headings[index] in wrapped_headings
            self.write_column(sheet, index, column, is_wrapped=is_wrapped)
        sheet.freeze_panes(1, layout.get("frozen", 0))
        sheet.repeat_rows(0)
        self.place_charts(sheet, table)

    def write_column(
        self, sheet: Any, column: int, values: Sequence[Value], *, is_wrapped: bool
    ) -> None:
        """Write the cells of a column below its heading; texts are wrapped if `is_wrapped`."""
        # a text with one of these first characters becomes a formula when a person edits it
        formula_starts = "=+-@#"
        layout = {"text_wrap": True} if is_wrapped else {"align": "left", "indent": 1}
        column_place, text_format = compute_column_place(values), self.get_format(**layout)
        for row, value in enumerate(values, start=1):
            if isinstance(value, Cell):
                text = replace_unprintable(value.text)
                sheet.write_url(row, column, f"internal:{value.link}", string=text)
            elif isinstance(value, str):
                cell_format = text_format
                if value[:1] in formula_starts:
                    cell_format = self.get_format(quote_prefix=True, **layout)
                if value:
                    _write_text(sheet, row, column, value, cell_format)
            elif value is not None:
                number = value.value if isinstance(value, NumberCell) else value
                if math.isfinite(number):
                    number_format = format_in_column(value, column_place).number_format
                    sheet.write_number(row, column, number, self.get_format(number_format))

    def place_charts(self, sheet: Any, table: Table) -> None:
        """Place the charts in rows of two, below the table or beside a long table."""
        max_rows_above = 80  # a reader would not find charts below a longer table
        width, height, gap = 704, 436, 16  # pixels
        top, left = len(table.rows) + 2, 0
        if table.charts and len(table.rows) > max_rows_above:
            top, left = 1, len(table.headings) + 1
            sheet.print_area(0, 0, len(table.rows), len(table.headings) - 1)
        for index, chart in enumerate(table.charts):
            row, column = divmod(index, 2)
            chart_object = _add_chart(self.book, table, chart)
            chart_object.set_size({"width": width - gap, "height": height - gap})
            offset = {"x_offset": column * width, "y_offset": row * height, "object_position": 3}
            sheet.insert_chart(top, left, chart_object, offset)


def make_unique_headings(headings: Sequence[str]) -> list[str]:
    """Make headings valid for a table of Excel: unique regardless of case, and not empty.

    A heading has at most 250 characters, and a number if it would repeat another heading.
    """
    unique_headings: dict[str, str] = {}
    for heading in headings:
        printable_heading = replace_unprintable(heading)[:250] or "column"
        unique_heading, count = printable_heading, 1
        while unique_heading.casefold() in unique_headings:
            count += 1
            unique_heading = f"{printable_heading} {count}"
        unique_headings[unique_heading.casefold()] = unique_heading
    return list(unique_headings.values())


def _write_text(sheet: Any, row: int, column: int, text: str, cell_format: Any) -> None:
    """Write a text, with unprintable characters replaced, to a cell."""
    sheet.write_string(row, column, replace_unprintable(text), cell_format)


def _compute_widths(table: Table, wrapped_headings: Sequence[str]) -> list[int]:
    """Compute the width of each column, characters: that of its longest text, within limits."""
    button_width, max_wrapped_width, max_width = 3, 46, 34  # the button is beside the heading
    widths = [max(8, *map(len, heading.split(" "))) + button_width for heading in table.headings]
    for row in table.rows:
        for column, value in enumerate(row):
            text = value.text if isinstance(value, Cell) else value
            if isinstance(text, str):
                widths[column] = max(widths[column], len(text) + 1)
    is_wrapped = [heading in wrapped_headings for heading in table.headings]
    limits = [max_wrapped_width if wraps else max_width for wraps in is_wrapped]
    return list(map(min, widths, limits))


def _add_chart(book: Any, table: Table, chart: Chart) -> Any:
    """Add a chart of the columns of a table to a workbook."""
    max_lines = 12  # more lines could not be distinguished
    chart_object = book.add_chart({"type": "scatter", "subtype": "straight"})
    x, y = (table.headings.index(heading) for heading in (chart.x, chart.y))
    for index, (name, (first, last)) in enumerate(list(chart.lines.items())[:max_lines]):
        dash = _CHART_DASHES[index // len(_CHART_COLOURS) % len(_CHART_DASHES)]
        colour = _CHART_COLOURS[index % len(_CHART_COLOURS)]
        chart_object.add_series({
            "name": _escape_formula(name),
            "categories": [table.title, first + 1, x, last + 1, x],
            "values": [table.title, first + 1, y, last + 1, y],
            "line": {"color": colour, "width": 1.5, "dash_type": dash},
        })  # fmt: skip
    options: dict[str, Any] = {
        "name_font": {"bold": False, "size": 10}, "num_font": {"size": 9}, "num_format": "General",
        "major_gridlines": {"visible": True, "line": {"color": "#e0e0e0", "width": 0.5}},
    }  # fmt: skip
    options |= {"log_base": 10, "crossing": "min"} if chart.is_log else {}
    set_x, set_y = chart_object.set_x_axis, chart_object.set_y_axis
    for set_axis, heading in ((set_x, chart.x), (set_y, chart.y)):
        set_axis({"name": _escape_formula(heading[:1].upper() + heading[1:]), **options})
    title = {"name": _escape_formula(chart.title), "name_font": {"bold": False, "size": 11}}
    chart_object.set_title(title if chart.title else {"none": True})
    chart_object.set_legend({"position": "right", "font": {"size": 9}})
    return chart_object


def _escape_formula(text: str) -> str:
    """Precede an initial ``=`` with a thin space, so that a chart does not show a formula."""
    return re.sub("^=", "\u200a=", replace_unprintable(text))
