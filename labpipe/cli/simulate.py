"""``labpipe simulate``."""

from __future__ import annotations

import argparse
import re
from collections.abc import Container
from dataclasses import replace
from pathlib import Path

from labpipe.errors import UsageError, error_text
from labpipe.units import parse_quantity
from labpipe.virtual_lab import (
    CONDUIT_TYPES,
    TAPED_TYPES,
    CantileverScenario,
    conduit_scenario,
    simulate_test,
    taped_scenario,
)

_DEFAULT_TYPES = {"taped-bundle": "TWB-B1-19-PVC", "conduit-bundle": "CWB-1"}
_WIRE = "W1"
"""Not in any wire sheet: its law is given by numbers, not by strands."""


def run(options: argparse.Namespace) -> int:
    """Write the synthetic exports of one test, its sheet, and the truth."""
    try:
        folder = _simulate(options)
    except ValueError as error:
        message = error_text(
            "options",
            "",
            expected='--rate and --fps such as "10 kHz" and "50 Hz", at least one cycle, a plain '
            "name, and a type and cycles that fit the kind",
            found=str(error),
            remedy="See `labpipe simulate --help`.",
        )
        raise UsageError(message) from error
    print(f"wrote {folder}: exports, test.yaml, truth.json (synthetic, seed {options.seed})")
    return 0


def _simulate(options: argparse.Namespace) -> Path:
    rate, fps = (parse_quantity(text, "1/s") for text in (options.rate, options.fps))
    cycles = 3 if options.cycles is None else options.cycles
    _check(rate=rate, fps=fps, cycles=cycles, name=options.name)
    if options.kind == "conduit-bundle":
        return _conduit(options, rate=rate, fps=fps)
    scenario = _cantilever(options)
    scenario = replace(
        scenario,
        name=options.name,
        mechanics=replace(scenario.mechanics, cycles=cycles),
        clocks=replace(scenario.clocks, rate=rate, fps=fps),
    )
    return simulate_test(scenario, options.out / options.name, options.seed)


def _cantilever(options: argparse.Namespace) -> CantileverScenario:
    """Return the default wire, or the bundle of the options."""
    if options.kind == "wire":
        if options.type is not None:
            message = f"type={options.type} of a wire"
            raise ValueError(message)
        return CantileverScenario(specimen_type=_WIRE, spool=f"{_WIRE}-s1")
    return taped_scenario(_type(options, TAPED_TYPES))


def _conduit(options: argparse.Namespace, *, rate: float, fps: float) -> Path:
    if options.cycles is not None:
        message = f"cycles={options.cycles} of a conduit bundle"
        raise ValueError(message)
    scenario = conduit_scenario(_type(options, CONDUIT_TYPES))
    clocks = replace(scenario.clocks, rate=rate, fps=fps)
    scenario = replace(scenario, name=options.name, clocks=clocks)
    return simulate_test(scenario, options.out / options.name, options.seed)


def _type(options: argparse.Namespace, types: Container[str]) -> str:
    specimen_type = _DEFAULT_TYPES[options.kind] if options.type is None else str(options.type)
    if specimen_type not in types:
        message = f"type={specimen_type} of a {options.kind}"
        raise ValueError(message)
    return specimen_type


def _check(*, rate: float, fps: float, cycles: int, name: str) -> None:
    """Refuse numbers and names that make no virtual test."""
    numbers = {"rate": rate, "fps": fps, "cycles": cycles}
    wrong = [f"{key}={value:g}" for key, value in numbers.items() if not value >= 1]
    if not re.fullmatch(r"\w[\w.+-]*", name):
        wrong.append(f"name={name}")
    if wrong:
        message = ", ".join(wrong)
        raise ValueError(message)
