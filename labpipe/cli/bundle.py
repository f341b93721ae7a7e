"""``labpipe bundle``."""

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
        bores=[_bore(text) for text in options.bore],
        out=options.out,
        figures=not options.no_figures,
        png=options.png,
    )
    print(json.dumps(as_json(modelled)) if options.json else format_bundle(modelled))
    return 0


def _bore(text: str) -> float:
    try:
        bore = parse_quantity(text, "m")
    except ValueError:
        bore = 0.0
    if not bore > 0.0:
        raise UsageError.about("cli.bad_bore", "--bore", found=text)
    return bore


def format_bundle(modelled: ModelledBundle) -> str:
    """Lay out the main numbers of a bundle for a terminal.

    Parameters
    ----------
    modelled : the bundle

    Returns
    -------
    Its stiffness bounds, principal axes, packing fractions, notes and the folder of the files.
    """
    model = modelled.model
    least, largest = model.principal
    lines = [
        f"{modelled.name}: {model.bundle.composition}, {model.layout.arrangement}",
        _stiffness("EI, wires slip, strands slip", model.low),
        _stiffness("EI, wires slip, strands stick", model.free),
        _stiffness("EI, nothing slips, bent along y", model.high),
        _stiffness("  in the least stiff direction", least),
        _stiffness(f"  in the stiffest ({_direction(modelled)})", largest),
        f"  {'smallest bore for the wires as they lie':<{_LABEL_WIDTH}}"
        f"{1e3 * model.smallest_bore:>12.5g} mm",
        *_conduits(modelled),
    ]
    lines += _friction(modelled)
    lines += [f"  {note.severity}: {note.message}" for note in model.notes]
    return "\n".join([*lines, f"results: {shorten_path(modelled.folder)}"])


def _stiffness(label: str, value: float) -> str:
    digits = float(f"{1e6 * value:.5g}")  # never in scientific notation
    return f"  {label:<{_LABEL_WIDTH}}{digits:>12.10g} N mm^2"


def _friction(modelled: ModelledBundle) -> Iterator[str]:
    label_width = 52
    if modelled.no_friction:
        yield f"  no hysteresis loop predicted: {modelled.no_friction}"
    fit = modelled.friction
    if fit is None:
        return
    written = make_number_writer(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0)
    held = f"{written(fit.held):>6} %, 95 %: {written(fit.held_lower)} to {written(fit.held_upper)}"
    for label, number in (
        ("share of the wires' axial stiffness that takes part", _share(fit.composite_share)),
        ("share of it that remains once they slip (fitted)", held),
        ("error on fitted cycles, of the peak force", _share(fit.error_fitted)),
        ("error on cycles left out, of the peak force", _share(fit.error_held_out)),
    ):
        yield f"  {label:<{label_width}}{number} %"
    loss = f"{1e3 * fit.loss:.3g} mJ measured, {1e3 * fit.predicted_loss:.3g} mJ predicted"
    yield f"  {'energy lost over the cycles left out':<{label_width}}{loss}"


def _share(share: float) -> str:
    return f"{100.0 * share:>6.2g}"


def _direction(modelled: ModelledBundle) -> str:
    least, largest = modelled.model.principal
    if largest - least <= 1e-6 * largest:
        return "the same in all directions"
    return f"{math.degrees(modelled.model.principal_angle):.3g} deg from x"


def _conduits(modelled: ModelledBundle) -> Iterator[str]:
    label = f"bore for a packing fraction of {WANTED_FRACTION:g}"
    mark = "  the wires do not fit" if modelled.wanted_bore < modelled.model.smallest_bore else ""
    yield f"  {label:<{_LABEL_WIDTH}}{1e3 * modelled.wanted_bore:>12.5g} mm{mark}"
    chosen = modelled.model.bundle.conduit_bore
    for conduit in modelled.conduits:
        label = f"packing fraction in a bore of {1e3 * conduit.bore:.4g} mm"
        mark = "" if conduit.holds else "  the wires do not fit"
        mark = "  chosen" if conduit.bore == chosen and len(modelled.conduits) > 1 else mark
        yield f"  {label:<{_LABEL_WIDTH}}{conduit.packing_fraction:>12.3g}{mark}"
