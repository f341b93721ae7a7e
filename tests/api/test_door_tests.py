"""One test, its parts, its page in a notebook, exports, and paths of any kind."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import date
from pathlib import Path

import pandas as pd
import pytest

from labpipe.api.data_frames import parse_path, parse_paths
from labpipe.api.one_test import Test, inspect
from labpipe.errors import ProcessingError, ReadError, UsageError
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Specimen, TestResult
from labpipe.store.summaries import build_summary
from tests.builders.small_tests import Lab, Run
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    built = build_result(half_cycle=1.0)
    return replace(built, date=date(2026, 3, 4), operator="lab")


@pytest.fixture(scope="module")
def test(result: TestResult) -> Test:
    return Test(result)


def test_facts_of_a_test(test: Test, result: TestResult) -> None:
    assert (test.name, test.protocol, test.operator) == ("A2-085-1", "wire-cantilever", "lab")
    assert (test.date, test.instruments, test.folder) == (date(2026, 3, 4), (), None)
    assert test.specimen.dimensions == {"length": 0.085}
    assert test.summary == build_summary(result)
    assert test.figures == result.figures
    assert repr(test) == "<labpipe test A2-085-1 (wire-cantilever): 1 ok, 1 doubtful, 1 failed>"
    assert test._repr_html_().startswith("<div>")


def test_display_does_not_change_the_test(test: Test) -> None:
    shown = test.display
    assert shown.results.loc["residual_displacement.1", "unit"] == "mm"
    assert shown.results.loc["residual_displacement.1", "value"] == pytest.approx(3.1)
    assert shown.curve.attrs["units"]["displacement"] == "mm"
    assert shown.shape.attrs["units"]["position"] == "mm"
    assert shown.raw["force/HostService"].equals(test.raw["force/HostService"])
    assert test.results.loc["residual_displacement.1", "unit"] == "m"
    assert shown.budget("peak_force.1").equals(test.budget("peak_force.1"))


def test_shapes_and_recordings_are_read_on_first_use(result: TestResult) -> None:
    readings = []

    def whole() -> TestResult:
        readings.append(1)
        return result

    test = Test(replace(result, shape=None, recordings={}), read_full=whole)
    assert isinstance(test.curve, pd.DataFrame)
    assert len(test.results) == 3
    assert readings == []
    assert len(test.shape) == len(test.raw["markers"])
    assert len(test.display.raw) == 5
    assert readings == [1]


def test_unknown_names_are_refused(test: Test) -> None:
    with pytest.raises(UsageError, match=r"A2-085-1: expected a result such as peak_force\.1, .*"):
        test.budget("peak_forse.1")
    with pytest.raises(UsageError, match=r"expected a figure such as .*wire-shapes.*found 'shape'"):
        test.figure("shape")


def test_missing_parts_are_refused(result: TestResult) -> None:
    note = QualityNote("no_branches", Severity.ERROR, "force", "The motion never turns.")
    without_curve = Test(replace(result, curve=None, shape=None, quality=(note,)))
    with pytest.raises(ProcessingError, match=r"expected a curve, found none\. Reason: The motion"):
        _ = without_curve.curve
    with pytest.raises(ProcessingError, match="expected a shape, found none"):
        _ = without_curve.shape
    without_results = Test(replace(result, results=(), quality=()))
    assert repr(without_results) == "<labpipe test A2-085-1 (wire-cantilever): nothing>"
    with pytest.raises(UsageError, match=r"expected a result, found none\. The notes in `quality`"):
        without_results.budget("peak_force.1")


def test_export_prints_the_text_of_inspect(pristine: Lab, run: Run) -> None:
    export = pristine.raw / "force.mat"
    inspected = inspect(export)
    assert f"{inspected!r}\n" == run("inspect", export).out
    assert inspected.facts == json.loads(run("inspect", export, "--json").out)
    assert inspected.file == export


def test_tables_of_an_export(pristine: Lab) -> None:
    export = inspect(str(pristine.raw / "force.mat"))
    texts, numbers = ("clock", "name", "path", "unit", "unit_in_file"), ("first", "last")
    types = {str(name): str(kind) for name, kind in export.channels.dtypes.items()}
    expected = dict.fromkeys(texts, "str") | dict.fromkeys((*numbers, "min", "max"), "float64")
    assert types == expected | {"missing": "int64"}
    assert export.channels["path"][0] == "Model Root/Load Cell/Out1"
    assert export.channels["unit"].isna().all()  # a MAT file does not say it
    assert "units_not_stated" in export.notes["code"].tolist()
    assert list(export.data) == ["force"]
    assert len(export.data["force"]) == export.facts["streams"][0]["samples"]
    take = inspect(pristine.raw / "take.csv")
    assert (len(take.channels), next(iter(take.data))) == (0, "take")
    assert take.channels.dtypes["first"] == "float64"
    with pytest.raises(ReadError, match="expected an export of a known format"):
        inspect(pristine.sheet)


def test_parse_paths(tmp_path: Path) -> None:
    assert parse_path(str(tmp_path)) == parse_path(tmp_path) == tmp_path
    assert parse_paths(tmp_path) == parse_paths(iter([tmp_path])) == [tmp_path]
    assert parse_paths([str(tmp_path), tmp_path / "a"]) == [tmp_path, tmp_path / "a"]


def test_impossible_paths_are_refused() -> None:
    for path, message in (
        ("x" * 5000, "expected a file that can be used, found file name too long"),
        ("a\0b", r"'a\\x00b': expected a path, found embedded null"),
    ):
        with pytest.raises(UsageError, match=message):
            parse_path(path)
        with pytest.raises(UsageError, match=message):
            parse_paths([path])


RESULT = build_result(half_cycle=0.5)


def test_notebook_shows_results_in_display_units() -> None:
    page = Test(RESULT)._repr_html_()
    assert "A2-085-1" in page
    assert re.findall("<td>(.*?)</td>", page)[:5] == ["0.62", "0.59", "0.61", "N", "ok"]
    assert "<td>3.1</td>" in page
    assert "the force never fell below 5 mN" in page


def test_notebook_shows_names_as_text() -> None:
    tag = "<script>alert(1)</script>&\x07\"'"
    results = (replace(RESULT.results[0], name=tag), *RESULT.results[1:])
    hostile = replace(RESULT, test=tag, operator=tag, specimen=Specimen(tag, tag, tag))
    page = Test(replace(hostile, results=results))._repr_html_()
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert "\x07" not in page
