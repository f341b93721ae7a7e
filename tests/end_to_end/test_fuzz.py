"""Damaged exports and test sheets: status 0, 1 or 2, never a traceback, raw files untouched."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.builders.small_tests import Lab, Run, state

Mutation = Callable[[bytes, random.Random], bytes]
NUMBERS = (b"nan", b"inf", b"-1e308", b"", b"0", b"1e999", b"x", b"-1", b"\xff", b"9" * 400)
WORDS = (b"null", b"[]", b"{}", b"!!python/object:x", b"&a [*a]", b"1 mm", b"-5 N", b"\t", b"~")


def flip_bits(content: bytes, chance: random.Random) -> bytes:
    found = bytearray(content)
    for _ in range(chance.choice([1, 3, 30])):
        found[chance.randrange(len(found))] ^= 1 << chance.randrange(8)
    return bytes(found)


def cut_off(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def cut_out(content: bytes, chance: random.Random) -> bytes:
    start = chance.randrange(len(content))
    return content[:start] + content[start + chance.choice([1, 7, 100, 5000]) :]


def shuffle_lines(content: bytes, chance: random.Random) -> bytes:
    lines = content.splitlines(keepends=True)
    for _ in range(chance.choice([1, 5])):
        i, j = chance.randrange(len(lines)), chance.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
    return b"".join(lines)


def repeat_lines(content: bytes, chance: random.Random) -> bytes:
    lines = content.splitlines(keepends=True)
    at = chance.randrange(len(lines))
    return b"".join(lines[:at] + lines[at:][: chance.choice([1, 50])] + lines[at:])


def replace_cells(content: bytes, chance: random.Random) -> bytes:
    lines = content.split(b"\n")
    for _ in range(chance.choice([1, 5, 200])):
        at = chance.randrange(len(lines))
        cells = lines[at].split(b",")
        cells[chance.randrange(len(cells))] = chance.choice(NUMBERS)
        lines[at] = b",".join(cells)
    return b"\n".join(lines)


def blank_columns(content: bytes, chance: random.Random) -> bytes:
    """One column empty, or far off, over a stretch of lines."""
    lines = content.split(b"\n")
    start = chance.randrange(len(lines))
    column, cell = chance.randrange(1, 60), chance.choice(NUMBERS[:6])
    for i in range(start, min(len(lines), start + chance.choice([3, 100, 2000]))):
        cells = lines[i].split(b",")
        cells[column % len(cells)] = cell
        lines[i] = b",".join(cells)
    return b"\n".join(lines)


def replace_words(content: bytes, chance: random.Random) -> bytes:
    words = content.split(b" ")
    words[chance.randrange(len(words))] = chance.choice(WORDS)
    return b" ".join(words)


BINARY: tuple[Mutation, ...] = (flip_bits, cut_off, cut_out)
TABLE: tuple[Mutation, ...] = (
    *BINARY,
    shuffle_lines,
    repeat_lines,
    replace_cells,
    blank_columns,
)
SHEET: tuple[Mutation, ...] = (*BINARY, shuffle_lines, repeat_lines, replace_words)
MUTATIONS = {".mat": BINARY, ".csv": TABLE, ".yaml": SHEET}


def mutated(path: Path, chance: random.Random) -> str:
    mutation = chance.choice(MUTATIONS[path.suffix])
    path.write_bytes(mutation(path.read_bytes(), chance))
    return mutation.__name__


def survives(lab: Lab, run: Run, names: list[str], seed: int) -> None:
    chance = random.Random(seed)
    done = [(name, mutated(lab.raw / name, chance)) for name in names]
    raw = state(lab.home / "raw")
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status in (0, 1, 2), (done, ran)
    assert "Traceback" not in ran.err
    assert "Warning" not in ran.err, (done, ran.err)
    if ran.status == 2:
        assert "labpipe process: " in ran.err, (done, ran)
        assert "expected" in ran.err, (done, ran.err)
    else:
        assert "nan" not in ran.out.replace("finance", ""), (done, ran.out)
        assert lab.results
    assert state(lab.home / "raw") == raw


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 400))
def test_synthetic_at_length(lab: Lab, run: Run, seed: int) -> None:
    chance = random.Random(seed)
    names = ["force.mat", "take.csv", "test.yaml"]
    survives(lab, run, chance.sample(names, chance.choice([1, 1, 2])), seed)
