"""Write a load-frame record as a workbook of the TestResources kind: time s, force lbf, travel in.

No real export was at hand: that there are these three quantities in these units is known, sheet
name, names of columns and rows above them are made up. The first row, the title of the workbook
and its description say that the file is synthetic.
"""

from __future__ import annotations

import io
import re
import zipfile
from datetime import datetime
from pathlib import Path

from openpyxl import Workbook

from labpipe.virtual_lab.tensile_record import FrameRecord

NEWTONS_PER_POUND, METRES_PER_INCH = 4.4482216152605, 0.0254
HEADER = ("Time (s)", "Force (lbf)", "Displacement (in)")
SHEET = "Test Data"
_DIGITS = 6
_OLDEST = (1980, 1, 1, 0, 0, 0)  # the first date that a zip archive can hold


def write_r_controller(
    path: Path, record: FrameRecord, *, name: str, started: datetime, seed: int
) -> None:
    """Write a record; the same record gives the same bytes.

    Parameters
    ----------
    path : the file
    record : what the controller measured
    name : of the test
    started : time for the head of the sheet and the properties of the workbook
    seed : for the note that the test is synthetic
    """
    note = f"SYNTHETIC: made by labpipe's virtual lab, seed {seed}, not a measurement"
    book = Workbook(write_only=True)
    properties = book.properties
    properties.title, properties.description, properties.creator = name, note, "labpipe virtual lab"
    properties.created = started
    sheet = book.create_sheet(SHEET)
    for row in ((note,), ("Test", name), ("Date", f"{started:%m/%d/%Y %H:%M:%S}"), (), HEADER):
        sheet.append(row)
    for values in zip(*_columns(record), strict=True):
        sheet.append(values)
    buffer = io.BytesIO()
    book.save(buffer)
    path.write_bytes(_without_dates(buffer.getvalue(), started))


def _columns(record: FrameRecord) -> tuple[list[float], ...]:
    """The three columns in the units of the file, to the digits of its cells."""
    scaled = (
        record.time,
        record.force / NEWTONS_PER_POUND,
        record.displacement / METRES_PER_INCH,
    )
    return tuple((column.round(_DIGITS) + 0.0).tolist() for column in scaled)


def _without_dates(book: bytes, started: datetime) -> bytes:
    """Replace the moment of writing by the date of the test: equal tests are equal files."""
    stamp = f">{started:%Y-%m-%dT%H:%M:%SZ}</dcterms:modified>".encode("ascii")
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(book)) as old,
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for member in old.namelist():
            content = re.sub(rb">[^<]*</dcterms:modified>", stamp, old.read(member))
            new.writestr(zipfile.ZipInfo(member, _OLDEST), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
