"""``labpipe report``."""

from __future__ import annotations

import argparse
import sys

from labpipe.cli.telling import reading, report_table
from labpipe.pipeline.reporting import BY_TYPE, Reported, Wanted, report_tests
from labpipe.pipeline.targets import find_results
from labpipe.records.result import Status


def run(options: argparse.Namespace) -> int:
    """Put processed tests together into a page, figures and a workbook."""
    files = find_results(options.paths)
    with reading(len(files)) as say:
        reported = report_tests(
            files, out=options.out, title=options.title, say=say, wanted=_wanted(options)
        )
    print(report_table(reported))
    return status_of(reported)


def _wanted(options: argparse.Namespace) -> Wanted:
    """Groups and comparisons as they were typed."""
    by = tuple(dict.fromkeys(filter(None, map(str.strip, options.by.split(",")))))
    return Wanted(by or BY_TYPE.by, options.compare, options.wire)


def status_of(reported: Reported) -> int:
    """Exit status: 2 where a test could not be read, 1 where a result failed, else 0."""
    for reason in reported.campaign.left_out.values():
        print(f"labpipe report: left out: {reason}", file=sys.stderr)
    if reported.campaign.left_out:
        return 2
    samples = [sample for group in reported.campaign.groups for sample in group.samples]
    failed = any(each.status is Status.FAILED for sample in samples for each in sample.results)
    return 1 if failed else 0
