"""``labpipe report``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from labpipe.campaign.queries import escaped
from labpipe.campaign.reporting import ReportContext, Reported, ReportOptions, report_tests
from labpipe.cli.terminal import from_here, name_width, reading, result_line
from labpipe.errors import UsageError, error_text, nearest
from labpipe.process.output_paths import find_results
from labpipe.records.group import GroupNumber
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.lab_report import Letterhead
from labpipe.report.logo import read_logo
from labpipe.report.saving import FORMATS


def run(options: argparse.Namespace) -> int:
    """Put processed tests together into a page, figures and a workbook."""
    files, beside = find_results(options.paths), _beside(options)
    with reading(len(files)) as say:
        reported = report_tests(
            files,
            out=options.out,
            title=options.title,
            say=say,
            wanted=wanted_by(options),
            beside=beside,
        )
    print(report_table(reported))
    return status_of(reported)


def wanted_by(options: argparse.Namespace) -> ReportOptions:
    """Read groups and comparisons as they were typed.

    Parameters
    ----------
    options : of ``labpipe report``
    """
    by = tuple(dict.fromkeys(filter(None, map(str.strip, options.by.split(",")))))
    return ReportOptions(by, options.compare, options.wire)


def letterhead_of(options: argparse.Namespace) -> Letterhead:
    """Who a report is from and for, as it was typed.

    Parameters
    ----------
    options : with lab, customer, order and logo

    Raises
    ------
    UsageError
        If the logo is no picture that a page can show.
    """
    words = {"Lab": options.lab, "Customer": options.customer, "Order": options.order}
    logo = "" if options.logo is None else read_logo(options.logo)
    return Letterhead(tuple((name, said) for name, said in words.items() if said), logo)


def _beside(options: argparse.Namespace) -> ReportContext:
    """Letterhead, figures as files and pages of tests, as they were typed."""
    wanted = tuple(dict.fromkeys(filter(None, map(str.strip, options.figures.split(",")))))
    unknown = [each for each in wanted if each not in FORMATS]
    if unknown:
        message = error_text(
            "--figures",
            "",
            expected=f"some of {', '.join(FORMATS)}",
            found=", ".join(map(repr, unknown)),
            remedy=f"Write {nearest(unknown[0], list(FORMATS), most=1)[0]}, or another of them.",
        )
        raise UsageError(message)
    return ReportContext(letterhead_of(options), wanted, options.pages)


def status_of(reported: Reported) -> int:
    """Exit status: 2 where a test could not be read, 1 where a result failed, else 0."""
    for reason in reported.campaign.left_out.values():
        print(f"labpipe report: left out: {reason}", file=sys.stderr)
    if reported.campaign.left_out:
        return 2
    samples = [sample for group in reported.campaign.groups for sample in group.samples]
    failed = any(result.status is Status.FAILED for sample in samples for result in sample.results)
    return 1 if failed else 0


def report_table(reported: Reported) -> str:
    """Lay out the main numbers of a report for a terminal.

    Parameters
    ----------
    reported : the report

    Returns
    -------
    A heading per group, one line per number with its interval, then where the files are.
    """
    lines: list[str] = []
    for group in reported.campaign.groups:
        spools = {sample.specimen.spool for sample in group.samples}
        count = f"{_several(len(group.samples), 'sample')} from {_several(len(spools), 'spool')}"
        lines.append(f"{group.name}  ({group.protocol}): {count}")
        display = dict(group.samples[0].display) if group.samples else {}
        width = name_width(number.name for number in group.numbers)
        lines += [_mean_line(number, display, width) for number in group.numbers]
        lines.append("")
    for file, why in reported.campaign.rejected.items():
        lines.append(f"rejected: {from_here(Path(file).absolute().parent)}: {escaped(why)}")
    lines.append(
        f"report: {from_here(reported.files[0])}" if reported.files else "report: nothing written"
    )
    return "\n".join(lines)


def _several(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _mean_line(number: GroupNumber, display: Mapping[str, str], width: int) -> str:
    mean = number.mean.chosen if number.mean is not None else None
    value = mean.mean if mean is not None else None
    interval = mean.interval if mean is not None else None
    status = Status.FAILED if value is None else Status.OK
    reasons = (Reason("no_samples", "no sample has it"),) if value is None else ()
    as_result = Result(
        number.name,
        value,
        number.unit,
        interval,
        status,
        reasons,
        estimate=mean.estimate if mean is not None else None,
    )
    missing = f"  ({len(number.left_out)} without)" if number.left_out else ""
    return f"{result_line(as_result, display, width)}{missing}"
