"""``labpipe calibrate``: fit the wire model to processed cantilever tests."""

from __future__ import annotations

import argparse
import json
import sys

from labpipe.campaign.decisions import exclude_rejected_tests
from labpipe.cli.terminal import shorten_path, show_completion
from labpipe.mechanics.studies.calibration_file import CalibrationStudy, build_json
from labpipe.mechanics.studies.calibration_study import calibrate_tests
from labpipe.process.output_paths import find_results
from labpipe.records.wire import IsotropicShare
from labpipe.report import calibration_report as reports
from labpipe.report.wording import format_count


def run(options: argparse.Namespace) -> int:
    """Calibrate the wire model with processed cantilever tests that were not rejected."""
    files, rejected = exclude_rejected_tests(find_results(options.paths))
    for file, reason in rejected.items():
        message = f"labpipe calibrate: rejected: {file.parent}: {reason}"
        from labpipe.campaign.queries import escape_controls  # imports the catalog

        print(escape_controls(message), file=sys.stderr)
    with show_completion("test", in_pipe=False) as (_, say):
        study = calibrate_tests(
            files if rejected else options.paths,
            wires=options.wire,
            plan=options.plan,
            out=options.out,
            figures=not options.no_figures,
            png=options.png,
            say=say,
        )
    print(json.dumps(build_json(study)) if options.json else format_calibration(study))
    for reason in study.left_out.values():
        print(f"labpipe calibrate: left out: {reason}", file=sys.stderr)
    return 2 if study.left_out else 0


def format_calibration(study: CalibrationStudy) -> str:
    """Format a calibration for a terminal.

    Parameters
    ----------
    study : calibration of a wire and its validation

    Returns
    -------
    The wire, its parameters with intervals and verdicts, the isotropic share, sentences on the fit,
    a line per wire and length and per external curve with its notes, and the folder of the files.
    """
    lines = [study.calibration.wire]
    parameters = study.calibration.parameters
    lines += [f"  {reports.format_parameter(parameter)}" for parameter in parameters]
    if study.calibration.isotropic_share is not None:
        lines.append(_format_share(study.calibration.isotropic_share))
    lines += [f"  {sentence}" for sentence in reports.describe_calibration(study.calibration)]
    for group in study.groups:
        texts = [group.heading, *reports.describe_agreement(group)]
        lines.append(f"  {'; '.join(texts)}")
    for comparison in study.comparisons:
        lines.append(f"  {'; '.join(reports.describe_match(comparison))}")
        lines += [f"  {note.severity}: {note.where}: {note.message}" for note in comparison.notes]
    return "\n".join([*lines, f"results: {shorten_path(study.folder)}"])


def _format_share(share: IsotropicShare) -> str:
    """Format the line of the isotropic share, or the reason why it is not calibrated."""
    if not share.is_creep:
        lower, upper, n_tests = share.interval.lower, share.interval.upper, share.n_tests
        interval = f"{lower:.2f} to {upper:.2f}, from {format_count(n_tests, 'test')}"
        return f"  isotropic share {share.value:.2f}, {interval}"
    residual, peaks = (f"{ends.lower:.2f} to {ends.upper:.2f}" for ends in share.intervals.values())
    return (
        f"  isotropic share: not calibrated, {residual} by the residual deflection "
        f"but {peaks} by the peaks of two cycles: the insulation creeps"
    )
