"""``labpipe campaign``."""

from __future__ import annotations

import argparse

from labpipe.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Do what is asked of a campaign."""
    message = f"labpipe campaign {options.action} is not there yet"
    raise UsageError(message)
