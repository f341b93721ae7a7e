"""``labpipe bundle``: bounds of the bending stiffness of a harness bundle."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator

from labpipe.cli.terminal import shorten_path
from labpipe.errors import UsageError
from labpipe.mechanics.studies.bundle_bounds import ModelledBundle, as_json, model_bundle
from labpipe.mechanics.wire.bundle_packing import WANTED_FRACTION
from labpipe.records.curve import Interval
from labpipe.report.wording import make_number_writer
from labpipe.units import parse_quantity

_LABEL_WIDTH = 44


def run(options: argparse.Namespace) -> int:
    """Print the bounds of a harness bundle's bending stiffness."""
    modelled = model_bundle(
        options.bundle,
        wires=options.wire,
        arrangement=options.arrangement,
        bores=[_parse_bore(text) for text in options.bore],
        out=options.out,
        figures=not options.no_figures,
        png=options.png,
    )
    print(json.dumps(as_json(modelled)) if options.json else format_bundle(modelled))
    return 0


def _parse_bore(text: str) -> float:
    try:
        bore = parse_quantity(text, "m")
    except ValueError:
        bore = 0.0
    if not bore > 0.0:
        raise UsageError.about("cli.bad_bore", "--bore", found=text)
    return bore


def format_bundle(modelled: ModelledBundle) -> str:
    """Format the main numbers of a bundle for a terminal.

    Parameters
    ----------
    modelled : the bundle

    Returns
    -------
    Its stiffness bounds, principal axes, packing fractions, notes and the folder of the files.
    """
    model = modelled.model
    smallest, largest = model.principal
    lines = [
        f"{modelled.name}: {model.bundle.composition}, {model.layout.arrangement}",
        _format_stiffness("EI, wires slip, strands slip", model.low),
        _format_stiffness("EI, wires slip, strands stick", model.free),
        _format_stiffness("EI, nothing slips, bent along y", model.high),
        _format_stiffness("  in the least stiff direction", smallest),
        _format_stiffness(f"  in the stiffest ({_format_direction(modelled)})", largest),
        f"  {'smallest bore for the wires as they lie':<{_LABEL_WIDTH}}"
        f"{1e3 * model.smallest_bore:>12.5g} mm",
        *_format_conduits(modelled),
    ]
    lines += _format_friction(modelled)
    lines += [f"  {note.severity}: {note.message}" for note in model.notes]
    return "\n".join([*lines, f"results: {shorten_path(modelled.folder)}"])


def _format_stiffness(label: str, value: float) -> str:
    rounded = float(f"{1e6 * value:.5g}")  # so that it is not in scientific notation
    return f"  {label:<{_LABEL_WIDTH}}{rounded:>12.10g} N mm^2"


def _format_friction(modelled: ModelledBundle) -> Iterator[str]:
    label_width = 52
    if modelled.no_friction:
        yield f"  no hysteresis loop predicted: {modelled.no_friction}"
    fit = modelled.friction
    if fit is None:
        return
    write = make_number_writer(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0)
    held_share = f"{write(fit.held):>6} %, 95 %: {write(fit.held_lower)} to {write(fit.held_upper)}"
    for label, number in (
        ("share of the wires' axial stiffness that takes part", _format_share(fit.composite_share)),
        ("share of it that remains once they slip (fitted)", held_share),
        ("error on fitted cycles, of the peak force", _format_share(fit.error_fitted)),
        ("error on cycles left out, of the peak force", _format_share(fit.error_held_out)),
    ):
        yield f"  {label:<{label_width}}{number} %"
    loss = f"{1e3 * fit.loss:.3g} mJ measured, {1e3 * fit.predicted_loss:.3g} mJ predicted"
    yield f"  {'energy lost over the cycles left out':<{label_width}}{loss}"


def _format_share(share: float) -> str:
    return f"{100.0 * share:>6.2g}"


def _format_direction(modelled: ModelledBundle) -> str:
    smallest, largest = modelled.model.principal
    if largest - smallest <= 1e-6 * largest:
        return "the same in all directions"
    return f"{math.degrees(modelled.model.principal_angle):.3g} deg from x"


def _format_conduits(modelled: ModelledBundle) -> Iterator[str]:
    label = f"bore for a packing fraction of {WANTED_FRACTION:g}"
    mark = "  the wires do not fit" if modelled.wanted_bore < modelled.model.smallest_bore else ""
    yield f"  {label:<{_LABEL_WIDTH}}{1e3 * modelled.wanted_bore:>12.5g} mm{mark}"
    chosen = modelled.model.bundle.conduit_bore
    for conduit in modelled.conduits:
        label = f"packing fraction in a bore of {1e3 * conduit.bore:.4g} mm"
        mark = "" if conduit.holds else "  the wires do not fit"
        mark = "  chosen" if conduit.bore == chosen and len(modelled.conduits) > 1 else mark
        yield f"  {label:<{_LABEL_WIDTH}}{conduit.packing_fraction:>12.3g}{mark}"
