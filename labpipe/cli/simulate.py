"""``labpipe simulate``."""

from __future__ import annotations

import argparse
from dataclasses import replace

from labpipe.errors import UsageError, complaint
from labpipe.units import parse_quantity
from labpipe.virtual_lab import CantileverScenario, simulate_test


def run(options: argparse.Namespace) -> int:
    """Write the synthetic exports of one cantilever test, its sheet, and the truth."""
    usual = CantileverScenario()
    try:
        rate, fps = (parse_quantity(text, "1/s") for text in (options.rate, options.fps))
        scenario = replace(
            usual,
            name=options.name,
            mechanics=replace(usual.mechanics, cycles=options.cycles),
            clocks=replace(usual.clocks, rate=rate, fps=fps),
        )
        folder = simulate_test(scenario, options.out / options.name, options.seed)
    except ValueError as error:
        message = complaint(
            "options",
            "",
            expected="--rate and --fps such as '10 kHz' and '50 Hz', at least one cycle",
            found=str(error),
            remedy="See `labpipe simulate --help`.",
        )
        raise UsageError(message) from error
    print(f"wrote {folder}: exports, test.yaml, truth.json (synthetic, seed {options.seed})")
    return 0
