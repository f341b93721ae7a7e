"""``labpipe bundle``: compute bounds of the bending stiffness of a harness bundle."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator

from labpipe.cli.terminal import shorten_path
from labpipe.errors import UsageError
from labpipe.mechanics.studies.bundle_bounds import ModelledBundle, build_json, model_bundle
from labpipe.mechanics.wire.bundle_layout import WANTED_FRACTION
from labpipe.report.harness_figures import describe_friction, describe_stiffness
from labpipe.units import parse_quantity


def run(options: argparse.Namespace) -> int:
    """Compute and print the bounds of the bending stiffness of a harness bundle."""
    modelled = model_bundle(
        options.bundle,
        wires=options.wire,
        arrangement=options.arrangement,
        bores=[_parse_bore(text) for text in options.bore],
        out=options.out,
        figures=not options.no_figures,
        png=options.png,
    )
    print(json.dumps(build_json(modelled)) if options.json else format_bundle(modelled))
    return 0


def _parse_bore(text: str) -> float:
    """Parse the inner diameter of a conduit, m."""
    try:
        bore = parse_quantity(text, "m")
    except ValueError:
        bore = 0.0  # refused below, as a bore that is not positive
    if not bore > 0.0:
        raise UsageError.about("cli.bad_bore", "--bore", found=text)
    return bore


def format_bundle(modelled: ModelledBundle) -> str:
    """Format the main numbers of a bundle for a terminal.

    Parameters
    ----------
    modelled : the bundle with its model and files

    Returns
    -------
    Lines with its stiffness bounds, bores, packing fractions, friction, notes and folder of files.
    """
    model = modelled.model
    lines = [
        f"{modelled.name}: {model.bundle.composition}, {model.layout.arrangement}",
        f"  {describe_stiffness(model)}",
        f"  smallest bore for this arrangement: {1e3 * model.smallest_bore:.5g} mm",
        *_format_conduits(modelled),
    ]
    if modelled.no_friction:
        lines.append(f"  no hysteresis loop predicted: {modelled.no_friction}")
    if modelled.friction is not None:
        lines.append(f"  {describe_friction(modelled.friction)}")
    lines += [f"  {note.severity}: {note.message}" for note in model.notes]
    return "\n".join([*lines, f"results: {shorten_path(modelled.folder)}"])


def _format_conduits(modelled: ModelledBundle) -> Iterator[str]:
    """Yield lines on the bore for the wanted packing fraction, and on conduits to choose from."""
    no_fit = ": the wires do not fit"
    wanted = f"{1e3 * modelled.wanted_bore:.5g} mm"
    wanted += no_fit if modelled.wanted_bore < modelled.model.smallest_bore else ""
    yield f"  bore for a packing fraction of {WANTED_FRACTION:g}: {wanted}"
    chosen_bore = modelled.model.bundle.conduit_bore
    for conduit in modelled.conduits:
        verdict = ": chosen" if conduit.bore == chosen_bore and len(modelled.conduits) > 1 else ""
        verdict += "" if conduit.holds else no_fit
        fraction = f"{conduit.packing_fraction:.3g} in a bore of {1e3 * conduit.bore:.4g} mm"
        yield f"  packing fraction {fraction}{verdict}"
