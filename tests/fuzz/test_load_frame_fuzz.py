"""Damaged exports of load frames: a recording or a ReadError in words, never anything else.

The damage is of the kind that files meet: cut off, bytes changed, lines lost or repeated, cells
swapped, separators and decimal signs exchanged, zeros in a block, another encoding.
"""

from __future__ import annotations

import faulthandler
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.inspection import format_inspection, inspect_export, make_inspection_record
from labpipe.readers import read_export
from labpipe.records.recording import Recording
from tests.builders.load_frames import EXAMPLES

LONGEST = 60.0
"""Seconds after which one file is held to hang."""
Damage = Callable[[bytes, random.Random], bytes]


def cut(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data))]


def beheaded(data: bytes, chance: random.Random) -> bytes:
    return data[chance.randrange(min(len(data), 600)) :]


def changed(data: bytes, chance: random.Random) -> bytes:
    """A few bytes, more often near the front."""
    out = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        reach = len(out) if chance.random() < 0.5 else min(len(out), 600)
        out[chance.randrange(reach)] = chance.randrange(256)
    return bytes(out)


def digits_changed(data: bytes, chance: random.Random) -> bytes:
    """Signs that numbers are made of in the place of others."""
    out = bytearray(data)
    for _ in range(chance.randint(1, 12)):
        out[chance.randrange(len(out))] = chance.choice(b"0123456789.,;-+eE \t\"'[]()\n\r")
    return bytes(out)


def zeroed(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data))
    return data[:at] + bytes(min(chance.randint(1, 512), len(data) - at)) + data[at + 512 :]


def doubled(data: bytes, chance: random.Random) -> bytes:
    """Two exports in one, or a part of it twice."""
    at = chance.randrange(len(data))
    return data[:at] + data[max(0, at - chance.randint(1, 2000)) :]


def lines_shuffled(data: bytes, chance: random.Random) -> bytes:
    rows = data.split(b"\n")
    for _ in range(chance.randint(1, 4)):
        one, other = chance.randrange(len(rows)), chance.randrange(len(rows))
        rows[one], rows[other] = rows[other], rows[one]
    return b"\n".join(rows)


def lines_lost(data: bytes, chance: random.Random) -> bytes:
    rows = data.split(b"\n")
    for _ in range(chance.randint(1, 5)):
        del rows[chance.randrange(len(rows))]
        if not rows:
            break
    return b"\n".join(rows)


def signs_exchanged(data: bytes, chance: random.Random) -> bytes:
    one, other = chance.sample([b",", b".", b";", b"\t", b'"', b" ", b"\n", b"-"], 2)
    return data.replace(one, other, chance.choice([1, 10, -1]))


def words_in_cells(data: bytes, chance: random.Random) -> bytes:
    words = [b"NaN", b"inf", b"-", b"<None>", b"1e999", b"0x1F", b"1_0", b"---", b"1.2.3", b""]
    words += [b"1,234,567", b"=1+1", b"#REF!", "½".encode(), b"9" * 400, b"\xff\xfe", b'"']
    rows = data.split(b"\n")
    at = chance.randrange(len(rows))
    separator = chance.choice([b",", b"\t", b";"])
    cells = rows[at].split(separator)
    cells[chance.randrange(len(cells))] = chance.choice(words)
    rows[at] = separator.join(cells)
    return b"\n".join(rows)


def recoded(data: bytes, chance: random.Random) -> bytes:
    """The text written in another encoding; some signs may be lost."""
    text = data.decode("utf-16" if data[:2] == b"\xff\xfe" else "latin-1", errors="replace")
    encodings = ["utf-8-sig", "utf-16", "utf-16-be", "utf-16-le", "gbk", "cp1252", "utf-32"]
    return text.encode(chance.choice(encodings), errors="replace")


BINARY: tuple[Damage, ...] = (cut, beheaded, changed, zeroed, doubled)
TEXT: tuple[Damage, ...] = (
    *BINARY,
    *(digits_changed, lines_shuffled, lines_lost, signs_exchanged, words_in_cells, recoded),
)


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Once or twice damaged."""
    is_binary = data.startswith((b"PK", b"\xd0\xcf"))
    for _ in range(chance.choice([1, 1, 2])):
        if data:
            data = chance.choice(BINARY if is_binary else TEXT)(data, chance)
    return data


@pytest.fixture(autouse=True)
def _no_hang() -> Iterator[None]:
    """A loop inside a C library cannot be left otherwise: the stack is shown and the run ends."""
    yield
    faulthandler.cancel_dump_traceback_later()


def sound(recording: Recording) -> None:
    """What a recording promises: channels as long as their clock, paths that differ."""
    lengths = {clock.name: len(clock.time) for clock in recording.clocks}
    assert len(lengths) == len(recording.clocks)
    paths = [channel.path for channel in recording.channels]
    assert len(set(paths)) == len(paths)
    for channel in recording.channels:
        assert len(channel.values) == lengths[channel.clock]
        assert not np.isinf(channel.values).any()
    for clock in recording.clocks:
        assert np.isfinite(clock.time).all()


def survives(file: Path) -> None:
    """Read for processing, and inspect: whatever comes out is sound or said in words."""
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        sound(read_export(file, "load-frame"))
    except ReadError as error:
        text = str(error)
        said = text.startswith(str(file)) and ": expected " in text and ", found " in text
        assert said and text.endswith(".") and "\n" not in text, text  # noqa: PT018
    try:
        inspection = inspect_export(file)
        assert format_inspection(inspection)
        make_inspection_record(inspection)
    except ReadError as error:
        assert str(error).startswith(str(file))  # noqa: PT017
    faulthandler.cancel_dump_traceback_later()


def try_seeds(content: bytes, file: Path, seeds: range) -> None:
    for seed in seeds:
        file.write_bytes(damaged(content, random.Random(seed)))
        try:
            survives(file)
        except Exception as error:
            error.add_note(f"seed {seed}")
            raise


@pytest.mark.parametrize("dialect", EXAMPLES)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.8, 0.999])
def test_cut_off_anywhere_gives_no_sample_too_many(
    tmp_path: Path, dialect: str, share: float
) -> None:
    name, content = EXAMPLES[dialect]
    whole = content()
    file = tmp_path / name
    file.write_bytes(whole)
    most = sum(len(clock.time) for clock in read_export(file).clocks)
    file.write_bytes(whole[: int(share * len(whole))])
    survives(file)
    try:
        recording = read_export(file, "load-frame")
    except ReadError:
        return
    assert sum(len(clock.time) for clock in recording.clocks) <= most + 1


@pytest.mark.slow
@pytest.mark.parametrize("dialect", EXAMPLES)
def test_damaged_at_length(tmp_path: Path, dialect: str) -> None:
    name, content = EXAMPLES[dialect]
    try_seeds(content(), tmp_path / name, range(1000, 1600))


REAL = (
    *("mts", "lloyd_nexygen", "instron", "zwick", "walter_bai"),
    *("shimadzu", "hbm_catman", "deben", "ta_dma"),
)


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.parametrize("folder", REAL)
def test_damaged_real_exports(realdata: Path, tmp_path: Path, folder: str) -> None:
    files = [path for path in sorted((realdata / folder).rglob("*")) if path.is_file()]
    for i, original in enumerate(files):
        content = original.read_bytes()
        few = 4 if len(content) > 400_000 else 12
        try_seeds(content, tmp_path / original.name, range(100 * i, 100 * i + few))
