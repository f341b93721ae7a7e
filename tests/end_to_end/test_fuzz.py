"""Damaged exports and test sheets: status 0, 1 or 2, never a traceback, raw files untouched."""

from __future__ import annotations

import random

import pytest

from tests.builders.small_tests import Lab, Run, state
from tests.fuzz.test_load_frame_fuzz import BINARY, TEXT, Damage, lines_lost, lines_shuffled

WORDS = (b"null", b"[]", b"{}", b"!!python/object:x", b"&a [*a]", b"1 mm", b"-5 N", b"\t", b"~")
NUMBERS = (b"nan", b"inf", b"-1e308", b"", b"0", b"1e999")


def blank_columns(content: bytes, chance: random.Random) -> bytes:
    """One column empty, or far off, over a stretch of lines."""
    lines = content.split(b"\n")
    start = chance.randrange(len(lines))
    column, cell = chance.randrange(1, 60), chance.choice(NUMBERS)
    for i in range(start, min(len(lines), start + chance.choice([3, 100, 2000]))):
        cells = lines[i].split(b",")
        cells[column % len(cells)] = cell
        lines[i] = b",".join(cells)
    return b"\n".join(lines)


def replace_words(content: bytes, chance: random.Random) -> bytes:
    words = content.split(b" ")
    words[chance.randrange(len(words))] = chance.choice(WORDS)
    return b" ".join(words)


DAMAGES: dict[str, tuple[Damage, ...]] = {
    "force.mat": BINARY,
    "take.csv": (*TEXT, blank_columns),
    "test.yaml": (*BINARY, lines_shuffled, lines_lost, replace_words),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 400))
def test_damaged_exports_and_sheets(lab: Lab, run: Run, seed: int) -> None:
    chance, done = random.Random(seed), []
    for name in chance.sample(list(DAMAGES), chance.choice([1, 1, 2])):
        damage, file = chance.choice(DAMAGES[name]), lab.raw / name
        file.write_bytes(damage(file.read_bytes(), chance))
        done.append((name, damage.__name__))
    raw = state(lab.home / "raw")
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status in (0, 1, 2), (done, ran)
    assert "Traceback" not in ran.err
    assert "Warning" not in ran.err, (done, ran.err)
    if ran.status == 2:
        assert "labpipe process: " in ran.err, (done, ran)
        assert "expected" in ran.err, (done, ran.err)
    else:
        assert "nan" not in ran.out, (done, ran.out)
        assert lab.results
    assert state(lab.home / "raw") == raw
