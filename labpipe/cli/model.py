"""``labpipe model``."""

from __future__ import annotations

import argparse
import json
import sys

from labpipe.cli.telling import reading
from labpipe.cli.wire_lines import model_table
from labpipe.pipeline.modelling import as_json, model_wires


def run(options: argparse.Namespace) -> int:
    """Turn a sheet of wires into moment-curvature and stiffness tables."""
    with reading(1) as say:
        modelled = model_wires(
            options.sheet, out=options.out, figures=not options.no_figures, say=say
        )
    print(json.dumps(as_json(modelled)) if options.json else model_table(modelled))
    for reason in modelled.refused.values():
        print(f"labpipe model: {reason}", file=sys.stderr)
    return 1 if modelled.refused else 0
