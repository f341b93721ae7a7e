"""A synthetic test result: a cantilever with hysteresis, plastic set, noise and marker troubles.

Everything in it is made up; the shapes are smooth curves of the right kind, not a solution of the
mechanics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Floats
from labpipe.records.curve import (
    Aligned,
    Branch,
    ClockFit,
    Curve,
    Direction,
    FittedLine,
    Interval,
    PointFlag,
    Series,
    Shape,
    Slip,
    SlipDecision,
)
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import Contribution, InputFile, Result, Specimen, Status, TestResult

LENGTH = 0.085
STROKE = 0.050
REST = 3.0
OFFSET, DRIFT = 3.217, 48e-6


def build_result(
    *,
    cycles: int = 3,
    rate: float = 50.0,
    half_cycle: float = 20.0,
    markers: int = 8,
    force_rate: float = 500.0,
    seed: int = 1,
) -> TestResult:
    """Make a whole test; at 50 frames/s, 53 s and 10 kHz it has the size of a real one."""
    rng = np.random.default_rng(seed)
    turns: Floats = REST + half_cycle * np.arange(2 * cycles + 1, dtype=np.float64)
    time: Floats = np.arange(0.0, turns[-1] + REST, 1.0 / rate)
    travel = _travel(time, turns, cycles)
    displacement = travel * STROKE / 0.053
    force = _force(displacement, time, turns)
    shape = _shape(time, displacement, markers, rng)
    branches = _branches(time, turns)
    raw_force = force + rng.normal(0, 0.004, len(time))
    raw_displacement = displacement + rng.normal(0, 4e-5, len(time))
    aligned = Aligned(
        time,
        {
            "force": Series(raw_force, "N"),
            "travel": Series(travel, "m"),
            "displacement": Series(raw_displacement, "m"),
        },
        _clock_fit(turns, rng),
    )
    return TestResult(
        test="A2-085-1",
        specimen=Specimen("A2", "A2-s1", "1", {"length": LENGTH}),
        protocol="wire-cantilever",
        protocol_yaml="version: 1\nname: wire-cantilever\n",
        test_yaml="test: A2-085-1\n# µ, ü and 線\n",
        labpipe_version="0.1.0",
        inputs=(
            InputFile("markers", "take.csv", "ab" * 32, 123456),
            InputFile("force", "force_1.mat", "cd" * 32, 3_000_000_000),
            InputFile("force", "force_2.mat", "ef" * 32, 7),
        ),
        recordings={
            "markers": _take(shape, travel, rng),
            "force": _load_cell(turns, cycles, force_rate, rng),
        },
        aligned=aligned,
        curve=Curve(time, displacement, force, branches),
        shape=shape,
        results=_results(),
        quality=_quality(),
        display={"displacement": "mm", "force": "N", "energy": "mJ", "time": "s"},
        figures=("force-displacement", "wire-shapes", "timeline", "marker-quality"),
    )


def around(value: float, half: float) -> Interval:
    return Interval(value - half, value + half)


def with_slips(result: TestResult, decision: SlipDecision = SlipDecision.REPAIRED) -> TestResult:
    """Give a test two slips and two lines, as a tensile test has them."""
    slips = tuple(
        Slip(position, drop, around(position, 1e-5), around(drop, 0.1), decision, start, start + 2)
        for position, drop, start in ((0.011, 1.5, 11), (0.023, 0.7, 23))
    )
    lines = (
        FittedLine("stiffness_first", 1.2e4, 0.3, 0.002, 0.008),
        FittedLine("stiffness_second", 2.3e3, 81.0, 0.010, 0.020),
    )
    return replace(result, slips=slips, lines=lines)


def counted_in_rows(result: TestResult) -> TestResult:
    """Give a test clocks that only count the rows of an export without times."""
    if result.aligned is None or result.curve is None:
        message = "expected a test with a curve"
        raise ValueError(message)
    rows: Floats = np.arange(len(result.curve.time), dtype=np.float64)
    channel = Channel("Load", "Load", result.curve.force, "rows", "N", "kN")
    recording = Recording("load-frame", clocks=(Clock("rows", rows, "1"),), channels=(channel,))
    return replace(
        result,
        recordings={"frame": recording},
        aligned=replace(result.aligned, time=rows, clock_fit=None, time_unit="1"),
        curve=replace(result.curve, time=rows, time_unit="1"),
    )


def _travel(time: Floats, turns: Floats, cycles: int) -> Floats:
    levels = np.array([0.0, *([0.053, 0.0] * cycles)])
    smooth: Floats = np.interp(time, turns, levels)
    return smooth


def _force(displacement: Floats, time: Floats, turns: Floats) -> Floats:
    """Many sliders in parallel: loops, softening, a set after each cycle, and some fatigue."""
    limits = np.geomspace(4e-4, 0.06, 24)
    stiffness = np.full(24, 0.5)
    slider = np.zeros(24)
    force = np.empty_like(displacement)
    for number, place in enumerate(displacement):
        slider = np.clip(slider, place - limits, place + limits)
        force[number] = stiffness @ (place - slider)
    cycle = np.clip((time - turns[0]) / (turns[2] - turns[0]), 0, None)
    total: Floats = (force + 3.0 * displacement) * (1.0 - 0.03 * np.minimum(cycle, 6))
    return total


def _branches(time: Floats, turns: Floats) -> tuple[Branch, ...]:
    cuts = np.searchsorted(time, turns)
    return tuple(
        Branch(
            start=int(cuts[number]),
            stop=int(cuts[number + 1]),
            cycle=number // 2 + 1,
            direction=Direction.UNLOADING if number % 2 else Direction.LOADING,
            start_time=float(turns[number]),
            stop_time=float(turns[number + 1]),
        )
        for number in range(len(turns) - 1)
    )


def _clock_fit(turns: Floats, rng: np.random.Generator) -> ClockFit:
    errors = rng.uniform(5e-4, 2e-3, len(turns))
    return ClockFit(
        offset=OFFSET,
        drift=DRIFT,
        offset_interval=around(OFFSET, 0.002),
        drift_interval=around(DRIFT, 9e-6),
        residual=0.0012,
        event_times_motion=turns,
        event_times_force=OFFSET + (1 + DRIFT) * turns + rng.normal(0, errors),
        event_errors=errors,
        method="straight line through the turning points",
    )


def _shape(time: Floats, displacement: Floats, markers: int, rng: np.random.Generator) -> Shape:
    """Clamped end, markers, pull point on curves whose slope is a parabola in arc length."""
    terms = 8
    along: Floats = np.linspace(0.0, 1.0, 41)
    table = np.linspace(0.0, 1.4, 60)
    grid = np.stack([_power_series(tip, along, terms) for tip in table])
    tip_y = grid[:, 1, :].sum(axis=1)
    tips = np.interp(displacement, tip_y, table)
    low = np.clip(np.searchsorted(table, tips) - 1, 0, len(table) - 2)
    part = ((tips - table[low]) / (table[1] - table[0]))[:, None, None]
    coefficients = (1 - part) * grid[low] + part * grid[low + 1]
    arc = np.concatenate([[0.0], np.linspace(0.1, 0.95, markers), [1.0]])
    powers = arc[None, :] ** np.arange(terms)[:, None]
    positions = np.einsum("fct,tp->fpc", coefficients, powers)
    positions[:, 1:-1] += rng.normal(0, 1e-4, positions[:, 1:-1].shape)
    flags = _flags(len(time), markers)
    positions[flags == PointFlag.MISSING] = np.nan
    names = ("clamped end", *(f"wire:Marker{number + 1}" for number in range(markers)), "pull")
    turn = np.deg2rad(5.0)
    rotation = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    return Shape(
        time=time,
        positions=positions,
        names=names,
        flags=flags,
        arc_length=arc * LENGTH,
        coefficients=coefficients,
        length=LENGTH,
        rotation_lab_to_specimen=np.array(rotation),
    )


def _power_series(tip_angle: float, along: Floats, terms: int) -> Floats:
    angle = tip_angle * (2 * along - along**2)
    step = along[1]
    ends = [_integral(np.cos(angle), step), _integral(np.sin(angle), step)]
    fitted = [np.polynomial.polynomial.polyfit(along, end * LENGTH, terms - 1) for end in ends]
    series: Floats = np.stack([*fitted, np.zeros(terms)])
    return series


def _integral(values: Floats, step: float) -> Floats:
    pieces = (values[1:] + values[:-1]) / 2 * step
    total: Floats = np.concatenate([[0.0], np.cumsum(pieces)])
    return total


def _flags(frames: int, markers: int) -> NDArray[np.uint8]:
    flags = np.full((frames, markers + 2), PointFlag.MEASURED, dtype=np.uint8)
    flags[:, [0, -1]] = PointFlag.CONSTRUCTED
    spot = frames // 10
    flags[3 * spot : 3 * spot + max(frames // 150, 2), 3] = PointFlag.FILLED
    flags[int(6.2 * spot) : int(6.2 * spot) + max(frames // 30, 3), 5] = PointFlag.MISSING
    flags[int(4.5 * spot) :, min(7, markers)] = PointFlag.RELABELLED
    flags[spot : spot + max(frames // 40, 3), min(7, markers)] = PointFlag.FILLED
    return flags


def _take(shape: Shape, travel: Floats, rng: np.random.Generator) -> Recording:
    frames = len(shape.time)
    nothing = np.full(frames, np.nan)
    clamp = np.stack([np.zeros(frames), -travel, np.zeros(frames)], axis=1)
    error = np.abs(rng.normal(1.2e-4, 3e-5, frames))
    error[frames // 2 : frames // 2 + frames // 50] *= 5
    bodies = (
        RigidBody("Clamp", clamp, np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1)), error),
        RigidBody("Table/1", clamp * np.nan, np.full((frames, 4), np.nan), nothing),
    )
    tracks = MarkerTracks(
        time=shape.time,
        frames=np.arange(frames, dtype=float),
        rate=50.0,
        names=shape.names[1:-1],
        positions=shape.positions[:, 1:-1],
        bodies=bodies,
        unit_in_file="Millimeters",
    )
    return Recording(
        reader="motive-csv",
        program="Motive",
        program_version="synthetic",
        markers=tracks,
        metadata={"Take Name": "synthetic \u0000 take", "columns": [1, 2.5, None, True]},
        notes=(QualityNote("time_rounded", Severity.INFO, "markers", "Times stand in ms."),),
    )


def _load_cell(turns: Floats, cycles: int, rate: float, rng: np.random.Generator) -> Recording:
    """Volts of a 16-bit converter on a slightly jittered time axis, and a slow second raster."""
    ideal: Floats = np.arange(0.0, turns[-1] + 2 * REST, 1.0 / rate)
    time = ideal + rng.normal(0, 2e-7, len(ideal))
    travel = _travel(ideal, turns + OFFSET, cycles)
    volts = 0.2 + 80 * travel * (1 - 4 * travel) + rng.normal(0, 0.008, len(ideal))
    step = 20 / 2**16
    slow: Floats = np.arange(0.0, turns[-1], 0.5)
    volts = np.round(volts / step) * step
    volts[min(5, len(volts) - 1)] = np.nan
    return Recording(
        reader="dspace-mat",
        program="ControlDesk",
        program_version="7.4",
        clocks=(Clock("HostService", time), Clock("slow raster", slow)),
        channels=(
            Channel("Out1", "Model Root/Load Cell/Out1", volts, "HostService", "V", "V"),
            Channel("Out1", "Model Root/Heat/Out1", np.cos(slow), "slow raster", None, "", "x 2"),
            Channel("time", "Model Root/time", slow, "slow raster", "s"),
        ),
        metadata={"revision": "2.1"},
    )


def _results() -> tuple[Result, ...]:
    return (
        Result(
            "peak_force.1",
            0.62,
            "N",
            Interval(0.59, 0.61),
            method="highest",
            n=41,
            estimate=0.6,
            budget=(
                Contribution("noise", 0.003),
                Contribution("scale of the force", -0.004, is_common=True),
            ),
        ),
        Result(
            "residual_displacement.1",
            0.0031,
            "m",
            status=Status.DOUBTFUL,
            reasons=(Reason("extrapolated", "the force never fell below 5 mN"),),
        ),
        Result(
            "initial_stiffness",
            None,
            "N/m",
            status=Status.FAILED,
            reasons=(Reason("not_reached", "too short"),),
        ),
    )


def _quality() -> tuple[QualityNote, ...]:
    return (
        QualityNote("marker_filled", Severity.WARNING, "wire:Marker3", "26 frames were filled."),
        QualityNote("out_of_plane", Severity.INFO, "shape", "Out of plane by 0.3 mm, rms."),
    )


def differences(left: object, right: object, place: str = "result") -> list[str]:
    """Say where two records differ; arrays are compared bit by bit, NaN included."""
    if type(left) is not type(right):
        return [f"{place}: {type(left).__name__} and {type(right).__name__}"]
    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray):
        same = left.dtype == right.dtype and left.shape == right.shape
        return [] if same and left.tobytes() == right.tobytes() else [f"{place}: arrays differ"]
    if is_dataclass(left):
        pairs = [(f.name, getattr(left, f.name), getattr(right, f.name)) for f in fields(left)]
    elif isinstance(left, Mapping) and isinstance(right, Mapping):
        if list(left) != list(right):
            return [f"{place}: keys {list(left)} and {list(right)}"]
        pairs = [(str(key), left[key], right[key]) for key in left]
    elif isinstance(left, tuple) and isinstance(right, tuple) and len(left) == len(right):
        pairs = [(str(number), *pair) for number, pair in enumerate(zip(left, right, strict=True))]
    else:
        same = left == right or (left != left and right != right)
        return [] if same else [f"{place}: {left!r} and {right!r}"]
    return [text for name, a, b in pairs for text in differences(a, b, f"{place}.{name}")]
