from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.campaign.report_samples import sample_of
from labpipe.campaign.test_pages import page_of_test, pages_of
from labpipe.errors import StoreError
from labpipe.records.group import Campaign
from labpipe.report.page_facts import report_id
from labpipe.store.read import Drawable, read_result
from labpipe.store.write import write_result
from tests.builders.campaigns import build_group
from tests.store.builders_result import build_result


def test_a_page_for_each_test_with_the_id_of_the_report(tmp_path: Path) -> None:
    file = tmp_path / "result.h5"
    write_result(replace(build_result(half_cycle=1.0), figures=()), file)
    sample = sample_of(Drawable(read_result(file), None, None), source=str(file), label="c/<x>")
    group = replace(build_group("A", []), samples=(sample,))
    campaign = Campaign("S", (group,), rejected_samples=(replace(sample, label="c/y"),))
    pages = pages_of(campaign)
    assert list(pages) == ["tests/c__<x>.html", "tests/c__y.html"]
    for page in pages.values():
        assert f"report {report_id(campaign)}" in page.replace("\\20 ", " ")
    assert f"<h1>{sample.test}</h1>" in page_of_test(file)


def test_a_result_that_is_gone(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="expected a result file, found nothing"):
        page_of_test(tmp_path / "result.h5")
