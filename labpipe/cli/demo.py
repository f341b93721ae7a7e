"""``labpipe demo``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from labpipe.cli.process import process_all
from labpipe.cli.report import status_of
from labpipe.cli.telling import headline, report_table, table
from labpipe.pipeline.process import Processed
from labpipe.pipeline.reporting import report_tests
from labpipe.pipeline.targets import find_tests
from labpipe.virtual_lab import simulate_campaign, simulate_tensile_campaign

SAMPLES = 3
"""Cantilever tests; the tensile tests are as many as the campaign has."""


def run(options: argparse.Namespace) -> int:
    """Make a synthetic campaign in vendor formats, process and report it, and say where to look."""
    raw = options.folder / "raw" / "demo"
    out = options.folder / "processed" / "demo"
    print(f"making a synthetic campaign in {raw}", file=sys.stderr)
    simulate_campaign(raw, samples=SAMPLES)
    simulate_tensile_campaign(raw)
    processed, refused = process_all(find_tests([raw]), out=out, figures=not options.no_figures)
    print(_told(processed))
    reported = report_tests([each.folder for each in processed], title="Synthetic demo campaign")
    print(f"\n{report_table(reported)}")
    figures = [
        path for each in _firsts(processed) for path in each.figures if path.suffix == ".png"
    ]
    if figures:
        print("\nfigures to look at, of the first test of each kind:")
        print("\n".join(f"  {path}" for path in figures))
    return 2 if refused else max(status_of(reported), int(any(each.n_failed for each in processed)))


def _told(processed: Sequence[Processed]) -> str:
    """The first test of each kind in full, the others in a line."""
    firsts = _firsts(processed)
    told = [f"\n{table(each)}\n" if each in firsts else headline(each) for each in processed]
    return "\n".join(told).replace("\n\n\n", "\n\n").strip()


def _firsts(processed: Sequence[Processed]) -> list[Processed]:
    kinds: dict[str, Processed] = {}
    for each in processed:
        kinds.setdefault(each.result.protocol, each)
    return list(kinds.values())
