"""Make faults on purpose and see whether the tests notice.

``python -m tests.mutation`` tries what has not been tried, for an hour at most, and writes down
what notices each fault, in ``tests/mutation/tried.jsonl``. ``--again`` tries those again that
survived, ``--all`` tries all again. ``--report`` prints the score, ``--publish`` puts it into
docs/explanations/coverage.md. What survives is explained in ``tests/mutation/explained.toml``, or
is a test that is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.mutation.entered import REPOSITORY, Entered
from tests.mutation.mutants import COUNT, LAYERS, Mutant, sampled
from tests.mutation.trials import in_session, noticed_by

HERE = Path(__file__).resolve().parent
TRIED, EXPLAINED = HERE / "tried.jsonl", HERE / "explained.toml"
PAGE = REPOSITORY / "docs" / "explanations" / "coverage.md"
DEMO = REPOSITORY / "raw" / "demo"
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"
BESIDE, KEPT, OTHERS = "tests of its room", "numbers kept of the demo", "other tests"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0, help="go on for so long")
    parser.add_argument("--demo", type=Path, default=DEMO, help="folder of the demo's exports")
    parser.add_argument("--again", action="store_true", help="try again what survived")
    parser.add_argument("--all", action="store_true", help="try all again")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults whose name has this")
    parser.add_argument("--report", action="store_true", help="print the score")
    parser.add_argument("--publish", action="store_true", help="put the score into the docs")
    options = parser.parse_args()
    drawn = sampled(REPOSITORY / "labpipe")
    if not (options.report or options.publish):
        trials = {} if options.all else tried()
        if options.again:
            why = explained()
            trials = {
                name: by for name, by in trials.items() if by or name.rpartition(" [")[0] in why
            }
        chosen = [
            mutant for mutant in drawn if options.only in mutant.key and token(mutant) not in trials
        ]
        os.environ["LABPIPE_DEMO"] = str(options.demo.resolve())
        try_for(options.seconds, chosen)
        forget_others(drawn)
    counted = Counted.of(drawn, tried(), explained())
    print(counted)
    if options.publish:
        publish(counted)
    return 0


def try_for(seconds: float, mutants: Sequence[Mutant]) -> None:
    """Try mutants one after the other, and write down how each ends."""
    ends, trials, entered = time.monotonic() + seconds, tried(), Entered.kept()
    tests = {mutant: entered.tests_of(mutant, trials.get(token(mutant), "")) for mutant in mutants}

    def try_all(session: pytest.Session) -> None:
        for number, mutant in enumerate(mutants):
            if time.monotonic() > ends:
                return
            by = trials[token(mutant)] = noticed_by(mutant, tests[mutant], session)
            write(trials)
            print(f"{number + 1}/{len(mutants)} {by or 'NOTHING'}  <  {mutant.key}", flush=True)

    if files := {test.partition("::")[0] for names in tests.values() for test in names}:
        in_session(sorted(files), try_all)


def token(mutant: Mutant) -> str:
    """Under which a trial is kept: tried again once the function has changed."""
    return f"{mutant.key} [{mutant.digest}]"


def tried() -> dict[str, str]:
    """What noticed each mutant that was tried; an empty text where nothing did."""
    if not TRIED.is_file():
        return {}
    lines = map(json.loads, TRIED.read_text(encoding="utf-8").splitlines())
    return {line["mutant"]: line["by"] for line in lines}


def forget_others(drawn: Sequence[Mutant]) -> None:
    """Forget what was tried of functions that are gone or have changed."""
    names, trials = {token(mutant) for mutant in drawn}, tried()
    write({name: by for name, by in trials.items() if name in names})


def write(trials: Mapping[str, str]) -> None:
    """Keep what was tried, in the order of names."""
    lines = [json.dumps({"mutant": name, "by": by}) for name, by in sorted(trials.items())]
    TRIED.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def explained() -> dict[str, str]:
    """Why a mutant changes no result, by its name."""
    if not EXPLAINED.is_file():
        return {}
    entries = tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))["explained"]
    return {entry["mutant"]: entry["why"] for entry in entries}


@dataclass(frozen=True)
class Counted:
    """How the mutants of the package as it is ended.

    Parameters
    ----------
    ends : layer by layer: how many were noticed by what, were explained, or survived
    survived : names of those that nothing notices and nobody has explained
    """

    ends: Mapping[str, Counter[str]]
    survived: tuple[str, ...]

    @classmethod
    def of(
        cls, drawn: Sequence[Mutant], trials: Mapping[str, str], why: Mapping[str, str]
    ) -> Counted:
        ends: dict[str, Counter[str]] = {
            room: Counter() for room in sorted(layer.rpartition("/")[2] for layer in LAYERS)
        }
        survived = []
        for mutant in drawn:
            end = _end(mutant, trials.get(token(mutant)), why)
            ends[mutant.room][end] += 1
            if end == "survived":
                survived.append(mutant.key)
        return cls(ends, tuple(survived))

    @property
    def all(self) -> Counter[str]:
        return sum(self.ends.values(), Counter())

    @property
    def n_tried(self) -> int:
        return self.all.total() - self.all["not tried"]

    @property
    def share(self) -> float:
        """Noticed or explained, of those that were tried."""
        return (self.n_tried - len(self.survived)) / self.n_tried if self.n_tried else 0.0

    def __str__(self) -> str:
        told = ", ".join(f"{n} {end}" for end, n in sorted(self.all.items()))
        lines = [f"{self.n_tried} of {COUNT} tried: {told}"]
        lines += [f"noticed or explained: {100.0 * self.share:.1f} %"]
        return "\n".join([*lines, *(f"  {key}" for key in sorted(self.survived))])

    @property
    def table(self) -> str:
        """In markdown, layer by layer."""
        names = (BESIDE, OTHERS, KEPT, "explained", "survived")
        rows = [*((f"`{layer}`", ends) for layer, ends in self.ends.items()), ("all", self.all)]
        lines = [f"| layer | {' | '.join(['tried', *names])} |", "|---" * (len(names) + 2) + "|"]
        for name, ends in rows:
            tries = sum(ends.values()) - ends["not tried"]
            lines.append(f"| {' | '.join([name, str(tries), *(str(ends[n]) for n in names)])} |")
        return "\n".join(lines)


def _end(mutant: Mutant, by: str | None, why: Mapping[str, str]) -> str:
    if by is None:
        return "not tried"
    if not by:
        return "explained" if mutant.key in why else "survived"
    if by.startswith("tests/golden/"):
        return KEPT
    is_beside = f"tests/{mutant.room}/" in by or "/" not in by
    return BESIDE if is_beside else OTHERS


def publish(counted: Counted) -> None:
    """Put the score between the marks of the page, with the commit that was tried."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    killed = counted.n_tried - counted.all["explained"] - len(counted.survived)
    told = (
        f"At commit {commit.stdout.strip()}, **{counted.n_tried} of {COUNT} were tried: {killed} "
        f"noticed, {counted.all['explained']} explained, {len(counted.survived)} survived** "
        f"({100.0 * counted.share:.1f} % noticed or explained)."
    )
    text = f"{BEGIN}\n{told}\n\n{counted.table}\n{END}"
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(
        re.sub(f"{BEGIN}.*{END}", lambda _: text, page, flags=re.DOTALL), encoding="utf-8"
    )


if __name__ == "__main__":
    sys.exit(main())
