"""Count how often intervals hold the truth, in tests, calibrations and lines.

``status`` makes canary rows again and compares them with those kept; ``run`` makes rows that are
missing or do not hold, or all ``--again``, for some minutes, and goes on where it was stopped;
``keep`` takes what was made into the project; ``publish`` puts what is kept on the pages, ``show``
prints it. A KIND is a name, a pattern such as 'lab/*' or 'own C?*', or a study: tests,
calibrations, lines.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.coverage import study


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.coverage", description=__doc__)
    parser.add_argument("task", choices=list(TASKS))
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="all if none")
    parser.add_argument("--minutes", type=float, default=50.0, help="no row begins after them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--again", action="store_true", help="run: all rows, whatever is kept")
    parser.add_argument("--file", type=Path, help="keep: rows made elsewhere")
    options = parser.parse_args()
    try:
        kinds = study.kinds_of(options.kinds)
    except LookupError as error:
        parser.error(str(error.args[0]))
    return TASKS[options.task](options, kinds)


def _run(options: argparse.Namespace, kinds: list[str]) -> int:
    left = study.run(kinds, again=options.again, minutes=options.minutes, jobs=options.jobs)
    print(f"{left} rows are left" if left else "all rows were made")
    return 0


def _status(options: argparse.Namespace, kinds: list[str]) -> int:
    rows = study.kept_rows()
    changed = study.describe_changes(study.make_rows(study.canary(kinds), jobs=options.jobs))
    for kind in kinds:
        state = "differs" if kind in changed else "holds" if rows[kind] else ""
        print(f"{kind}: {len(rows[kind])} of {len(study.BY_KIND[kind].seeds[kind])} kept {state}")
    print(study.remedy(changed) if changed else "all canary rows are as kept")
    return 1 if changed else 0


def _show(_: argparse.Namespace, kinds: list[str]) -> int:
    for chosen_study in _studies(kinds):
        print(study.published(chosen_study, study.kept_rows()))
    return 0


def _publish(_: argparse.Namespace, kinds: list[str]) -> int:
    for chosen_study in _studies(kinds):
        study.publish(chosen_study)
    return 0


def _studies(kinds: list[str]) -> list[study.Study]:
    return [study for study in study.STUDIES if set(study.seeds) & set(kinds)]


def _keep(options: argparse.Namespace, kinds: list[str]) -> int:
    kept = study.keep(options.file or study.WORKING)
    for kind in kinds:
        print(f"{kind}: {kept[kind]} of {len(study.BY_KIND[kind].seeds[kind])}")
    if options.file is None:
        study.WORKING.unlink(missing_ok=True)
    return 0


TASKS = {"run": _run, "status": _status, "show": _show, "publish": _publish, "keep": _keep}

if __name__ == "__main__":
    sys.exit(main())
