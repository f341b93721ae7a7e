"""The commands run in-process: what they print, where, and how they end."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import webbrowser
from pathlib import Path

import pytest

from labpipe.campaign.serving import ReportServer
from labpipe.cli import EXIT_ERROR, EXIT_OK
from labpipe.errors import LabpipeError
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from tests.builders.pulled_campaigns import make_pulls
from tests.builders.small_tests import Lab, Run


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (LabpipeError("take.csv, line 3: expected this, found that. Do so."), "take.csv, line 3: "),
        (MemoryError(), "out of memory. Close other programs"),
    ],
)
def test_message_names_the_command(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, message: str
) -> None:
    def refused(path: Path) -> None:
        raise error

    monkeypatch.setattr("labpipe.process.inspection.inspect_export", refused)
    ran = run("inspect", tmp_path)
    assert ran.err.startswith(f"labpipe inspect: {message}")
    assert (ran.status, ran.out) == (EXIT_ERROR, "")


def test_new_then_check(run: Run, lab: Lab) -> None:
    lab.sheet.unlink()
    facts = ["--type", "A2", "--spool", "A2-s1", "--sample", "1", "--length", "85 mm"]
    options = [*facts, "--force", "force.mat", "--markers", "take.csv"]
    ran = run("new", lab.raw, *options, "--set", "rig.stroke=12 mm", "--because", "a short stroke")
    assert ran.status == EXIT_OK
    assert ran.out.splitlines()[0] == f"wrote {lab.sheet}"
    assert "  not used: truth.json (JSON)" in ran.out.splitlines()
    ran = run("check", lab.raw)
    assert (ran.status, ran.out) == (EXIT_OK, "0 protocols, 1 test: no faults found\n")
    content = lab.sheet.read_bytes()
    assert run("new", lab.raw, *options).status == EXIT_ERROR
    assert lab.sheet.read_bytes() == content
    assert run("new", lab.raw, *options, "--overwrite").status == EXIT_OK
    lab.edit("test.yaml", "take.csv", "tale.csv")
    ran = run("check", lab.raw)
    assert (ran.status, ran.out) == (EXIT_ERROR, "0 protocols, 1 test: 1 fault\n")
    assert "tale.csv" in ran.err


def test_new_from_a_sheet(run: Run, tmp_path: Path) -> None:
    sheet = tmp_path / "campaign.csv"
    head = "test,protocol,type,spool,sample,length,force,markers\n"
    rows = [f"A2-{n},wire-cantilever,A2,s1,{n},85 mm,force.mat,take.csv\n" for n in (1, 2)]
    sheet.write_text(head + "".join(rows), encoding="utf-8")
    ran = run("new", tmp_path / "raw", "--from", sheet)
    assert ran.status == EXIT_OK
    assert ran.out.count("wrote ") == 2
    assert ran.out.count("  missing exports: force.mat, take.csv\n") == 2
    assert run("new", tmp_path / "raw", "--from", sheet).out.count("kept ") == 2


@pytest.mark.parametrize("command", ["inspect", "check", "process", "report", "model"])
def test_impossible_file_name(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    why = {"loop": "a link that leads back to itself", "a" * 300: "File name too long"}
    for name, reason in why.items():
        ran = run(command, name)
        shown = f"'{name}'" if name == "loop" else f"'{'a' * 60}...'"
        message = f"expected the name of a file or a folder, found {shown} ({reason})"
        assert (ran.status, message in ran.err) == (EXIT_ERROR, True), name


@pytest.mark.skipif(os.name == "nt", reason="names of files are Unicode there")
def test_unencodable_file_name(lab: Lab) -> None:
    text = re.sub(r"files: {\w+: ", "\\g<0>\xe4", lab.sheet.read_text(encoding="utf-8"))
    lab.sheet.write_text(text, encoding="utf-8")
    program = "import sys; from labpipe.cli import main; sys.exit(main(sys.argv[1:]))"
    ended = subprocess.run(
        [sys.executable, "-c", program, "check", str(lab.sheet)],
        capture_output=True,
        check=False,
        env=os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0"},
    )
    assert ended.returncode == 2
    assert b"Traceback" not in ended.stderr
    assert b"whose encoding is ascii, found '\\xe4'. Choose a locale of UTF-8" in ended.stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("labpipe campaign re", {"replay", "rebuild"}),
        pytest.param("labpipe report --ti", {"--title"}, marks=pytest.mark.slow),
        pytest.param("labpipe inspect ta", {"take.csv"}, marks=pytest.mark.slow),
    ],
)
def test_completes_actions_options_and_files(
    tmp_path: Path, repository: Path, typed: str, offered: set[str]
) -> None:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "take.csv").touch()
    answer = tmp_path / "answer"
    request = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer)}
    line = {"COMP_LINE": typed, "COMP_POINT": str(len(typed)), "COMP_TYPE": "9"}
    env = {**os.environ, **request, **line, "_ARGCOMPLETE_IFS": "\n", "PYTHONPATH": str(repository)}
    command = [sys.executable, "-c", "from labpipe.cli import main; main()"]
    subprocess.run(command, cwd=tmp_path / "lab", env=env, check=True, stdout=subprocess.DEVNULL)
    answers = answer.read_text(encoding="utf-8").split("\n")
    assert {text.strip() for text in answers} == offered


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_examples_are_copied(run: Run, repository: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "lab"
    ran = run("examples", folder)
    assert (ran.status, ran.err) == (EXIT_OK, "")
    expected = contents(repository / "examples") | {
        f"protocols/{name}": text for name, text in contents(repository / "protocols").items()
    }
    assert contents(folder) == expected
    assert ran.out.count("wrote ") == len(expected)
    assert run("examples", folder).status == EXIT_OK, "the same again does no harm"


def test_examples_never_replace_a_file(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "protocols" / "tensile.yaml"
    file.parent.mkdir()
    file.write_text("mine", encoding="utf-8")
    ran = run("examples", tmp_path)
    assert ran.status == EXIT_ERROR
    assert f"{file}: expected the example unchanged, or no such file" in ran.err
    assert contents(tmp_path) == {"protocols/tensile.yaml": b"mine"}


def test_writes_exports_sheet_and_truth(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario that the options ask for reaches the virtual lab."""
    calls: list[tuple[CantileverScenario, Path, int]] = []

    def simulate(scenario: CantileverScenario, folder: Path, seed: int) -> Path:
        calls.append((scenario, folder, seed))
        return folder

    monkeypatch.setattr("labpipe.cli.simulate.simulate_test", simulate)
    options = ["--name", "S7", "--fps", "120Hz", "--cycles", "2", "--seed", "9"]
    ran = run("simulate", "--out", tmp_path, "--rate", "1 kHz", *options)
    assert ran.status == 0
    (scenario, folder, seed), *_ = calls
    facts = scenario.name, scenario.clocks.rate, scenario.clocks.fps, scenario.mechanics.cycles
    assert (folder, seed, facts) == (tmp_path / "S7", 9, ("S7", 1000.0, 120.0, 2))
    wrote = f"wrote {tmp_path / 'S7'}: exports, test.yaml, truth.json (synthetic, seed 9)\n"
    assert ran.out == wrote


@pytest.mark.parametrize(
    ("options", "rejected"),
    [
        ("--kind taped-bundle --type CWB-1", "type=CWB-1 of a taped-bundle"),
        ("--kind conduit-bundle --cycles 2", "cycles=2 of a conduit-bundle"),
        ("--kind metal-tension --cycles 2", "cycles=2 of a metal-tension"),
        ("--kind metal-tension --rate 1kHz", "rate=1kHz of a metal-tension"),
        ("--kind metal-tension --fps 25Hz", "fps=25Hz of a metal-tension"),
        ("--type CWB-1", "type=CWB-1 of a wire"),
        ("--name con", "name=con"),
        ("--name a. --rate fast --cycles 0", "rate=fast, cycles=0, name=a."),
    ],
)
def test_simulate_refuses_options_of_other_kinds(
    run: Run, tmp_path: Path, options: str, rejected: str
) -> None:
    ran = run("simulate", "--out", tmp_path, *options.split())
    assert ran.status == EXIT_ERROR
    assert ran.err.startswith("labpipe simulate: options: expected --rate and --fps such as ")
    assert (
        f"options that the kind of specimen has, found {rejected}. See `labpipe simulate --help`."
        in ran.err
    )


@pytest.fixture(scope="module")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"), ("T-1", "T-2"))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that a browser would open; the server is ended at once, as by Ctrl+C."""

    def interrupted(_: ReportServer) -> None:
        raise KeyboardInterrupt

    addresses: list[str] = []
    monkeypatch.setattr(ReportServer, "serve_forever", interrupted)
    monkeypatch.setattr(webbrowser, "open", addresses.append)
    return addresses


def test_serve_makes_and_opens_the_report(
    run: Run, processed: Path, opened: list[str], tmp_path: Path
) -> None:
    page = processed / "report" / "report.html"
    ran = run("serve", processed, "--port", "0", "--title", "Tubes")
    assert ran.status == EXIT_OK
    assert "Tubes" in page.read_text("utf-8")
    (address,) = opened
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", address)
    assert (
        ran.out == f"Tubes: {address}\nReachable from this machine only. Press Ctrl+C to stop.\n\n"
    )
    page.write_text("as it was", "utf-8")
    run("serve", processed, "--port", "0", "--no-browser")
    assert page.read_text("utf-8") == "as it was"
    ran = run("serve", tmp_path)
    assert ran.status == EXIT_ERROR
    assert "expected a result.h5, or a folder with processed tests" in ran.err
    assert "expected a whole number, found 'x'" in run("serve", tmp_path, "--port", "x").err
    assert opened == [address]
