"""The .mat export has the layout that ControlDesk writes."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, whosmat

from labpipe.virtual_lab.observations import Observation
from labpipe.virtual_lab.recorders import DIRECTION_PATH, FREQUENCY_PATH
from labpipe.virtual_lab.vendor_exports import Run, write_control_desk

RUN = Run("A2-085-1", datetime(2026, 3, 4, 10, 5, 0), seed=11)


@pytest.fixture(scope="module")
def file(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mat") / "force.mat"
    write_control_desk(path, observation.force_record, RUN)
    return path


@pytest.fixture(scope="module")
def content(file: Path) -> Any:
    return loadmat(file, struct_as_record=False, squeeze_me=True)["force"]


def test_header_and_container(file: Path) -> None:
    head = file.read_bytes()[:132]
    assert head.startswith(
        b"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Wed Mar 04 10:08:43 2026 "
    )
    assert head[124:128] == b"\x00\x01IM"
    assert head[128:132] == b"\x0e\x00\x00\x00"  # not compressed, as in real exports
    assert whosmat(file) == [("force", (1, 1), "struct")]


def test_fields_in_the_order_of_revision_2_1(content: Any) -> None:
    assert content._fieldnames == ["Info", "X", "Y", "Description"]
    assert (content.Info.RevisionMajor, content.Info.RevisionMinor) == (2, 1)
    assert content.X._fieldnames == ["Name", "Type", "Data", "Unit", "Raster"]
    assert content.Y[0]._fieldnames == [
        *("Name", "Type", "Data", "Unit", "Raster", "Device", "XIndex", "DownSampling"),
        *("Description", "DisplayIdentifier", "Path", "Flags", "Min", "Max", "MinWeak", "MaxWeak"),
    ]


def test_channels_by_path_with_one_name_and_no_unit(content: Any) -> None:
    assert [channel.Path for channel in content.Y] == [
        "Model Root/Load Cell",
        "Model Root/Motor/Direction",
        "Model Root/Motor/Frequency",
    ]
    assert {channel.Name for channel in content.Y} == {"Out1"}
    assert all(len(channel.Unit) == 0 for channel in content.Y)
    assert {channel.XIndex for channel in content.Y} == {1}
    assert {channel.Raster for channel in content.Y} == {content.X.Raster} == {"HostService"}


def test_numbers_are_exact_and_whole_ones_small(content: Any, observation: Observation) -> None:
    record = observation.force_record
    np.testing.assert_array_equal(content.X.Data, record.clock)
    np.testing.assert_array_equal(content.Y[0].Data, record.volts)
    np.testing.assert_array_equal(content.Y[1].Data, record.signals[DIRECTION_PATH])
    np.testing.assert_array_equal(content.Y[2].Data, record.signals[FREQUENCY_PATH])
    kinds = [channel.Data.dtype for channel in content.Y]
    assert kinds == [np.float64, np.uint8, np.uint16]


def test_data_are_rows(file: Path) -> None:
    raw = loadmat(file)["force"]
    assert raw["X"][0, 0]["Data"][0, 0].shape[0] == 1
    assert raw["Y"][0, 0].shape == (1, 3)


def test_says_that_it_is_synthetic(content: Any) -> None:
    origin = content.Description.General.Origin
    assert "ControlDesk version: 7.4" in origin
    assert "SYNTHETIC" in origin
    assert "seed 11" in origin
    assert content.Description.General.DateTime == "2026/03/04 10:08:43"
    assert content.Description.Measurement.StartTimestamp == 0.0
    assert content.Description.Measurement.Length == pytest.approx(content.X.Data[-1])


def test_same_record_same_bytes(file: Path, observation: Observation, tmp_path: Path) -> None:
    again = tmp_path / "force.mat"
    write_control_desk(again, observation.force_record, RUN)
    assert again.read_bytes() == file.read_bytes()
