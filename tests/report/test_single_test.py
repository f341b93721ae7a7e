from __future__ import annotations

import re
from dataclasses import replace
from datetime import date

from labpipe.records.quality import Reason
from labpipe.records.result import Instrument, Status
from labpipe.report.single_test import render_test
from tests.store.builders_result import build_result


def test_who_when_with_what_and_every_number() -> None:
    cell = Instrument("force", ("force",), "LC-500", date(2025, 1, 1), date(2026, 1, 1))
    result = replace(
        build_result(half_cycle=1.0), date=date(2026, 3, 2), operator="A <b>", instruments=(cell,),
        figures=("force-displacement",),
    )  # fmt: skip
    first = replace(
        result.results[0], status=Status.DOUBTFUL, reasons=(Reason("code_1", "it slipped"),)
    )
    same = replace(result.results[1], status=Status.DOUBTFUL, reasons=first.reasons)
    page = render_test(replace(result, results=(first, same, *result.results[2:])), report="abc")
    assert "2026-03-02 by A &lt;b&gt;" in page
    assert "force LC-500 (calibrated 2025-01-01, due 2026-01-01)" in page
    assert page.count("It slipped.") == page.count("As above.") == 1
    assert 'title="code_1"' in page
    assert page.count("<svg") == 1
    for each in result.results:
        assert f'title="{each.name}"' in page
    assert "<script" not in page
    assert not re.findall(r' style="', page)
    assert all(each.sha256 in page for each in result.inputs)


def test_names_are_text_and_figures_without_data_say_so() -> None:
    bare = replace(
        build_result(half_cycle=1.0), test="<i>", curve=None, shape=None, aligned=None,
        figures=("wire-shapes",), results=(), quality=(),
    )  # fmt: skip
    page = render_test(bare)
    assert "<i>" not in page
    assert "<h1>&lt;i&gt;</h1>" in page
    assert "There is no shape to draw" in page
