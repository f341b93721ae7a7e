"""Pages of single tests from their result files."""

from __future__ import annotations

from pathlib import Path

from labpipe.records.group import Campaign
from labpipe.report.page_facts import report_id, samples_of
from labpipe.report.page_tests import page_file
from labpipe.report.single_test import render_test
from labpipe.store.read import read_result


def page_of_test(file: Path, report: str = "") -> str:
    """Make the page of a test: facts, numbers and figures.

    Parameters
    ----------
    file : its result.h5
    report : id of the report that links to it; empty for none

    Returns
    -------
    A self-contained HTML document without scripts.

    Raises
    ------
    StoreError
        If the result cannot be read.
    """
    return render_test(read_result(file), report=report)


def pages_of(campaign: Campaign) -> dict[str, str]:
    """Make the pages of all tests of a report, including rejected ones.

    Parameters
    ----------
    campaign : with its groups

    Returns
    -------
    Pages by address below the report.
    """
    report = report_id(campaign)
    return {
        page_file(sample.label or sample.test): page_of_test(Path(sample.source), report)
        for sample in (*samples_of(campaign), *campaign.rejected_samples)
    }
