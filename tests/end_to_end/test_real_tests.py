"""Real exports through the command, against numbers that stand in the files and their README."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.store.read import read_result
from tests.builders.small_tests import Lab, state

pytestmark = [pytest.mark.realdata, pytest.mark.slow]
SOFT_ARM = """\
test: T1
protocol: markers-only
specimen: {type: soft-arm, spool: "1", sample: "1"}
files: {markers: take.csv}
"""


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


def test_shapes_of_the_soft_arm(realdata: Path, tmp_path: Path) -> None:
    """Distances between rings, which no choice of frame changes, in all 8708 frames."""
    soft_arm = Lab(tmp_path)
    soft_arm.raw.mkdir(parents=True)
    soft_arm.sheet.write_text(SOFT_ARM, encoding="utf-8")
    source = realdata / "motive" / "softarm_sim-fk-400-2_1.23.csv"
    shutil.copy(source, soft_arm.raw / "take.csv")
    raw = state(soft_arm.home / "raw")
    assert main(["process", str(soft_arm.raw)]) == 0
    assert state(soft_arm.home / "raw") == raw
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
