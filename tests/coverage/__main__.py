"""Count how often intervals hold the truth.

``run`` goes on where it stopped, for some minutes, and may be killed at any time; ``status`` says
whether the page still holds; ``publish`` puts what was counted on the page.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.coverage.page import PAGE, publish, published_digest, tables
from tests.coverage.study import FILE, KINDS, carry_on, missing, read, rests_on


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.coverage", description=__doc__)
    parser.add_argument("task", choices=["run", "status", "show", "publish"])
    parser.add_argument(
        "kinds", nargs="*", metavar="KIND", help="such as lab/pet-tape; all if none"
    )
    parser.add_argument("--minutes", type=float, default=50.0, help="no test begins after them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--rounds", type=int, help="only the first so many seeds of each kind")
    parser.add_argument("--file", type=Path, default=FILE, help="of the lines")
    options = parser.parse_args()
    return TASKS[options.task](options)


def _run(options: argparse.Namespace) -> int:
    chosen = [k for k in KINDS if not options.kinds or f"{k.simulator}/{k.name}" in options.kinds]
    if len(chosen) < len(options.kinds):
        names = ", ".join(f"{kind.simulator}/{kind.name}" for kind in KINDS)
        print(f"expected some of {names}, found {', '.join(options.kinds)}", file=sys.stderr)
        return 2
    left = carry_on(
        options.file,
        minutes=options.minutes,
        jobs=options.jobs,
        kinds=chosen,
        rounds=options.rounds,
    )
    print(f"{left} tests are left" if left else "all tests were made")
    return 0


def _status(options: argparse.Namespace) -> int:
    now, then = rests_on(), published_digest(PAGE.read_text(encoding="utf-8"))
    holds = "holds" if now == then else "is out of date"
    print(f"{PAGE.name} {holds}: it rests on {then or 'nothing it names'}, the code is {now}")
    print(f"{options.file.name}: {len(missing(options.file))} tests are missing")
    return 0 if now == then else 1


def _show(options: argparse.Namespace) -> int:
    print(tables(list(read(options.file).values())))
    return 0


def _publish(options: argparse.Namespace) -> int:
    publish(list(read(options.file).values()))
    return 0


TASKS = {"run": _run, "status": _status, "show": _show, "publish": _publish}

if __name__ == "__main__":
    sys.exit(main())
