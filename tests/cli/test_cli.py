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
from labpipe.cli import BAD_INPUT, DONE, main
from labpipe.errors import LabpipeError
from labpipe.virtual_lab import CantileverScenario
from tests.builders.pulled_campaigns import make_pulls
from tests.builders.small_tests import Lab, Run


def test_message_names_the_command(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path) -> None:
        message = "take.csv, line 3: expected this, found that. Do so."
        raise LabpipeError(message)

    monkeypatch.setattr("labpipe.process.inspection.inspect_export", refused)
    ran = run("inspect", tmp_path)
    assert ran.err == ("labpipe inspect: take.csv, line 3: expected this, found that. Do so.\n")
    assert (ran.status, ran.out) == (2, "")


@pytest.mark.skipif(os.name == "nt", reason="pipes are another matter on Windows")
def test_reader_of_a_pipe_that_goes_away(pristine: Lab) -> None:
    command = (
        f'"{sys.executable}" -c "import sys; from labpipe.cli import main; sys.exit(main())" '
        f'inspect "{pristine.raw / "take.csv"}" --json | head -c 1; exit ${{PIPESTATUS[0]}}'
    )
    ended = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert ended.stdout == "{"
    assert ended.stderr == ""
    assert ended.returncode == DONE


def test_check(run: Run, lab: Lab) -> None:
    ran = run("check", lab.raw)
    assert (ran.status, ran.out) == (DONE, "0 protocols, 1 tests: no faults found\n")
    lab.edit("test.yaml", "take.csv", "tale.csv")
    ran = run("check", lab.raw)
    assert ran.status == 2
    assert ran.out == "0 protocols, 1 tests: 1 fault\n"
    assert "tale.csv" in ran.err


def test_inspect(run: Run, pristine: Lab) -> None:
    ran = run("inspect", pristine.raw / "force.mat")
    assert ran.status == DONE
    assert "Model Root/Load Cell/Out1" in ran.out
    ran = run("inspect", pristine.raw / "test.yaml")
    assert ran.status == 2
    assert "expected an export of a known format" in ran.err


def test_new_then_check(run: Run, lab: Lab) -> None:
    (lab.raw / "test.yaml").unlink()
    said = {"type": "A2", "spool": "A2-s1", "sample": "1", "length": "85 mm"}
    options = [part for key, value in said.items() for part in (f"--{key}", value)]
    files = ["--force", "force.mat", "--markers", "take.csv"]
    change = ["--set", "rig.stroke=12 mm", "--because", "a short stroke"]
    ran = run("new", lab.raw, *options, *files, *change)
    assert ran.status == DONE
    assert ran.out.splitlines()[0] == f"wrote {lab.raw / 'test.yaml'}"
    assert "  not used: truth.json: JSON" in ran.out.splitlines()
    assert run("check", lab.raw).status == DONE
    before = (lab.raw / "test.yaml").read_bytes()
    ran = run("new", lab.raw, *options, *files)
    assert ran.status == 2
    assert (lab.raw / "test.yaml").read_bytes() == before
    assert run("new", lab.raw, *options, *files, "--overwrite").status == DONE


def test_new_sees_what_lies_there(run: Run, lab: Lab) -> None:
    folder = lab.raw.rename(lab.raw.with_name("A2-085-3"))
    (folder / "test.yaml").unlink()
    ran = run("new", folder)
    assert (ran.status, ran.err) == (DONE, "")
    assert ran.out.splitlines()[0] == f"wrote {folder / 'test.yaml'}"
    assert ran.out.splitlines()[-1] == "  to be filled in: spool"
    assert "(specimen.spool): expected text, found nothing." in run("check", folder).err
    assert run("new", folder, "--spool", "A2-s1", "--overwrite").status == DONE
    assert run("check", folder).status == DONE


def test_new_from_a_sheet(run: Run, tmp_path: Path) -> None:
    sheet = tmp_path / "campaign.csv"
    sheet.write_text(
        "test,protocol,type,spool,sample,length,force,markers\n"
        "A2-1,wire-cantilever,A2,s1,1,85 mm,force.mat,take.csv\n"
        "A2-2,wire-cantilever,A2,s1,2,85 mm,force.mat,take.csv\n",
        encoding="utf-8",
    )
    ran = run("new", tmp_path / "raw", "--from", sheet)
    assert ran.status == DONE
    assert ran.out.count("wrote ") == 2
    assert ran.out.count("  not there yet: force.mat, take.csv\n") == 2
    ran = run("new", tmp_path / "raw", "--from", sheet)
    assert ran.out.count("kept ") == 2


@pytest.mark.parametrize("command", ["inspect", "check", "process", "report", "model"])
@pytest.mark.parametrize(
    ("name", "why"),
    [("a" * 300, "File name too long"), ("loop", "a link that leads back to itself")],
)
def test_a_name_that_the_file_system_refuses(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    name: str,
    why: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    with pytest.raises(SystemExit) as left:
        main([command, name])
    assert left.value.code == 2
    shown = "'loop'" if name == "loop" else f"'{'a' * 60}...'"
    said = f"expected the name of a file or a folder, found {shown} ({why})"
    assert said in capsys.readouterr().err


def test_memory_that_is_used_up(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def large(path: Path) -> None:
        raise MemoryError

    monkeypatch.setattr("labpipe.process.inspection.inspect_export", large)
    ran = run("inspect", tmp_path)
    assert ran.status == 2
    assert ran.err.startswith("labpipe inspect: expected data that go into the memory, found that")


@pytest.mark.skipif(os.name == "nt", reason="names of files are Unicode there")
def test_a_name_that_the_system_cannot_write(lab: Lab) -> None:
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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_a_script_for_each_shell(run: Run, shell: str) -> None:
    ran = run("completion", shell)
    assert ran.status == DONE
    assert "labpipe" in ran.out
    assert "ARGCOMPLETE" in ran.out


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("labpipe rep", {"report"}),
        ("labpipe campaign re", {"replay", "rebuild"}),
        ("labpipe report --ti", {"--title"}),
        ("labpipe simulate --kind ta", {"taped-bundle"}),
        ("labpipe inspect ta", {"take.csv"}),
    ],
)
def test_completes_commands_actions_options_and_files(
    tmp_path: Path, repository: Path, typed: str, offered: set[str]
) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "take.csv").touch()
    answer = tmp_path / "answer"
    asked = {
        **{
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
            "_ARGCOMPLETE_IFS": "\n",
        },
        **{"COMP_LINE": typed, "COMP_POINT": str(len(typed)), "COMP_TYPE": "9"},
    }
    command = [sys.executable, "-c", "from labpipe.cli import main; main()"]
    environment = os.environ | asked | {"PYTHONPATH": str(repository)}
    subprocess.run(command, cwd=lab, env=environment, check=True, stdout=subprocess.DEVNULL)
    words = answer.read_text(encoding="utf-8").split("\n")
    assert {word.strip() for word in words} == offered


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_copies_what_a_lab_starts_from(run: Run, repository: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "lab"
    ran = run("examples", folder)
    assert (ran.status, ran.err) == (DONE, "")
    expected = contents(repository / "examples") | {
        f"protocols/{name}": text for name, text in contents(repository / "protocols").items()
    }
    assert contents(folder) == expected
    assert ran.out.count("wrote ") == len(expected)
    assert run("examples", folder).status == DONE, "the same again does no harm"


def test_a_file_of_ones_own_is_never_replaced(run: Run, tmp_path: Path) -> None:
    own = tmp_path / "protocols" / "tensile.yaml"
    own.parent.mkdir()
    own.write_text("mine", encoding="utf-8")
    ran = run("examples", tmp_path)
    assert ran.status == BAD_INPUT
    assert ran.err == (
        f"labpipe examples: {own}: expected the example as it comes with labpipe, or no such file,"
        " found another one. Move it away, or name another folder; nothing was written.\n"
    )
    assert contents(tmp_path) == {"protocols/tensile.yaml": b"mine"}


def test_table_and_progress(run: Run, lab: Lab) -> None:
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 0
    assert ran.err == "1/1 T1\n"
    heading, first, *rest = ran.out.splitlines()
    assert heading == f"T1  (wire-cantilever): 15 ok  ->  {lab.processed}"
    assert first.split()[:1] == ["clock_offset"]
    assert first.split()[2:4] == ["s", "95"]
    assert len(rest) == 14
    assert not (lab.processed / "figures").exists()


def test_writes_exports_sheet_and_truth(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario that the options ask for reaches the virtual lab."""
    asked: list[tuple[CantileverScenario, Path, int]] = []

    def simulate(scenario: CantileverScenario, folder: Path, seed: int) -> Path:
        asked.append((scenario, folder, seed))
        return folder

    monkeypatch.setattr("labpipe.cli.simulate.simulate_test", simulate)
    ran = run(
        *("simulate", "--out", tmp_path, "--name", "S7", "--rate", "1 kHz"),
        *("--fps", "120 Hz", "--cycles", "2", "--seed", "9"),
    )
    assert ran.status == 0
    (scenario, folder, seed), *_ = asked
    assert (folder, seed, scenario.name) == (tmp_path / "S7", 9, "S7")
    assert (scenario.clocks.rate, scenario.clocks.fps) == (1000.0, 120.0)
    assert scenario.mechanics.cycles == 2
    assert ran.out == (
        f"wrote {tmp_path / 'S7'}: exports, test.yaml, truth.json (synthetic, seed 9)\n"
    )


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (("--kind", "taped-bundle", "--type", "CWB-1"), "type=CWB-1 of a taped-bundle"),
        (("--kind", "conduit-bundle", "--cycles", "2"), "cycles=2 of a conduit bundle"),
        (("--type", "CWB-1"), "type=CWB-1 of a wire"),
    ],
)
def test_what_a_kind_does_not_have(
    run: Run, tmp_path: Path, options: tuple[str, ...], found: str
) -> None:
    ran = run("simulate", "--out", tmp_path, *options)
    assert ran.status == 2
    assert ran.err == (
        'labpipe simulate: options: expected --rate and --fps such as "10 kHz" and "50 Hz", a '
        f"cycle, a plain name, a type and cycles that the kind has, found {found}. See `labpipe "
        f"simulate --help`.\n"
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


def test_it_makes_the_report_and_opens_it(run: Run, processed: Path, opened: list[str]) -> None:
    page = processed / "report" / "report.html"
    ran = run("serve", processed, "--port", "0", "--title", "Tubes")
    assert ran.status == 0
    assert "Tubes" in page.read_text("utf-8")
    (address,) = opened
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", address)
    assert ran.out.splitlines() == [
        f"Tubes: {address}",
        "Only this machine can open it. Ctrl+C ends it.",
        "",
    ]
    page.write_text("as it was", "utf-8")
    run("serve", processed, "--port", "0", "--no-browser")
    assert page.read_text("utf-8") == "as it was"
    assert len(opened) == 1


def test_bad_input(run: Run, tmp_path: Path, opened: list[str]) -> None:
    ran = run("serve", tmp_path)
    assert ran.status == BAD_INPUT
    assert "expected a result.h5, or a folder with processed tests" in ran.err
    assert "expected a whole number, found 'x'" in run("serve", tmp_path, "--port", "x").err
    assert opened == []
