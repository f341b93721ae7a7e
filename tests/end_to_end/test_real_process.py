"""The main job on two real exports, with numbers taken straight from the files."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.records.curve import PointFlag
from labpipe.store.read import read_result
from tests.builders.reasons import why
from tests.builders.small_tests import Lab, state

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

SOFT_ARM = """\
test: T1
protocol: markers-only
specimen: {type: soft-arm, spool: "1", sample: "1"}
files: {markers: take.csv}
"""
LOAD = "Model Root/Harware/Subsystem1/load raw1/In1"
LASER = "Model Root/Laser Sensor/laser_-x1/In1"
PULLED = f"""\
test: T1
protocol: force-displacement
specimen: {{type: relative, spool: "1", sample: "1"}}
files: {{force: 0103_3_3.mat}}
overrides:
  sources.force.channels.force.channel: {{value: "{LOAD}", because: all channels are called In1}}
  sources.force.channels.force.unit: {{value: V, because: no calibration is known}}
  sources.force.channels.force.calibration: {{value: {{gain: 1 N/V}}, because: unit assumed}}
  sources.force.channels.displacement.channel: {{value: "{LASER}", because: the laser}}
  sources.force.channels.displacement.unit: {{value: mm, because: taken as mm}}
"""


def made(home: Path, sheet: str, source: Path, name: str) -> Lab:
    lab = Lab(home)
    lab.raw.mkdir(parents=True)
    (lab.raw / "test.yaml").write_text(sheet, encoding="utf-8")
    shutil.copy(source, lab.raw / name)
    return lab


def channels(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time and channels of a ControlDesk recording in HDF5, by full path, line breaks left out."""
    import h5py

    with h5py.File(path) as file:
        (group,) = (file[name] for name in file if not name.startswith("#"))

        def text(reference: Any) -> str:
            return "".join(map(chr, file[reference][:].ravel())).replace(r"\n", "")

        y = group["Y"]
        names = [
            f"{text(where)}/{text(name)}"
            for where, name in zip(y["Path"][:, 0], y["Name"][:, 0], strict=True)
        ]
        values = [file[reference][:].ravel() for reference in y["Data"][:, 0]]
        return group["X"]["Data"][:].ravel(), dict(zip(names, values, strict=True))


@pytest.fixture(scope="module")
def pulled(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """0103_3_3.mat, processed once."""
    source = realdata / "dspace" / "0103_3_3.mat"
    lab = made(tmp_path_factory.mktemp("pulled"), PULLED, source, source.name)
    raw = state(lab.home / "raw")
    assert main(["process", str(lab.raw)]) in (0, 1)
    assert state(lab.home / "raw") == raw
    return lab


@pytest.mark.slow
def test_force_against_displacement(pulled: Lab) -> None:
    result = read_result(pulled.result)
    time, signals = channels(pulled.raw / "0103_3_3.mat")
    aligned, curve = result.aligned, result.curve
    assert aligned is not None
    assert curve is not None
    np.testing.assert_array_equal(aligned.time, time)
    np.testing.assert_allclose(aligned.series["displacement"].values, 1e-3 * signals[LASER])
    np.testing.assert_allclose(aligned.series["force"].values, signals[LOAD])
    # 20 ms at 500 Hz are 10 samples, 9 for a window with a middle; ends of branches aside.
    window = np.ones(9) / 9.0
    ends = [at for each in curve.branches for at in (each.start, each.stop)]
    inside = np.min(np.abs(np.subtract.outer(np.arange(len(time)), ends)), axis=1) > 10
    inside[:10], inside[-10:] = False, False
    assert inside.mean() > 0.7
    for name, raw in (("force", signals[LOAD]), ("displacement", 1e-3 * signals[LASER])):
        smooth = np.convolve(raw, window, mode="same")[inside]
        np.testing.assert_allclose(getattr(curve, name)[inside], smooth, rtol=0, atol=1e-12)
    assert {path.name for path in (pulled.processed / "figures").iterdir()} == {
        f"{name}.svg" for name in ("force-displacement", "timeline")
    }


def turning_points(values: np.ndarray, hysteresis: float) -> list[int]:
    """Samples of the extremes that a signal comes back from, by a plain scan."""
    found, rising, at = [], True, 0
    for i, value in enumerate(values):
        ahead = value - values[at] if rising else values[at] - value
        if ahead > 0:
            at = i
        elif ahead < -hysteresis:
            found.append(at)
            rising, at = not rising, i
    return found


def test_cycles_of_the_real_curve(pulled: Lab) -> None:
    """The motion sets out downwards: loading is downwards, and the peaks are the lower turns."""
    _, signals = channels(pulled.raw / "0103_3_3.mat")
    laser = 1e-3 * np.convolve(signals[LASER], np.ones(9) / 9.0, mode="same")
    load = np.convolve(signals[LOAD], np.ones(9) / 9.0, mode="same")
    turns = turning_points(laser, 1e-3)
    lower = [i for i in turns if laser[i] < 0]
    results = pulled.results
    names = [name for name in results if name.startswith("peak_displacement.")]
    assert len(names) == len(lower) == 62
    for i, name in zip(lower, names, strict=True):  # filtered up to the turn, but not across it
        largest = 1e-3 * signals[LASER][i - 10 : i + 11].min()
        assert largest <= results[name]["value"] <= laser[i] + 8e-5, name
    around = zip([turns[0], *(i for i in turns if laser[i] > 0)][1:-1], lower[1:], strict=False)
    for number, (begin, end) in enumerate(around, start=2):
        found = results[f"peak_force.{number}"]["value"]
        assert found < 0.0
        least = signals[LOAD][begin : end + 20].min()
        assert least <= found <= 0.88 * load[begin : end + 20].min()


def test_record_that_breaks_off_is_told(pulled: Lab) -> None:
    last = list(pulled.results)[-1]
    assert last.startswith("energy.")
    assert pulled.results[last]["status"] == "doubtful"
    assert why(pulled.results[last]).startswith("partial_cycle: the record ends at 20.48")
    others = [each for name, each in pulled.results.items() if name != last]
    assert {each["status"] for each in others} == {"ok"}


def take_columns(path: Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, frame times and positions (frames, tracks, 3) of a take's marker columns."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        rows = list(csv.reader(stream))
    at = next(i for i, row in enumerate(rows) if row[:1] == ["Frame"])
    types, names, quantities = rows[at - 4], rows[at - 3], rows[at - 1]
    chosen = [
        i
        for i, (kind, what) in enumerate(zip(types, quantities, strict=False))
        if kind == "Marker" and what == "Position"
    ]
    body = [row for row in rows[at + 1 :] if row]
    table = np.array([[float(row[i]) if row[i] else np.nan for i in chosen] for row in body])
    time = np.array([float(row[1]) for row in body])
    labels = [names[i] for i in chosen[::3]]
    return labels, time, table.reshape(len(body), -1, 3)


@pytest.fixture(scope="module")
def soft_arm(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """The take of a soft arm, processed once."""
    source = realdata / "motive" / "softarm_sim-fk-400-2_1.23.csv"
    lab = made(tmp_path_factory.mktemp("arm"), SOFT_ARM, source, "take.csv")
    raw = state(lab.home / "raw")
    assert main(["process", str(lab.raw)]) == 0
    assert state(lab.home / "raw") == raw
    return lab


RINGS = ("SA-base", "SA-low", "SA-middle", "SA-up")
MERGED = {1: "Unlabeled 1366", 2: "Unlabeled 1364", 3: "Unlabeled 1365"}
"""The nearest unlabelled track where each marker of the base comes back: 0.02 mm to 6 mm off,
the others 51 mm and more."""
FIRST_LABELLED = 3932


def ring_centres(labels: list[str], positions: np.ndarray) -> list[np.ndarray]:
    """Mean of the markers of each ring; of the base, before it has labels, of the unlabelled."""
    centres = []
    for ring in RINGS:
        own = [i for i, name in enumerate(labels) if name.startswith(ring)]
        centres.append(positions[:, own].mean(axis=1))
    unlabelled = [i for i, name in enumerate(labels) if name.startswith("Unlabeled")]
    stray = positions[:, unlabelled].mean(axis=1)
    centres[0] = np.where(np.isnan(centres[0]), stray, centres[0])
    return centres


@pytest.mark.slow
def test_shapes_of_the_soft_arm(soft_arm: Lab) -> None:
    """Distances between rings, which no choice of frame changes, in all 8708 frames."""
    shape = read_result(soft_arm.result).shape
    assert shape is not None
    assert shape.names == RINGS
    labels, time, positions = take_columns(soft_arm.raw / "take.csv")
    centres = ring_centres(labels, 1e-3 * positions)
    assert len(shape.time) == len(time) == 8708
    for i in range(4):
        for j in range(i):
            true = np.linalg.norm(centres[i] - centres[j], axis=1)
            found = np.linalg.norm(shape.positions[:, i] - shape.positions[:, j], axis=1)
            seen = np.isfinite(true)
            assert seen.mean() > 0.998
            np.testing.assert_allclose(found[seen], true[seen], rtol=0, atol=1e-9)
    names = {path.name for path in (soft_arm.processed / "figures").iterdir()}
    assert {"wire-shapes.svg", "marker-quality.svg"} <= names


def test_travel_of_the_tip(soft_arm: Lab) -> None:
    labels, _, positions = take_columns(soft_arm.raw / "take.csv")
    tip = 1e-3 * ring_centres(labels, positions)[-1]
    away = np.linalg.norm(tip - tip[:5].mean(axis=0), axis=1)
    found = soft_arm.results["tip_travel"]
    assert found["value"] == pytest.approx(away.max(), abs=1e-6)
    assert found["status"] == "ok"


def test_labels_that_switch_are_undone_and_flagged(soft_arm: Lab) -> None:
    result = read_result(soft_arm.result)
    shape = result.shape
    assert shape is not None
    relabelled = shape.flags == PointFlag.RELABELLED
    assert relabelled[:FIRST_LABELLED, 0].all()
    assert not relabelled[FIRST_LABELLED:].any()
    assert not relabelled[:, 1:].any()
    said = [note.message for note in result.quality if note.code == "unlabelled_merged"]
    for number, track in MERGED.items():
        assert any(
            f"SA-base:Marker{number} was labelled as {track}, frames 0 to 3931" in each
            for each in said
        )
    merged = {note["message"] for note in soft_arm.summary["quality"]}
    assert set(said) <= merged
