"""The results of a calibration as a workbook, for people who go on calculating with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.errors import StoreError, complaint
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_tables import tables_of
from labpipe.report.wire_workbook import Sheet, _add, _heading

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook

_READ_ME = "read me"
_ABOUT = (
    "Calibration of the wire model by first loadings of cantilevers. Numbers are in the units of"
    " their row or heading, with all digits. An empty cell: no such number.",
    "Sheet 'summary': the parameters. Lower and upper are the ends of 95 % intervals by profile"
    " likelihood; where one is open, the end of its search stands there.",
    "Sheet 'fit': what the calibration rests on, and what 'method: source' makes of the tests.",
    "Sheet 'identified': a combination with singular value s is known to 1 / s in logarithms; below"
    " 1 the tests do not determine it.",
    "Sheet 'agreement': model against the mean of the samples, for wires and lengths that it was"
    " calibrated by and for others that it foretells. SSE grows with the number of points.",
    "Sheet 'curves': each test against the model without the sample's own factor. A sheet for each"
    " wire and length holds mean, model and samples; 'lower' and 'upper' of the mean are its 95 %"
    " band by Student's t with n - 1 degrees of freedom.",
)


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write a calibration as an xlsx file.

    Parameters
    ----------
    report : all of it
    path : of the file

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    Text stays text: a test that is called ``=1+1`` is not a formula. Numbers that are not finite
    are empty cells. Characters that a workbook cannot hold are shown as U+FFFD.
    """
    try:
        with path.open("wb") as file:  # first: a book that was begun has to be saved
            _book(report).save(file)
    except OSError as error:
        message = complaint(
            path,
            "",
            expected="a workbook that can be written",
            found=str(error),
            remedy="Make room, change the permissions, or close it where it is open, and calibrate"
            " again.",
        )
        raise StoreError(message) from error


def _book(report: CalibrationReport) -> Workbook:
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    book.add_named_style(_heading())
    _add(book, Sheet(_READ_ME, ("About",), [(line,) for line in _ABOUT]))
    for sheet in tables_of(report, [_READ_ME]):
        _add(book, sheet)
    book.active = 1
    return book
