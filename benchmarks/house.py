"""How large the house is, and how much of it one test walks through.

``python -m benchmarks.house [TREE]`` prints it; ``--check`` compares it with the table in
``benchmarks/house.toml`` and fails where anything has grown; ``--lower`` writes what has shrunk
into the table. A line of the table is raised by hand, with a new reason (``because``), which the
changelog must hold, too: a raise is seen against the last other table of git.

Lines of code are those that hold a token and are no docstring, no comment and not blank. The share
of docstrings is that of their lines in lines of code and docstrings together; a string under a
constant is its docstring.

What runs is counted in a process of its own by a profile hook that is set before labpipe is
imported and holds for all threads (`benchmarks.calls`). A *function* is a named function, method or
property of a file of labpipe; each counts once, however often it is called. Comprehensions,
generator expressions and lambdas belong to the function around them; code that dataclasses write
has no file. Bodies of classes run once, when their module is imported. *Functions and classes*, and
the files that hold any of those that ran, is the count of earlier times: 877 in 120 files for
A2-085-1 at e82cbe5. Bodies of modules make a file *imported*, no more.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import subprocess
import sys
import tempfile
import tokenize
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import load_frames
from benchmarks.jobs import simulated
from benchmarks.timing import REPOSITORY

TABLE = Path(__file__).with_name("house.toml")
CALLS = Path(__file__).with_name("calls.py")
LAYOUT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    tokenize.ENDMARKER,
}
WIRE, TUBE, BAR = "A2-085-1", "CT-10-1", "bar"
BAR_BYTES = 200_000


@dataclass(frozen=True)
class Size:
    """Files, lines of code, and lines of docstrings."""

    files: int = 0
    code: int = 0
    docstrings: int = 0

    def __add__(self, other: Size) -> Size:
        docstrings = self.docstrings + other.docstrings
        return Size(self.files + other.files, self.code + other.code, docstrings)

    @property
    def share(self) -> float:
        """Of docstrings."""
        return self.docstrings / max(self.code + self.docstrings, 1)


def size_of(source: str) -> Size:
    """Size of one file."""
    docstrings = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    code = {
        line
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in LAYOUT
        for line in range(token.start[0], token.end[0] + 1)
    }
    return Size(1, len(code - docstrings), len(docstrings))


def sizes(package: Path) -> dict[str, Size]:
    """Sizes by folder of the package, ``.`` for the files in none."""
    by_folder: dict[str, Size] = {}
    for path in sorted(package.rglob("*.py")):
        folders = path.relative_to(package).parts[:-1]
        folder = "/".join(folders[: 2 if folders[:1] == ("mechanics",) else 1]) or "."
        by_folder[folder] = by_folder.get(folder, Size()) + size_of(
            path.read_text(encoding="utf-8")
        )
    return by_folder


@dataclass(frozen=True)
class Walk:
    """What one command runs; the files of functions and classes, and those imported."""

    functions: int
    files_of_functions: int
    functions_and_classes: int
    files: int
    imported: int


def walk(tree: Path, test: Path, out: Path) -> Walk:
    """What ``labpipe process --no-figures`` of a test runs, with the package of a tree."""
    written = out / "calls.json"
    command = ["process", str(test), "--no-figures", "--out", str(out)]
    subprocess.run(
        [sys.executable, "-P", str(CALLS), str(tree), str(written), *command],
        check=True,
        capture_output=True,
        cwd=out,
        env=os.environ | {"PYTHONPATH": str(tree)},
    )
    ran = json.loads(written.read_text(encoding="utf-8"))["ran"]
    named = [call for call in ran if not call["name"].rpartition(".")[2].startswith("<")]
    functions = [call for call in named if call["is_function"]]
    return Walk(
        len(functions),
        len({function["file"] for function in functions}),
        len(named),
        len({call["file"] for call in named}),
        sum(call["name"] == "<module>" for call in ran),
    )


def write_tests(folder: Path) -> dict[str, Path]:
    """A cantilever and a corrugated tube of the demo, and a plain bar from a csv, by protocol."""
    tests = simulated((WIRE, TUBE), folder)
    bar = load_frames.write_csv_test(folder / BAR, size=BAR_BYTES)
    return {"wire-cantilever": tests[WIRE], "corrugated-tube": tests[TUBE], "tensile": bar.parent}


def show_sizes(tree: Path) -> None:
    """A line for each folder, and the whole."""
    rooms = sizes(tree / "labpipe")
    for name, size in {**rooms, "labpipe": sum(rooms.values(), Size())}.items():
        text = f"{size.code:>6} lines in {size.files:>3} files"
        print(f"{name:<14}{text}, docstrings {size.share:.1%}", flush=True)


def show_walks(tree: Path) -> None:
    """A line for each kind of test."""
    with tempfile.TemporaryDirectory() as folder:
        for protocol, test in write_tests(Path(folder)).items():
            run = walk(tree, test, Path(folder))
            text = (
                f"{run.functions:>4} functions in {run.files_of_functions} files,"
                f" {run.functions_and_classes:>4} functions and classes in {run.files},"
                f" {run.imported} imported"
            )
            print(f"{protocol:<16}{text}", flush=True)


def measured(tree: Path) -> dict[str, int]:
    """Files and lines of code of each room of package and tests, words of docs, and walks."""
    numbers: dict[str, int] = {}
    for top in ("labpipe", "tests"):
        rooms = sizes(tree / top)
        for room, size in {**rooms, "all": sum(rooms.values(), Size())}.items():
            numbers |= {f"{top}/{room} files": size.files, f"{top}/{room} lines": size.code}
    pages = [tree / "README.md", tree / "CONTRIBUTING.md", *(tree / "docs").rglob("*.md")]
    numbers["docs pages"] = len(pages)
    numbers["docs words"] = sum(len(page.read_text(encoding="utf-8").split()) for page in pages)
    with tempfile.TemporaryDirectory() as folder:
        for protocol, test in write_tests(Path(folder)).items():
            run = walk(tree, test, Path(folder))
            numbers[f"{protocol} functions and classes"] = run.functions_and_classes
            numbers[f"{protocol} files"] = run.files
    return numbers


def most_of(line: Any) -> int:
    """Number of a line of the table."""
    return int(line["most"] if isinstance(line, dict) else line)


def reason_of(line: Any) -> str:
    """Why a line of the table was raised; empty where it was not."""
    return " ".join(line["because"].split()) if isinstance(line, dict) else ""


def before(place: Path) -> dict[str, Any]:
    """The last other table that git has, of this commit or the one before it; empty without any."""
    for commit in ("HEAD", "HEAD^"):
        command = ["git", "show", f"{commit}:./{place.name}"]
        shown = subprocess.run(command, cwd=place.parent, capture_output=True, check=False)
        if shown.returncode == 0 and shown.stdout != place.read_bytes():
            return tomllib.loads(shown.stdout.decode("utf-8"))
    return {}


def faults(
    numbers: dict[str, int], table: dict[str, Any], earlier: dict[str, Any], changelog: str
) -> list[str]:
    """Lines of the table that are exceeded, or raised without a reason that the changelog holds.

    Parameters
    ----------
    numbers : as `measured`
    table : number by name, or ``{most, because}`` where it was raised
    earlier : the table before
    changelog : text
    """
    messages = []
    for name, number in numbers.items():
        line = table.get(name, 0)
        most, reason, last = most_of(line), reason_of(line), earlier.get(name, line)
        if number > most:
            messages.append(
                f"{TABLE.name}, {name}: expected at most {most}, found {number}. Take away as much"
                " as came in, or raise the line with its reason in the changelog."
            )
        if most > most_of(last) and reason == reason_of(last):
            messages.append(
                f"{TABLE.name}, {name}: expected at most {most_of(last)} as before, found {most}"
                " without a new reason. Write {most = ..., because = ...}, and the reason in the"
                " changelog, too."
            )
        if reason not in changelog:
            messages.append(
                f"{TABLE.name}, {name}: its reason is not in the changelog. Write it there."
            )
    return messages


def lowered(numbers: dict[str, int], table: dict[str, Any]) -> str:
    """The table with what has shrunk, as text; what is not measured any more is left out."""
    text = ["# Written by: python -m benchmarks.house --lower\n"]
    for name, number in numbers.items():
        line = table.get(name, number)
        if isinstance(line, dict) and most_of(line) <= number:
            text.append(f'"{name}" = {{ most = {line["most"]}, because = "{line["because"]}" }}\n')
        else:
            text.append(f'"{name}" = {min(most_of(line), number)}\n')
    return "".join(text)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.house", description=__doc__)
    parser.add_argument("tree", type=Path, nargs="?", default=REPOSITORY, help="another checkout")
    parser.add_argument("--check", action="store_true", help="fail where anything has grown")
    parser.add_argument("--lower", action="store_true", help="write what has shrunk")
    options = parser.parse_args(arguments)
    tree = options.tree.resolve()
    if not options.check and not options.lower:
        show_sizes(tree)
        show_walks(tree)
        return 0
    numbers, place = measured(tree), tree / "benchmarks" / TABLE.name
    table = tomllib.loads(place.read_text(encoding="utf-8")) if place.is_file() else {}
    if options.lower:
        place.write_text(lowered(numbers, table), encoding="utf-8")
        return 0
    changelog = " ".join((tree / "CHANGELOG.md").read_text(encoding="utf-8").split())
    messages = faults(numbers, table, before(place) if table else {}, changelog)
    print("\n".join(messages) or "nothing has grown")
    return int(bool(messages))


if __name__ == "__main__":
    sys.exit(main())
