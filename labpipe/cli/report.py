"""``labpipe report``: write means, figures and tables of many tests."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from labpipe.campaign.reporting import ReportOptions, WrittenReport, report_tests
from labpipe.cli.terminal import compute_name_width, format_result, shorten_path, show_completion
from labpipe.errors import UsageError, sort_by_likeness
from labpipe.process.output_paths import find_results
from labpipe.records.group import GroupNumber
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.figure_page import FORMATS
from labpipe.report.lab_report import read_logo
from labpipe.report.wording import describe_counts


def run(options: argparse.Namespace) -> int:
    """Write the report of processed tests: a page, figures and a workbook."""
    files, report_options = find_results(options.paths), parse_report_options(options)
    with show_completion("test", len(files) + 1, in_pipe=False) as (_, say):
        report = report_tests(files, out=options.out, say=say, options=report_options)
    print(format_report(report))
    return print_left_out_tests(report)


def parse_report_options(options: argparse.Namespace) -> ReportOptions:
    """Convert the options of a command to those of a report.

    Parameters
    ----------
    options : options of ``labpipe report`` or ``labpipe serve``

    Raises
    ------
    UsageError
        If a format of figures is unknown, or the logo is not a PNG or JPEG of the allowed size.
    """
    formats = _split_list(getattr(options, "figures", ""))
    unknown_formats = [name for name in formats if name not in FORMATS]
    if unknown_formats:
        raise UsageError.about(
            "cli.figure_format", "--figures", known=", ".join(FORMATS),
            found=", ".join(map(repr, unknown_formats)),
            near=sort_by_likeness(unknown_formats[0], list(FORMATS), limit=1)[0],
        )  # fmt: skip
    letterhead = {"Lab": options.lab, "Customer": options.customer, "Order": options.order}
    logo = "" if options.logo is None else read_logo(options.logo)
    return ReportOptions(
        title=options.title,
        by=_split_list(options.by),
        alone=options.compare,
        wires=options.wire,
        letterhead={name: text for name, text in letterhead.items() if text},
        logo=logo,
        formats=formats,
        has_test_pages=getattr(options, "pages", False),
    )


def _split_list(text: str) -> tuple[str, ...]:
    """Split a comma-separated option into its distinct entries."""
    return tuple(dict.fromkeys(filter(None, map(str.strip, text.split(",")))))


def print_left_out_tests(report: WrittenReport) -> int:
    """Print the reasons why tests are left out of a report, and choose the exit status.

    Parameters
    ----------
    report : written report

    Returns
    -------
    Exit status: 2 if a test is left out, 1 if a result failed, 0 otherwise.
    """
    for reason in report.campaign.failures.values():
        print(f"labpipe report: left out: {reason}", file=sys.stderr)
    if report.campaign.failures:
        return 2
    samples = [sample for group in report.campaign.groups for sample in group.samples]
    statuses = {result.status for sample in samples for result in sample.results}
    return 1 if Status.FAILED in statuses else 0


def format_report(report: WrittenReport) -> str:
    """Format the main results of a report for a terminal.

    Parameters
    ----------
    report : written report

    Returns
    -------
    A heading per group, one line per result with its interval, rejected tests, and the path of the
    report.
    """
    lines: list[str] = []
    for group in report.campaign.groups:
        lines.append(f"{group.name}  ({group.protocol}): {describe_counts(group)}")
        display = dict(group.samples[0].display) if group.samples else {}
        width = compute_name_width(number.name for number in group.numbers)
        lines += [_format_mean(number, display, width) for number in group.numbers]
        lines.append("")
    for file, reason in report.campaign.rejected.items():
        from labpipe.campaign.queries import escape_controls  # imports the catalog

        folder = shorten_path(Path(file).absolute().parent)
        lines.append(f"rejected: {folder}: {escape_controls(reason)}")
    page = shorten_path(report.files[0]) if report.files else "nothing written"
    return "\n".join([*lines, f"report: {page}"])


def _format_mean(number: GroupNumber, display: Mapping[str, str], width: int) -> str:
    """Format the mean of a result of a group, with the number of samples without the result."""
    mean = number.mean.chosen
    result = Result(number.name, mean.mean, number.unit, mean.interval, estimate=mean.estimate)
    if not number.values:
        reasons = (Reason("no_samples", "no sample has this result"),)
        result = Result(number.name, None, number.unit, status=Status.FAILED, reasons=reasons)
    remark = f"  ({len(number.exclusions)} without)" if number.exclusions else ""
    return f"{format_result(result, display, width)}{remark}"
