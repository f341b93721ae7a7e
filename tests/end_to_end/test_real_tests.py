"""Real exports through the command, against numbers that stand in the files and their README."""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.records.curve import PointFlag
from labpipe.store.read import read_result
from tests.builders.reasons import why
from tests.builders.small_tests import Lab, state
from tests.builders.tensile_tests import TensileLab

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


def real_lab(home: Path, sheet: str, source: Path, name: str) -> Lab:
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
    lab = real_lab(tmp_path_factory.mktemp("pulled"), PULLED, source, source.name)
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
    ends = [at for branch in curve.branches for at in (branch.start, branch.stop)]
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
    lab = real_lab(tmp_path_factory.mktemp("arm"), SOFT_ARM, source, "take.csv")
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
            f"SA-base:Marker{number} was labelled as {track}, frames 0 to 3931" in sentence
            for sentence in said
        )
    merged = {note["message"] for note in soft_arm.summary["quality"]}
    assert set(said) <= merged


LLOYD = "lloyd_nexygen/tensile_22awg_{}_50mm.txt"
TIMED = "DAQ- Crosshead, … - (Timed).csv"


@dataclass(frozen=True)
class Real:
    """One export, the length between its grips (from its name), and what is known of it."""

    file: str
    length: str
    rows: int
    status: int
    peak: float | None = None
    cycles: int = 1
    window: tuple[str, str] | None = None
    failed: tuple[str, ...] = ()


NOT_BROKEN = ("failure_displacement", "failure_force", "energy_to_break")
TESTS = {
    # Copper at 0.1 mm a row: neither toe nor 0.5 mm hold eight samples.
    "copper-1": Real(
        LLOYD.format("copper_1"), "50 mm", 88, 1, 76.678, failed=("slack", "stiffness")
    ),
    "copper-1a": Real(
        *(LLOYD.format("copper_1a"), "50 mm", 81, 1),
        failed=("slack", "stiffness", *NOT_BROKEN),
    ),
    "copper-2": Real(LLOYD.format("copper_2"), "50 mm", 88, 1, failed=("slack", "stiffness")),
    # Steepest where they begin, and not broken.
    "silicone-1": Real(
        *(LLOYD.format("silicone_1"), "50 mm", 98, 1),
        window=("2 mm", "12 mm"),
        failed=("slack", *NOT_BROKEN),
    ),
    "silicone-2": Real(
        *(LLOYD.format("silicone_2"), "50 mm", 86, 1),
        window=("2 mm", "12 mm"),
        failed=("slack", *NOT_BROKEN),
    ),
    "cable-ld": Real(f"mts/REU/SteelCableLD_200mm_Trial3/{TIMED}", "200 mm", 635, 0, 504.26132),
    "cable-sd": Real(f"mts/REU/SteelCableSD_100mm_Trial1/{TIMED}", "100 mm", 297, 0, 180.28583),
    "cable-cycles": Real(
        *(f"mts/REU/Hysteresis_SteelCableSD_Trial1/{TIMED}", "100 mm", 3888, 1, 105.39071),
        cycles=15,
        failed=NOT_BROKEN,
    ),
}


def tensile_lab(home: Path, name: str, realdata: Path) -> TensileLab:
    lab, test = TensileLab(home, name), TESTS[name]
    lab.raw.mkdir(parents=True)
    source = realdata / test.file
    shutil.copy(source, lab.raw / source.name)
    lab.sheet.write_text(
        f"test: {name}\nprotocol: tensile\n"
        f'specimen: {{type: {name}, spool: "1", sample: "1", length: {test.length}}}\n'
        f'files: {{frame: "{source.name}"}}\n',
        encoding="utf-8",
    )
    if test.window is not None:
        lab.override("results.stiffness.from", test.window[0])
        lab.override("results.stiffness.to", test.window[1])
    return lab


@pytest.fixture(scope="module")
def pulls(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, TensileLab]:
    labs = {name: tensile_lab(tmp_path_factory.mktemp("real"), name, realdata) for name in TESTS}
    for name, lab in labs.items():
        raw = state(lab.home / "raw")
        assert main(["process", str(lab.raw)]) == TESTS[name].status, name
        assert state(lab.home / "raw") == raw
    return labs


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTS)
def test_results(pulls: dict[str, TensileLab], name: str) -> None:
    results, test = pulls[name].results, TESTS[name]
    failed = {each for each, found in results.items() if found["status"] == "failed"}
    assert failed == set(test.failed)
    peaks = [result for result in results if result.startswith("peak_force.")]
    assert len(peaks) == test.cycles
    for each in set(results) - failed:
        assert results[each]["lower"] <= results[each]["estimate"] <= results[each]["upper"]


@pytest.mark.parametrize("name", [name for name, test in TESTS.items() if test.peak is not None])
def test_peaks(pulls: dict[str, TensileLab], name: str) -> None:
    found = [
        result["value"]
        for each_name, result in pulls[name].results.items()
        if each_name.startswith("peak_force.")
    ]
    assert max(found) == pytest.approx(TESTS[name].peak, rel=1e-6)
    recording = read_result(pulls[name].result).recordings["frame"]
    (force,) = (channel.values for channel in recording.channels if channel.name == "force")
    assert len(force) == TESTS[name].rows
    assert np.nanmax(force) == pytest.approx(TESTS[name].peak, rel=1e-6)


def test_every_cycle_has_its_peak(pulls: dict[str, TensileLab]) -> None:
    """Force-controlled, to 105 N: the largest samples lie between 104.5 N and 105.4 N."""
    for number in range(1, 16):
        found = pulls["cable-cycles"].results[f"peak_force.{number}"]
        assert found["status"] == "ok"
        assert found["value"] == pytest.approx(105.0, abs=0.8)


def test_silicone_has_no_toe(pulls: dict[str, TensileLab]) -> None:
    reason = why(pulls["silicone-1"].results["slack"])
    assert reason.startswith("no_toe: the line meets zero force at -4.596 mm, before the first ")
    # 1.736 N at 13.105 mm and 0.457 N at 2.418 mm
    found = pulls["silicone-1"].results["stiffness"]["value"]
    assert found == pytest.approx((1.7352 - 0.45677) / (13.105e-3 - 2.4177e-3), rel=0.05)


SPANS = {
    "1": "12.8 mm",
    "1b": "12.8 mm",
    "2": "12.8 mm",
    "3": "73.6 mm",
    "4": "40 mm",
    "5": "57.6 mm",
    "6": "76.8 mm",
    "7": "96 mm",
}
"""By group, as the README of the exports says; 1b is taken to be as 1."""
STRAIGHT = {"2_test1", "3_test1", "4_test1", "5_test1", "5_test2", "5_test3"}
"""No bend in the first 4 mm (a quarter of the shortest span) that two segments would be told by."""
SEGMENTS = ("segment_stiffness_first", "segment_stiffness_second", "break_point")
PEAKS = {"1_test1": 0.83469, "1_test2": 0.78565, "1_test3": 0.69346, "4_test1": 0.97611}


def bend_lab(home: Path, source: Path, span: str, *changes: str) -> TensileLab:
    lab = TensileLab(home, source.stem.replace(" ", "_"))
    lab.raw.mkdir(parents=True)
    shutil.copy(source, lab.raw / source.name)
    lab.sheet.write_text(
        f"test: {lab.raw.name}\nprotocol: three-point-bend\n"
        f'specimen: {{type: bundle, spool: "1", sample: "1", span: {span}}}\n'
        f'files: {{frame: "{source.name}"}}\n',
        encoding="utf-8",
    )
    for change in changes:
        key, _, value = change.partition("=")
        lab.override(key, value)
    return lab


@pytest.fixture(scope="module")
def bends(realdata: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, TensileLab]:
    labs = {}
    for source in sorted((realdata / "lloyd_nexygen").glob("3pb_*.txt")):
        name = source.stem.removeprefix("3pb_hm3_")
        span = SPANS[name.partition("_")[0]]
        change = ("results.two-segments.to=3.2 mm",) if span == "12.8 mm" else ()
        labs[name] = bend_lab(tmp_path_factory.mktemp("real"), source, span, *change)
        raw = state(labs[name].home / "raw")
        assert main(["process", str(labs[name].raw)]) == (1 if name in STRAIGHT else 0), name
        assert state(labs[name].home / "raw") == raw
    return labs


def test_two_segments_or_the_reason_why_not(bends: dict[str, TensileLab]) -> None:
    for name, lab in bends.items():
        found = lab.results
        for segment in (*SEGMENTS, "bending_stiffness"):
            if name in STRAIGHT:
                assert found[segment]["status"] == "failed"
                continue
            own = found[segment]
            assert own["lower"] < own["estimate"] < own["upper"], (name, segment)
        if name in STRAIGHT:
            assert why(found["break_point"]).startswith("no_bend: ")
        else:
            assert found["segment_stiffness_first"]["value"] > found[SEGMENTS[1]]["value"]


def test_bending_stiffness_is_that_of_a_beam(bends: dict[str, TensileLab]) -> None:
    """K L^3 / 48, and what an elastic rod on knife edges gets softer by up to a sixth of a span."""
    for name, lab in bends.items():
        if name in STRAIGHT:
            continue
        span = float(SPANS[name.partition("_")[0]].split()[0]) * 1e-3
        plain = lab.results[SEGMENTS[0]]["value"] * span**3 / 48.0
        assert 1.0 < lab.results["bending_stiffness"]["value"] / plain < 1.35, name
        assert "large-deflection" in lab.results["bending_stiffness"]["method"]


def test_peaks_are_the_largest_sample(bends: dict[str, TensileLab]) -> None:
    for name, peak in PEAKS.items():
        assert bends[name].results["peak_force.1"]["value"] == pytest.approx(peak, rel=1e-6)
