"""Count how often predicted bands of lines hold what lines do.

``run`` goes on where it stopped, for some minutes, and may be killed at any time; ``status`` says
whether the page still holds; ``show`` prints and ``publish`` writes what was counted. ``draws``
solves draws of six lines and writes how the bands stand beside them; ``second`` solves some lines
in space by a rod of its own and writes how far the study's truth is from that.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.line_coverage import drawn_bands, line_judgement, line_study, second_truths


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.line_coverage", description=__doc__)
    parser.add_argument("task", choices=["run", "status", "show", "publish", "draws", "second"])
    parser.add_argument("--minutes", type=float, default=60.0, help="no line begins after them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--file", type=Path, default=line_study.FILE, help="of the lines")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), help="which of how many")
    options = parser.parse_args()
    if options.task == "run":
        left = line_study.carry_on(
            options.file, minutes=options.minutes, jobs=options.jobs, part=options.part
        )
        print(f"{left} lines are left" if left else "all lines were made")
        return 0
    if options.task == "draws":
        rows = drawn_bands.all_cases(options.jobs)
        line_judgement.put(drawn_bands.table(rows), line_judgement.DRAWS)
        return 0
    if options.task == "second":
        made, lines = second_truths.all_solved(options.jobs), line_study.read(options.file)
        line_judgement.put(second_truths.table(lines, made), line_judgement.SECOND)
        return 0
    return _tell(options.task, options.file)


def _tell(task: str, file: Path) -> int:
    lines, now = line_study.read(file), line_study.rests_on()
    missing, page = len(line_study.missing(file)), line_judgement.PAGE
    if task == "status":
        holds = f"`{now}`" in page.read_text(encoding="utf-8")
        print(f"{page.name} {'holds' if holds else 'is out of date'}: the code is {now}")
        print(f"{file.name}: {missing} lines are missing")
        return 0 if holds else 1
    if task == "publish":
        line_judgement.publish(lines, now, missing)
    else:
        print(line_judgement.tables(lines, now, missing))
    return 0


if __name__ == "__main__":
    sys.exit(main())
