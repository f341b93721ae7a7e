"""``labpipe inspect``."""

from __future__ import annotations

import argparse
import json

from labpipe.readers.workbooks import begin_sheets


def run(options: argparse.Namespace) -> int:
    """Say what an export holds."""
    begin_sheets(options.file)  # parsing lets go of the interpreter; the rest is imported meanwhile
    from labpipe.process.inspection import as_json, as_text, inspect_export

    found = inspect_export(options.file)
    print(json.dumps(as_json(found), indent=2) if options.json else as_text(found))
    return 0
