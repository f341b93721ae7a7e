"""``labpipe bundle``."""

from __future__ import annotations

import argparse
import json

from labpipe.cli.bundle_lines import bundle_table
from labpipe.errors import UsageError, complaint
from labpipe.pipeline.bundling import as_json, model_bundle
from labpipe.units import parse_quantity


def run(options: argparse.Namespace) -> int:
    """Work out between what bounds the bending of a harness bundle lies."""
    modelled = model_bundle(
        options.bundle,
        wires=options.wire,
        arrangement=options.arrangement,
        bores=[_bore(text) for text in options.bore],
        out=options.out,
        figures=not options.no_figures,
    )
    print(json.dumps(as_json(modelled)) if options.json else bundle_table(modelled))
    return 0


def _bore(text: str) -> float:
    try:
        bore = parse_quantity(text, "m")
    except ValueError as error:
        raise _not_a_bore(text) from error
    if not bore > 0.0:
        raise _not_a_bore(text)
    return bore


def _not_a_bore(text: str) -> UsageError:
    message = complaint(
        "--bore",
        "",
        expected="a length above zero with its unit, such as '10.7 mm'",
        found=repr(text),
        remedy="Write the inner diameter of the conduit.",
    )
    return UsageError(message)
