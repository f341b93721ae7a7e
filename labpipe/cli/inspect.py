"""``labpipe inspect``: print the contents of an export."""

from __future__ import annotations

import argparse
import json


def run(options: argparse.Namespace) -> int:
    """Print the channels, sampling rates, gaps and other findings of an export."""
    from labpipe.process.inspection import format_inspection, inspect_export, make_inspection_record

    inspection = inspect_export(options.file)
    record = make_inspection_record(inspection)
    print(json.dumps(record, indent=2) if options.json else format_inspection(inspection))
    return 0
