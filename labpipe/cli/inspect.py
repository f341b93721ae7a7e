"""``labpipe inspect``."""

from __future__ import annotations

import argparse
import json

from labpipe.pipeline.inspection import as_json, as_text, inspect_export


def run(options: argparse.Namespace) -> int:
    """Say what an export holds."""
    found = inspect_export(options.file)
    print(json.dumps(as_json(found), indent=2) if options.json else as_text(found))
    return 0
