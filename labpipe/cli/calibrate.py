"""``labpipe calibrate``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence

import numpy as np

from labpipe.campaign.decisions import without_rejected
from labpipe.campaign.queries import escaped
from labpipe.cli.terminal import DIGITS, from_here, reading
from labpipe.process.output_paths import find_results
from labpipe.records.wire_calibration import (
    DISPLAYED,
    CalibratedParameter,
    CurveMatch,
    ExternalCurveComparison,
    Identifiability,
)
from labpipe.report.calibration_summary import ValidationGroup
from labpipe.report.wording import plain_numbers
from labpipe.studies.calibration_study import Calibrated, as_json, calibrate_tests

_DOUBTED = {
    Identifiability.NOT,
    Identifiability.TWO,
    Identifiability.AT_BOUND,
    Identifiability.AGAINST_PRIOR,
}
_WIDEST = 28


def run(options: argparse.Namespace) -> int:
    """Calibrate the wire model by processed cantilever tests that were not rejected."""
    left, rejected = without_rejected(find_results(options.paths))
    for file, why in rejected.items():
        print(escaped(f"labpipe calibrate: rejected: {file.parent}: {why}"), file=sys.stderr)
    with reading(len(options.paths)) as say:
        done = calibrate_tests(
            left if rejected else options.paths,
            wires=options.wire,
            plan=options.plan,
            out=options.out,
            figures=not options.no_figures,
            png=options.png,
            say=say,
        )
    print(json.dumps(as_json(done)) if options.json else calibration_table(done))
    for reason in done.left_out.values():
        print(f"labpipe calibrate: left out: {reason}", file=sys.stderr)
    return 2 if done.left_out else 0


def calibration_table(done: Calibrated) -> str:
    """Lay out a calibration for a terminal.

    Parameters
    ----------
    done : the calibration and what it was compared with

    Returns
    -------
    The parameters with intervals, what is not identified, a line per wire and length, notes, and
    where the files are.
    """
    found = done.calibration
    lines = [
        f"{found.wire}: {found.n_points} points of {found.n_samples} "
        f"sample{'s' * (found.n_samples != 1)}, rms "
        f"{_rounded(1e3 * found.rmse, 3)} mN ({_percent(found.rmse_share)} of the largest force)"
    ]
    lines += [_parameter(parameter) for parameter in found.parameters]
    lines += [f"  {parameter.words}" for parameter in found.parameters if parameter.words]
    priors = [
        parameter.conflict.message
        for parameter in found.parameters
        if parameter.conflict is not None
    ]
    lines += [f"  {message}" for message in priors]
    if found.friction_separability is not None:
        lines.append(f"  {found.friction_separability.words}")
    lines += ["", *_groups(done)]
    lines += comparison_lines(done.comparisons)
    shown = {*(parameter.words for parameter in found.parameters), *priors}
    lines += [
        f"  {note.severity}: {note.where}: {note.message}"
        for note in found.notes
        if note.message not in shown
    ]
    lines.append(f"results: {from_here(done.folder)}")
    return "\n".join(lines)


def _parameter(each: CalibratedParameter) -> str:
    factor, unit = DISPLAYED[each.name]
    if math.isnan(each.value):
        return f"  {each.name:<20}{'-':>10} {unit:<4} does not act"
    mark = "?" if each.verdict in _DOUBTED else " "
    own = next((part for part in each.intervals if part.lower <= each.value <= part.upper), None)
    written = plain_numbers(each.value, own or each.interval, factor, DIGITS)
    line = f"{mark} {each.name:<20}{written(each.value):>10} {unit:<4}"
    if each.interval is None:
        return f"{line} {each.verdict}"
    ends = [
        [*map(plain_numbers(part.lower, part, factor), (part.lower, part.upper))]
        for part in each.intervals
    ]
    ends[0][0] = "?" if each.is_open_below else ends[0][0]
    ends[-1][1] = "?" if each.is_open_above else ends[-1][1]
    parts = " or ".join(f"{low} to {high}" for low, high in ends)
    return f"{line} 95 %: {parts}  {each.verdict}"


def _rounded(number: float, digits: int) -> str:
    """Some digits, never as a power of ten."""
    return np.format_float_positional(float(f"{number:.{digits}g}"), trim="-")


def _percent(share: float, digits: int = 2) -> str:
    return f"{_rounded(100.0 * share, digits)} %"


def _cells(rmse: float, share: str, inside: str) -> str:
    """Columns of errors, apart however wide they are."""
    return f" {_rounded(1e3 * rmse, 3):>8} {share:>8} {inside:>8}"


def _groups(done: Calibrated) -> list[str]:
    heading = (
        f"  {'wire':<14}{'samples':>8}{'rms mN':>9}{'of peak':>9}{'in band':>9}  {'tests are'}"
    )
    return [heading, *(_group(group) for group in done.groups)]


def _group(each: ValidationGroup) -> str:
    role = "calibrating" if each.is_calibrated else "predicted"
    head = f"  {f'{each.wire}, {1e3 * each.length:.4g} mm':<14}{len(each.samples):>8}"
    errors = each.errors
    if errors is None:
        return f"{head}{'-':>9}{'-':>9}{'-':>9}  {role}; {each.reason or ''}"
    cells = _cells(errors.rmse, _percent(errors.rmse_share), _percent(errors.inside, 3))
    return f"{head}{cells}  {role}"


def comparison_lines(comparisons: Sequence[ExternalCurveComparison]) -> list[str]:
    """Lay out external curves for a terminal.

    Parameters
    ----------
    comparisons : external curves, compared with tests and model

    Returns
    -------
    A heading, a line for each curve and what it is compared with, and what was left out; nothing
    without any.
    """
    if not comparisons:
        return []
    width = min(_WIDEST, max(len(comparison.curve.name) for comparison in comparisons))
    width = max(width, len("external curve"))
    heading = f"  {'external curve':<{width}}  {'compared with':<22}{'points':>8}{'rms mN':>9}"
    lines = ["", f"{heading}{'of peak':>9}{'in band':>9}"]
    for external_curve_comparison in comparisons:
        curve = external_curve_comparison.curve
        of = f"{curve.wire}, {1e3 * curve.length:.4g} mm"
        for what, found in (
            ("tests", external_curve_comparison.tests),
            ("model", external_curve_comparison.model),
        ):
            if found is not None:
                called = (
                    curve.name if len(curve.name) <= _WIDEST else f"{curve.name[: _WIDEST - 1]}…"
                )
                name = f"  {called:<{width}}  {f'{what} of {of}':<22}"
                lines.append(f"{name}{_numbers(found)}")
    notes = [note for comparison in comparisons for note in comparison.notes]
    return [*lines, *(f"  {note.severity}: {note.where}: {note.message}" for note in notes)]


def _numbers(found: CurveMatch) -> str:
    errors = found.errors
    if errors is None:
        return f"{0:>8}{'-':>9}{'-':>9}{'-':>9}"
    inside = _percent(errors.inside, 3) if math.isfinite(errors.inside) else "-"
    return f"{errors.n:>8}{_cells(errors.rmse, _percent(errors.rmse_share), inside)}"
