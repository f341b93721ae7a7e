"""The studies of coverage: how often intervals hold the truth in tests, calibrations and lines.

Seeds were fixed before the first run and are never changed. Rows stay in `KEPT` and hold while the
code gives their numbers again: of each kind the canary seeds of ``kinds.csv`` are made again, and a
number that differs voids the rows of its kind.
"""

from __future__ import annotations

import csv
import json
import lzma
import math
import os
import subprocess
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean, median
from typing import Any

from tests.coverage import (
    drawn_lines,
    lab,
    line_judgement,
    page,
    predicted_lines,
    short_judgement,
    wire_campaigns,
    wire_judgement,
)
from tests.judges.foreign import processed as foreign
from tests.judges.short_records import SHAPES

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "tests" / "coverage" / "kept"
WORKING = ROOT / "processed" / "coverage.jsonl"
"""Rows as they are made, of all studies; `keep` takes them from there."""
DIGITS = 11
"""Of a number that is kept."""
CANARIES = 2
EXACT, SEARCHED, WALKED = 1e-9, 1e-6, 3e-4
"""To which a number is made again on any processor, of the largest number of its result: exactly;
where a search or an iteration ends; along a line, whose walk amplifies rounding: the bands of a
slack line differ by 9e-5 between two processors."""
OF_INTERVAL = 3e-5
"""Share of an interval's width that changes no conclusion: where clocks are known badly, an
iteration ends elsewhere on another processor, by up to 1.5e-5."""

Row = dict[str, Any]
"""Kind, seed, commit, error, about (text and numbers on the whole), rows: of each result its name,
truth, value, lower, upper and status; seconds of CPU while it is not kept."""
Rows = dict[str, dict[int, Row]]
"""By kind and seed."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is drawn again and again, and counted on one page.

    Parameters
    ----------
    name : of its file of kept rows, and between the marks of its page
    seeds : by kind; kinds of all studies have different names
    make : about and rows of a kind and a seed
    tables : of its rows, in markdown
    page : in docs/explanations
    nearness : of numbers that are not exact, by how the names of their results begin
    """

    name: str
    seeds: Mapping[str, range]
    make: Callable[[str, int], Row]
    tables: Callable[[Sequence[Row]], str]
    page: str
    nearness: Mapping[str, float]


def _make_test(kind: str, seed: int) -> Row:
    simulator, _, name = kind.partition("/")
    with tempfile.TemporaryDirectory(prefix="coverage-") as folder:
        if simulator == "lab":
            return {"rows": lab.rows(name, seed, Path(folder))}
        chance = foreign.chance_of(name, seed)
        said = foreign.process(chance, Path(folder) / "test")
    error = said.printed if "Traceback" in said.printed else ""
    about = {"noise": chance.noise, "fault": chance.fault}
    return {"about": about, "rows": list(said.rows), "error": error}


def _make_short(kind: str, seed: int) -> Row:
    with tempfile.TemporaryDirectory(prefix="coverage-") as folder:
        return short_judgement.rows(kind.partition("/")[2], seed, Path(folder))


_CAMPAIGNS = {kind.name: kind for kind in wire_campaigns.KINDS}
_LINES = {kind.name: kind for kind in drawn_lines.KINDS}
STUDIES = (
    Study(
        "tests",
        {
            **{f"foreign/{name}": range(26000, 26200) for name in foreign.KINDS},
            **{f"lab/{name}": range(27000, 27200) for name in lab.KINDS},
        },
        _make_test,
        page.tables,
        "coverage.md",
        {"clock": SEARCHED, "slack": SEARCHED},
    ),
    Study(
        "short",
        {f"short/{shape}": short_judgement.NUMBERS for shape in SHAPES},
        _make_short,
        short_judgement.tables,
        "coverage.md",
        {},
    ),
    Study(
        "calibrations",
        {name: kind.seeds for name, kind in _CAMPAIGNS.items()},
        lambda kind, seed: wire_campaigns.rows(_CAMPAIGNS[kind], seed),
        wire_judgement.tables,
        "calibration.md",
        {"": SEARCHED},
    ),
    Study(
        "lines",
        {name: kind.seeds for name, kind in _LINES.items()},
        lambda kind, seed: predicted_lines.rows(_LINES[kind], seed),
        line_judgement.tables,
        "rod-bands.md",
        {"": WALKED},
    ),
)
BY_KIND = {kind: study for study in STUDIES for kind in study.seeds}


def kinds_of(patterns: Iterable[str]) -> list[str]:
    """Kinds by their names, patterns of them such as ``lab/*``, or studies; all without any.

    Raises
    ------
    LookupError
        If one of them fits no kind.
    """
    asked = list(patterns)
    fits = {
        pattern: {
            k for k, study in BY_KIND.items() if fnmatchcase(k, pattern) or study.name == pattern
        }
        for pattern in asked
    }
    if nothing := [pattern for pattern, kinds in fits.items() if not kinds]:
        message = f"{', '.join(nothing)}: expected kinds among {', '.join(BY_KIND)}"
        raise LookupError(message)
    return [kind for kind in BY_KIND if not asked or any(kind in fit for fit in fits.values())]


def make_row(kind: str, seed: int) -> Row:
    """Make one row; an error that nobody expects is kept in it."""
    begin, made = time.process_time(), Row()
    try:
        made = BY_KIND[kind].make(kind, seed)
    except Exception:  # noqa: BLE001 - kept in the row, and counted
        made = {"error": traceback.format_exc()}
    seconds = round(time.process_time() - begin, 3)
    row = {"kind": kind, "seed": seed, "seconds": seconds}
    return {**row, "error": "", "about": {}, "rows": [], **made}


def differences(kept: Row, made: Row) -> list[str]:
    """Numbers and words of a row that another one of its kind and seed has otherwise."""
    nearness, found = BY_KIND[kept["kind"]].nearness, []
    if bool(kept["error"]) != bool(made["error"]):
        found.append(f"error: {kept['error'] or 'none'} -> {made['error'] or 'none'}")
    ours, theirs = (_results(row) for row in (kept, made))
    for name in dict.fromkeys([*ours, *theirs]):
        one, other = ours.get(name, {}), theirs.get(name, {})
        tolerance = next((x for stem, x in nearness.items() if name.startswith(stem)), EXACT)
        scale = max(
            (abs(x) for x in one.values() if isinstance(x, float) and math.isfinite(x)), default=0.0
        )
        width = (one.get("upper") or math.nan) - (one.get("lower") or math.nan)
        of_interval = OF_INTERVAL * width if width > 0.0 else 0.0
        found += [
            f"{name} {key}: {one.get(key)} -> {other.get(key)}"
            for key in dict.fromkeys([*one, *other])
            if not _is_same(one.get(key), other.get(key), max(tolerance * scale, of_interval))
        ]
    return found


def _results(row: Row) -> dict[str, dict[str, Any]]:
    results = {"about": row["about"], **{cell["name"]: cell for cell in row["rows"]}}
    return {name: dict(_leaves("", result)) for name, result in results.items()}


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, (list, dict)):
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        for name, each in inner:
            if name not in _WORDS:
                yield from _leaves(f"{key} {name}".strip(), each)
    elif value is not None:
        yield key, float(value) if isinstance(value, (int, float)) else value


_WORDS = ("why", "name")


def _is_same(one: Any, other: Any, nearness: float) -> bool:
    if isinstance(one, float) and isinstance(other, float) and math.isfinite(one):
        return abs(one - other) <= nearness
    return bool(one == other) or (one != one and other != other)


def standing(rows: Iterable[Row]) -> Rows:
    """Rows that hold, in the order of kinds and seeds.

    Of a kind and seed the last one counts. Where its numbers differ from those of the one before,
    rows of its kind from other commits no longer hold.
    """
    found: Rows = {kind: {} for kind in BY_KIND}
    for row in rows:
        own = found.get(row["kind"], {})
        if row["seed"] in own and differences(own[row["seed"]], row):
            own = {seed: other for seed, other in own.items() if other["commit"] == row["commit"]}
            found[row["kind"]] = own
        own[row["seed"]] = row
    return {kind: dict(sorted(own.items())) for kind, own in found.items()}


def read(file: Path) -> Iterator[Row]:
    """Rows of a file of JSON lines, if it is there; a torn line is left out."""
    yield from _parsed(file.read_text(encoding="utf-8").splitlines() if file.is_file() else ())


def kept_rows(kinds: Iterable[str] | None = None) -> Rows:
    """All that are kept, or those of some kinds."""
    wanted = set(BY_KIND if kinds is None else kinds)
    begins = tuple(f'{{"kind": "{kind}"' for kind in wanted)
    files = [_file(study) for study in STUDIES if wanted & set(study.seeds)]
    lines = [line for file in files if file.is_file() for line in _unpacked(file.read_bytes())]
    return standing(_parsed(line for line in lines if line.startswith(begins)))


def _parsed(lines: Iterable[str]) -> Iterator[Row]:
    for line in lines:
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


@lru_cache(maxsize=len(STUDIES))
def _unpacked(packed: bytes) -> list[str]:
    return lzma.decompress(packed).decode().splitlines()


def _file(study: Study) -> Path:
    return KEPT / f"{study.name}.jsonl.xz"


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU seconds of one row of a kind, and the seeds that are made again."""

    seconds: float
    canary: tuple[int, ...]


def costs() -> dict[str, Cost]:
    """By kind, as kept."""
    file = KEPT / "kinds.csv"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return {
        kind: Cost(float(seconds), tuple(map(int, canary.split())))
        for kind, seconds, canary in list(csv.reader(lines))[1:]
    }


def keep(file: Path) -> dict[str, int]:
    """Take rows of a file to those that are kept; how many there are now, by kind.

    A canary stays while its row is there; a new one is cheap, without a fault, and has as many
    numbers as the others of its kind.
    """
    new, known = list(read(file)), costs()
    rows = standing([row for own in kept_rows().values() for row in own.values()] + new)
    for kind in {row["kind"] for row in new} & set(rows):
        made = [row for row in rows[kind].values() if "seconds" in row]
        before = known.get(kind, Cost(0.0, ()))
        canary = tuple(seed for seed in before.canary if seed in rows[kind])
        seconds = before.seconds
        if len(made) > CANARIES or kind not in known:
            seconds = round(fmean(row["seconds"] for row in made), 3)
        known[kind] = Cost(seconds, (*canary, *_cheapest(made, canary))[:CANARIES])
    KEPT.mkdir(exist_ok=True)
    for study in STUDIES:
        text = "".join(_line(row) for kind in study.seeds for row in rows[kind].values())
        _file(study).write_bytes(lzma.compress(text.encode(), preset=9))
    lines = [
        f"{kind},{known[kind].seconds:g},{' '.join(map(str, known[kind].canary))}\n"
        for kind in BY_KIND
        if kind in known
    ]
    (KEPT / "kinds.csv").write_text("kind,seconds,canary\n" + "".join(lines), encoding="utf-8")
    return {kind: len(own) for kind, own in rows.items()}


def _cheapest(rows: Sequence[Row], known: Sequence[int]) -> Iterator[int]:
    sizes = {row["seed"]: sum("lower" in cell for cell in row["rows"]) for row in rows}
    for row in sorted(rows, key=lambda row: row["seconds"]):
        is_plain = not (row["error"] or row["about"].get("fault"))
        if is_plain and row["seed"] not in known and sizes[row["seed"]] >= median(sizes.values()):
            yield row["seed"]


def _line(row: Row) -> str:
    """A row as it is kept: numbers rounded; no words but codes; of an error the last line."""
    rows = [{key: cell[key] for key in cell if key != "why"} for cell in row["rows"]]
    error = row["error"].strip().rpartition("\n")[2]
    about = {key: row[key] for key in ("kind", "seed", "commit")}
    return (
        f"{json.dumps(_rounded({**about, 'error': error, 'about': row['about'], 'rows': rows}))}\n"
    )


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def canary(kinds: Iterable[str]) -> list[tuple[str, int]]:
    """Kinds and seeds that are made again."""
    known = costs()
    return [(kind, seed) for kind in kinds if kind in known for seed in known[kind].canary]


def describe_changes(made: Iterable[Row]) -> dict[str, list[str]]:
    """By kind, what rows made just now have otherwise than those kept."""
    rows, found = list(made), dict[str, list[str]]()
    kept = kept_rows({row["kind"] for row in rows})
    for row in rows:
        said = differences(kept[row["kind"]][row["seed"]], row)
        if said:
            found.setdefault(row["kind"], []).extend(
                f"seed {row['seed']}, {sentence}" for sentence in said
            )
    return found


def remedy(changed: Mapping[str, Sequence[str]]) -> str:
    """What differs, by kind, and what to do about it."""
    known = costs()
    seconds = {kind: known[kind].seconds * len(BY_KIND[kind].seeds[kind]) for kind in changed}
    lines = [
        f"{kind}: {len(said)} numbers differ ({'; '.join(said[:3])}); {seconds[kind]:.0f} CPU s"
        for kind, said in changed.items()
    ]
    names = " ".join(f"'{kind}'" for kind in changed)
    return "\n".join(
        [
            *lines,
            f"If that is meant, renew these kinds in {sum(seconds.values()) / 60.0:.1f} CPU min:",
            f"  python -m tests.coverage run {names} --again",
            "  python -m tests.coverage keep",
            "  python -m tests.coverage publish",
        ]
    )


def run(kinds: Sequence[str], *, again: bool, minutes: float, jobs: int) -> int:
    """Make rows for some minutes, into `WORKING`; how many are left.

    Parameters
    ----------
    kinds : of which rows
    again : all of them but those in `WORKING`; else those that are missing or do not hold
    minutes : no row is begun after them
    jobs : processes

    Notes
    -----
    First come canary rows of what another commit made: where they differ, all others of their kind
    are made again. Then rounds, so that after any time all kinds have the same share of theirs.
    """
    until, commit = time.monotonic() + 60.0 * minutes, head()
    kept = [] if again else [row for own in kept_rows().values() for row in own.values()]
    rows = standing([*kept, *read(WORKING)])
    seeds = [
        (kind, seed)
        for kind, seed in canary(kinds)
        if seed in rows[kind] and rows[kind][seed]["commit"] != commit
    ]
    for made in make_rows(seeds, jobs=jobs, until=until):
        append(WORKING, {"commit": commit, **made})
    wanted = missing(standing([*kept, *read(WORKING)]), kinds)
    left = len(wanted)
    for made in make_rows(wanted, jobs=jobs, until=until):
        append(WORKING, {"commit": commit, **made})
        left -= 1
    return left


def missing(rows: Rows, kinds: Iterable[str]) -> list[tuple[str, int]]:
    """Kinds and seeds without a row, in rounds."""
    wanted = [
        (number / len(BY_KIND[kind].seeds[kind]), kind, seed)
        for kind in kinds
        for number, seed in enumerate(BY_KIND[kind].seeds[kind])
        if seed not in rows[kind]
    ]
    return [(kind, seed) for _, kind, seed in sorted(wanted, key=lambda each: each[0])]


def make_rows(
    wanted: Iterable[tuple[str, int]], *, jobs: int, until: float = math.inf
) -> Iterator[Row]:
    """Make rows in processes, as they come; only a few are asked for ahead of time.

    Parameters
    ----------
    wanted : kinds and seeds
    jobs : processes
    until : nothing is begun after that, of the monotonic clock
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before the processes load it
    left, running = iter(wanted), set[Future[Row]]()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        while True:
            while len(running) < 2 * jobs and time.monotonic() < until:
                if (each := next(left, None)) is None:
                    break
                running.add(pool.submit(make_row, *each))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)


def append(file: Path, row: Row) -> None:
    """Add a row in one piece; behind a torn line it begins a new one."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a+b") as stream:
        stream.seek(max(stream.tell() - 1, 0))
        is_torn = stream.read() not in (b"", b"\n")
        stream.write((b"\n" if is_torn else b"") + json.dumps(row).encode() + b"\n")


def head() -> str:
    """Short name of the commit, with a plus where files differ from it; empty without git."""
    said = [
        subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        for words in (("rev-parse", "--short", "HEAD"), ("status", "--porcelain", "-uno"))
    ]
    return said[0].stdout.strip() + ("+" if said[1].stdout.strip() else "")


def published(study: Study, rows: Rows) -> str:
    """What is counted of a study, in markdown: how many rows, at which commits, tables."""
    own = {kind: list(rows[kind].values()) for kind in study.seeds}
    every = [row for seeds in own.values() for row in seeds]
    commits = Counter(row["commit"] for row in every)
    numbers = sorted({len(seeds) for seeds in own.values()})
    summary = (
        f"{len(every)} of {sum(map(len, study.seeds.values()))} {study.name},"
        f" {' to '.join(map(str, (numbers[0], numbers[-1])[: len(numbers)]))} of each kind, made at"
        f" {', '.join(f'`{commit}` ({number})' for commit, number in commits.items())}."
    )
    return f"{summary}\n\n{study.tables(every)}"


def publish(study: Study) -> None:
    """Put what is kept on the page of its study; every result of tests into a file beside it."""
    rows, file = kept_rows(), ROOT / "docs" / "explanations" / study.page
    page.put(published(study, rows), study.name, file)
    if study.name == "tests":
        every = [row for kind in study.seeds for row in rows[kind].values()]
        lines = [",".join(map(str, cells)) for cells in page.every_result(every)]
        file.with_suffix(".csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
