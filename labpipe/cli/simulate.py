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

_TYPES = {"taped-bundle": TAPED_TYPES, "conduit-bundle": CONDUIT_TYPES}
"""Specimen types, keyed by kind of test; each other kind has one specimen."""
_DEFAULT_TYPES = {"taped-bundle": "TWB-B1-19-PVC", "conduit-bundle": "CWB-1"}
"""Specimen type without the option ``--type``, keyed by kind of test."""
_UNUSED_OPTIONS = {"conduit-bundle": ("cycles",), "metal-tension": ("cycles", "rate", "fps")}
"""Options that a kind of test does not accept."""
_WIRE_TYPE = "W1"
"""Type of the simulated wire. No wire sheet lists it, because only its bending law is known."""


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
    name, kind = options.name, options.kind
    specimen_type = options.type or _DEFAULT_TYPES.get(kind, "")
    cycles = 3 if options.cycles is None else options.cycles
    rate_text, fps_text = options.rate or "10 kHz", options.fps or "50 Hz"
    rate, fps = (try_parse_quantity(text, "1/s") or 0.0 for text in (rate_text, fps_text))
    checks = {
        f"rate={rate_text}": rate >= 1.0,
        f"fps={fps_text}": fps >= 1.0,
        f"cycles={cycles}": cycles >= 1,
        f"name={name}": is_test_name(name),
        f"type={specimen_type} of a {kind}": specimen_type in _TYPES.get(kind, ("",)),
    }
    for key in _UNUSED_OPTIONS.get(kind, ()):
        value = getattr(options, key)
        checks[f"{key}={value} of a {kind}"] = value is None
    if faults := [text for text, is_valid in checks.items() if not is_valid]:
        raise ValueError(", ".join(faults))
    scenario: Scenario
    if kind == "metal-tension":
        scenario = MetalTension(name=name)
    elif kind == "conduit-bundle":
        conduit = build_conduit_scenario(specimen_type)
        scenario = replace(conduit, name=name, clocks=replace(conduit.clocks, rate=rate, fps=fps))
    else:
        wire = CantileverScenario(specimen_type=_WIRE_TYPE, spool=f"{_WIRE_TYPE}-s1")
        cantilever = wire if kind == "wire" else build_taped_scenario(specimen_type)
        mechanics = replace(cantilever.mechanics, cycles=cycles)
        clocks = replace(cantilever.clocks, rate=rate, fps=fps)
        scenario = replace(cantilever, name=name, mechanics=mechanics, clocks=clocks)
    return simulate_test(scenario, options.out / name, options.seed)
