"""``labpipe check``: find faults of protocols and test sheets without processing."""

from __future__ import annotations

import argparse
import sys

from labpipe.process.checking import check_paths
from labpipe.report.wording import format_count


def run(options: argparse.Namespace) -> int:
    """Print the faults of protocols and tests, without processing."""
    report = check_paths(options.paths, follow_links=options.follow_links)
    for fault in report.faults:
        print(fault, file=sys.stderr)
    verdict = format_count(len(report.faults), "fault") if report.faults else "no faults found"
    plans = f", {format_count(len(report.plans), 'plan')}" if report.plans else ""
    print(f"{len(report.protocols)} protocols, {len(report.tests)} tests{plans}: {verdict}")
    return 2 if report.faults else 0
