"""``labpipe demo``."""

from __future__ import annotations

import argparse
import sys

from labpipe.cli.process import process_all
from labpipe.cli.telling import table
from labpipe.pipeline.process import find_tests
from labpipe.virtual_lab import simulate_campaign

SAMPLES = 3


def run(options: argparse.Namespace) -> int:
    """Make a synthetic campaign in vendor formats, process it, and say where to look."""
    raw = options.folder / "raw" / "demo"
    out = options.folder / "processed" / "demo"
    print(f"making a synthetic campaign of {SAMPLES} tests in {raw}", file=sys.stderr)
    simulate_campaign(raw, samples=SAMPLES)
    processed, refused = process_all(find_tests([raw]), out=out, figures=not options.no_figures)
    print("\n\n".join(table(each) for each in processed))
    figures = [path for each in processed for path in each.figures if path.suffix == ".png"]
    if figures:
        print("\nfigures to look at:")
        print("\n".join(f"  {path}" for path in figures))
    if refused:
        return 2
    return 1 if any(each.n_failed for each in processed) else 0
