"""What every reader and dialect owes: recognition by content, refusal in words, nothing else."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labpipe.errors import LabpipeError, ReadError
from labpipe.readers import READERS, read_export, recognise_export
from labpipe.readers.load_frame import read, recognise_card
from labpipe.readers.load_frame.cards import load_shipped_cards
from labpipe.records.arrays import Floats
from labpipe.records.recording import Recording
from tests.builders import load_frames as frames
from tests.builders.controldesk import (
    Axis,
    Signal,
    write_csv,
    write_mat_v5,
    write_mat_v73,
    write_mf4,
)
from tests.builders.load_frames import EXAMPLES
from tests.builders.motive import (
    Layout,
    RowBody,
    marker,
    rigid_body,
    write_row_style,
    write_table,
    write_xlsx,
)

N = 60


TIME: Floats = np.arange(float(N)) * 0.001


SIGNALS = [
    Signal("Model Root/Load Cell", "Out1", np.sin(40.0 * TIME)),
    Signal("Model Root/Laser", "Out1", np.cos(40.0 * TIME)),
]


TRACK = np.column_stack([np.sin(TIME), np.cos(TIME), TIME])


COLUMNS = [*rigid_body("Clamp", TRACK, np.ones((N, 4))), *marker("Tip", TRACK)]


def write_mf4_file(path: Path) -> Path:
    made = write_mf4(path.with_suffix(".mf4"), Axis(TIME), SIGNALS)
    return made.rename(path)  # asammdf insists on its own suffix


def write_xlsx_file(path: Path) -> Path:
    return write_xlsx(path.with_suffix(".xlsx"), COLUMNS, N, Layout()).rename(path)


def write_rows(path: Path, version: str) -> Path:
    body = RowBody(
        "Clamp", 1, TRACK, np.ones((N, 4)), TRACK[:, None, :], np.ones(N, dtype=np.bool_)
    )
    return write_row_style(path, TIME, [body], version=version)


def write_suite(path: Path) -> Path:
    path.write_bytes(frames.mts_suite(rows=frames.pull(TIME, np.sin(TIME), 1.0 + TIME)))
    return path


def write_frame_workbook(path: Path) -> Path:
    names = ["Time (s)", "Force (N)", "Travel (mm)"]
    rows = frames.pull(TIME, np.sin(40.0 * TIME), np.cos(40.0 * TIME))
    path.write_bytes(frames.workbook({"synthetic": [names, *rows]}))
    return path


EXPORTS: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "v5": ("dspace-mat", lambda path: write_mat_v5(path, [Axis(TIME)], SIGNALS)),
    "v73": ("dspace-mat", lambda path: write_mat_v73(path, [Axis(TIME)], SIGNALS)),
    "csv": ("dspace-csv", lambda path: write_csv(path, Axis(TIME), SIGNALS)),
    "mf4": ("dspace-mf4", write_mf4_file),
    "table": ("motive-csv", lambda path: write_table(path, COLUMNS, N, Layout())),
    "rows 1.0": ("motive-csv", lambda path: write_rows(path, "1.0")),
    "rows 1.1": ("motive-csv", lambda path: write_rows(path, "1.1")),
    "xlsx": ("motive-xlsx", write_xlsx_file),
    "frame": ("load-frame", write_suite),
    "frame xlsx": ("load-frame", write_frame_workbook),
}


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exports")
    return {kind: write(folder / f"{kind}.dat") for kind, (_, write) in EXPORTS.items()}


def samples(recording: Recording) -> int:
    if recording.markers is not None:
        return len(recording.markers.time)
    return max((len(clock.time) for clock in recording.clocks), default=0)


@pytest.mark.parametrize("kind", EXPORTS)
def test_the_content_decides_and_not_the_suffix(exports: dict[str, Path], kind: str) -> None:
    named = [reader.name for reader in READERS.values() if reader.recognise(exports[kind])]
    assert named == [EXPORTS[kind][0]]
    before = exports[kind].read_bytes(), exports[kind].stat().st_mtime_ns
    recording = read_export(exports[kind])
    assert recording.reader == EXPORTS[kind][0]
    assert samples(recording) == N
    assert (exports[kind].read_bytes(), exports[kind].stat().st_mtime_ns) == before


@pytest.mark.parametrize("kind", EXPORTS)
@pytest.mark.parametrize("reader", READERS)
def test_a_file_of_another_format_is_refused(
    exports: dict[str, Path], kind: str, reader: str
) -> None:
    actual = EXPORTS[kind][0]
    if reader == actual:
        assert read_export(exports[kind], reader).reader == actual
        return
    expected = f"expected a file of the format {reader}, found one of the format {actual}\\. Name"
    with pytest.raises(ReadError, match=expected):
        read_export(exports[kind], reader)


def test_what_no_reader_takes_is_named(tmp_path: Path) -> None:
    file = tmp_path / "walk.c3d"
    file.write_bytes(b"\x02\x50" + bytes(600))
    expected = (
        r"walk\.c3d: expected an export of a known format \(dspace-mat, .*load-frame\), found a"
        r" C3D file \(motion capture\), which is recognised but not read\. Export the recording in"
    )
    with pytest.raises(ReadError, match=expected):
        recognise_export(file)


def test_importing_the_readers_loads_no_heavy_library() -> None:
    heavy = {"pandas", "scipy", "h5py", "asammdf", "python_calamine", "openpyxl", "pint"}
    code = f"import labpipe.readers, sys; print(sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "[]"


def read_or_refuse(file: Path) -> int | None:
    """Number of samples, None if refused; any error but our own fails the test."""
    try:
        return samples(read_export(file))
    except LabpipeError as error:
        text = str(error)
        assert text.startswith(str(file))
        assert ": expected " in text
        assert ", found " in text
        assert text.endswith(".")
        return None


@pytest.mark.parametrize("kind", EXPORTS)
@given(part=st.floats(0.0, 0.999))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_cut_anywhere(exports: dict[str, Path], tmp_path: Path, kind: str, part: float) -> None:
    content = exports[kind].read_bytes()
    file = tmp_path / "cut.dat"
    file.write_bytes(content[: int(part * len(content))])
    found = read_or_refuse(file)
    assert found is None or found <= N


def mutate(content: bytes, seed: int) -> bytes:
    """Change, delete, insert or repeat a few bytes somewhere, more often near the front."""
    random = np.random.default_rng(seed)
    data = bytearray(content)
    for _ in range(int(random.integers(1, 6))):
        reach = len(data) if random.random() < 0.5 else min(len(data), 2000)
        at = int(random.integers(0, max(reach, 1)))
        size = int(random.integers(1, 9))
        noise = random.integers(0, 256, size, dtype=np.uint8).tobytes()
        swap = random.integers(0, 4)
        data[at : at + size * (swap != 1)] = [noise, noise, b"", bytes(data[at : at + 64])][swap]
    return bytes(data)


@pytest.mark.parametrize("kind", EXPORTS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_mutated(exports: dict[str, Path], tmp_path: Path, kind: str, seed: int) -> None:
    file = tmp_path / "mutated.dat"
    file.write_bytes(mutate(exports[kind].read_bytes(), seed))
    read_or_refuse(file)


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["dspace", "motive"])
def test_mutated_real_exports(realdata: Path, tmp_path: Path, folder: str) -> None:
    for original in sorted((realdata / folder).iterdir()):
        content = original.read_bytes()
        for seed in range(30):
            file = tmp_path / f"{seed}-{original.name}"
            file.write_bytes(mutate(content, seed))
            read_or_refuse(file)
            file.unlink()
        file = tmp_path / original.name
        shutil.copyfile(original, file)
        for part in (0.9, 0.5, 0.2, 0.05, 0.01):
            file.write_bytes(content[: int(part * len(content))])
            read_or_refuse(file)


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One synthetic export for each card."""
    written = {}
    for dialect, (name, content) in EXAMPLES.items():
        file = tmp_path_factory.mktemp(dialect) / name
        file.write_bytes(content())
        written[dialect] = file
    return written


def test_every_card_has_an_example_and_is_documented(repository: Path) -> None:
    assert {*load_shipped_cards()} == {*EXAMPLES}
    pages = [path.read_text(encoding="utf-8") for path in (repository / "docs").rglob("*.md")]
    for dialect in EXAMPLES:
        assert any(f"`{dialect}`" in page for page in pages), dialect


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_an_example_is_recognised_by_its_own_card(examples: dict[str, Path], dialect: str) -> None:
    """Two cards of one rank would be an error, so the one found is the only one."""
    names = [reader.name for reader in READERS.values() if reader.recognise(examples[dialect])]
    assert names == ["load-frame"]
    card = recognise_card(examples[dialect])
    assert card is not None
    assert card.name == dialect
    recording = read_export(examples[dialect])
    assert recording.reader == "load-frame"
    assert card.program in recording.program
    codes = {note.code for note in recording.notes}
    assert ("dialect_generic" in codes) == card.fallback


@pytest.mark.slow
@pytest.mark.parametrize("dialect", sorted(EXAMPLES))
def test_no_vendor_s_card_reads_another_s_export(examples: dict[str, Path], dialect: str) -> None:
    """An export that only a card of last resort takes may be read by the card that is named."""
    file = examples[dialect]
    assert read(file, dialect=dialect).channels
    refusal = r": expected .+, found .+\. .+\.$"
    for asked in {*EXAMPLES} - {dialect}:
        if not load_shipped_cards()[dialect].fallback:
            message = f"dialect {asked}, found one of the dialect {dialect}"
            with pytest.raises(ReadError, match=message):
                read(file, dialect=asked)
            continue
        try:
            assert read(file, dialect=[asked]).channels
        except ReadError:
            with pytest.raises(ReadError, match=refusal):
                read(file, dialect=[asked])


def content_of(recording: Recording) -> dict[str, list[object]]:
    """What channels hold, by path, with their clocks."""
    return {
        channel.path: [
            *(channel.name, channel.unit, channel.unit_in_file, channel.values.tobytes()),
            *((clock := recording.get_clock(channel.clock)).unit, clock.time.tobytes()),
        ]
        for channel in recording.channels
    }


@pytest.mark.parametrize("kind", [*EXAMPLES, "v5", "v73", "csv", "mf4"])
def test_some_channels_are_the_same_as_all_and_choosing(
    examples: dict[str, Path], exports: dict[str, Path], kind: str
) -> None:
    file = (exports | examples)[kind]
    whole = content_of(read_export(file))
    assert len(whole) >= 2
    for wanted in (*combinations(whole, 1), *combinations(whole, 2), [*whole][::-1]):
        some = content_of(read_export(file, channels=list(wanted)))
        assert some == {path: whole[path] for path in wanted}
    with pytest.raises(ReadError, match=r"expected (a name that only one chan|one of the .* chan)"):
        read_export(file, channels=["Out1"])
