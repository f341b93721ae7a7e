"""``labpipe harness``."""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labpipe.cli.terminal import from_here, statuses_of
from labpipe.records.result import Result, Status
from labpipe.report.wording import count_of, plain_numbers, unit_words
from labpipe.studies.harness_solution import FollowedHarness
from labpipe.studies.harness_study import Watcher, as_json, follow_harness

_SHOWN = {
    "m": (1e3, "mm"),
    "N": (1.0, "N"),
    "N*m": (1e3, "N*mm"),
    "1/m": (1.0, "1/m"),
    "J": (1e3, "mJ"),
}
_WIDTH = 32


def run(options: argparse.Namespace) -> int:
    """Follow the line of each harness, and say what became of it."""
    statuses = []
    for file in options.files:
        out = options.out if options.out is None or len(options.files) == 1 else None
        with following() as watcher:
            found = follow_harness(
                file,
                wires=options.wire,
                out=out or _own_folder(options.out, file),
                figures=not options.no_figures,
                png=options.png,
                watcher=watcher,
            )
        print(json.dumps(as_json(found)) if options.json else harness_table(found))
        faults = list(_faults(found))
        for fault in faults:
            print(f"labpipe harness: {file}: {fault}", file=sys.stderr)
        statuses.append(1 if faults else 0)
    return max(statuses)


@contextmanager
def following() -> Iterator[Watcher]:
    """Show lines and steps as they are followed: a bar on a terminal, a line for each in a pipe."""
    if not sys.stderr.isatty():
        names, total = itertools.count(1), [0]

        def say(words: str) -> None:
            if total[0] > 1:
                print(f"{next(names)}/{total[0]} {words}", file=sys.stderr)

        yield Watcher(lambda lines, _: total.__setitem__(0, lines), say)
        return
    from tqdm import tqdm

    with tqdm(unit="step", leave=False) as bar:
        yield Watcher(
            lambda lines, steps: bar.reset(lines * steps), bar.set_description, bar.update
        )


def _faults(found: FollowedHarness) -> Iterator[str]:
    """What a script that lays harnesses has to stop at; an assumed bend radius is no promise."""
    if found.status is Status.FAILED:
        yield from (f"{reason.code}: {reason.message}" for reason in found.reasons)
    elif not found.limit.is_assumed and found.sharpest.radius < found.limit.radius:
        yield "".join(_limit(found)).strip()


def _own_folder(out: Path | None, file: Path) -> Path | None:
    """Folder of one of several files below the one that was asked for."""
    return None if out is None else out / file.stem


def harness_table(found: FollowedHarness) -> str:
    """Lay out a harness for a terminal.

    Parameters
    ----------
    found : that was followed

    Returns
    -------
    Its status, its numbers, its allowed bend radius, doubts, and where the files are.
    """
    line, steps = found.prepared.line, found.harness.steps
    became = found.status if found.status is Status.FAILED else statuses_of(found.results)
    head = (
        f"{found.file.stem}: {became}; {1e3 * line.length:.6g} mm of {found.material.name}, "
        f"{count_of(len(line.lengths), 'element')}, {count_of(steps, 'step')}"
    )
    if found.status is Status.FAILED:
        reached = len(found.path.states) - 1
        way = f"to step {reached} of {steps}" if reached >= 0 else "not even laid as at the start"
        return f"{head}\n  followed {way}; earlier results stay"
    lines = [head, *map(_line, found.results), *_limit(found), *_sweep(found)]
    own = [
        reason for result in found.results for reason in result.reasons if result.value is not None
    ]
    said = dict.fromkeys([*found.reasons, *own])
    lines += [f"  doubtful: {sentence.code}: {sentence.message}" for sentence in said]
    lines += [f"  {note.severity}: {note.message}" for note in found.material.notes]
    return "\n".join([*lines, f"results: {from_here(found.folder)}"])


def _line(result: Result) -> str:
    factor, unit = _SHOWN[result.unit]
    if result.value is None:
        return f"  {result.name:<{_WIDTH}}{'-':>11}  {result.why}"
    written = plain_numbers(result.value, result.interval, factor)
    shown = f"  {result.name:<{_WIDTH}}{written(result.value):>11} {unit_words(unit):<5}"
    if result.interval is not None:
        shown += f"  95 %: {written(result.interval.lower)} to {written(result.interval.upper)}"
    doubts = [result.status] if result.status is Status.DOUBTFUL else []
    return "  ".join([shown, *doubts, result.remark]).rstrip()


def _limit(found: FollowedHarness) -> Iterator[str]:
    limit, bend = found.limit, found.sharpest
    verdict = "kept" if bend.radius >= limit.radius else "NOT KEPT"
    verdict += " (doubtful)" if found.is_bend_doubtful else ""
    where = f"step {bend.step}, {1e3 * bend.place:.4g} mm from the start"
    words = f"  allowed bend radius {1e3 * limit.radius:.4g} mm ({limit.source}): {verdict}"
    yield (
        words if bend.radius >= limit.radius else f"{words}, {1e3 * bend.radius:.4g} mm at {where}"
    )


def _sweep(found: FollowedHarness) -> Iterator[str]:
    if found.sweep:
        yield "  length of the line    smallest bend radius    on the way"
    for finding in found.sweep:
        if finding.status == "failed":
            yield f"  {1e3 * finding.length:>12.5g} mm        -  {finding.reasons[0].message}"
            continue
        radius, way = 1e3 * finding.bend.radius, 1e3 * finding.bend_on_path.radius
        doubt = f"  doubtful: {finding.reasons[0].code}" if finding.reasons else ""
        yield f"  {1e3 * finding.length:>12.5g} mm{radius:>19.4g} mm{way:>14.4g} mm{doubt}"
