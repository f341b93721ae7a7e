"""``labpipe simulate``: write synthetic exports of a test with known true values."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from labpipe.errors import UsageError
from labpipe.protocol.grammar import is_test_name, try_parse_quantity
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, build_taped_scenario
from labpipe.virtual_lab.lab_files import Scenario, simulate_test
from labpipe.virtual_lab.specimens import CONDUIT_TYPES, TAPED_TYPES
from labpipe.virtual_lab.tensile import MetalTension
from labpipe.virtual_lab.three_point import build_conduit_scenario

_TYPES = {
    "wire": (),
    "metal-tension": (),
    "taped-bundle": TAPED_TYPES,
    "conduit-bundle": CONDUIT_TYPES,
}
"""Specimen types, keyed by kind of test; a kind without types has only one specimen."""
_DEFAULT_TYPES = {"taped-bundle": "TWB-B1-19-PVC", "conduit-bundle": "CWB-1"}
"""Specimen type without the option ``--type``, keyed by kind of test."""
_WIRE_TYPE = "W1"
"""Type of the simulated wire. No wire sheet has it, since its bending law has no cross-section."""


def run(options: argparse.Namespace) -> int:
    """Write the synthetic exports of one test, its sheet, and the true values."""
    try:
        folder = _simulate(options)
    except ValueError as error:
        raise UsageError.about("cli.bad_scenario", "options", found=error) from error
    print(f"wrote {folder}: exports, test.yaml, truth.json (synthetic, seed {options.seed})")
    return 0


def _simulate(options: argparse.Namespace) -> Path:
    """Simulate the test and return its folder; a `ValueError` lists all faults of the options."""
    cycles = 3 if options.cycles is None else options.cycles
    texts = {"rate": options.rate or "10 kHz", "fps": options.fps or "50 Hz"}
    rate, fps = (try_parse_quantity(text, "1/s") or 0.0 for text in texts.values())
    settings = {"rate": rate, "fps": fps, "cycles": cycles}
    faults = [f"{x}={texts.get(x, cycles)}" for x, value in settings.items() if not value >= 1]
    if not is_test_name(options.name):
        faults.append(f"name={options.name}")
    specimen_type = options.type or _DEFAULT_TYPES.get(options.kind, "")
    if specimen_type and specimen_type not in _TYPES[options.kind]:
        faults.append(f"type={specimen_type} of a {options.kind}")
    unused_options = {"conduit-bundle": ("cycles",), "metal-tension": ("cycles", "rate", "fps")}
    for name in unused_options.get(options.kind, ()):
        value = getattr(options, name)
        if value is not None:
            faults.append(f"{name}={value} of a {options.kind.replace('-', ' ')}")
    if faults:
        raise ValueError(", ".join(faults))
    scenario: Scenario
    if options.kind == "metal-tension":
        scenario = MetalTension(name=options.name)
    elif options.kind == "conduit-bundle":
        conduit = build_conduit_scenario(specimen_type)
        clocks = replace(conduit.clocks, rate=rate, fps=fps)
        scenario = replace(conduit, name=options.name, clocks=clocks)
    else:
        wire = CantileverScenario(specimen_type=_WIRE_TYPE, spool=f"{_WIRE_TYPE}-s1")
        cantilever = wire if options.kind == "wire" else build_taped_scenario(specimen_type)
        scenario = replace(
            cantilever,
            name=options.name,
            mechanics=replace(cantilever.mechanics, cycles=cycles),
            clocks=replace(cantilever.clocks, rate=rate, fps=fps),
        )
    return simulate_test(scenario, options.out / options.name, options.seed)
