from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.curve import FittedLine
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.records.quality import Reason
from labpipe.records.result import Specimen

COUNT = 5


def sample_curve() -> SampleCurve:
    return SampleCurve(np.arange(float(COUNT)), np.zeros(COUNT), np.ones(COUNT))


def band() -> Band:
    values = np.zeros(COUNT)
    return Band(np.arange(float(COUNT)), values, values, values, values, values, 3, "samples")


def sample(test: str = "T1") -> Sample:
    specimen = Specimen("tube", "s1", "1")
    return Sample(test, specimen, "twist-tube", (sample_curve(),), (), ())


@pytest.mark.parametrize("name", ["displacement", "force", "as_measured"])
def test_a_sample_curve_is_read_only(name: str) -> None:
    values = getattr(sample_curve(), name)
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 1.0


@pytest.mark.parametrize("name", ["force", "as_measured"])
def test_a_sample_curve_of_uneven_lengths(name: str) -> None:
    wrong: dict[str, Any] = {name: np.zeros(COUNT + 1)}
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(5,\), found \(6,\)"):
        replace(sample_curve(), **wrong)


def test_a_sample_curve_of_two_columns() -> None:
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(None,\), found \(5, 2\)"):
        SampleCurve(np.zeros((COUNT, 2)), np.zeros(COUNT), np.zeros(COUNT))


def test_what_is_not_said_of_a_sample() -> None:
    made = sample()
    assert (made.slips, made.lines, made.quality, made.source) == ((), (), (), "")
    assert dict(made.display) == {}
    assert made.loading[0].cycle == 1
    with pytest.raises(FrozenInstanceError):
        made.test = "T2"  # type: ignore[misc]


NAMES = ("mean", "lower", "upper", "lower_all", "upper_all")


@pytest.mark.parametrize("name", ["displacement", *NAMES])
def test_a_band_is_read_only(name: str) -> None:
    assert not getattr(band(), name).flags.writeable


@pytest.mark.parametrize("name", NAMES)
def test_a_band_of_uneven_lengths(name: str) -> None:
    wrong: dict[str, Any] = {name: np.zeros(COUNT - 1)}
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(5,\), found \(4,\)"):
        replace(band(), **wrong)


def test_a_band_without_a_curve_is_empty() -> None:
    nothing: dict[str, Any] = {name: np.empty(0) for name in ("displacement", *NAMES)}
    made = Band(**nothing, n=0, over="samples", reason=Reason("no_overlap", "of nothing"))
    assert len(made.mean) == 0


def test_groups_hold_their_samples_in_order() -> None:
    group = Group("tube", "twist-tube", (sample("T2"), sample("T1")), (), band())
    assert [each.test for each in group.samples] == ["T2", "T1"]
    assert (group.band_scaled, group.notes) == (None, ())


def test_lines_are_values() -> None:
    line = FittedLine("stiffness", 100.0, 0.2, 0.002, 0.008)
    assert line == FittedLine("stiffness", slope=100.0, level=0.2, start=0.002, stop=0.008)
    assert len({line, replace(line)}) == 1
