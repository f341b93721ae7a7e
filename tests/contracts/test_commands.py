"""Every command keeps what is promised of commands, and ``import labpipe`` is cheap."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

import labpipe
from labpipe.cli import BAD_INPUT, DONE
from labpipe.errors import StoreError, UsageError
from tests.builders.small_tests import Lab, Run, make_lab, runner, small_scenario, state

COMMANDS = (
    *("demo", "inspect", "new", "check", "process", "campaign", "report", "serve"),
    *("model", "bundle", "harness", "calibrate", "simulate", "examples", "completion"),
)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)


@pytest.fixture(scope="module")
def small_lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return make_lab(tmp_path_factory.mktemp("lab"), small_scenario())


def test_help_lists_every_command(run: Run) -> None:
    ran = run("--help")
    assert ran.status == DONE
    listed = re.findall(r"^    (\w+) ", ran.out, flags=re.MULTILINE)
    assert listed == list(COMMANDS)
    assert "exit status: 0 done; 1 some results failed (they are listed); 2 bad input" in ran.out


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_module_and_help(run: Run, command: str) -> None:
    assert callable(import_module(f"labpipe.cli.{command}").run)
    ran = run(command, "--help")
    assert ran.status == DONE
    assert ran.out.startswith(f"usage: labpipe {command} ")
    options = re.findall(r"^  (--[\w-]+|[A-Z]+)(.*)$", ran.out, flags=re.MULTILINE)
    assert options
    for name, rest in options:
        alone = rest.strip() in ("", name.removeprefix("--").upper())
        follows = re.search(rf"^  {re.escape(name)}.*\n +\S", ran.out, flags=re.MULTILINE)
        assert not alone or follows, f"{name} has no help"


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_quotes_as_every_shell_does(run: Run, command: str) -> None:
    """The command prompt of Windows takes a single quote for a letter."""
    said = " ".join(run(*filter(None, [command]), "--help").out.split())
    of_sql = re.sub(r"\"name = '.*?' and type = '.*?'\"", "", said)
    assert not re.search(r"(?<!\w)'|'(?!\w)", of_sql)


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("proces",),
        ("process",),
        ("inspect",),
        ("new",),
        ("process", "x", "--fast"),
        ("simulate", "--cycles", "many"),
    ],
)
def test_bad_usage_is_status_2(run: Run, arguments: tuple[str, ...]) -> None:
    ran = run(*arguments)
    assert ran.status == BAD_INPUT
    assert ran.err.startswith("usage: labpipe")
    assert "Traceback" not in ran.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("process", "nowhere"),
        ("inspect", "nowhere.mat"),
        ("check", "nowhere"),
        ("simulate", "--rate", "10"),
        ("simulate", "--fps", "50 mm"),
        ("simulate", "--cycles", "0"),
        ("simulate", "--rate", "0 Hz"),
        ("simulate", "--fps", "-50 Hz"),
        ("new", "raw/x", "--set", "nonsense"),
        ("new", "raw/x", "--from", "nowhere.xlsx"),
    ],
)
def test_bad_input_is_status_2_and_one_message(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run(*arguments)
    assert ran.status == BAD_INPUT, ran
    assert ": expected " in ran.err
    assert ", found " in ran.err
    assert "Traceback" not in ran.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("process", "LAB", "--out", "FILE"),
        ("simulate", "--cycles", "1", "--fps", "20 Hz", "--rate", "100 Hz", "--out", "FILE"),
        ("new", "FILE", "--protocol", "tensile", "--frame", "a.csv", "--type", "T", "--spool", "s",
         "--sample", "1"),
    ],
)  # fmt: skip
def test_a_file_where_a_folder_is_to_be_made(
    run: Run, small_lab: Lab, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "mine").write_text("mine")
    places = {"LAB": small_lab.raw, "FILE": tmp_path / "mine"}
    ran = run(*(places.get(word, word) for word in arguments))
    assert ran.status == BAD_INPUT, ran
    assert re.search(
        r"mine[^\n]*: expected a folder to write in, found a file in its place\. Choose", ran.err
    ), ran
    assert ran.err.count(": expected ") == 1
    assert (tmp_path / "mine").read_text() == "mine"


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\nfrom labpipe.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'h5py', 'matplotlib', 'pydantic', 'yaml', 'pint'}\n"
        "sys.exit(','.join(sorted(heavy & set(sys.modules))) or 0)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr


def test_json_of_process(run: Run, small_lab: Lab, tmp_path: Path) -> None:
    ran = run("process", small_lab.raw, "--out", tmp_path, "--no-figures", "--json")
    assert ran.status == DONE
    said = json.loads(ran.out)
    assert said == json.loads((tmp_path / "T1" / "summary.json").read_text(encoding="utf-8"))
    assert set(said) == {
        *("schema", "test", "specimen", "protocol", "labpipe", "inputs"),
        *("results", "quality", "run", "made_of", "date", "operator", "instruments"),
    }
    assert said["schema"] == 2
    assert set(said["inputs"][0]) == {"role", "file", "sha256"}
    for result in said["results"]:
        assert set(result) == {
            *("name", "value", "unit", "lower", "upper", "level"),
            *("estimate", "code", "reason", "status", "reasons", "method", "budget", "seal"),
        }
        assert re.fullmatch(r"[a-z][a-z0-9_]*(\.\d+)?", result["name"])
        for reason in result["reasons"]:
            assert set(reason) == {"code", "message"}
            assert re.fullmatch(r"[a-z][a-z0-9_]*", reason["code"])
        for row in result["budget"]:
            assert set(row) == {"cause", "change", "share", "common"}
        assert not result["budget"] or math.isclose(
            sum(row["share"] for row in result["budget"]), 1
        )
    for note in said["quality"]:
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


@pytest.fixture(scope="module")
def processed(pristine: Lab, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    from labpipe.cli import main

    lab = pristine.copy(tmp_path_factory.mktemp("api"))
    assert main(["process", str(lab.raw)]) == 0
    return lab


def python(code: str) -> str:
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def test_importing_labpipe_imports_nothing_else() -> None:
    """Nothing outside of the standard library: what of that is there already differs by machine."""
    new = "{name.partition('.')[0] for name in {*sys.modules} - old} - sys.stdlib_module_names"
    code = f"import sys; old = {{*sys.modules}}; import labpipe; print(*sorted({new}))"
    assert python(code) == "labpipe"
    assert python("import sys, labpipe; print('labpipe.api' in sys.modules)") == "False"


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
    with pytest.raises(UsageError, match=r"expected a result\.h5, or a folder with processed test"):
        labpipe.open(processed.raw)
    with pytest.raises(UsageError, match="found nothing of that name"):
        labpipe.open(tmp_path / "none")
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
    assert frame["result"].tolist() == [each["name"] for each in processed.summary["results"]]
    export = processed.raw / "take.csv"
    assert f"{labpipe.inspect(export)!r}\n" == run("inspect", export).out
