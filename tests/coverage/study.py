"""The study of coverage: tests of both simulators by seed, one JSON line each, in parts.

Seeds were fixed before the first run and are never changed. Tests are drawn in rounds, one of each
kind, so that after any time all kinds have as many. A line says which commit made it and what it
rests on; where that has changed since, the test is made again.
"""

from __future__ import annotations

import json
import lzma
import os
import shutil
import subprocess
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from tests.coverage import lab
from tests.coverage.rests_on import ROOT, digest, together
from tests.judges.foreign import processed as foreign

KEPT = ROOT / "tests" / "coverage" / "kept"
"""Lines of studies that are not whole, compressed."""
Each = TypeVar("Each")

Line = dict[str, Any]
"""Of one test: simulator, kind, seed, noise, fault, commit, rests_on, seconds, error, rows."""


@dataclass(frozen=True, slots=True, order=True)
class Kind:
    """A kind of test.

    Parameters
    ----------
    simulator : ``foreign`` or ``lab``
    name : of the simulator's kind
    """

    simulator: str
    name: str

    @property
    def rests_on(self) -> str:
        """Digest of what its numbers rest on."""
        return _digest(self.simulator, lab.PROTOCOLS.get(self.name, self.name))

    @property
    def seeds(self) -> range:
        """Its tests."""
        return SEEDS[self.simulator]


SEEDS = {"foreign": range(26000, 26200), "lab": range(27000, 27200)}
"""Never changed."""
KINDS = (
    *(Kind("foreign", name) for name in foreign.KINDS),
    *(Kind("lab", name) for name in lab.KINDS),
)
FILE = ROOT / "processed" / "coverage.jsonl"

_digest = cache(digest)


def rests_on() -> str:
    """One digest for the whole study."""
    return together([kind.rests_on for kind in KINDS])


def read(file: Path) -> dict[tuple[Kind, int], Line]:
    """The tests of a study that still hold, in the order of the kinds; a torn line is left out."""
    found: dict[tuple[Kind, int], Line] = {}
    for text in file.read_text(encoding="utf-8").split("\n") if file.is_file() else ():
        line = whole(text)
        kind = Kind(line["simulator"], line["kind"]) if line else None
        if line and kind in KINDS and line["rests_on"] == kind.rests_on:
            found[kind, line["seed"]] = line
    return dict(sorted(found.items(), key=lambda each: (KINDS.index(each[0][0]), each[0][1])))


def whole(text: str) -> Line | None:
    """Read a line; None for a torn one."""
    try:
        line = json.loads(text)
    except json.JSONDecodeError:
        return None
    return line if isinstance(line, dict) else None


def read_lines(file: Path, kinds: Iterable[str], rests_on: str) -> list[Line]:
    """Read the lines of a study that still hold, each kind and seed once, the last one made.

    Parameters
    ----------
    file : of the lines; need not be there. Lines that were kept of it come before them, see `keep`
    kinds : names, in the order wanted; lines of others are left out
    rests_on : digest that a line must rest on
    """
    order = {name: number for number, name in enumerate(kinds)}
    found: dict[tuple[int, int], Line] = {}
    for text in [*_kept(file), *_written(file)]:
        line = whole(text)
        if line and line["kind"] in order and line["rests_on"] == rests_on:
            found[order[line["kind"]], line["seed"]] = line
    return [line for _, line in sorted(found.items(), key=lambda each: each[0])]


def keep(file: Path, lines: Iterable[Line]) -> Path:
    """Keep the lines of a study that is not whole, for `read_lines` to begin with on any machine.

    Parameters
    ----------
    file : of the lines, by whose name they are kept
    lines : that still hold; without any, what was kept before goes

    Returns
    -------
    Where they are kept.
    """
    kept, text = _kept_file(file), "".join(f"{json.dumps(line)}\n" for line in lines)
    kept.unlink(missing_ok=True)
    if text:
        kept.parent.mkdir(exist_ok=True)
        kept.write_bytes(lzma.compress(text.encode(), preset=9))
    return kept


def _kept_file(file: Path) -> Path:
    return KEPT / f"{file.name}.xz"


def _kept(file: Path) -> list[str]:
    kept = _kept_file(file)
    return lzma.decompress(kept.read_bytes()).decode().split("\n") if kept.is_file() else []


def _written(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").split("\n") if file.is_file() else []


def line_of(kind: str, seed: int, rests_on: str, make: Callable[[], Line]) -> Line:
    """Make a line of a study; an error that nobody expects is kept in it.

    Parameters
    ----------
    kind, seed, rests_on : of the line
    make : what it says beside them
    """
    begin, error, said = time.process_time(), "", {}
    try:
        said = make()
    except Exception:  # noqa: BLE001 - kept in the line, and counted
        error = traceback.format_exc()
    seconds = round(time.process_time() - begin, 3)
    made = {"kind": kind, "seed": seed, "rests_on": rests_on}
    return {**made, "seconds": seconds, "error": error, **said}


def missing(file: Path, kinds: Iterable[Kind] = KINDS) -> list[tuple[Kind, int]]:
    """Tests that have not been made, or rest on what has changed, in rounds."""
    done, asked = read(file), tuple(kinds)
    rounds = zip(*(kind.seeds for kind in asked), strict=True)
    wanted = ((kind, seed) for each in rounds for kind, seed in zip(asked, each, strict=True))
    return [each for each in wanted if each not in done]


def carry_on(
    file: Path,
    *,
    minutes: float,
    jobs: int = 2,
    kinds: Iterable[Kind] = KINDS,
    rounds: int | None = None,
) -> int:
    """Go on with the study for some minutes.

    Parameters
    ----------
    file : of the lines; made if it is not there
    minutes : no test is begun after them
    jobs : processes
    kinds : which tests
    rounds : of each kind, the first so many; all if left out

    Returns
    -------
    How many tests are still missing.
    """
    wanted = [
        (kind, seed)
        for kind, seed in missing(file, kinds)
        if rounds is None or seed in kind.seeds[:rounds]
    ]
    return len(wanted) - make_lines(file, one, wanted, minutes=minutes, jobs=jobs)


def make_lines(
    file: Path,
    make: Callable[[Each, int], Line],
    wanted: Iterable[tuple[Each, int]],
    *,
    minutes: float,
    jobs: int,
) -> int:
    """Make lines of a study in processes for some minutes, and keep each as it comes.

    Parameters
    ----------
    file : of the lines; made if it is not there
    make : line of a kind and a seed; a function of a module
    wanted : kinds and seeds, in order
    minutes : nothing is begun after them
    jobs : processes

    Returns
    -------
    How many were made.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before the processes load it
    until, left, commit = time.monotonic() + 60.0 * minutes, iter(wanted), head()
    file.parent.mkdir(parents=True, exist_ok=True)
    written = 0
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for line in _made(pool, make, left, until=until, ahead=2 * jobs):
            append(file, {"commit": commit, **line})
            written += 1
    return written


def _made(
    pool: ProcessPoolExecutor,
    make: Callable[[Each, int], Line],
    left: Iterator[tuple[Each, int]],
    *,
    until: float,
    ahead: int,
) -> Iterator[Line]:
    """Lines as they come; only a few are asked for ahead of time."""
    running: set[Future[Line]] = set()
    while True:
        while len(running) < ahead and time.monotonic() < until:
            if (wanted := next(left, None)) is None:
                break
            running.add(pool.submit(make, *wanted))
        if not running:
            return
        done, running = wait(running, return_when=FIRST_COMPLETED)
        yield from (each.result() for each in done)


def append(file: Path, line: Line) -> None:
    """Add a line in one piece; behind a torn one it begins afresh."""
    with file.open("a+b") as stream:
        torn = stream.tell() > 0 and _last_byte(file) != b"\n"
        stream.write((b"\n" if torn else b"") + json.dumps(line).encode() + b"\n")


def _last_byte(file: Path) -> bytes:
    with file.open("rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read()


def one(kind: Kind, seed: int) -> Line:
    """Make, process and take away one test; an error that nobody expects is kept in its line."""
    home, begin = Path(tempfile.mkdtemp(prefix="coverage-")), time.process_time()
    noise, fault, error, rows = "", "", "", []
    try:
        if kind.simulator == "foreign":
            chance = foreign.chance_of(kind.name, seed)
            noise, fault = chance.noise, chance.fault
            said = foreign.process(chance, home / "test")
            rows = list(said.rows)
            error = said.printed if "Traceback" in said.printed else ""
        else:
            rows = lab.rows(kind.name, seed, home)
    except Exception:  # noqa: BLE001 - kept in the line, and counted
        error = traceback.format_exc()
    finally:
        shutil.rmtree(home, ignore_errors=True)
    return {
        "simulator": kind.simulator,
        "kind": kind.name,
        "seed": seed,
        "noise": noise,
        "fault": fault,
        "rests_on": kind.rests_on,
        "seconds": round(time.process_time() - begin, 3),
        "error": error,
        "rows": rows,
    }


def head() -> str:
    """Short name of the commit, with a plus where files differ from it; empty without git."""
    said = [
        subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        for words in (("rev-parse", "--short", "HEAD"), ("status", "--porcelain", "-uno"))
    ]
    return said[0].stdout.strip() + ("+" if said[1].stdout.strip() else "")
