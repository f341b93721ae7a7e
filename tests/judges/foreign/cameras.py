"""Tests that cameras follow: wires and bundles on a string, bundles on two supports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.judges.foreign import specimens
from tests.judges.foreign.exports import write_mat, write_motive, write_mts, write_sheet
from tests.judges.foreign.frames import Truth, measured, sheet
from tests.judges.foreign.rig import Chance, Clocks, Made, Way, noisy, scale, stated
from tests.judges.foreign.specimens import Along, Branch, Law, Loop, Wire, knives, loops

Array = NDArray[np.float64]
FPS, RATE = 50.0, 1000.0
SLOW_FPS = 25.0


@dataclass(frozen=True)
class Clamped:
    """How a wire or bundle hangs between clamp and string.

    Parameters
    ----------
    wire, way : what is bent, and how
    gain : N/V
    grip, pull, centre : m; pivot to clamped end, last marker to string, axis to marker
    apart, markers : m, how many
    """

    wire: Wire
    way: Way
    gain: float
    grip: float
    pull: float
    centre: float
    apart: float
    markers: int

    @property
    def places(self) -> Array:
        """Arc lengths of the markers, m."""
        last = self.wire.length - self.pull
        return np.asarray(last - self.apart * np.arange(self.markers)[::-1], dtype=np.float64)


def at_rest_turned(chance: Chance) -> tuple[Array, Array]:
    """Rotation of the rig in the room of the cameras, whose Y points up, and as a quaternion."""
    about, tilt = chance.rng.uniform(-np.pi, np.pi), chance.rng.normal(0.0, 0.01)
    c, s, ct, st = np.cos(about), np.sin(about), np.cos(tilt), np.sin(tilt)
    upright = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    turned = upright @ np.array([[1.0, 0.0, 0.0], [0.0, ct, -st], [0.0, st, ct]])
    quaternion = np.array([0.0, np.sin(about / 2), 0.0, np.cos(about / 2)])
    return turned, quaternion


def clocks_of(chance: Chance) -> Clocks:
    """Offset of up to two seconds, drift of some tens of ppm."""
    offset = float(chance.rng.uniform(0.2, 1.7))
    if chance.fault == "begins-under-load" or chance.seed % 3 == 0:
        offset = -0.3 * offset
    return Clocks(offset, float(chance.rng.uniform(-60e-6, 60e-6)))


def clamped(chance: Chance, folder: Path, rig: Clamped) -> Truth:
    """Run a test on the string, write what load cell and cameras saw; how the clocks differ."""
    branches = loops(rig.wire, rig.way.stroke, rig.way.cycles)
    start, end = rig.way.kept(chance.fault)
    clocks = clocks_of(chance)
    ticks = clocks.samples(RATE, end - start)
    force = _force(branches, rig.way, np.clip(start + clocks.cameras(ticks), 0.0, None))
    off = chance.error(scale(chance.kind, "force"))
    force = chance.noisy(force, 1.0 / RATE) * (1.0 + off)
    volts = (force + 0.1 * chance.rng.uniform(-1.0, 1.0)) / rig.gain
    write_mat(folder / "rec1_007.mat", ticks, {"Model Root/Load Cell/Out1": volts})
    frames = np.arange(0.0, end - start, 1.0 / FPS)
    pivot, markers = _places(chance, branches, rig, start + frames)
    turn, quaternion = at_rest_turned(chance)
    where = np.array([0.31, 1.24, -0.57])
    pivot, markers = pivot @ turn.T + where, markers @ turn.T + where
    order = chance.rng.permutation(rig.markers)
    named = {f"W{i + 1}": chance.seen(markers[:, j]) for i, j in enumerate(order)}
    write_motive(folder / "take.csv", FPS, chance.seen(pivot), named, quaternion)
    return {"clock_offset": clocks.offset, "clock_drift": clocks.drift}


def _force(branches: tuple[Branch, ...], way: Way, time: Array) -> Array:
    travel, which = way.travel(time), way.stroke_at(time)
    out = np.empty_like(time)
    for number, branch in enumerate(branches):
        here = which == number
        out[here] = branch.at(travel[here])[0]
    return out


def _places(
    chance: Chance, branches: tuple[Branch, ...], rig: Clamped, time: Array
) -> tuple[Array, Array]:
    """Pivot (frames, 3) and markers (frames, markers, 3) in the frame of the rig, m."""
    travel, which = rig.way.travel(time), rig.way.stroke_at(time)
    along = Along(rig.wire.length)
    by = stated(chance.kind, "markers", "offset_uncertainty")
    offset = chance.error(by), chance.error(by)
    places = rig.places - offset[0]
    centre = rig.centre + chance.off("centre", stated(chance.kind, "markers", "centre_uncertainty"))
    markers = np.zeros((len(time), rig.markers, 3))
    for number, branch in enumerate(branches):
        here = which == number
        angle, x, y = along.shapes(branch.bends(travel[here]), places)
        markers[here, :, 0] = x - centre * np.sin(angle)
        markers[here, :, 1] = y + centre * np.cos(angle) - travel[here, None]
    pivot = np.column_stack([0.0 * time - rig.grip - offset[1], -travel, 0.0 * time])
    return pivot, markers


def clamped_truth(rig: Clamped, over: float) -> Truth:
    """Numbers of the curves of all cycles."""
    truth: Truth = {}
    branches = loops(rig.wire, rig.way.stroke, rig.way.cycles)
    for cycle in range(rig.way.cycles):
        (d, f), (back_d, back_f) = (_dense(branches[2 * cycle + i]) for i in (0, 1))
        key = f".{cycle + 1}"
        truth["peak_force" + key], truth["peak_displacement" + key] = float(f[-1]), float(d[-1])
        lost = specimens.work(d, f) - specimens.work(back_d, back_f)
        truth["energy" + key] = lost
        away = d[-1] - back_d
        near = (away >= 0.1 * over) & (away <= over)
        truth["unloading_stiffness" + key] = specimens.slope(back_d[near], back_f[near])
        truth["residual_displacement" + key] = specimens.crossing(back_d, back_f, 0.0)
    return truth


def _dense(branch: Branch) -> tuple[Array, Array]:
    """Deflection and force along a stroke, evenly in travel, in rising order."""
    force, deflection = branch.at(np.linspace(branch.travel[0], branch.travel[-1], 12001))
    return deflection, force


def wire_cantilever(chance: Chance, folder: Path) -> Made:
    """A single wire; three cycles of 24 mm."""
    rigidity = (1.6e-3, 2.0e-3, 2.4e-3)[chance.variety]
    wire = Wire(0.085, rigidity, ((1.5e-2, 4.0), (2e-3, 0.6)))
    way = Way(24e-3, 2e-3, 3, chance.rest, chance.dwell)
    rig = Clamped(wire, way, 0.5, 6e-3, 4e-3, 0.8e-3, 10e-3, 8)
    truth = clamped(chance, folder, rig)
    changed = {"rig__stroke": "24 mm", "rig__crosshead_speed": "2 mm/s"}
    files = {"force": "rec1_007.mat", "markers": "take.csv"}
    write_sheet(folder, sheet(chance, measured(chance, "length", 85.0), files, **changed))
    truth |= clamped_truth(rig, 3e-3)
    first = _dense(loops(wire, way.stroke, way.cycles)[0])
    truth["initial_stiffness"] = specimens.window_slope(*first, 0.5e-3, 4e-3)
    for at in (1, 3):
        truth[f"bending_stiffness_at_{at}"] = float(wire.first_moment(float(at))) / at
    return Made(folder, truth)


def taped_bundle(chance: Chance, folder: Path) -> Made:
    """Wires in tape that slip on one another; two cycles of 24 mm."""
    rigidity = (1.2e-2, 1.5e-2, 1.8e-2)[chance.variety]
    wire = Wire(0.1143, rigidity, ((2.4e-2, 0.7),))
    way = Way(24e-3, 2e-3, 2, chance.rest, chance.dwell)
    rig = Clamped(wire, way, 0.89, 6e-3, 6.35e-3, 2.75e-3, 12.7e-3, 9)
    truth = clamped(chance, folder, rig)
    changed = {"rig__stroke": "24 mm", "rig__crosshead_speed": "2 mm/s", "rig__cycles": "2"}
    files = {"force": "rec1_007.mat", "markers": "take.csv"}
    length = 0.1143 + chance.error(stated(chance.kind, "specimen", "uncertainty", "length"))
    bundle = {"wires": {"B1": 19}}
    said = {"length": f"{1e3 * length:.4f} mm", "bundle": bundle}
    write_sheet(folder, sheet(chance, said, files, **changed))
    truth |= clamped_truth(rig, 3e-3)
    branches = loops(wire, way.stroke, way.cycles)
    first, again = _dense(branches[0]), _dense(branches[2])
    truth |= bundle_truth(*first)
    truth["bending_stiffness"] = truth["initial_stiffness"] * 0.1143**3 / 3.0
    for cycle, (d, f) in enumerate((first, again)):
        taut = specimens.crossing(d, f, 0.0) if cycle else 0.0
        stiff = specimens.window_slope(d, f, taut, taut + 5e-3)
        truth[f"loading_stiffness.{cycle + 1}"] = stiff
    truth["hardening.2"] = truth["loading_stiffness.2"] / truth["loading_stiffness.1"]
    return Made(folder, truth)


def bundle_truth(d: Array, f: Array) -> Truth:
    """Stiffness, kink, slope at the end and plateau of a first loading."""
    stiff = specimens.window_slope(d, f, 0.2e-3, 5e-3)
    _, _, place, force = specimens.two_segments(d, f, 0.2e-3, 5e-3)
    truth = {"initial_stiffness": stiff, "kink_displacement": place, "kink_force": force}
    truth["end_slope"] = specimens.window_slope(d, f, d[-1] - 5e-3, d[-1]) / stiff
    levels = specimens.onset(d, f, 0.1 * stiff)
    if levels is not None:
        truth["plateau_displacement"], truth["plateau_force"] = levels
    return truth


@dataclass(frozen=True, eq=False)
class Conduit:
    """Wires in a conduit on two knife edges, pressed at mid-span; bent, they stay bent a little.

    Parameters
    ----------
    loop, way : what is bent, and how
    begin, end : s, what is kept of the record; the frame moves at 0
    """

    loop: Loop
    way: Way
    begin: float
    end: float

    @cached_property
    def laws(self) -> list[Law]:
        """Force there and back."""
        return self.loop.strokes((self.way.stroke, 0.0))

    @cached_property
    def left(self) -> float:
        """Where the roller leaves the conduit on the way back, m."""
        d = np.linspace(0.0, self.way.stroke, 20001)
        return specimens.crossing(d, self.laws[1](d), 0.0)

    def bent(self, time: Array) -> tuple[Array, Array]:
        """Force and deflection at some times."""
        time = np.clip(time, 0.0, None)
        travel, back = self.way.travel(time), self.way.stroke_at(time) == 1
        held = np.where(travel > self.left, self.laws[1](travel), 0.0)
        force = np.where(back, held, self.laws[0](travel))
        return force, np.where(back, np.maximum(travel, self.left), travel)


CONDUITS = (
    Loop(20.0, ((3.0, 1.6e-3), (3.0, 4.0e-3))),
    Loop(300.0, ((1.2, 1.6e-3), (2.0, 6.0e-3))),
    Loop(450.0, ((1.8, 1.6e-3), (3.0, 6.0e-3))),
)
SPAN, RADIUS, TWIST = 0.1524, 8.55e-3, 0.06
"""m, m from the axis to a marker, rad at the end of the stroke."""


def conduit_bundle(chance: Chance, folder: Path) -> Made:
    """Recorder, frame and cameras; one trigger for the first two."""
    way = Way(15e-3, 0.5e-3, 1, 0.0, chance.dwell)
    stroke = way.stroke / way.speed
    end = way.lasts - 0.4 * stroke if chance.fault == "cut" else way.lasts + 2.0
    begin = 0.12 * stroke if chance.fault == "begins-under-load" else 0.0
    rig = Conduit(CONDUITS[chance.variety], way, begin, end)
    early = float(chance.rng.uniform(2e-3, 12e-3))
    _press(chance, folder, rig, early)
    _watch(chance, folder, rig)
    changed: dict[str, Any] = {"rig__stroke": "15 mm"}
    changed["results__bending-stiffness__corrections"] = ["large-deflection"]
    files = {"force": "rec1_007.mat", "frame": "run.txt", "markers": "take.csv"}
    by = stated(chance.kind, "specimen", "uncertainty", "span")
    span = f"{1e3 * (SPAN + chance.error(by)):.4f} mm"
    bundle = {"span": span, "bundle": {"wires": {"B1": 19}}}
    write_sheet(folder, sheet(chance, bundle, files, **changed))
    truth = {"clock_offset": early - 0.02, "clock_drift": 0.0, "twist": TWIST}
    return Made(folder, {**truth, **_pressed_truth(rig)})


def _press(chance: Chance, folder: Path, rig: Conduit, early: float) -> None:
    """Volts of the recorder, which starts a little before the frame; the frame's crosshead."""
    ticks = np.arange(0.0, rig.end - rig.begin + early, 1.0 / RATE)
    force = chance.noisy(rig.bent(rig.begin - early + ticks)[0], 1.0 / RATE)
    volts = (force * (1.0 + chance.error(scale(chance.kind, "force"))) - 0.002846) / -0.21082
    write_mat(folder / "rec1_007.mat", ticks, {"Model Root/Load Cell/Out1": volts})
    time = np.arange(rig.begin, rig.end, 1.0 / FPS)
    crosshead = noisy(
        rig.way.travel(time), "white", min(chance.loud, 1.0) * 1e-7, 1.0 / FPS, chance.rng
    )
    crosshead *= 1.0 + chance.off("travel", scale(chance.kind, "frame", "displacement"))
    columns = [("Crosshead", "mm", 1e3 * crosshead), ("Time", "sec", time - rig.begin + 0.02)]
    write_mts(folder / "run.txt", columns)


def _watch(chance: Chance, folder: Path, rig: Conduit) -> None:
    """Two rows of markers, seen from 3.2 s before the frame moves."""
    time = np.arange(rig.begin - (0.0 if rig.begin else 3.2), rig.end, 1.0 / SLOW_FPS)
    _, deflection = rig.bent(time)
    turn, _ = at_rest_turned(chance)
    twist = deflection / rig.way.stroke * TWIST
    by = stated(chance.kind, "markers", "centre_uncertainty")
    markers = _on_conduit(deflection, twist, RADIUS + chance.off("centre", by)) @ turn.T
    order = chance.rng.permutation(markers.shape[1])
    named = {f"C{i + 1}": chance.seen(markers[:, j] + 0.4) for i, j in enumerate(order)}
    write_motive(folder / "take.csv", SLOW_FPS, None, named, np.zeros(4))


def _pressed_truth(rig: Conduit) -> Truth:
    stroke, (load, unload) = rig.way.stroke, rig.laws
    there, back = np.linspace(0.0, stroke, 12001), np.linspace(stroke, rig.left, 12001)
    force = load(there)
    lost = specimens.work(there, force) + specimens.work(back, unload(back))
    truth = {"peak_force.1": float(force[-1]), "peak_displacement.1": stroke, "energy.1": lost}
    return {**truth, **bundle_truth(there, force), **rod_truth(there, force, SPAN)}


def rod_truth(d: Array, f: Array, span: float) -> Truth:
    """Numbers that are read as if the specimen were a uniform rod."""
    rod = knives()
    ratio, elastic, bend, slope = (
        np.interp(d / span, rod.deflection, row)
        for row in (rod.deflection, rod.load, rod.curvature, rod.slope)
    )
    share = specimens.window_slope(d, elastic / span**2, 0.2e-3, 5e-3)
    stiff = specimens.window_slope(d, f, 0.2e-3, 5e-3)
    moment = 0.25 * f * span * (1.0 + 2.0 * ratio * np.tan(slope))
    inside = (d >= 1e-3) & (d <= 10e-3)
    middle = specimens.slope(bend[inside] / span, moment[inside])
    return {
        "bending_stiffness": stiff / share,
        "mid_span_bending_stiffness": middle,
        "mid_span_curvature": float(bend[-1] / span),
    }


def _on_conduit(deflection: Array, twist: Array, radius: float) -> Array:
    """Two rows of markers, 35 deg off the side, every half inch; (frames, markers, 3)."""
    along = 12.7e-3 * np.arange(-6.0, 7.0)
    x, y, angle = knives().axis(deflection, SPAN, along)
    rows = []
    for around in np.radians((55.0, 125.0)):
        up = radius * np.cos(around + twist)[:, None]
        out = radius * np.sin(around + twist)[:, None] * np.ones_like(x)
        rows.append(np.stack([x - up * np.sin(angle), y + up * np.cos(angle), out], axis=2))
    return np.concatenate(rows, axis=1)


CAMERAS: dict[str, Callable[[Chance, Path], Made]] = {
    "wire-cantilever": wire_cantilever,
    "taped-bundle": taped_bundle,
    "conduit-bundle": conduit_bundle,
}
