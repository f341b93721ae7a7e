"""The results of a calibration as a workbook, for people who go on calculating with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_tables import tables_of
from labpipe.report.sheets import Sheet, save_sheets

_READ_ME = "read me"
_ABOUT = (
    "Calibration of the wire model by first loadings of cantilevers. Numbers are in the units of"
    " their row or heading, with all digits. An empty cell: no such number.",
    "Sheet 'summary': the parameters. Lower and upper are the ends of 95 % intervals by profile"
    " likelihood; where one is open, the end of its search stands there.",
    "Sheet 'fit': what the calibration rests on, and what 'method: source' makes of the tests.",
    "Sheet 'identified': a combination with singular value s is known to 1 / s in logarithms; below"
    " 1 the tests do not determine it.",
    "Sheet 'agreement': model against all points of the samples, for wires and lengths that it was"
    " calibrated by and for others that it foretells. SSE grows with the number of points; the band"
    " is that of one more sample.",
    "Sheet 'curves': each test against the model without the sample's own factor. A sheet for each"
    " wire and length holds mean, model and samples; 'lower' and 'upper' of the mean are its 95 %"
    " band by Student's t with n - 1 degrees of freedom.",
    "Sheets 'third curves': curves from elsewhere, if the plan names some, against the mean of the"
    " tests and against the model, at their own deflections and never beyond either.",
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
    """
    save_sheets(_sheets(report), path, again="calibrate", active=1)


def _sheets(report: CalibrationReport) -> Iterator[Sheet]:
    yield Sheet(_READ_ME, ("About",), [(line,) for line in _ABOUT])
    yield from tables_of(report, [_READ_ME])
