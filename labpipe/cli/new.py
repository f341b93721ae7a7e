"""``labpipe new``."""

from __future__ import annotations

import argparse

from labpipe.errors import UsageError, complaint
from labpipe.process.new_sheets import new_from_sheet, new_test

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
    """Write one test sheet from options, or one per row of a campaign sheet."""
    if options.sheet is not None:
        made = new_from_sheet(options.sheet, options.folder, overwrite=options.overwrite)
        for path in made.written:
            print(f"wrote {path}")
        for path in made.kept:
            print(f"kept  {path}: it was there already; --overwrite replaces it")
        return 0
    given = {name: getattr(options, name) for name in _OPTIONS}
    values = {name: value for name, value in given.items() if value is not None}
    for change in options.set:
        key, equals, value = change.partition("=")
        if not equals:
            message = complaint(
                "--set", "", expected="KEY=VALUE", found=change, remedy="Such as rig.cycles=1."
            )
            raise UsageError(message)
        values[key.strip()] = value.strip()
    print(f"wrote {new_test(options.folder, values, overwrite=options.overwrite)}")
    return 0
