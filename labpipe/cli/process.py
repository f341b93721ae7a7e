"""``labpipe process``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

from labpipe.cli.telling import progress, table
from labpipe.pipeline.many import Refused, process_tests
from labpipe.pipeline.process import Processed
from labpipe.pipeline.targets import find_tests
from labpipe.store.summary import summary

_FINISHED = "a process was killed while it replaced the files here; that was finished first"


def run(options: argparse.Namespace) -> int:
    """Process tests; a bad one does not stop the others."""
    tests = find_tests(options.tests)
    processed, refused = process_all(
        tests,
        out=options.out,
        figures=lambda _: not options.no_figures,
        png=options.png,
        jobs=options.jobs,
        follow_links=options.follow_links,
    )
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
    tests: list[Path],
    *,
    out: Path | None,
    figures: Callable[[Path], bool],
    jobs: int,
    png: bool = False,
    follow_links: bool = False,
) -> tuple[list[Processed], int]:
    """Process tests and say what is wrong with those that cannot be.

    Returns
    -------
    processed : those that were
    refused : number of those that were not
    """
    processed, refused = [], 0
    with progress(len(tests)) as begin:
        for done in process_tests(
            tests,
            out=out,
            figures=figures,
            png=png,
            follow_links=follow_links,
            jobs=jobs,
            begin=begin,
        ):
            if isinstance(done, Refused):
                print(f"labpipe process: {done.reason}", file=sys.stderr)
                refused += 1
                continue
            if done.finished:
                print(f"labpipe process: {done.folder}: {_FINISHED}", file=sys.stderr)
            processed.append(done)
    return processed, refused
