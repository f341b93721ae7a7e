"""Make faults on purpose and see whether the tests notice.

``python -m tests.mutation`` goes on where it stopped, for an hour at most, and writes each mutant
that was tried into ``tests/mutation/tried.jsonl``; ``--report`` prints the score. A mutant is
killed if one of the tests fails that mirror its module or import it. What survives is explained in
``tests/mutation/explained.toml``, or is a test that is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from pathlib import Path

from tests.mutation.mutants import COUNT, Mutant, sampled

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
TRIED = HERE / "tried.jsonl"
_MOST = 240.0
"""s that the tests of a mutant may take; a mutant that makes them wait forever is noticed."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0, help="go on for so long")
    parser.add_argument("--report", action="store_true", help="print the score")
    options = parser.parse_args()
    if not options.report:
        try_for(options.seconds)
    return report()


def try_for(seconds: float) -> None:
    """Try the mutants that have not been tried, one after the other."""
    known, ends = tried(), time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        ignored = shutil.ignore_patterns("__pycache__")
        for part in ("labpipe", "tests", "protocols", "pyproject.toml"):
            source = REPOSITORY / part
            if source.is_dir():
                shutil.copytree(source, tree / part, ignore=ignored)
            else:
                shutil.copy(source, tree / part)
        for mutant in sampled(REPOSITORY / "labpipe"):
            if time.monotonic() > ends:
                return
            if mutant.key not in known:
                line = {"mutant": mutant.key, "end": end_of(mutant, tree)}
                with TRIED.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")


def end_of(mutant: Mutant, tree: Path) -> str:
    """Whether the tests killed a mutant, survived it, or never ended."""
    path = tree / "labpipe" / mutant.module
    path.write_text(mutant.text, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:randomly", *files_for(mutant)]
    try:
        ran = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, timeout=_MOST, check=False
        )
    except subprocess.TimeoutExpired:
        return "killed"
    finally:
        path.write_text(mutant.source, encoding="utf-8")
    return "survived" if ran.returncode == 0 else "killed"


def files_for(mutant: Mutant) -> list[str]:
    """Files of tests that mirror a module first, then those that import it."""
    module = Path(mutant.module)
    own = sorted((REPOSITORY / "tests" / module.parent).glob(f"test_{module.stem}*.py"))
    dotted = "labpipe." + module.with_suffix("").as_posix().replace("/", ".")
    users = [
        path
        for path in sorted((REPOSITORY / "tests").rglob("test_*.py"))
        if path not in own and f"{dotted} " in path.read_text(encoding="utf-8")
    ]
    return [path.relative_to(REPOSITORY).as_posix() for path in [*own, *users]]


def tried() -> dict[str, str]:
    """Mutants that were tried, and how that ended."""
    if not TRIED.is_file():
        return {}
    lines = map(json.loads, TRIED.read_text(encoding="utf-8").splitlines())
    return {line["mutant"]: line["end"] for line in lines}


def score() -> tuple[Counter[str], list[str]]:
    """How the mutants of the package as it is ended, and which survived without an explanation."""
    known, why = tried(), {}
    if (HERE / "explained.toml").is_file():
        why = tomllib.loads((HERE / "explained.toml").read_text(encoding="utf-8"))
    keys = [mutant.key for mutant in sampled(REPOSITORY / "labpipe")]
    ends = Counter(known.get(key, "not tried") for key in keys)
    return ends, [key for key in keys if known.get(key) == "survived" and key not in why]


def report() -> int:
    """Print the score."""
    ends, unexplained = score()
    done = COUNT - ends["not tried"]
    print(f"{done} of {COUNT} tried, {ends['killed']} killed, {ends['survived']} survived")
    if done:
        print(f"killed or explained: {100.0 * (done - len(unexplained)) / done:.1f} %")
    print("".join(f"  {key}\n" for key in unexplained), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
