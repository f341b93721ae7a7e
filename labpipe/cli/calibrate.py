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
from labpipe.mechanics.studies.calibration_study import Calibrated, as_json, calibrate_tests
from labpipe.process.output_paths import find_results
from labpipe.records.wire_calibration import (
    DISPLAYED,
    CalibratedParameter,
    CurveMatch,
    ExternalCurveComparison,
    Identifiability,
    IsotropicShare,
)
from labpipe.report.calibration_summary import ValidationGroup
from labpipe.report.wording import make_number_writer

_DOUBTED = {
    Identifiability.NOT,
    Identifiability.TWO,
    Identifiability.AT_BOUND,
    Identifiability.AGAINST_PRIOR,
}


def run(options: argparse.Namespace) -> int:
    """Calibrate the wire model with processed cantilever tests that were not rejected."""
    files, rejected = without_rejected(find_results(options.paths))
    for file, why in rejected.items():
        print(escaped(f"labpipe calibrate: rejected: {file.parent}: {why}"), file=sys.stderr)
    with reading(len(options.paths)) as say:
        done = calibrate_tests(
            files if rejected else options.paths,
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
    done : the calibration and its validation

    Returns
    -------
    The parameters with intervals, what is not identified, a line per wire and length, notes and
    the folder of the files.
    """
    calibration = done.calibration
    lines = [
        f"{calibration.wire}: {calibration.n_points} points of {calibration.n_samples} "
        f"sample{'s' * (calibration.n_samples != 1)}, rms "
        f"{_rounded(1e3 * calibration.rmse, 3)} mN ({_percent(calibration.rmse_share)} of the "
        f"largest force)"
    ]
    parameters = calibration.parameters
    lines += [_parameter(parameter) for parameter in parameters]
    if calibration.share is not None:
        lines.append(_share(calibration.share))
    explanations = [parameter.explanation for parameter in parameters if parameter.explanation]
    conflicts = [parameter.conflict.message for parameter in parameters if parameter.conflict]
    lines += [f"  {message}" for message in (*explanations, *conflicts)]
    if calibration.friction_separability is not None:
        lines.append(f"  {calibration.friction_separability.explanation}")
    heading = f"  {'wire':<14}{'samples':>8}{'rms mN':>9}{'of peak':>9}{'in band':>9}  {'role'}"
    lines += ["", heading, *map(_group, done.groups), *comparison_lines(done.comparisons)]
    lines += [
        f"  {note.severity}: {note.where}: {note.message}"
        for note in calibration.notes
        if note.message not in {*explanations, *conflicts}
    ]
    lines.append(f"results: {from_here(done.folder)}")
    return "\n".join(lines)


def _share(share: IsotropicShare) -> str:
    """Return the line of the isotropic share, or why it is not calibrated."""
    low, high = share.interval.lower, share.interval.upper
    if not share.is_creep:
        tests = f"{share.n_tests} test{'s' * (share.n_tests != 1)} with cycles"
        return f"  isotropic share {share.value:.2f}, {low:.2f} to {high:.2f}, from {tests}"
    ends = [f"{part.lower:.2f} to {part.upper:.2f}" for part in share.by_number.values()]
    return (
        f"  isotropic share: not calibrated, {ends[0]} by the residual deflection "
        f"but {ends[1]} by the peaks of two cycles: the insulation creeps"
    )


def _parameter(parameter: CalibratedParameter) -> str:
    factor, unit = DISPLAYED[parameter.name]
    if math.isnan(parameter.value):
        return f"  {parameter.name:<20}{'-':>10} {unit:<4} has no effect"
    mark = "?" if parameter.verdict in _DOUBTED else " "
    enclosing = next(
        (part for part in parameter.intervals if part.lower <= parameter.value <= part.upper), None
    )
    written = make_number_writer(parameter.value, enclosing or parameter.interval, factor, DIGITS)
    line = f"{mark} {parameter.name:<20}{written(parameter.value):>10} {unit:<4}"
    if parameter.interval is None:
        return f"{line} {parameter.verdict}"
    ends = [
        [*map(make_number_writer(part.lower, part, factor), (part.lower, part.upper))]
        for part in parameter.intervals
    ]
    ends[0][0] = "?" if parameter.is_open_below else ends[0][0]
    ends[-1][1] = "?" if parameter.is_open_above else ends[-1][1]
    parts = " or ".join(f"{low} to {high}" for low, high in ends)
    return f"{line} 95 %: {parts}  {parameter.verdict}"


def _rounded(number: float, digits: int) -> str:
    """Write a number with some digits, never in scientific notation."""
    return np.format_float_positional(float(f"{number:.{digits}g}"), trim="-")


def _percent(share: float, digits: int = 2) -> str:
    return f"{_rounded(100.0 * share, digits)} %"


def _cells(rmse: float, share: str, inside: str) -> str:
    """Lay out the columns of errors, always with a space between them."""
    return f" {_rounded(1e3 * rmse, 3):>8} {share:>8} {inside:>8}"


def _group(group: ValidationGroup) -> str:
    role = "calibrating" if group.is_calibrated else "predicted"
    head = f"  {f'{group.wire}, {1e3 * group.length:.4g} mm':<14}{len(group.samples):>8}"
    errors = group.errors
    if errors is None:
        return f"{head}{'-':>9}{'-':>9}{'-':>9}  {role}; {group.reason or ''}"
    cells = _cells(errors.rmse, _percent(errors.rmse_share), _percent(errors.inside, 3))
    return f"{head}{cells}  {role}"


def comparison_lines(comparisons: Sequence[ExternalCurveComparison]) -> list[str]:
    """Lay out external curves for a terminal.

    Parameters
    ----------
    comparisons : external curves, compared with tests and model

    Returns
    -------
    A heading, a line for each curve and comparison, and the notes; nothing without curves.
    """
    max_name_width = 28
    if not comparisons:
        return []
    names = [_shortened(comparison.curve.name, max_name_width) for comparison in comparisons]
    width = max(map(len, (*names, "external curve")))
    heading = f"  {'external curve':<{width}}  {'compared with':<22}{'points':>8}{'rms mN':>9}"
    lines = ["", f"{heading}{'of peak':>9}{'in band':>9}"]
    for name, comparison in zip(names, comparisons, strict=True):
        specimen = f"{comparison.curve.wire}, {1e3 * comparison.curve.length:.4g} mm"
        for compared_with, match in (("tests", comparison.tests), ("model", comparison.model)):
            if match is not None:
                row = f"  {name:<{width}}  {f'{compared_with} of {specimen}':<22}"
                lines.append(f"{row}{_numbers(match)}")
    notes = [note for comparison in comparisons for note in comparison.notes]
    return [*lines, *(f"  {note.severity}: {note.where}: {note.message}" for note in notes)]


def _shortened(name: str, width: int) -> str:
    return name if len(name) <= width else f"{name[: width - 1]}…"


def _numbers(match: CurveMatch) -> str:
    errors = match.errors
    if errors is None:
        return f"{0:>8}{'-':>9}{'-':>9}{'-':>9}"
    inside = _percent(errors.inside, 3) if math.isfinite(errors.inside) else "-"
    return f"{errors.n:>8}{_cells(errors.rmse, _percent(errors.rmse_share), inside)}"
