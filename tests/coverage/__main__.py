"""Count how often intervals hold the truth.

``run`` goes on where it stopped, for some minutes, and may be killed at any time; ``status`` says
whether the page still holds; ``publish`` puts what was counted on the page; ``keep`` puts the lines
of a study that is not whole into the project, so that it goes on from them on any machine. With
``--calibrations`` it is the study of calibrations, whose kinds are chosen by words of their names,
such as ``foreign A2``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.coverage import wire_judgement, wire_study
from tests.coverage.page import PAGE, publish, published_digest, tables
from tests.coverage.study import FILE, KINDS, carry_on, keep, missing, read, rests_on
from tests.coverage.wire_campaigns import KINDS as WIRE_KINDS


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.coverage", description=__doc__)
    parser.add_argument("task", choices=["run", "status", "show", "publish", "keep"])
    parser.add_argument(
        "kinds", nargs="*", metavar="KIND", help="such as lab/pet-tape; all if none"
    )
    parser.add_argument("--minutes", type=float, default=50.0, help="no test begins after them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--rounds", type=int, help="only the first so many seeds of each kind")
    parser.add_argument("--file", type=Path, help="of the lines")
    parser.add_argument("--calibrations", action="store_true", help="the study of calibrations")
    options = parser.parse_args()
    if options.task == "keep" and not options.calibrations:
        parser.error("only lines of calibrations are kept: the other study is made in one piece")
    options.file = options.file or (wire_study.FILE if options.calibrations else FILE)
    return (WIRE_TASKS if options.calibrations else TASKS)[options.task](options)


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


def _run_wires(options: argparse.Namespace) -> int:
    words = set(options.kinds)
    chosen = [kind for kind in WIRE_KINDS if words <= set(kind.name.split())]
    left = wire_study.carry_on(
        options.file, minutes=options.minutes, jobs=options.jobs, kinds=chosen
    )
    print(f"{left} campaigns are left" if left else "all campaigns were made")
    return 0


def _status_of_wires(options: argparse.Namespace) -> int:
    now = wire_study.rests_on()
    holds = f"`{now}`" in wire_judgement.PAGE.read_text(encoding="utf-8")
    print(f"{wire_judgement.PAGE.name} {'holds' if holds else 'is out of date'}: the code is {now}")
    print(f"{options.file.name}: {len(wire_study.missing(options.file))} campaigns are missing")
    return 0 if holds else 1


def _show_wires(options: argparse.Namespace) -> int:
    print(wire_judgement.tables(wire_study.read(options.file), wire_study.rests_on()))
    return 0


def _publish_wires(options: argparse.Namespace) -> int:
    wire_judgement.publish(wire_study.read(options.file), wire_study.rests_on())
    return 0


def _keep_wires(options: argparse.Namespace) -> int:
    print(keep(options.file, wire_study.read(options.file)).name)
    return 0


TASKS = {"run": _run, "status": _status, "show": _show, "publish": _publish}
WIRE_TASKS = {
    "run": _run_wires,
    "status": _status_of_wires,
    "show": _show_wires,
    "publish": _publish_wires,
    "keep": _keep_wires,
}

if __name__ == "__main__":
    sys.exit(main())
