"""``labpipe calibrate``."""

from __future__ import annotations

import argparse
import json
import sys

from labpipe.cli.calibration_lines import calibration_table
from labpipe.cli.telling import reading
from labpipe.pipeline.calibrating import as_json, calibrate_tests


def run(options: argparse.Namespace) -> int:
    """Calibrate the wire model by processed cantilever tests."""
    with reading(len(options.paths)) as say:
        done = calibrate_tests(
            options.paths,
            wires=options.wire,
            plan=options.plan,
            out=options.out,
            figures=not options.no_figures,
            say=say,
        )
    print(json.dumps(as_json(done)) if options.json else calibration_table(done))
    for reason in done.left_out.values():
        print(f"labpipe calibrate: left out: {reason}", file=sys.stderr)
    return 2 if done.left_out else 0
