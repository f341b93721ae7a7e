"""``labpipe simulate``: synthetic exports of a test with known truth."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path

from labpipe.errors import UsageError
from labpipe.units import parse_quantity
from labpipe.virtual_lab import (
    CONDUIT_TYPES,
    TAPED_TYPES,
    CantileverScenario,
    MetalTension,
    build_conduit_scenario,
    build_taped_scenario,
    simulate_tension,
    simulate_test,
)

_TYPES = {
    "wire": (),
    "metal-tension": (),
    "taped-bundle": TAPED_TYPES,
    "conduit-bundle": CONDUIT_TYPES,
}
_DEFAULT_TYPES = {"taped-bundle": "TWB-B1-19-PVC", "conduit-bundle": "CWB-1"}
_WIRE_TYPE = "W1"
"""Type of the simulated wire; it is in no wire sheet, since its law is stated by numbers."""


def run(options: argparse.Namespace) -> int:
    """Write the synthetic exports of one test, its sheet, and the truth."""
    try:
        folder = _simulate(options)
    except ValueError as error:
        raise UsageError.about("cli.bad_scenario", "options", found=error) from error
    print(f"wrote {folder}: exports, test.yaml, truth.json (synthetic, seed {options.seed})")
    return 0


def _simulate(options: argparse.Namespace) -> Path:
    rate, fps = (parse_quantity(text, "1/s") for text in (options.rate, options.fps))
    cycles = 3 if options.cycles is None else options.cycles
    numbers = {"rate": rate, "fps": fps, "cycles": cycles}
    faults = [f"{key}={value:g}" for key, value in numbers.items() if not value >= 1]
    if not re.fullmatch(r"\w[\w.+-]*", options.name):
        faults.append(f"name={options.name}")
    specimen_type = options.type or _DEFAULT_TYPES.get(options.kind, "")
    if specimen_type and specimen_type not in _TYPES[options.kind]:
        faults.append(f"type={specimen_type} of a {options.kind}")
    if options.kind == "conduit-bundle" and options.cycles is not None:
        faults.append(f"cycles={cycles} of a conduit bundle")
    if faults:
        raise ValueError(", ".join(faults))
    folder = options.out / options.name
    if options.kind == "metal-tension":
        return simulate_tension(MetalTension(name=options.name), folder, options.seed)
    if options.kind == "conduit-bundle":
        conduit = build_conduit_scenario(specimen_type)
        clocks = replace(conduit.clocks, rate=rate, fps=fps)
        return simulate_test(
            replace(conduit, name=options.name, clocks=clocks), folder, options.seed
        )
    wire = CantileverScenario(specimen_type=_WIRE_TYPE, spool=f"{_WIRE_TYPE}-s1")
    scenario = wire if options.kind == "wire" else build_taped_scenario(specimen_type)
    scenario = replace(
        scenario,
        name=options.name,
        mechanics=replace(scenario.mechanics, cycles=cycles),
        clocks=replace(scenario.clocks, rate=rate, fps=fps),
    )
    return simulate_test(scenario, folder, options.seed)
