from __future__ import annotations

from dataclasses import replace
from datetime import date

import pandas as pd
import pytest
from matplotlib.figure import Figure

from labpipe.door.one_test import Test
from labpipe.errors import ProcessingError, UsageError
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import TestResult
from labpipe.store.summaries import summary
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    made = build_result(half_cycle=1.0)
    return replace(made, date=date(2026, 3, 4), operator="lab")


@pytest.fixture(scope="module")
def test(result: TestResult) -> Test:
    return Test(result)


def test_what_a_test_says_of_itself(test: Test, result: TestResult) -> None:
    assert (test.name, test.protocol, test.operator) == ("A2-085-1", "wire-cantilever", "lab")
    assert (test.date, test.instruments, test.folder) == (date(2026, 3, 4), (), None)
    assert test.specimen.dimensions == {"length": 0.085}
    assert test.summary == summary(result)
    assert test.figures == result.figures
    assert repr(test) == "<labpipe test A2-085-1 (wire-cantilever): 1 ok, 1 doubtful, 1 failed>"
    assert test._repr_html_().startswith("<div>")


def test_display_converts_and_leaves_the_test_alone(test: Test) -> None:
    shown = test.display
    assert shown.results.loc["residual_displacement.1", "unit"] == "mm"
    assert shown.results.loc["residual_displacement.1", "value"] == pytest.approx(3.1)
    assert shown.curve.attrs["units"]["displacement"] == "mm"
    assert shown.shape.attrs["units"]["position"] == "mm"
    assert shown.raw["force/HostService"].equals(test.raw["force/HostService"])
    assert test.results.loc["residual_displacement.1", "unit"] == "m"
    assert shown.budget("peak_force.1").equals(test.budget("peak_force.1"))


def test_shapes_and_recordings_are_read_when_they_are_asked_for(result: TestResult) -> None:
    asked = []

    def whole() -> TestResult:
        asked.append(1)
        return result

    test = Test(replace(result, shape=None, recordings={}), whole=whole)
    assert isinstance(test.curve, pd.DataFrame)
    assert len(test.results) == 3
    assert asked == []
    assert len(test.shape) == len(test.raw["markers"])
    assert len(test.display.raw) == 5
    assert asked == [1]


@pytest.mark.parametrize("name", ["force-displacement", "uncertainty-budget"])
def test_figures(name: str, test: Test) -> None:
    figure = test.figure(name)
    assert isinstance(figure, Figure)
    assert figure.axes


def test_names_that_are_not_there(test: Test) -> None:
    with pytest.raises(UsageError, match=r"A2-085-1: expected a result such as peak_force\.1, .*"):
        test.budget("peak_forse.1")
    with pytest.raises(UsageError, match=r"expected a figure such as .*wire-shapes.*found 'shape'"):
        test.figure("shape")
    with pytest.raises(UsageError, match=r"a part such as .*, found 'raw'\. Choose one of these\."):
        test.dataset("raw")


def test_stages_that_are_not_there(result: TestResult) -> None:
    note = QualityNote("no_branches", Severity.ERROR, "force", "The motion never turns.")
    bare = Test(replace(result, curve=None, shape=None, quality=(note,)))
    with pytest.raises(ProcessingError, match=r"expected a curve, found none\. Why: The motion ne"):
        _ = bare.curve
    with pytest.raises(ProcessingError, match="expected a shape, found none"):
        _ = bare.shape
    nothing = Test(replace(result, results=(), quality=()))
    assert repr(nothing) == "<labpipe test A2-085-1 (wire-cantilever): nothing>"
    with pytest.raises(UsageError, match=r"expected a result, found none\. Look at `quality`\."):
        nothing.budget("peak_force.1")
