"""``labpipe new``: write test sheets."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from labpipe.errors import UsageError
from labpipe.process.sheet_writing import WrittenSheet, write_inferred_sheets, write_table_sheets

_OPTIONS_WITHOUT_VALUE = {"command", "folder", "sheet", "set", "overwrite"}
"""Options that state no value of a test sheet."""


def run(options: argparse.Namespace) -> int:
    """Write test sheets from exports and options, or from a campaign sheet."""
    if options.sheet is not None:
        for sheet in write_table_sheets(options.sheet, options.folder, overwrite=options.overwrite):
            print(_describe(sheet, ()))
        return 0
    values = {
        name: value
        for name, value in vars(options).items()
        if name not in _OPTIONS_WITHOUT_VALUE and value is not None
    }
    for change in options.set:
        key, equals, value = change.partition("=")
        if not equals:
            raise UsageError.about("cli.bad_set", "--set", found=change)
        values[key.strip()] = value.strip()
    printed: set[str] = set()
    for sheet in write_inferred_sheets(options.folder, values, overwrite=options.overwrite):
        print(_describe(sheet, printed))
        printed.update(sheet.remarks)
    return 0


def _describe(sheet: WrittenSheet, printed: Collection[str]) -> str:
    """Describe a sheet; of a remark that was printed already, only the first line."""
    if sheet.is_kept:
        return f"kept  {sheet.path}: it exists already; --overwrite replaces it"
    remarks = [
        remark.partition("\n")[0] if remark in printed else remark for remark in sheet.remarks
    ]
    lines = [f"wrote {sheet.path}", *(f"  {remark}" for remark in remarks)]
    if sheet.open_keys:
        lines.append(f"  to fill in: {', '.join(sheet.open_keys)}")
    return "\n".join(lines)
