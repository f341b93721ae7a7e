"""``labpipe bundle``: compute bounds of the bending stiffness of a harness bundle."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator

from labpipe.cli.terminal import shorten_path
from labpipe.errors import UsageError
from labpipe.mechanics.studies.bundle_bounds import ModelledBundle, build_json, model_bundle
from labpipe.mechanics.wire.bundle_layout import TARGET_PACKING_FRACTION
from labpipe.report.harness_figures import describe_friction, describe_stiffness
from labpipe.units import parse_quantity


def run(options: argparse.Namespace) -> int:
    """Compute and print the bounds of the bending stiffness of a harness bundle."""
    bundle = model_bundle(
        options.bundle,
        wires=options.wire,
        arrangement=options.arrangement,
        bores=[_parse_bore(text) for text in options.bore],
        out=options.out,
        figures=not options.no_figures,
        png=options.png,
    )
    print(json.dumps(build_json(bundle)) if options.json else format_bundle(bundle))
    return 0


def _parse_bore(text: str) -> float:
    """Parse the inner diameter of a conduit, m."""
    try:
        bore = parse_quantity(text, "m")
    except ValueError:
        bore = 0.0  # not positive, and therefore refused below
    if not bore > 0.0:
        raise UsageError.about("cli.bad_bore", "--bore", found=text)
    return bore


def format_bundle(bundle: ModelledBundle) -> str:
    """Format the main results of a bundle for a terminal.

    Parameters
    ----------
    bundle : bundle with its model and files

    Returns
    -------
    Lines with its stiffness bounds, bores, packing fractions, friction, notes and folder of files.
    """
    model = bundle.model
    lines = [
        f"{bundle.name}: {model.bundle.composition}, {model.layout.arrangement}",
        f"  {describe_stiffness(model)}",
        f"  smallest bore for this arrangement: {1e3 * model.smallest_bore:.5g} mm",
        *_format_conduits(bundle),
    ]
    if bundle.no_friction:
        lines.append(f"  no hysteresis loop predicted: {bundle.no_friction}")
    if bundle.friction is not None:
        lines.append(f"  {describe_friction(bundle.friction)}")
    lines += [f"  {note.severity}: {note.message}" for note in model.notes]
    return "\n".join([*lines, f"results: {shorten_path(bundle.folder)}"])


def _format_conduits(bundle: ModelledBundle) -> Iterator[str]:
    """Format lines on the bore for the wanted packing fraction, and on conduits to choose from."""
    no_fit = ": the wires do not fit"
    bore_text = f"{1e3 * bundle.wanted_bore:.5g} mm"
    bore_text += no_fit if bundle.wanted_bore < bundle.model.smallest_bore else ""
    yield f"  bore for a packing fraction of {TARGET_PACKING_FRACTION:g}: {bore_text}"
    chosen_bore = bundle.model.bundle.conduit_bore
    for conduit in bundle.conduits:
        verdict = ": chosen" if conduit.bore == chosen_bore and len(bundle.conduits) > 1 else ""
        verdict += "" if conduit.holds else no_fit
        fraction = f"{conduit.packing_fraction:.3g} in a bore of {1e3 * conduit.bore:.4g} mm"
        yield f"  packing fraction {fraction}{verdict}"
