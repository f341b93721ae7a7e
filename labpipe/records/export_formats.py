"""Formats of exports: one line each, in the order in which a file is asked for them."""

from __future__ import annotations

from typing import Final, NamedTuple


class ExportFormat(NamedTuple):
    """A format that labpipe reads.

    Parameters
    ----------
    name : as protocols write it
    module : that reads it; imported when it is asked
    is_text, is_workbook : whether its files can be texts or binary files of their own, and whether
        they can be workbooks
    has_markers : whether its exports hold marker tracks rather than channels
    """

    name: str
    module: str
    is_text: bool = True
    is_workbook: bool = False
    has_markers: bool = False


EXPORT_FORMATS: Final = (
    ExportFormat("dspace-mat", "labpipe.readers.dspace_mat"),
    ExportFormat("dspace-csv", "labpipe.readers.dspace_csv"),
    ExportFormat("dspace-mf4", "labpipe.readers.dspace_mf4"),
    ExportFormat("motive-csv", "labpipe.readers.motive_takes", has_markers=True),
    ExportFormat("motive-xlsx", "labpipe.readers.motive_takes", False, True, has_markers=True),
    ExportFormat("load-frame", "labpipe.readers.load_frame", is_workbook=True),
)
