"""``labpipe check``: find faults of protocols and test sheets without processing."""

from __future__ import annotations

import argparse
import sys

from labpipe.process.checking import check_paths
from labpipe.report.wording import write_count


def run(options: argparse.Namespace) -> int:
    """Print the faults of protocols and tests, without processing."""
    checked = check_paths(options.paths, follow_links=options.follow_links)
    for fault in checked.faults:
        print(fault, file=sys.stderr)
    faults = write_count(len(checked.faults), "fault") if checked.faults else "no faults found"
    plans = f", {write_count(len(checked.plans), 'plan')}" if checked.plans else ""
    print(f"{len(checked.protocols)} protocols, {len(checked.tests)} tests{plans}: {faults}")
    return 2 if checked.faults else 0
