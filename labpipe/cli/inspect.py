"""``labpipe inspect``: contents of an export."""

from __future__ import annotations

import argparse
import json


def run(options: argparse.Namespace) -> int:
    """Print channels, rates, gaps and oddities of an export."""
    from labpipe.process.inspection import as_json, as_text, inspect_export

    inspection = inspect_export(options.file)
    print(json.dumps(as_json(inspection), indent=2) if options.json else as_text(inspection))
    return 0
