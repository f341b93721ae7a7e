"""Real exports through the command, against numbers that stand in the files and their README."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
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


def real_lab(home: Path, sheet: str, source: Path, name: str) -> Lab:
    lab = Lab(home)
    lab.raw.mkdir(parents=True)
    (lab.raw / "test.yaml").write_text(sheet, encoding="utf-8")
    shutil.copy(source, lab.raw / name)
    return lab


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


SPANS = {"1": 12.8, "1b": 12.8, "2": 12.8, "3": 73.6, "4": 40.0, "5": 57.6, "6": 76.8, "7": 96.0}
"""In mm, by group, as the README of the exports says; 1b is taken to be as 1."""
STRAIGHT = {"2_test1", "3_test1", "4_test1", "5_test1", "5_test2", "5_test3"}
"""No bend in the first 4 mm (a quarter of the shortest span) that two segments would be told by."""
SEGMENTS = ("segment_stiffness_first", "segment_stiffness_second", "break_point")


def bend_lab(home: Path, source: Path, span: float) -> TensileLab:
    lab = TensileLab(home, source.stem.replace(" ", "_"))
    lab.raw.mkdir(parents=True)
    shutil.copy(source, lab.raw / source.name)
    lab.sheet.write_text(
        f"test: {lab.raw.name}\nprotocol: three-point-bend\n"
        f'specimen: {{type: bundle, spool: "1", sample: "1", span: {span} mm}}\n'
        f'files: {{frame: "{source.name}"}}\n',
        encoding="utf-8",
    )
    if span == 12.8:
        lab.override("results.two-segments.to", "3.2 mm")
    return lab


def test_stiffness_of_a_beam_or_the_reason_why_not(realdata: Path, tmp_path: Path) -> None:
    """K L^3 / 48, and what an elastic rod on knife edges gets softer by up to a sixth of a span."""
    for source in sorted((realdata / "lloyd_nexygen").glob("3pb_*.txt")):
        name = source.stem.removeprefix("3pb_hm3_")
        span = SPANS[name.partition("_")[0]]
        lab = bend_lab(tmp_path / name, source, span)
        raw = state(lab.home / "raw")
        assert main(["process", str(lab.raw), "--no-figures"]) == int(name in STRAIGHT), name
        assert state(lab.home / "raw") == raw
        results = lab.results
        if name in STRAIGHT:
            assert {results[segment]["status"] for segment in SEGMENTS} == {"failed"}
            assert why(results["break_point"]).startswith("no_bend: ")
            continue
        for segment in (*SEGMENTS, "bending_stiffness"):
            result = results[segment]
            assert result["lower"] < result["estimate"] < result["upper"], (name, segment)
        first, second = (results[segment]["value"] for segment in SEGMENTS[:2])
        assert first > second
        plain = first * (1e-3 * span) ** 3 / 48.0
        assert 1.0 < results["bending_stiffness"]["value"] / plain < 1.35, name
