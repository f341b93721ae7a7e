"""``labpipe new``."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from labpipe.errors import UsageError, error_text
from labpipe.process.sheet_writing import WrittenSheet, new_from_sheet, write_inferred_sheets

_OPTIONS = (
    "protocol",
    "type",
    "spool",
    "sample",
    "length",
    "date",
    "operator",
    "force",
    "markers",
    "frame",
    "because",
)


def run(options: argparse.Namespace) -> int:
    """Write test sheets from exports and options, or from a campaign sheet."""
    if options.sheet is not None:
        for sheet in new_from_sheet(options.sheet, options.folder, overwrite=options.overwrite):
            print(_describe(sheet, ()))
        return 0
    typed = {name: getattr(options, name) for name in _OPTIONS}
    values = {name: value for name, value in typed.items() if value is not None}
    for change in options.set:
        key, equals, value = change.partition("=")
        if not equals:
            message = error_text(
                "--set", "", expected="KEY=VALUE", found=change, remedy="For example: rig.cycles=1."
            )
            raise UsageError(message)
        values[key.strip()] = value.strip()
    printed: set[str] = set()
    for sheet in write_inferred_sheets(options.folder, values, overwrite=options.overwrite):
        print(_describe(sheet, printed))
        printed.update(sheet.remarks)
    return 0


def _describe(sheet: WrittenSheet, printed: Collection[str]) -> str:
    """Describe a sheet; of a long message that was printed before, only the first line."""
    if sheet.kept:
        return f"kept  {sheet.path}: it exists already; --overwrite replaces it"
    sentences = (
        sentence.partition("\n")[0] if sentence in printed else sentence
        for sentence in sheet.remarks
    )
    lines = [f"wrote {sheet.path}", *(f"  {sentence}" for sentence in sentences)]
    if sheet.open:
        lines.append(f"  to fill in: {', '.join(sheet.open)}")
    return "\n".join(lines)
