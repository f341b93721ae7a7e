"""What every dialect of a load frame owes: a card that parses, an example that it alone reads."""

from __future__ import annotations

import tomllib
from importlib import resources
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import READERS, read_export
from labpipe.readers.load_frame import read, recognise
from labpipe.readers.load_frame.cards import lab_cards, shipped_cards
from labpipe.readers.load_frame.recognition import chosen_card, recognised
from labpipe.records.recording import Recording
from tests.builders.load_frames import EXAMPLES

FOLDER = resources.files("labpipe.readers.load_frame") / "dialects"
CARDS = sorted(file.name for file in FOLDER.iterdir() if file.name.endswith(".toml"))
PAGE = Path("docs/how-to/new-dialect.md")


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One synthetic export for each card."""
    written = {}
    for dialect, (name, content) in EXAMPLES.items():
        file = tmp_path_factory.mktemp(dialect) / name
        file.write_bytes(content())
        written[dialect] = file
    return written


def test_every_card_has_an_example() -> None:
    assert {name.removesuffix(".toml") for name in CARDS} == set(EXAMPLES)
    assert sorted(shipped_cards()) == sorted(EXAMPLES)


@pytest.mark.parametrize("file", CARDS)
def test_a_card_is_plain_toml_that_says_what_it_is_for(file: str) -> None:
    data = tomllib.loads((FOLDER / file).read_text(encoding="utf-8"))
    card = shipped_cards()[file.removesuffix(".toml")]
    assert card.name == file.removesuffix(".toml")
    assert data["about"].endswith(".")
    assert len(data["about"]) > 40
    assert data.get("fallback", False) or data["program"]


def test_the_card_without_a_real_export_says_so() -> None:
    about = shipped_cards()["testresources"].about
    assert "no real export" in about.casefold()


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_every_card_is_documented(repository: Path, dialect: str) -> None:
    pages = (repository / "docs").rglob("*.md")
    assert any(f"`{dialect}`" in page.read_text(encoding="utf-8") for page in pages)


def test_every_key_of_a_card_is_documented(repository: Path) -> None:
    page = (repository / PAGE).read_text(encoding="utf-8")
    keys = {key for f in CARDS for key in tomllib.loads((FOLDER / f).read_text(encoding="utf-8"))}
    assert not [key for key in sorted(keys) if f"`{key}`" not in page]


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_an_example_is_recognised_by_its_own_card(exports: dict[str, Path], dialect: str) -> None:
    """Two cards of one rank would be an error, so the one found is the only one."""
    assert [r.name for r in READERS.values() if r.recognise(exports[dialect])] == ["load-frame"]
    assert recognise(exports[dialect])
    card = recognised(exports[dialect])
    assert card is not None
    assert card.name == dialect


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_the_suffix_says_nothing(exports: dict[str, Path], tmp_path: Path, dialect: str) -> None:
    odd = tmp_path / "export.odd"
    odd.write_bytes(exports[dialect].read_bytes())
    assert chosen_card(odd, None).name == dialect


@pytest.mark.slow
@pytest.mark.parametrize("asked", EXAMPLES)
@pytest.mark.parametrize("dialect", sorted(EXAMPLES))
def test_no_vendor_s_card_reads_another_s_export(
    exports: dict[str, Path], dialect: str, asked: str
) -> None:
    """An export that only a card of last resort takes may be read by the card that is named."""
    file = exports[dialect]
    if asked == dialect:
        assert read(file, dialect=asked).channels
        return
    if not shipped_cards()[dialect].fallback:
        with pytest.raises(ReadError, match=f"dialect {asked}, found one of the dialect {dialect}"):
            read(file, dialect=asked)
        return
    try:
        assert read(file, dialect=[asked]).channels
    except ReadError:
        with pytest.raises(ReadError, match=r": expected .+, found .+\. .+\.$"):
            read(file, dialect=[asked])


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_a_list_of_dialects_allows_each(exports: dict[str, Path], dialect: str) -> None:
    assert read(exports[dialect], dialect=sorted(EXAMPLES)).channels


def same(one: Recording, other: Recording, paths: list[str]) -> None:
    """Whether `one` holds just these channels of `other`, sample by sample."""
    assert sorted(each.path for each in one.channels) == sorted(paths)
    whole = {each.path: each for each in other.channels}
    for each in one.channels:
        twin = whole[each.path]
        assert (each.name, each.unit, each.unit_in_file) == (
            *(twin.name, twin.unit, twin.unit_in_file),
        )
        np.testing.assert_array_equal(each.values, twin.values)
        clock, its = one.clock(each.clock), other.clock(twin.clock)
        assert clock.unit == its.unit
        np.testing.assert_array_equal(clock.time, its.time)


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_some_channels_are_the_same_as_all_and_choosing(
    exports: dict[str, Path], dialect: str
) -> None:
    whole = read(exports[dialect])
    paths = [channel.path for channel in whole.channels]
    assert len(set(paths)) == len(paths) >= 2
    for count in (1, 2):
        for wanted in combinations(paths, count):
            same(read(exports[dialect], channels=list(wanted)), whole, list(wanted))
    same(read(exports[dialect], channels=paths[::-1]), whole, paths)


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_a_channel_that_is_not_there_lists_those_that_are(
    exports: dict[str, Path], dialect: str
) -> None:
    first = read(exports[dialect]).channels[0].name
    with pytest.raises(ReadError, match=r": expected .*, found ") as caught:
        read(exports[dialect], channels=[f"{first}x"])
    assert first in str(caught.value)


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_reading_says_who_read(exports: dict[str, Path], dialect: str) -> None:
    recording = read_export(exports[dialect])
    assert recording.reader == "load-frame"
    card = shipped_cards()[dialect]
    assert card.program in recording.program
    generic = {note.code for note in recording.notes} & {"dialect_generic"}
    assert bool(generic) == card.fallback


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_reading_leaves_the_export_as_it_was(exports: dict[str, Path], dialect: str) -> None:
    file = exports[dialect]
    before = (file.read_bytes(), file.stat().st_mtime_ns)
    read(file)
    assert (file.read_bytes(), file.stat().st_mtime_ns) == before


OWN = """\
program = "Bench of the lab"
about = "A synthetic card: names and units in one line, semicolons, decimal commas."
recognise = ['\\A# bench 1$']
separators = [";"]
decimal = ","
names = "with units"
brackets = "()"
time = ["t"]
"""
BENCH = b"# bench 1\nt (s);pull (N);way (mm)\n0,1;1,5;0,01\n0,2;2,5;0,02\n0,3;3,5;0,03\n"


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a card of its own and an export that only this card knows."""
    (tmp_path / "dialects").mkdir()
    (tmp_path / "dialects" / "bench.toml").write_text(OWN, encoding="utf-8")
    (tmp_path / "pull.txt").write_bytes(BENCH)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_lab_adds_a_dialect_without_python(lab: Path) -> None:
    assert [*lab_cards()] == ["bench"]
    recording = read_export(lab / "pull.txt", "load-frame", dialect=["bench"])
    assert recording.program == "Bench of the lab"
    assert [each.name for each in recording.channels] == ["pull", "way"]
    np.testing.assert_allclose(recording.clocks[0].time, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(recording.channels[0].values, [1.5, 2.5, 3.5])
    assert chosen_card(lab / "pull.txt", None).name == "bench"


def test_a_lab_cannot_shadow_a_card_silently(lab: Path) -> None:
    (lab / "dialects" / "bench.toml").rename(lab / "dialects" / "catman.toml")
    expected = r"catman\.toml: expected a name of its own, found 'catman', which is a card of labp"
    with pytest.raises(ReadError, match=expected):
        read(lab / "pull.txt")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('seperators = [","]', "separators"),
        ('names = "somewhere"', "names"),
        ("recognise = ['(']", "recognise"),
        ("separators = 3", "separators"),
        ("this is no TOML", "bench.toml"),
    ],
)
def test_a_wrong_card_is_told_in_words(lab: Path, line: str, said: str) -> None:
    key = line.split(" = ", maxsplit=1)[0]
    kept = [each for each in OWN.splitlines() if not each.startswith(f"{key} =")]
    (lab / "dialects" / "bench.toml").write_text("\n".join([*kept, line]), encoding="utf-8")
    with pytest.raises(ReadError, match=r"bench\.toml.*: expected .+, found .+\. .+\.$") as caught:
        read(lab / "pull.txt")
    assert said in str(caught.value)


def test_a_card_with_an_unknown_encoding_is_told(lab: Path) -> None:
    (lab / "dialects" / "bench.toml").write_text(f'{OWN}encodings = ["utf-99"]\n', encoding="utf-8")
    with pytest.raises(ReadError, match=r"bench\.toml.*: expected .+, found .*utf-99.*\. .+\.$"):
        read(lab / "pull.txt")
