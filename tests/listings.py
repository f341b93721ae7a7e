"""Printed listings of the documentation, run and compared, or filled in.

A listing is a fenced block that begins with ``$ labpipe``. ``python -m tests.listings`` runs those
of all pages and prints what differs; with ``--update`` it puts what was printed into the pages;
pages may be named. A line ``...`` stands for lines that are left out, and stays; lines that are
broken may be broken anywhere. `MAKERS` says what lies in the folder in which a page's commands run;
`NOT_RUN` says which listings are not run, and why.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import difflib
import io
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.cli import main as labpipe
from labpipe.cli.demo import CALIBRATION_PLAN, CAMPAIGNS
from labpipe.records.curve import Interval
from labpipe.report.wording import format_number
from labpipe.units import get_conversion_factor
from labpipe.virtual_lab import Campaign, simulate_campaigns, simulate_test, write_wire_sheet
from labpipe.virtual_lab.tensile import build_crimp_pull

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = "..."
WIDTH = 120
ALIKE = 0.6
"""Of its characters, digits apart, that a printed line shares with the line that it replaces."""
NOT_RUN = {
    "labpipe campaign watch": "waits for recordings, and prints times of the day",
    "labpipe serve": "serves until it is interrupted, at an address made by chance",
    "labpipe campaign run raw/tensile --executor": "asks for a cluster on other machines",
    "labpipe campaign decide processed/tubes --from": "takes decisions that a person made",
    "labpipe campaign replay raw/tubes --failed disk_full": "no disk is full",
    "labpipe demo --full": "takes minutes, and prints what its campaigns print",
}


@dataclass(frozen=True)
class Command:
    """A command of a page, and what the page prints below it.

    `first` and `last` are the lines of the page that hold what is printed.
    """

    line: str
    first: int
    last: int
    printed: tuple[str, ...]


def find_commands(text: str) -> list[Command]:
    """Commands in the fenced blocks of a page that begin with one."""
    lines, commands, is_inside = text.splitlines(), [], False
    position = 0
    while position < len(lines):
        line = lines[position]
        is_inside = not is_inside if line.startswith("```") else is_inside
        position += 1
        if not (is_inside and line.startswith("$ labpipe ")):
            continue
        command_line = line[2:]
        while command_line.endswith("\\"):
            command_line, position = f"{command_line[:-1]} {lines[position].strip()}", position + 1
        first = position
        while not lines[position].startswith(("$ ", "```")):
            position += 1
        commands.append(Command(command_line, first, position, tuple(lines[first:position])))
    return commands


def run(command_line: str) -> str:
    """What a command prints in the working folder."""
    out, stdin = io.StringIO(), sys.stdin
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
            labpipe(shlex.split(command_line)[1:])
    finally:
        sys.stdin = stdin
    return out.getvalue()


def join_broken_lines(lines: tuple[str, ...]) -> list[str]:
    """Lines as they were printed: one that was broken goes on where a line stands further in."""
    wholes: list[str] = []
    for line in lines:
        indent = len(line) - len(line.lstrip())
        goes_on = wholes and wholes[-1].strip() != LEFT_OUT and wholes[-1] and indent >= 6
        if goes_on and len(wholes[-1]) > 60 and not re.search(r"\S {2,}[^\s\[]", line):
            wholes[-1] = f"{wholes[-1]} {line.strip()}"
        else:
            wholes.append(line)
    return wholes


def find_missing_lines(command: Command, printed: str) -> list[str]:
    """Lines of a page that are not printed, in order and at one place; empty where all are."""
    actual, missing = iter(map(_folded, printed.splitlines())), []
    for line in join_broken_lines(command.printed):
        if line.strip() != LEFT_OUT and not any(
            _is_alike(line, printed_line) for printed_line in actual
        ):
            missing.append(line)
            actual = iter(map(_folded, printed.splitlines()))
    return missing


def _folded(line: str) -> str:
    return " ".join(line.split())


def _is_alike(line: str, printed: str) -> bool:
    """Whether a line says the same; `` ...`` at its end stands for the rest of it."""
    folded = _folded(line)
    if folded.endswith(f" {LEFT_OUT}"):
        return printed.startswith(folded.removesuffix(f" {LEFT_OUT}"))
    return folded == printed


def fill_in(command: Command, printed: str) -> list[str]:
    """The lines of a page with what was printed now; lines that are left out stay so."""
    actual, filled, position = printed.splitlines(), [], 0
    if not any(line.strip() == LEFT_OUT for line in command.printed):
        return [part for line in actual for part in _broken(line)]
    for line in join_broken_lines(command.printed):
        if line.strip() == LEFT_OUT:
            filled.append(line)
            continue
        nearest = max(
            range(position, len(actual)), key=lambda i: _likeness(line, actual[i]), default=-1
        )
        if nearest < 0 or _likeness(line, actual[nearest]) < ALIKE:
            continue
        if nearest > position and filled and filled[-1].strip() != LEFT_OUT:
            filled.append(f"  {LEFT_OUT}")
        now = line if _is_alike(line, _folded(actual[nearest])) else actual[nearest]
        filled += _broken(now)
        position = nearest + 1
    return filled


def _broken(line: str) -> list[str]:
    if len(line) <= WIDTH:
        return [line.rstrip()]
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.wrap(
        line.strip(), WIDTH, initial_indent=indent, subsequent_indent=f"{indent}    "
    )


def _likeness(one: str, other: str) -> float:
    plain = (re.sub(r"[\d.]+", "0", _folded(line)) for line in (one, other))
    return difflib.SequenceMatcher(None, next(plain), next(plain), autojunk=False).ratio()


def is_run(command_line: str) -> bool:
    """Whether a command is run."""
    return not any(command_line.startswith(prefix) for prefix in NOT_RUN)


@contextlib.contextmanager
def folder_of(page: str) -> Iterator[None]:
    """A working folder in which the commands of a page find what they need."""
    before, width = Path.cwd(), os.environ.get("COLUMNS")
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        os.environ["COLUMNS"] = "400"
        try:
            for prefix, make in MAKERS.items():
                if page.startswith(prefix):
                    make(Path(name))
            yield
        finally:
            os.chdir(before)
            os.environ.pop("COLUMNS")
            os.environ |= {} if width is None else {"COLUMNS": width}


def _one_wire(folder: Path) -> None:
    run('labpipe simulate --out raw/W1 --name W1-085-1 --rate "1 kHz"')
    (folder / "raw/W1/W1-085-1/test.yaml").unlink()


def _examples(_: Path) -> None:
    run("labpipe examples")


def _exports(folder: Path, of: Sequence[Campaign], names: Mapping[str, str]) -> None:
    """Exports of tests of the full demo, in folders with the short names that a tutorial gives."""
    for campaign in of:
        for scenario, seed in campaign.list_scenarios():
            if scenario.name not in names:
                continue
            test = simulate_test(scenario, folder / "all" / scenario.name, seed=seed)
            target = folder / names[scenario.name]
            target.mkdir(parents=True)
            texts = sorted(test.glob("*.txt"))
            for number, text in enumerate(texts, start=1):
                name = "frame.txt" if len(texts) == 1 else f"part_{number}.txt"
                shutil.copy(text, target / name)
            for export in (*test.glob("force.*"), *test.glob("take.*")):
                shutil.copy(export, target / export.name)


def _block(page: str, start: str) -> str:
    """The fenced block of a page that begins with some words."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return text[text.index(f"```\n{start}") + 4 :].partition("```")[0]


def _tubes(folder: Path) -> None:
    tests = [f"{spool}{sample}" for spool in "12" for sample in "abc"]
    names = {f"twist-tube-{test}": f"raw/TT/TT-{test}" for test in tests}
    _exports(folder, CAMPAIGNS["tensile"], names)
    (folder / "campaign.csv").write_text(_block(TENSILE, "test;protocol"), encoding="utf-8")


def _bundles(folder: Path) -> None:
    tests = [f"CWB-2{kind}-{sample}" for kind in "abc" for sample in "123"]
    _exports(folder, CAMPAIGNS["harness"], {test: f"raw/taping/{test}" for test in tests})
    (folder / "taping.csv").write_text(_block(BUNDLE, "test,protocol"), encoding="utf-8")
    write_wire_sheet(folder)


def _taped(folder: Path) -> None:
    _examples(folder)
    for campaign in CAMPAIGNS["harness"]:
        for scenario, seed in campaign.list_scenarios():
            if scenario.name == "TWB-B1-19-PVC-1":
                simulate_test(scenario, folder / "raw/demo/harness" / scenario.name, seed=seed)
    run("labpipe process raw/demo/harness --no-figures")


def _campaign(folder: Path) -> None:
    """Tubes of the demo, of which one export is cut off and one test is yet to come."""
    for campaign in CAMPAIGNS["tensile"]:
        for scenario, seed in campaign.list_scenarios():
            if scenario.name.startswith("CT-"):
                test = simulate_test(scenario, folder / "raw/tubes" / scenario.name, seed=seed)
                (test / "truth.json").unlink()
    export = folder / "raw/tubes/CT-10-2/CT-10-2.xlsx"
    export.rename(folder / "whole.xlsx")
    export.write_bytes((folder / "whole.xlsx").read_bytes()[:5000])
    (folder / "raw/tubes/CT-7-3").rename(folder / "CT-7-3")


def _mended() -> None:
    """The export anew, a sheet corrected, a test that comes in, and a file that nobody names."""
    shutil.copy("whole.xlsx", "raw/tubes/CT-10-2/CT-10-2.xlsx")
    shutil.copytree("CT-7-3", "raw/tubes/CT-7-3")
    sheet = Path("raw/tubes/CT-7-1/test.yaml")
    sheet.write_text(sheet.read_text().replace("operator: virtual lab", "operator: AT"))
    Path("raw/tubes/notes.txt").write_text("cut with the new knife\n")


def _tour(folder: Path) -> None:
    _examples(folder)
    _tubes(folder)
    simulate_campaigns(CAMPAIGNS["wires"], folder / "raw/demo/wires")
    write_wire_sheet(folder / "raw/demo/wires")
    (folder / "raw/demo/wires/plan.yaml").write_text(CALIBRATION_PLAN, encoding="utf-8")
    run("labpipe process raw/demo/wires --no-figures")


CAMPAIGN_PAGE, STATUS = "docs/how-to/run-a-campaign.md", "labpipe campaign status raw/tubes"
TENSILE, BUNDLE = "docs/tutorials/first-tensile-test.md", "docs/tutorials/first-bundle.md"


RESULTS_PAGE = "docs/reference/results.md"
ENDS = ("value", "lower", "upper")
EXAMPLE = re.compile(r"([-\d.]+)( [^\s,]+(?: mm\^2)?|), 95 %: ([-\d.]+) to (-?[\d.]*\d)")
MAX_SHIFT = 0.01
"""Of a value: how far the number of an example may have moved and still be known again."""


def _check_examples(path: Path, *, update: bool) -> list[str]:
    """Examples of the page of results, each a number of the demo or of real exports, as printed."""
    with folder_of(RESULTS_PAGE):
        summaries = [
            json.loads(file.read_text(encoding="utf-8")) for file in Path().rglob("summary.json")
        ]
    results = [entry for summary in summaries for entry in summary["results"] if entry["lower"]]
    table = (ROOT / "tests/golden/real.csv").read_text(encoding="utf-8")
    rows = [row for row in csv.DictReader(table.splitlines()) if row["lower"]]
    results += [row | {key: float(row[key]) for key in ENDS} for row in rows]
    stale: list[str] = []

    def fresh(example: re.Match[str]) -> str:
        example_text, unit = example[0], example[2].strip().replace("N mm", "N*mm") or "1"
        factor = get_conversion_factor(unit, SI[unit]) if unit in SI else 1.0
        number = factor * float(example[1])
        matches = [
            entry
            for entry in results
            if entry["unit"] == SI.get(unit, unit)
            and abs(entry["value"] - number) <= MAX_SHIFT * abs(number)
        ]
        if not matches:
            stale.append(f"{path.name}: no test of the demo has {example_text}")
            return example_text
        nearest = min(matches, key=lambda entry: abs(entry["value"] - number))
        ends = Interval(nearest["lower"], nearest["upper"])
        written = format_number(nearest["value"], ends, 1.0 / factor, digits=5)
        now = f"{written.value}{example[2]}, 95 %: {written.lower} to {written.upper}"
        if now != example_text:
            stale.append(f"{path.name}: {example_text}: now {now}")
        return now

    text = path.read_text(encoding="utf-8")
    new = re.sub(
        r"\*\*Example\*\*: .*?\n\n", lambda part: EXAMPLE.sub(fresh, part[0]), text, flags=re.S
    )
    if update:
        path.write_text(new, encoding="utf-8")
    return stale


SI = {
    **{
        "ppm": "1",
        "%": "1",
        "mm": "m",
        "N/mm": "N/m",
        "mJ": "J",
        "um/N": "m/N",
        "MPa": "Pa",
        "deg": "rad",
    },
    "N*mm^2": "N*m^2",
}


def _tests_of_the_demo(folder: Path) -> None:
    run("labpipe demo . --no-figures")
    _one_wire(folder)
    run("labpipe new raw/W1/W1-085-1 --spool W1-s1")
    crimp = build_crimp_pull("crimp", 1, strength=141.0, conductor="AWG 20", separation="slip")
    simulate_test(crimp, folder / "raw/crimps/crimp-1", seed=0)
    run("labpipe process raw/W1/W1-085-1 raw/crimps/crimp-1 --no-figures")


MAKERS: dict[str, Callable[[Path], None]] = {
    "README.md": _one_wire,
    RESULTS_PAGE: _tests_of_the_demo,
    "docs/tutorials/first-real-test.md": _one_wire,
    "docs/how-to/harness.md": lambda _: None,
    "docs/explanations/bundle-model.md": _taped,
    TENSILE: _tubes,
    BUNDLE: _bundles,
    "docs/tutorials/tour.md": _tour,
    CAMPAIGN_PAGE: _campaign,
}
PREPARATIONS: dict[tuple[str, str], Callable[[], None]] = {(CAMPAIGN_PAGE, STATUS): _mended}
"""What a person does before a command of a page."""


def check_page(page: str, *, update: bool = False) -> list[str]:
    """What is stale on a page; with `update`, it is filled in."""
    path = ROOT / page
    if page == RESULTS_PAGE:
        return _check_examples(path, update=update)
    text = path.read_text(encoding="utf-8")
    lines, stale = text.splitlines(), []
    with folder_of(page):
        changes = []
        for command in find_commands(text):
            if not is_run(command.line):
                continue
            PREPARATIONS.get((page, command.line), lambda: None)()
            printed = run(command.line)
            missing = find_missing_lines(command, printed) if command.printed else []
            stale += [f"{page}: {command.line}: {line.strip()}" for line in missing]
            if missing:
                changes.append((command, fill_in(command, printed)))
    for command, now in reversed(changes if update else []):
        lines[command.first : command.last] = now
    if update:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return stale


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.listings", description=__doc__)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="such as README.md; all if none")
    parser.add_argument("--update", action="store_true", help="fill in what was printed")
    options = parser.parse_args()
    stale = [
        line for page in options.pages or MAKERS for line in check_page(page, update=options.update)
    ]
    print("\n".join(stale) or "all listings are fresh")
    return int(bool(stale) and not options.update)


if __name__ == "__main__":
    sys.exit(main())
