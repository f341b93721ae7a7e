"""Every command keeps what DESIGN 8 promises of commands."""

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

from labpipe import __version__
from labpipe.cli import BAD_INPUT, DONE
from tests.builders.small_tests import Lab, Run, make_lab, runner, small_scenario, state

COMMANDS = (
    *("demo", "inspect", "new", "check", "process", "campaign", "report", "serve"),
    *("model", "bundle", "harness", "calibrate", "simulate", "examples", "completion"),
)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
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
    run: Run, lab: Lab, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "mine").write_text("mine")
    places = {"LAB": lab.raw, "FILE": tmp_path / "mine"}
    ran = run(*(places.get(word, word) for word in arguments))
    assert ran.status == BAD_INPUT, ran
    assert re.search(
        r"mine[^\n]*: expected a folder to write in, found a file in its place\. Choose", ran.err
    ), ran
    assert ran.err.count(": expected ") == 1
    assert (tmp_path / "mine").read_text() == "mine"


def test_version(run: Run) -> None:
    assert run("--version").out == f"labpipe {__version__}\n"


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


def test_json_of_process(run: Run, lab: Lab, tmp_path: Path) -> None:
    ran = run("process", lab.raw, "--out", tmp_path, "--no-figures", "--json")
    assert ran.status == DONE
    said = json.loads(ran.out)
    assert said == json.loads((tmp_path / "T1" / "summary.json").read_text(encoding="utf-8"))
    assert set(said) == {
        "schema",
        "test",
        "specimen",
        "protocol",
        "labpipe",
        "inputs",
        "results",
        "quality",
        "run",
        "made_of",
        "date",
        "operator",
        "instruments",
    }
    assert said["schema"] == 2
    assert set(said["inputs"][0]) == {"role", "file", "sha256"}
    for result in said["results"]:
        assert set(result) == {
            "name",
            "value",
            "unit",
            "lower",
            "upper",
            "level",
            "estimate",
            "code",
            "reason",
            "status",
            "reasons",
            "method",
            "budget",
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


@pytest.mark.parametrize("name", ["force.mat", "take.csv"])
def test_json_of_inspect(run: Run, lab: Lab, name: str) -> None:
    ran = run("inspect", lab.raw / name, "--json")
    assert ran.status == DONE
    said = json.loads(ran.out)
    assert {"file", "reader", "program", "version", "streams", "markers", "notes"} <= set(said)
    for stream in said["streams"]:
        assert {"clock", "samples", "start", "end", "step_median", "holes", "channels"} <= set(
            stream
        )
        for channel in stream["channels"]:
            assert {
                "name",
                "path",
                "unit",
                "unit_in_file",
                "first",
                "last",
                "min",
                "max",
                "missing",
            } <= set(channel)
    if said["markers"] is not None:
        wanted = {"frames", "rate", "start", "end", "names", "missing", "rigid_bodies"}
        assert wanted <= set(said["markers"])
        assert said["markers"]["frames"] == 851


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
    lab = make_lab(tmp_path_factory.mktemp("straight"), straight)
    sheet, out = repository / "examples" / "wires.xlsx", tmp_path / "asked" / "out"
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    assert run("process", lab.raw, "--no-figures", "--out", out / "tests").status == 0
    commands: list[tuple[object, ...]] = [
        ("process", out / "tests" / "T1" / "result.h5", "--out", out / "again", "--no-figures"),
        ("report", out / "tests", "--out", out / "report"),
        ("model", sheet, "--out", out / "model", "--no-figures"),
        ("bundle", "7 B1", "--wire", sheet, "--out", out / "bundle", "--no-figures"),
        ("calibrate", out / "tests", "--wire", sheet, "--out", out / "calibration", "--no-figures"),
        ("simulate", "--out", out / "raw", "--rate", "200 Hz", "--cycles", "1"),
        ("inspect", lab.raw / "take.csv"),
        ("check", lab.raw),
    ]
    before = state(lab.home), state(repository / "examples")
    for command in commands:
        ran = run(*command)
        assert ran.status in {0, 1}, ran.err
    assert before == (state(lab.home), state(repository / "examples"))
    assert not list(work.iterdir())
    assert {path.name for path in tmp_path.iterdir()} == {"asked", "work"}
