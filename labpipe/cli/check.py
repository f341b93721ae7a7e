"""``labpipe check``."""

from __future__ import annotations

import argparse
import sys

from labpipe.process.checking import check_paths


def run(options: argparse.Namespace) -> int:
    """Print the faults of protocols and tests, without processing."""
    checked = check_paths(options.paths, follow_links=options.follow_links)
    for fault in checked.faults:
        print(fault, file=sys.stderr)
    faults = len(checked.faults)
    verdict = f"{faults} fault{'' if faults == 1 else 's'}" if faults else "no faults found"
    count = len(checked.plans)
    plans = f", {count} plan{'' if count == 1 else 's'}" if count else ""
    print(f"{len(checked.protocols)} protocols, {len(checked.tests)} tests{plans}: {verdict}")
    return 2 if faults else 0
