"""``labpipe harness``: compute shape, forces and bend radii of a line between clips."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from labpipe.cli.terminal import format_result, format_statuses, shorten_path, show_progress_bar
from labpipe.mechanics.studies.harness_solution import HarnessSolution, Progress
from labpipe.mechanics.studies.harness_study import build_json, follow_harness
from labpipe.records.result import Status
from labpipe.report.wording import format_count

_DISPLAY = {"displacement": "mm", "moment": "N*mm", "energy": "mJ"}


def run(options: argparse.Namespace) -> int:
    """Compute the line of each harness and print its results."""
    statuses = []
    needs_own_folders = options.out is not None and len(options.files) > 1
    for file in options.files:
        with show_progress() as progress:
            solution = follow_harness(
                file,
                wires=options.wire,
                out=options.out / file.stem if needs_own_folders else options.out,
                figures=not options.no_figures,
                png=options.png,
                progress=progress,
            )
        print(json.dumps(build_json(solution)) if options.json else format_harness(solution))
        faults = list(_find_faults(solution))
        for fault in faults:
            print(f"labpipe harness: {file}: {fault}", file=sys.stderr)
        statuses.append(1 if faults else 0)
    return max(statuses)


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Show progress: a bar over all steps on a terminal, the name of each line in a pipe."""
    with show_progress_bar("step") as bar:

        def begin_line(name: str) -> None:
            if bar.disable:
                print(name, file=sys.stderr)
            bar.set_description(name)

        yield Progress(lambda lines, steps: bar.reset(lines * steps), begin_line, bar.update)


def _find_faults(solution: HarnessSolution) -> Iterator[str]:
    """Yield the reasons for a failure, or the message on a bend that is too sharp."""
    if solution.status is Status.FAILED:
        yield from (f"{reason.code}: {reason.message}" for reason in solution.reasons)
    elif not solution.limit.is_assumed and solution.sharpest_bend.radius < solution.limit.radius:
        yield _format_limit(solution).strip()


def format_harness(solution: HarnessSolution) -> str:
    """Format the results of a harness for a terminal.

    Parameters
    ----------
    solution : results of the harness

    Returns
    -------
    Its status, results, allowed bend radius, reasons for doubt, notes and folder.
    """
    line, steps = solution.path.line, solution.harness.steps
    is_failed = solution.status is Status.FAILED
    status = solution.status if is_failed else format_statuses(solution.results)
    headline = (
        f"{solution.file.stem}: {status}; {1e3 * line.length:.6g} mm of {solution.material.name}, "
        f"{format_count(len(line.lengths), 'element')}, {format_count(steps, 'step')}"
    )
    if is_failed:
        last_step = len(solution.path.states) - 1
        progress = f"solved to step {last_step} of {steps}"
        if last_step < 0:
            progress = "initial shape not found"
        return f"{headline}\n  {progress}; earlier results are unchanged"
    lines, reasons, name_width = [headline], dict.fromkeys(solution.reasons), 32
    for result in solution.results:
        remark = result.reason_text if result.value is None else result.remark
        lines.append(f"{format_result(result, _DISPLAY, name_width)}  {remark}".rstrip())
        reasons |= dict.fromkeys(result.reasons if result.value is not None else ())
    lines += [_format_limit(solution), *_format_sweep(solution)]
    lines += [f"  doubtful: {reason.code}: {reason.message}" for reason in reasons]
    lines += [f"  {note.severity}: {note.message}" for note in solution.material.notes]
    return "\n".join([*lines, f"results: {shorten_path(solution.folder)}"])


def _format_limit(solution: HarnessSolution) -> str:
    """Format the allowed bend radius, and the sharpest bend if its radius is smaller."""
    limit, bend = solution.limit, solution.sharpest_bend
    is_met = bend.radius >= limit.radius
    verdict = "kept" if is_met else "NOT KEPT"
    verdict += " (doubtful)" if solution.is_bend_doubtful else ""
    line = f"  allowed bend radius {1e3 * limit.radius:.4g} mm ({limit.source}): {verdict}"
    location = f"step {bend.step}, {1e3 * bend.arc_length:.4g} mm from the start"
    return line if is_met else f"{line}, {1e3 * bend.radius:.4g} mm at {location}"


def _format_sweep(solution: HarnessSolution) -> Iterator[str]:
    """Format a table with the smallest bend radius for each length of the line."""
    if solution.sweep:
        yield "  length of the line    smallest bend radius     in motion"
    for variant in solution.sweep:
        length = 1e3 * variant.harness.line.length
        if variant.status is Status.FAILED:
            yield f"  {length:>12.5g} mm        -  {variant.reasons[0].message}"
            continue
        radius = 1e3 * variant.final_sharpest_bend.radius
        path_radius = 1e3 * variant.sharpest_bend.radius
        doubt = f"  doubtful: {variant.reasons[0].code}" if variant.reasons else ""
        yield f"  {length:>12.5g} mm{radius:>19.4g} mm{path_radius:>14.4g} mm{doubt}"
