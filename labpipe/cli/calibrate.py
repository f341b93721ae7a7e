"""``labpipe calibrate``: fit the wire model to processed cantilever tests."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence

import numpy as np

from labpipe.campaign.decisions import exclude_rejected
from labpipe.campaign.queries import escape_controls
from labpipe.cli.terminal import DIGITS, shorten_path, show_reading
from labpipe.mechanics.studies.calibration_study import Calibrated, as_json, calibrate_tests
from labpipe.process.output_paths import find_results
from labpipe.records.wire_calibration import (
    DISPLAYED,
    CalibratedParameter,
    ExternalCurveComparison,
    Identifiability,
    IsotropicShare,
)
from labpipe.report.calibration_summary import ValidationGroup
from labpipe.report.wording import make_number_writer, write_count

_DOUBTFUL_VERDICTS = {
    Identifiability.NOT,
    Identifiability.TWO,
    Identifiability.AT_BOUND,
    Identifiability.AGAINST_PRIOR,
}


def run(options: argparse.Namespace) -> int:
    """Calibrate the wire model with processed cantilever tests that were not rejected."""
    files, rejected = exclude_rejected(find_results(options.paths))
    for file, why in rejected.items():
        print(
            escape_controls(f"labpipe calibrate: rejected: {file.parent}: {why}"), file=sys.stderr
        )
    with show_reading(len(options.paths)) as say:
        done = calibrate_tests(
            files if rejected else options.paths,
            wires=options.wire,
            plan=options.plan,
            out=options.out,
            figures=not options.no_figures,
            png=options.png,
            say=say,
        )
    print(json.dumps(as_json(done)) if options.json else format_calibration(done))
    for reason in done.left_out.values():
        print(f"labpipe calibrate: left out: {reason}", file=sys.stderr)
    return 2 if done.left_out else 0


def format_calibration(done: Calibrated) -> str:
    """Format a calibration for a terminal.

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
        f"{calibration.wire}: {calibration.n_points} points of "
        f"{write_count(calibration.n_samples, 'sample')}, "
        f"rms {_format_rounded(1e3 * calibration.rmse, 3)} mN "
        f"({_format_percent(calibration.rmse_share)} of the largest force)"
    ]
    parameters = calibration.parameters
    lines += [_format_parameter(parameter) for parameter in parameters]
    if calibration.share is not None:
        lines.append(_format_share(calibration.share))
    explanations = [parameter.explanation for parameter in parameters if parameter.explanation]
    conflicts = [parameter.conflict.message for parameter in parameters if parameter.conflict]
    lines += [f"  {message}" for message in (*explanations, *conflicts)]
    if calibration.friction_separability is not None:
        lines.append(f"  {calibration.friction_separability.explanation}")
    heading = f"  {'wire':<14}{'samples':>8}{'rms mN':>9}{'of peak':>9}{'in band':>9}  {'role'}"
    lines += ["", heading, *map(_format_group, done.groups), *format_comparisons(done.comparisons)]
    lines += [
        f"  {note.severity}: {note.where}: {note.message}"
        for note in calibration.notes
        if note.message not in {*explanations, *conflicts}
    ]
    lines.append(f"results: {shorten_path(done.folder)}")
    return "\n".join(lines)


def _format_share(share: IsotropicShare) -> str:
    """Write the line of the isotropic share, or why it is not calibrated."""
    low, high = share.interval.lower, share.interval.upper
    if not share.is_creep:
        tests = write_count(share.n_tests, "test")
        return f"  isotropic share {share.value:.2f}, {low:.2f} to {high:.2f}, from {tests}"
    ends = [f"{part.lower:.2f} to {part.upper:.2f}" for part in share.by_number.values()]
    return (
        f"  isotropic share: not calibrated, {ends[0]} by the residual deflection "
        f"but {ends[1]} by the peaks of two cycles: the insulation creeps"
    )


def _format_parameter(parameter: CalibratedParameter) -> str:
    factor, unit = DISPLAYED[parameter.name]
    if math.isnan(parameter.value):
        return f"  {parameter.name:<20}{'-':>10} {unit:<4} has no effect"
    mark = "?" if parameter.verdict in _DOUBTFUL_VERDICTS else " "
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


def _format_rounded(number: float, digits: int) -> str:
    """Write a number with some digits, never in scientific notation."""
    return np.format_float_positional(float(f"{number:.{digits}g}"), trim="-")


def _format_percent(share: float, digits: int = 2) -> str:
    return f"{_format_rounded(100.0 * share, digits)} %"


def _format_errors(rmse: float, share: str, inside: str) -> str:
    """Format the columns of errors, with a space between them."""
    return f" {_format_rounded(1e3 * rmse, 3):>8} {share:>8} {inside:>8}"


def _format_group(group: ValidationGroup) -> str:
    role = "calibrating" if group.is_calibrated else "predicted"
    head = f"  {f'{group.wire}, {1e3 * group.length:.4g} mm':<14}{len(group.samples):>8}"
    errors = group.errors
    if errors is None:
        return f"{head}{'-':>9}{'-':>9}{'-':>9}  {role}; {group.reason or ''}"
    cells = _format_errors(
        errors.rmse, _format_percent(errors.rmse_share), _format_percent(errors.inside, 3)
    )
    return f"{head}{cells}  {role}"


def format_comparisons(comparisons: Sequence[ExternalCurveComparison]) -> list[str]:
    """Format the comparisons with external curves for a terminal.

    Parameters
    ----------
    comparisons : external curves, compared with tests and model

    Returns
    -------
    A line for each curve and comparison, and the notes.
    """
    lines = []
    for comparison in comparisons:
        curve = comparison.curve
        specimen = f"{curve.wire}, {1e3 * curve.length:.4g} mm"
        for reference, match in (("tests", comparison.tests), ("model", comparison.model)):
            if match is None:
                continue
            errors = match.errors
            text = "no common points"
            if errors is not None:
                text = f"{errors.n} points, rms {_format_rounded(1e3 * errors.rmse, 3)} mN"
                text += f" ({_format_percent(errors.rmse_share)} of the peak)"
                if math.isfinite(errors.inside):
                    text += f", {_format_percent(errors.inside, 3)} in the band"
            lines.append(f"  {curve.name}, compared with {reference} of {specimen}: {text}")
        lines += [f"  {note.severity}: {note.where}: {note.message}" for note in comparison.notes]
    return lines
