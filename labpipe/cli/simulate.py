"""``labpipe simulate``."""

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
    build_conduit_scenario,
    build_taped_scenario,
    simulate_test,
)

_TYPES = {"wire": (), "taped-bundle": TAPED_TYPES, "conduit-bundle": CONDUIT_TYPES}
_DEFAULT_TYPES = {"taped-bundle": "TWB-B1-19-PVC", "conduit-bundle": "CWB-1"}
_WIRE = "W1"
"""Not in any wire sheet: its law is given by numbers, not by strands."""


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
    wrong = [f"{key}={value:g}" for key, value in numbers.items() if not value >= 1]
    if not re.fullmatch(r"\w[\w.+-]*", options.name):
        wrong.append(f"name={options.name}")
    specimen_type = options.type or _DEFAULT_TYPES.get(options.kind, "")
    if specimen_type and specimen_type not in _TYPES[options.kind]:
        wrong.append(f"type={specimen_type} of a {options.kind}")
    if options.kind == "conduit-bundle" and options.cycles is not None:
        wrong.append(f"cycles={cycles} of a conduit bundle")
    if wrong:
        raise ValueError(", ".join(wrong))
    goal = options.out / options.name
    if options.kind == "conduit-bundle":
        conduit = build_conduit_scenario(specimen_type)
        clocks = replace(conduit.clocks, rate=rate, fps=fps)
        return simulate_test(replace(conduit, name=options.name, clocks=clocks), goal, options.seed)
    wire = CantileverScenario(specimen_type=_WIRE, spool=f"{_WIRE}-s1")
    bent = wire if options.kind == "wire" else build_taped_scenario(specimen_type)
    bent = replace(
        bent,
        name=options.name,
        mechanics=replace(bent.mechanics, cycles=cycles),
        clocks=replace(bent.clocks, rate=rate, fps=fps),
    )
    return simulate_test(bent, goal, options.seed)
