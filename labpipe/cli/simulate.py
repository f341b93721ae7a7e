"""``labpipe simulate``."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace

from labpipe.errors import UsageError, complaint
from labpipe.units import parse_quantity
from labpipe.virtual_lab import CantileverScenario, simulate_test


def run(options: argparse.Namespace) -> int:
    """Write the synthetic exports of one cantilever test, its sheet, and the truth."""
    usual = CantileverScenario()
    try:
        rate, fps = (parse_quantity(text, "1/s") for text in (options.rate, options.fps))
        _check(rate=rate, fps=fps, cycles=options.cycles, name=options.name)
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
            expected="--rate and --fps such as '10 kHz' and '50 Hz', a cycle, a plain name",
            found=str(error),
            remedy="See `labpipe simulate --help`.",
        )
        raise UsageError(message) from error
    print(f"wrote {folder}: exports, test.yaml, truth.json (synthetic, seed {options.seed})")
    return 0


def _check(*, rate: float, fps: float, cycles: int, name: str) -> None:
    """Refuse what no virtual test can be made of."""
    numbers = {"rate": rate, "fps": fps, "cycles": cycles}
    wrong = [f"{key}={value:g}" for key, value in numbers.items() if not value >= 1]
    if not re.fullmatch(r"\w[\w.+-]*", name):
        wrong.append(f"name={name}")
    if wrong:
        message = ", ".join(wrong)
        raise ValueError(message)
