"""``labpipe new``."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from labpipe.errors import UsageError, error_text
from labpipe.process.sheet_writing import InferredSheet, new_from_sheet, new_seen

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
    """Write test sheets: by what lies in a folder and by options, or from a campaign sheet."""
    if options.sheet is not None:
        made = new_from_sheet(options.sheet, options.folder, overwrite=options.overwrite)
        for path in made.written:
            print(f"wrote {path}")
            absent = ", ".join(made.absent.get(path, ()))
            if absent:
                print(f"  not there yet: {absent}")
        for path in made.kept:
            print(f"kept  {path}: it was there already; --overwrite replaces it")
        return 0
    given = {name: getattr(options, name) for name in _OPTIONS}
    values = {name: value for name, value in given.items() if value is not None}
    for change in options.set:
        key, equals, value = change.partition("=")
        if not equals:
            message = error_text(
                "--set", "", expected="KEY=VALUE", found=change, remedy="Such as rig.cycles=1."
            )
            raise UsageError(message)
        values[key.strip()] = value.strip()
    told: set[str] = set()
    for sheet in new_seen(options.folder, values, overwrite=options.overwrite):
        print(_about(sheet, told))
        told.update(sheet.said)
    return 0


def _about(sheet: InferredSheet, told: Collection[str]) -> str:
    """What became of a sheet; of what takes several lines and was told before, the first one."""
    if sheet.kept:
        return f"kept  {sheet.path}: it was there already; --overwrite replaces it"
    said = (
        sentence.partition("\n")[0] if sentence in told else sentence for sentence in sheet.said
    )
    lines = [f"wrote {sheet.path}", *(f"  {sentence}" for sentence in said)]
    if sheet.open:
        lines.append(f"  to be filled in: {', '.join(sheet.open)}")
    return "\n".join(lines)
