"""How the cost of a test grows with its samples, cycles and frames.

As a command: ``python -m benchmarks.growth``.

Each line varies one of them by factors of two and prints the processor time of one more test of a
campaign (`benchmarks.next_test`) and the exponent of a power law through all sizes, by least
squares. One is proportional; a cost that does not depend on the size has zero.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.timing import labpipe, timed

SIZES: dict[str, tuple[tuple[str, ...], ...]] = {
    "samples (--rate, kHz)": tuple(("--rate", f"{rate} kHz") for rate in (5, 10, 20, 40)),
    "cycles (--cycles)": tuple(("--rate", "1 kHz", "--cycles", str(n)) for n in (3, 6, 12, 24)),
    "frames (--fps, Hz)": tuple(
        ("--rate", "1 kHz", "--fps", f"{n} Hz") for n in (25, 50, 100, 200)
    ),
}
NEXT_TEST = Path(__file__).with_name("next_test.py")


def measure_cpu(options: tuple[str, ...], folder: Path) -> float:
    """Return the processor time of one more test that is simulated with these options, s."""
    name = "-".join(options).replace(" ", "").strip("-")
    timed(labpipe("simulate", "--out", folder, "--name", name, *options))
    cost_file = folder / "cost.json"
    test = str(folder / name)
    timed([sys.executable, "-P", str(NEXT_TEST), str(cost_file), test, test, test])
    return float(json.loads(cost_file.read_text(encoding="utf-8"))["cpu"])


def main() -> None:
    """Print a line for each quantity."""
    for quantity, sizes in SIZES.items():
        with tempfile.TemporaryDirectory() as folder:
            seconds = [measure_cpu(options, Path(folder)) for options in sizes]
        steps = np.arange(len(seconds)) * np.log(2.0)
        exponent = np.polyfit(steps, np.log(seconds), 1)[0]
        listed = ", ".join(f"{cpu:.2f}" for cpu in seconds)
        print(f"{quantity:<24}exponent {exponent:4.2f}   cpu, s: {listed}", flush=True)


if __name__ == "__main__":
    main()
