"""``labpipe process``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from labpipe.cli.telling import progress, table
from labpipe.errors import LabpipeError
from labpipe.pipeline.process import Processed, process_test
from labpipe.pipeline.targets import find_tests
from labpipe.store.summary import summary


def run(options: argparse.Namespace) -> int:
    """Process tests one after the other; a bad one does not stop the others."""
    tests = find_tests(options.tests)
    processed, refused = process_all(tests, out=options.out, figures=not options.no_figures)
    if not processed:
        return 2  # each has been told
    if options.json:
        summaries = [summary(each.result) for each in processed]
        print(json.dumps(summaries[0] if len(tests) == 1 else summaries, indent=2))
    else:
        print("\n\n".join(table(each) for each in processed))
    if refused:
        return 2
    return 1 if any(each.n_failed for each in processed) else 0


def process_all(
    tests: list[Path], *, out: Path | None, figures: bool
) -> tuple[list[Processed], int]:
    """Process tests and say what is wrong with those that cannot be.

    Returns
    -------
    processed : those that were
    refused : number of those that were not
    """
    processed, refused = [], 0
    for test, say in progress(tests):
        try:
            processed.append(process_test(test, out=out, figures=figures, say=say))
        except LabpipeError as error:
            print(f"labpipe process: {error}", file=sys.stderr)
            refused += 1
    return processed, refused
