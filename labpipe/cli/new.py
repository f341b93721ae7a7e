"""``labpipe new``: write test sheets."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from labpipe.errors import UsageError
from labpipe.process.sheet_writing import WrittenSheet, write_inferred_sheets, write_table_sheets

_OTHER_OPTIONS = {"command", "folder", "sheet", "set", "overwrite"}
"""Options that are not values of a test sheet."""


def run(options: argparse.Namespace) -> int:
    """Write test sheets from exports and options, or from a campaign sheet."""
    if options.sheet is not None:
        for sheet in write_table_sheets(options.sheet, options.folder, overwrite=options.overwrite):
            print(_describe_sheet(sheet, ()))
        return 0
    values = {
        name: value
        for name, value in vars(options).items()
        if name not in _OTHER_OPTIONS and value is not None
    }
    for change in options.set:
        key, equals, value = change.partition("=")
        if not equals:
            raise UsageError.about("cli.bad_set", "--set", found=change)
        values[key.strip()] = value.strip()
    printed_remarks: set[str] = set()
    for sheet in write_inferred_sheets(options.folder, values, overwrite=options.overwrite):
        print(_describe_sheet(sheet, printed_remarks))
        printed_remarks.update(sheet.remarks)
    return 0


def _describe_sheet(sheet: WrittenSheet, printed_remarks: Collection[str]) -> str:
    """Describe a sheet; a remark that was printed before is shortened to its first line."""
    if sheet.is_kept:
        return f"kept  {sheet.path}: it exists already; --overwrite replaces it"
    lines = [f"wrote {sheet.path}"]
    for remark in sheet.remarks:
        text = remark.partition("\n")[0] if remark in printed_remarks else remark
        lines.append(f"  {text}")
    if sheet.open_keys:
        lines.append(f"  to fill in: {', '.join(sheet.open_keys)}")
    return "\n".join(lines)
