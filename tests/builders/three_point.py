"""Three-point bending of an elastic rod on knife edges: recordings with known truth, in memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from labpipe.mechanics.law.plays import PlayLaw, make_elastic_law
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol, remove_absent_sources
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording
from labpipe.records.result import Result
from labpipe.results.kinds import ReducedTest


@dataclass(frozen=True)
class ElasticModel:
    """An elastic bar, with which a rig is compared with textbook solutions.

    Parameters
    ----------
    stiffness : N m^2
    """

    stiffness: float

    def build_law(self) -> PlayLaw:
        """Moment against curvature."""
        return make_elastic_law(self.stiffness)


SPAN, STROKE, SPEED, RADIUS = 0.1524, 0.0294, 0.5e-3, 8.55e-3
GAIN, OFFSET = -0.21082, 0.002846
CONDUIT = Path(__file__).parents[2] / "protocols" / "conduit-bundle.yaml"
ANGLES = (np.radians(55.0), np.radians(125.0))
"""From y towards z: two rows, 35 deg off the side that the cameras see."""


@dataclass(frozen=True)
class BendingRecord:
    """What is true of a recorded test.

    Parameters
    ----------
    rigidity : N m^2
    force_late, cameras_early : s, the force's recorder starts so late, the cameras so early
    gap : m, travel before the load touches
    twist : rad, at full stroke
    angles : rad, of the markers of a section around the axis
    noise : N, m of the frame, m of a marker
    hides : frames in which a third of the markers is seen, then another third, before the loading
    """

    rigidity: float = 0.02
    force_late: float = 0.0
    cameras_early: float = 3.2
    gap: float = 0.0
    twist: float = 0.05
    angles: tuple[float, ...] = ANGLES
    noise: tuple[float, float, float] = (5e-3, 2e-6, 2e-5)
    hides: int = 0
    seed: int = 0

    @property
    def lasts(self) -> float:
        """Duration of the loading, s."""
        return STROKE / SPEED

    def travel(self, time: Floats) -> Floats:
        """Up from time 0 on and down again, m."""
        path = SPEED * np.clip(self.lasts - np.abs(time - self.lasts), 0.0, None)
        return np.clip(path - self.gap, 0.0, None)


@lru_cache
def shapes() -> tuple[Floats, Floats, list[CubicSpline], list[CubicSpline], Floats]:
    """Deflections, loads over EI, x(s), y(s) of the right half, slopes at the support.

    By shooting, with the reaction normal to the rod at the support: no code of labpipe.
    """
    deflections, loads, xs, ys, slopes = [0.0], [0.0], [], [], [0.0]
    s = np.linspace(0.0, 0.12, 241)
    xs.append(CubicSpline(s, s))
    ys.append(CubicSpline(s, 0.0 * s))
    for slope in np.linspace(0.02, 0.75, 40):
        push = brentq(lambda n, a=slope: _reach(n, a)[0] - 0.5 * SPAN, 1.0, 4e4)
        _, half = _reach(push, slope)
        length = half.t[-1]
        inside = half.sol(np.clip(length - s, 0.0, length))
        beyond = np.clip(s - length, 0.0, None)
        x = 0.5 * SPAN - inside[2] + beyond * np.cos(slope)
        y = inside[3] + beyond * np.sin(slope)
        xs.append(CubicSpline(s, x - x[0]))
        ys.append(CubicSpline(s, y - y[0]))
        deflections.append(-float(half.y[3, -1]))
        loads.append(2.0 * push * np.cos(slope))
        slopes.append(slope)
    return np.array(deflections), np.array(loads), xs, ys, np.array(slopes)


def _reach(push: float, slope: float) -> tuple[float, Any]:
    """From the support (slope, no moment) to where the slope is zero; EI = 1 N m^2."""
    up, along = push * np.cos(slope), -push * np.sin(slope)

    def path(_: float, state: Floats) -> list[float]:
        angle, bend, _, _ = state
        pull = up * np.cos(angle) - along * np.sin(angle)
        return [-bend, pull, np.cos(angle), -np.sin(angle)]

    def flat(_: float, state: Floats) -> float:
        return float(state[0])

    flat.terminal = True  # type: ignore[attr-defined]
    start, ends = [slope, 0.0, 0.0, 0.0], [0.0, 0.3]
    half = solve_ivp(path, ends, start, events=flat, rtol=1e-9, atol=1e-12, dense_output=True)
    return float(half.y[2, -1]), half


def load_at(record: BendingRecord, deflection: Floats) -> Floats:
    """Load at some deflections, N."""
    known, loads, *_ = shapes()
    return record.rigidity * np.asarray(CubicSpline(known, loads)(deflection), dtype=np.float64)


def curvature_at(deflection: float) -> float:
    """Curvature at mid-span, 1/m: moment there over EI."""
    known, loads, _, _, slopes = shapes()
    load = float(CubicSpline(known, loads)(deflection))
    slope = float(CubicSpline(known, slopes)(deflection))
    return float(0.5 * load * (0.5 * SPAN + deflection * np.tan(slope)))


def recordings(record: BendingRecord) -> dict[str, Recording]:
    """Force in volts, frame, markers, each on its own clock."""
    random = np.random.default_rng(record.seed)
    time = np.arange(0.0, 2.0 * record.lasts + 8.0, 0.004)
    force = load_at(record, record.travel(time + record.force_late))
    volts = (force + random.normal(0.0, record.noise[0], len(time)) - OFFSET) / GAIN
    frame = np.arange(0.0, 2.0 * record.lasts + 2.0, 0.05)
    path = SPEED * np.clip(record.lasts - np.abs(frame - record.lasts), 0.0, None)
    path = path + random.normal(0.0, record.noise[1], len(frame))
    return {
        "force": _one("force", time, volts, "V"),
        "frame": _one("displacement", frame, path, "m"),
        "markers": Recording("motive-csv", markers=tracks(record, random)),
    }


def _one(name: str, time: Floats, values: Floats, unit: str) -> Recording:
    channel = Channel(name, name, values, unit=unit)
    return Recording("synthetic", clocks=(Clock("time", time),), channels=(channel,))


def tracks(record: BendingRecord, random: np.random.Generator) -> MarkerTracks:
    """Markers around the rod at every half inch, 25 frames per second, in a turned lab frame."""
    seen = np.arange(0.0, 2.0 * record.lasts + 6.0, 0.04)
    deflection = record.travel(seen - record.cameras_early)
    known, _, xs, ys, _ = shapes()
    places = 0.0127 * np.arange(-7, 8)
    half = np.abs(places)
    grid = [np.stack([piece(half) for piece in part]) for part in (xs, ys)]
    slope = np.stack([np.arctan2(y(half, 1), x(half, 1)) for x, y in zip(xs, ys, strict=True)])
    x, y = (np.asarray(CubicSpline(known, part)(deflection)) for part in grid)
    angle = np.asarray(CubicSpline(known, slope)(deflection)) * np.sign(places)
    x, y = x * np.sign(places), y - deflection[:, None]
    phi = record.twist * deflection / STROKE
    columns, names = [], []
    for number in range(len(places)):
        for row, at in enumerate(record.angles):
            off, out = RADIUS * np.cos(at + phi), RADIUS * np.sin(at + phi)
            tilt = angle[:, number]
            place = x[:, number] - np.sin(tilt) * off, y[:, number] + np.cos(tilt) * off, out
            columns.append(np.column_stack(place))
            names.append(f"S{number + 1}{'ab'[row]}")
    positions = np.stack(columns, axis=1)
    positions += random.normal(0.0, record.noise[2], positions.shape)
    for frame in range(int(25.0 * record.cameras_early)) if record.hides else ():
        is_hidden = 3 * np.arange(len(names)) // len(names) != frame // record.hides % 3
        positions[frame, is_hidden] = np.nan
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    frames = np.arange(len(seen), dtype=np.float64)
    return MarkerTracks(seen, frames, 25.0, tuple(names), positions @ turn.T + 0.3)


def reduced(
    record: BendingRecord,
    *,
    without: tuple[str, ...] = (),
    change: tuple[tuple[str, str], ...] = (),
) -> tuple[ReducedTest, dict[str, Result]]:
    """Reduce a test by the shipped protocol and the rod's span, with some changes of their text."""
    text = CONDUIT.read_text(encoding="utf-8")
    text = text.replace("  section: {outer", "  span: 152.4 mm\n  section: {outer")
    for old, new in change:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    made = recordings(record)
    for role in without:
        del made[role]
    protocol = remove_absent_sources(parse_protocol(text, "conduit-bundle.yaml"), made)
    done = reduce_recordings(made, protocol)
    return done.reduced_test, {result.name: result for result in done.results}
