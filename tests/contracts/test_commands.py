"""Every command keeps what is promised of commands, and ``import labpipe`` is cheap."""

from __future__ import annotations

import io
import json
import math
import re
import subprocess
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

import labpipe
from labpipe.cli import EXIT_ERROR, EXIT_OK, main
from labpipe.errors import StoreError, UsageError
from tests.builders.small_tests import Lab, Run, make_lab, small_scenario, state

COMMANDS = (
    *("demo", "inspect", "new", "check", "process", "campaign", "report", "serve"),
    *("model", "bundle", "harness", "calibrate", "simulate", "examples", "completion"),
)


def test_help_lists_every_command(run: Run) -> None:
    ran = run("--help")
    assert ran.status == EXIT_OK
    listed = re.findall(r"^    (\w+) ", ran.out, flags=re.MULTILINE)
    assert listed == list(COMMANDS)
    assert "exit status: 0 done; 1 some results failed (they are listed); 2 bad input" in ran.out


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_module_and_help(run: Run, command: str) -> None:
    """In quotes of every shell: the prompt of Windows takes a single quote for a letter."""
    assert callable(import_module(f"labpipe.cli.{command}").run)
    ran = run(command, "--help")
    assert ran.status == EXIT_OK
    assert ran.out.startswith(f"usage: labpipe {command} ")
    options = re.findall(r"^  (--[\w-]+|[A-Z]+)(.*)$", ran.out, flags=re.MULTILINE)
    assert options
    for name, rest in options:
        alone = rest.strip() in ("", name.removeprefix("--").upper())
        follows = re.search(rf"^  {re.escape(name)}.*\n +\S", ran.out, flags=re.MULTILINE)
        assert not alone or follows, f"{name} has no help"
    text = re.sub(r"\"name = '.*?' and type = '.*?'\"", "", " ".join(ran.out.split()))
    assert not re.search(r"(?<!\w)'|'(?!\w)", text)


@pytest.mark.parametrize(
    "arguments",
    [
        *("process nowhere", "inspect nowhere.mat", "check nowhere", "new raw/x --set nonsense"),
        *("simulate --rate 10", "simulate --fps 50mm", "simulate --cycles 0"),
        *("simulate --rate 0Hz", "simulate --fps=-50Hz", "new raw/x --from nowhere.xlsx"),
        *("", "proces", "process", "inspect", "new", "process x --fast", "serve --port x"),
    ],
)
def test_bad_input_is_status_2_and_one_message(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run(*arguments.split())
    assert ran.status == EXIT_ERROR, ran
    is_said = ": expected " in ran.err and ", found " in ran.err
    assert is_said or ran.err.startswith("usage: labpipe")
    assert "Traceback" not in ran.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param("process LAB --out mine", marks=pytest.mark.slow),
        "simulate --cycles 1 --fps 20Hz --rate 100Hz --out mine",
        "new mine --protocol tensile --frame a.csv --type T --spool s --sample 1",
    ],
)
def test_a_file_where_a_folder_is_to_be_made(
    run: Run, pristine: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine").write_text("mine")
    ran = run(*arguments.replace("LAB", str(pristine.raw)).split())
    assert ran.status == EXIT_ERROR, ran
    message = r"mine[^\n]*: expected a folder to write in, found a file in its place\. Choose"
    assert re.search(message, ran.err), ran
    assert ran.err.count(": expected ") == 1
    assert Path("mine").read_text() == "mine"


HELP = """
import sys
from labpipe.cli import main
try:
    main(['--help'])
except SystemExit:
    pass
heavy = {'numpy', 'scipy', 'pandas', 'h5py', 'matplotlib', 'pydantic', 'yaml', 'pint'}
sys.exit(','.join(sorted(heavy & set(sys.modules))) or 0)
"""
IMPORT = """
import sys
old = {*sys.modules}
import labpipe
new = {name.partition('.')[0] for name in {*sys.modules} - old} - sys.stdlib_module_names
sys.exit(0 if new == {'labpipe'} and 'labpipe.api' not in sys.modules else ','.join(new))
"""


@pytest.mark.parametrize("program", [HELP, IMPORT], ids=["help", "import"])
def test_help_and_import_load_nothing_heavy(program: str) -> None:
    """What of the standard library is there already differs by machine."""
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.fixture(scope="module")
def processed_and_printed(
    pristine: Lab, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Lab, str]:
    lab, printed = pristine.copy(tmp_path_factory.mktemp("api")), io.StringIO()
    with redirect_stdout(printed):
        assert main(["process", str(lab.raw), "--no-figures", "--json"]) == EXIT_OK
    return lab, printed.getvalue()


@pytest.fixture
def processed(processed_and_printed: tuple[Lab, str]) -> Lab:
    return processed_and_printed[0]


SUMMARY = "schema test specimen protocol labpipe inputs results quality run made_of date operator"
RESULT = "name value unit lower upper level estimate code reason status reasons method budget seal"


def test_json_of_process(processed_and_printed: tuple[Lab, str]) -> None:
    lab, printed = processed_and_printed
    summary = json.loads(printed)
    assert summary == lab.summary
    assert set(summary) == {*SUMMARY.split(), "instruments"}
    assert summary["schema"] == 2
    assert set(summary["inputs"][0]) == {"role", "file", "sha256"}
    for result in summary["results"]:
        assert set(result) == set(RESULT.split())
        assert re.fullmatch(r"[a-z][a-z0-9_]*(\.\d+)?", result["name"])
        for reason in result["reasons"]:
            assert set(reason) == {"code", "message"}
            assert re.fullmatch(r"[a-z][a-z0-9_]*", reason["code"])
        shares = [row["share"] for row in result["budget"]]
        assert not shares or math.isclose(sum(shares), 1)
        assert {key for row in result["budget"] for key in row} <= {
            *("cause", "change", "share", "common")
        }
    for note in summary["quality"]:
        assert set(note) == {"code", "severity", "message"}


@pytest.mark.slow
def test_nothing_is_written_but_where_it_is_asked(
    run: Run,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    repository: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of every command that has ``--out``, and of those that only look."""
    small = small_scenario()
    straight = replace(small, mechanics=replace(small.mechanics, slack=None))
    small_lab = make_lab(tmp_path_factory.mktemp("straight"), straight)
    sheet, out = repository / "examples" / "wires.xlsx", tmp_path / "asked" / "out"
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    assert run("process", small_lab.raw, "--no-figures", "--out", out / "tests").status == 0
    commands: list[tuple[object, ...]] = [
        ("process", out / "tests" / "T1" / "result.h5", "--out", out / "again", "--no-figures"),
        ("report", out / "tests", "--out", out / "report"),
        ("model", sheet, "--out", out / "model", "--no-figures"),
        ("bundle", "7 B1", "--wire", sheet, "--out", out / "bundle", "--no-figures"),
        ("calibrate", out / "tests", "--wire", sheet, "--out", out / "calibration", "--no-figures"),
        ("simulate", "--out", out / "raw", "--rate", "200 Hz", "--cycles", "1"),
        ("inspect", small_lab.raw / "take.csv"),
        ("check", small_lab.raw),
    ]
    before = state(small_lab.home), state(repository / "examples")
    for command in commands:
        ran = run(*command)
        assert ran.status in {0, 1}, ran.err
    assert before == (state(small_lab.home), state(repository / "examples"))
    assert not list(work.iterdir())
    assert {path.name for path in tmp_path.iterdir()} == {"asked", "work"}


@pytest.mark.slow
@pytest.mark.parametrize("given", [Path, str])
def test_a_test_opens_by_its_folder_and_by_its_file(given: type, processed: Lab) -> None:
    by_folder, by_file = labpipe.open(given(processed.processed)), labpipe.open(processed.result)
    assert by_folder.summary == by_file.summary == processed.summary
    assert by_folder.folder == processed.processed
    assert len(by_folder.raw["force"]) > 1000
    assert {"markers", "markers/Clamp"} <= set(by_folder.raw)
    assert len(by_folder.shape) == len(by_folder.raw["markers"])


@pytest.mark.slow
def test_processing_in_memory_gives_the_same_and_writes_nothing(processed: Lab) -> None:
    before = {path: path.stat().st_mtime_ns for path in processed.home.rglob("*")}
    wanted = labpipe.open(processed.processed)
    for source in (processed.raw, processed.sheet, processed.result, processed.processed):
        made = labpipe.process(source)
        assert made.summary == wanted.summary
        assert made.results.equals(wanted.results)
        assert made.curve.equals(wanted.curve)
        assert made.folder is None
    assert {path: path.stat().st_mtime_ns for path in processed.home.rglob("*")} == before


def test_what_cannot_be_opened_is_said(processed: Lab, tmp_path: Path) -> None:
    for folder, message in (
        (processed.raw, r"expected a result\.h5, or a folder with processed test"),
        (tmp_path / "none", "found nothing of that name"),
    ):
        with pytest.raises(UsageError, match=message):
            labpipe.open(folder)
    (tmp_path / "result.h5").write_bytes(b"no")
    with pytest.raises(StoreError, match="expected a result file, found a file that is not HDF5"):
        labpipe.open(tmp_path)
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.h5").touch()
    with pytest.raises(UsageError, match=r"expected one test, found 3 of them\. labpipe\.table"):
        labpipe.open(tmp_path)


def test_a_table_and_an_export(processed: Lab, run: Run) -> None:
    frame = labpipe.table(processed.home / "processed", by=["type", "length"])
    assert frame["result"].tolist() == [result["name"] for result in processed.summary["results"]]
    export = processed.raw / "take.csv"
    assert f"{labpipe.inspect(export)!r}\n" == run("inspect", export).out
