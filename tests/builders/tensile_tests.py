"""Synthetic tensile tests: on disk and in memory, and the true value of each of their results."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import Result
from labpipe.virtual_lab import observe, simulate_test
from labpipe.virtual_lab.instruments import PORT, ForceRecord, FrameRecord, Take, round_to_single
from labpipe.virtual_lab.lab_files import Observation
from labpipe.virtual_lab.tensile import TensileScenario
from tests.builders.small_tests import LabFolder

SEGMENTS = {"twist-tube": (2e-3, 20e-3), "pet-tape": (1e-3, 35e-3)}
"""Windows of the two-segment fits of the shipped protocols, m."""


@dataclass(frozen=True, slots=True)
class TensileLab(LabFolder):
    """One tensile test."""

    @property
    def export(self) -> Path:
        """The one export of the test."""
        (match,) = (path for path in self.raw.iterdir() if path.suffix in {".txt", ".xlsx", ".csv"})
        return match


def make_tensile(home: Path, scenario: TensileScenario, seed: int = 1) -> TensileLab:
    lab = TensileLab(home, scenario.name)
    simulate_test(scenario, lab.raw, seed)
    return lab


def write_pull(
    lab: TensileLab, protocol: str, force: Floats, travel: Floats, *, rate: float = 20.0
) -> None:
    """A TestSuite export of given numbers (N, m), and its sheet; synthetic."""
    lab.raw.mkdir(parents=True, exist_ok=True)
    head = ["File Path: C:\\SYNTHETIC   ", "Test: SYNTHETIC", f"Test Run: {lab.name}"]
    head += ["Date: 3/9/2026 10:05:00 AM", "", "", "Crosshead \tLoad \tTime ", "mm\tN\tsec"]
    rows = [
        f"{1e3 * d:.9G}\t{f:.9G}\t{(number + 1) / rate:.9G}"
        for number, (d, f) in enumerate(zip(travel, force, strict=True))
    ]
    (lab.raw / "pull.txt").write_bytes("\r\n".join([*head, *rows, ""]).encode("utf-8-sig"))
    lab.sheet.write_text(
        f"test: {lab.name}\nprotocol: {protocol}\n"
        'specimen: {type: synthetic, spool: "1", sample: "1", length: 75 mm}\n'
        "files: {frame: pull.txt}\n",
        encoding="utf-8",
    )


def shipped(repository: Path, name: str) -> Protocol:
    """A shipped protocol."""
    text = (repository / "protocols" / f"{name}.yaml").read_text(encoding="utf-8")
    return parse_protocol(text, f"{name}.yaml")


def reduced_in_memory(test: Observation[TensileScenario], protocol: Protocol) -> tuple[Result, ...]:
    """Results of an observation, without files in between."""
    frame, names = recordings_of(test)["frame"], {"Load": "force", "Crosshead": "displacement"}
    channels = tuple(replace(channel, name=names[channel.name]) for channel in frame.channels)
    return reduce_recordings({"frame": replace(frame, channels=channels)}, protocol).results


def recordings_of(test: Observation[Any]) -> dict[str, Recording]:
    """What the exports of an observation would be read as, by role: forces in V, others in SI."""
    return {role: _as_read(record) for role, record in test.records.items()}


def _as_read(record: ForceRecord | FrameRecord | Take) -> Recording:
    if isinstance(record, ForceRecord):
        signals = tuple(
            Channel(PORT, f"{path}/{PORT}", values, "HostService")
            for path, values in record.signals.items()
        )
        return Recording("dspace-mat", "", "", (Clock("HostService", record.clock_times),), signals)
    if isinstance(record, FrameRecord):
        travel, force = round_to_single(record.displacement), round_to_single(record.force)
        channels = (
            Channel("Crosshead", "Crosshead", travel, unit="m", unit_in_file="mm"),
            Channel("Load", "Load", force, unit="N", unit_in_file="N"),
        )
        return Recording("load-frame", clocks=(Clock("time", record.time),), channels=channels)
    bodies = tuple(
        RigidBody(body.name, *(x.round(6) for x in (body.position, body.rotation, body.error)))
        for body in record.bodies
    )
    frames = np.arange(float(len(record.time)))
    positions = record.positions.round(6)
    tracks = MarkerTracks(record.time, frames, record.rate, record.labels, positions, bodies)
    return Recording("motive-csv", markers=tracks)


def true_results(scenario: TensileScenario, seed: int) -> dict[str, float]:
    """True value of each result of the shipped protocols, by name."""
    return true_values(observe(scenario, seed))


def true_values(test: Observation[TensileScenario]) -> dict[str, float]:
    """As `true_results`, of a test that has been observed.

    Displacements count from the first sample, or from the foot where slack is taken off. A repaired
    curve ends higher by the drops of its slips. A slip is placed at the middle of its fall.
    """
    scenario, truth = test.scenario, test.truth
    start = float(truth["displacement"][0])
    zero = truth["foot"] if scenario.protocol == "pet-tape" else start
    peak = truth["peak_force"] + sum(slip.drop for slip in scenario.slips)
    values = {
        "peak_force.1": peak,
        "peak_displacement.1": truth["peak_displacement"] - start,
        "slack": truth["foot"] - start,
        "stiffness": truth["stiffness_first"],
        "stiffness_first": truth["stiffness_first"],
        "stiffness_second": truth["stiffness_second"],
        "stiffness_first_per_peak_force": truth["stiffness_first"] / peak,
        "stiffness_second_per_peak_force": truth["stiffness_second"] / peak,
        "compliance": 1.0 / truth["stiffness_first"],
        **_true_moduli(test),
    }
    for number, slip in enumerate(scenario.slips, start=1):
        middle = slip.position + 0.5 * slip.duration * scenario.frame.speed
        values |= {f"slip_position.{number}": middle - zero, f"slip_drop.{number}": slip.drop}
    if truth["failure_displacement"] is None:
        return values
    return values | {
        "failure_displacement": truth["failure_displacement"] - zero,
        "failure_force": truth["failure_force"],
        "energy_to_break": truth["energy_to_break"],
        **_true_segments(test, zero),
    }


def _true_moduli(test: Observation[TensileScenario]) -> dict[str, float]:
    """Moduli for the sections that stand in the protocols."""
    scaled = test.truth["stiffness_first"] * test.scenario.length
    outer, inner, wall = 14.1e-3, 10.7e-3, 0.27e-3
    return {
        "modulus_thin_wall": scaled / (math.pi * (outer - wall) * wall),
        "modulus_annulus": scaled / (0.25 * math.pi * (outer**2 - inner**2)),
        "modulus": scaled / (18.79e-3 * 0.28e-3),
    }


def _true_segments(test: Observation[TensileScenario], zero: float) -> dict[str, float]:
    """The best two segments of the true curve, which has a rounded knee: by plain search."""
    low, high = SEGMENTS[test.scenario.protocol]
    x = np.linspace(low, high, 1500)
    y = test.scenario.compute_force((x + zero) / test.scenario.frame.speed)

    def fitted(at: float) -> tuple[Floats, float]:
        design = np.column_stack([np.ones_like(x), np.minimum(x - at, 0), np.maximum(x - at, 0)])
        coefficients = np.linalg.lstsq(design, y, rcond=None)[0]
        return coefficients, float(np.sum((y - design @ coefficients) ** 2))

    grid = np.linspace(x[5], x[-6], 60)
    near = int(np.argmin([fitted(at)[1] for at in grid]))
    bounds = (grid[max(near - 1, 0)], grid[min(near + 1, 59)])
    match = minimize_scalar(
        lambda at: fitted(at)[1], bounds=bounds, method="bounded", options={"xatol": 1e-9}
    )
    _, first, second = fitted(match.x)[0]
    return {
        "break_point": float(match.x),
        "segment_stiffness_first": float(first),
        "segment_stiffness_second": float(second),
    }
