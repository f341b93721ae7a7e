"""Short records of a load frame: five shapes, from 10 to 200 samples a branch.

Synthetic. Nothing here is shared with labpipe. The truth is that of the curve without noise, and
between its samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
COUNTS = (10, 15, 20, 30, 50, 70, 90, 105, 120, 200)
SHAPES = ("line", "saturating", "knee", "toe", "cycles")
SEEDS = range(32000, 32200)
"""Of each shape and count; fixed before the first run."""
STROKE, LOW, HIGH = 10.0, 2.0, 6.0
"""mm: of the frame, and the window of the stiffness."""
NOISE = 0.0015
"""White, of the largest force."""
PROTOCOL = f"""\
version: 1
name: short
about: Short record of a synthetic specimen
sources:
  frame:
    reader: load-frame
    channels:
      force: {{channel: Force}}
      displacement: {{channel: Displacement}}
curve: {{force: force, displacement: displacementFAILURE}}
branches: {{channel: displacement, min_stroke: 2 mm}}
results: [{{result: peak-force}}, {{result: stiffness, from: {LOW} mm, to: {HIGH} mm}}ENERGY]
"""
SHEET = """\
test: T
protocol: ./short.yaml
specimen: {type: synthetic, spool: "1", sample: "1"}
files: {frame: table.csv}
"""


@dataclass
class ShortRecord:
    """Protocol, table and true numbers (N, N/m, J) of one record."""

    protocol: str
    table: str
    truth: dict[str, float]


def made(shape: str, count: int, seed: int) -> ShortRecord:
    """Draw a specimen of a shape, and record it with so many samples a branch."""
    rng = np.random.default_rng([seed, count, SHAPES.index(shape)])
    record = _cycles(count, rng) if shape == "cycles" else _pull(shape, count, rng)
    travel, force, fine, truth = record
    window = (fine[0] >= LOW) & (fine[0] <= HIGH)
    truth["stiffness"] = 1e3 * float(np.polyfit(fine[0][window], fine[1][window], 1)[0])
    force = force + NOISE * np.abs(force).max() * rng.standard_normal(len(force))
    rows = [f"{0.1 * row:.3f},{travel[row]:.5f},{force[row]:.6g}\n" for row in range(len(travel))]
    is_cyclic = shape == "cycles"
    protocol = PROTOCOL.replace("FAILURE", "" if is_cyclic else ", failure: {force_below: 50 %}")
    protocol = protocol.replace("ENERGY", ", {result: energy}" if is_cyclic else "")
    table = "Time,Displacement,Force\ns,mm,N\n" + "".join(rows)
    return ShortRecord(protocol, table, truth)


_Record = tuple[Array, Array, tuple[Array, Array], dict[str, float]]
"""Travel, force, both of the first loading between samples, and true numbers."""


def _pull(shape: str, count: int, rng: np.random.Generator) -> _Record:
    """Pull to a break between the last sample and the next one; the frame moves on."""
    size, first, second, beyond = rng.uniform(20.0, 400.0), *rng.uniform(size=3)

    def force_at(travel: Array) -> Array:
        x = travel / STROKE
        if shape == "line":
            return np.asarray(size * x)
        if shape == "saturating":
            return np.asarray(size * (1.0 - np.exp(-(2.0 + 2.0 * first) * x)))
        if shape == "knee":
            at, slope = 0.15 + 0.7 * first, 0.1 + 0.4 * second
            return np.asarray(size * (np.minimum(x, at) + slope * np.maximum(x - at, 0.0)))
        toe = 0.4 * first
        return np.asarray(size * np.where(x < toe, x**2 / (2.0 * toe), x - 0.5 * toe))

    step = STROKE / (count - 1 + beyond)
    travel, fine = step * np.arange(count + 4), np.linspace(0.0, STROKE, 20001)
    force = np.where(np.arange(count + 4) < count, force_at(travel), 0.0)
    truth = {"peak_force.1": float(force_at(np.array([STROKE]))[0])}
    return travel, force, (fine, force_at(fine)), truth


def _cycles(count: int, rng: np.random.Generator) -> _Record:
    """Two triangles of a spring beside a slider; the motion turns on a sample."""
    spring, contact = rng.uniform(5.0, 20.0), rng.uniform(10.0, 60.0)
    limit = rng.uniform(10.0, 60.0)

    def triangles(steps: int) -> tuple[Array, Array]:
        up = np.linspace(0.0, STROKE, steps)
        travel = np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])
        carried, force = 0.0, np.empty(len(travel))
        for sample, move in enumerate(np.diff(travel, prepend=0.0)):
            carried = float(np.clip(carried + contact * move, -limit, limit))
            force[sample] = spring * travel[sample] + carried
        return travel, force

    fine = triangles(20001)
    truth = {}
    for cycle, part in ((1, slice(0, 40001)), (2, slice(40000, 80001))):
        travel, force = (values[part] for values in fine)
        truth[f"peak_force.{cycle}"] = float(force.max())
        middles = 0.5 * (force[1:] + force[:-1])
        truth[f"energy.{cycle}"] = 1e-3 * float(np.sum(middles * np.diff(travel)))
    return *triangles(count), (fine[0][:20001], fine[1][:20001]), truth
