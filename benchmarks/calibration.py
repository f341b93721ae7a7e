"""A calibration of nine virtual curves, profiles and all, against its bound."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.first_loadings import observe_loading
from labpipe.mechanics.wire.calibration.calibrate_wire import (
    MeasuredCurve,
    Settings,
    Wire,
    calibrate,
)
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.records.wire import Calibration, CalibrationFailure
from labpipe.virtual_lab import WireCampaign
from labpipe.virtual_lab.campaigns import WireGroup
from labpipe.virtual_lab.specimens import WIRES

RUNS = 5
LENGTHS = (0.070, 0.085, 0.100)
SAMPLES = 3
POINTS = 272
DEEPEST = 0.62  # of the length, which the calibration follows
GRAVITY = 9.80665
GAIN = 0.002


def curves() -> list[MeasuredCurve]:
    """Three samples of A2 at each of three lengths."""
    groups = tuple(WireGroup(WIRES["A2"], length) for length in LENGTHS)
    campaign = WireCampaign(groups=groups, samples=SAMPLES, cycles=1, has_mishaps=False)
    measured = []
    for scenario, seed in campaign.list_scenarios(5):
        rig = scenario.mechanics
        stroke = min(rig.stroke, DEEPEST * rig.length)
        test = replace(scenario, mechanics=replace(rig, stroke=stroke))
        observed = observe_loading(test, seed, n_points=POINTS)
        slope = np.gradient(observed.true_force, observed.true_deflection)
        string = StringRig(
            rig.string_length, GRAVITY * rig.counterweight, rig.length, rig.string_length
        )
        measured.append(
            MeasuredCurve(
                wire="A2",
                test=scenario.name,
                sample=scenario.name,
                length=rig.length,
                deflection=observed.deflection,
                force=observed.force,
                noise=np.hypot(scenario.load_cell.noise, slope * scenario.markers.noise),
                rig=string,
                self_weight=rig.gravity * rig.wire.mass_per_length,
            )
        )
    return measured


def main() -> None:
    wire, tests = WIRES["A2"], curves()
    wire_model = Wire(wire.build_section(), wire.build_contacts())
    clock, processor = [], []

    def work() -> Calibration | CalibrationFailure:
        begun, busy = time.perf_counter(), time.process_time()
        calibrated = calibrate(wire_model, tests, Settings(gain=GAIN))
        clock.append(time.perf_counter() - begun)
        processor.append(time.process_time() - busy)
        return calibrated

    outcome = [work() for _ in range(RUNS)][-1]
    if isinstance(outcome, CalibrationFailure):
        message = f"{outcome.code}: {outcome.message}"
        raise RuntimeError(message)
    label = f"calibration, {len(tests)} curves of {POINTS} points, s"
    print(f"{label:<44}{min(clock):>8.2f}   (at most 2)  with profiles", flush=True)
    print(f"{'  processor time, s':<44}{min(processor):>8.2f}", flush=True)


if __name__ == "__main__":
    main()
