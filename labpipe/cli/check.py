"""``labpipe check``: find faults of protocols and test sheets without processing."""

from __future__ import annotations

import argparse
import sys

from labpipe.process.checking import check_paths
from labpipe.report.wording import format_count


def run(options: argparse.Namespace) -> int:
    """Print the faults of protocols, test sheets, exports and plans, without processing."""
    report = check_paths(options.paths, follow_links=options.follow_links)
    for fault in report.faults:
        print(fault, file=sys.stderr)
    verdict = format_count(len(report.faults), "fault") if report.faults else "no faults found"
    counts = [
        format_count(len(report.protocols), "protocol"),
        format_count(len(report.tests), "test"),
    ]
    counts += [format_count(len(report.plans), "plan")] if report.plans else []
    print(f"{', '.join(counts)}: {verdict}")
    return 2 if report.faults else 0
