"""The commands run in-process: what they print, where, and how they end."""

from __future__ import annotations

import gc
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from labpipe.cli import DONE, main
from labpipe.errors import LabpipeError
from tests.builders.small_tests import Lab, Run


def test_any_other_exception_is_a_bug_and_shows(
    run: Run, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*arguments: object, **more: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("labpipe.process.run.reduce_recordings", broken)
    with pytest.raises(ZeroDivisionError):
        main(["process", str(lab.raw)])


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


def test_interrupt(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("labpipe.process.inspection.inspect_export", stopped)
    assert run("inspect", tmp_path).status == 130


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


def test_collector_works_again_once_all_is_imported(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["labpipe", "check", str(lab.raw)])
    assert main() == 0
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0
    gc.unfreeze()


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


def test_new_for_a_campaign(run: Run, lab: Lab) -> None:
    (lab.raw / "test.yaml").unlink()
    campaign = lab.raw.parent
    assert run("new", campaign).out.startswith(f"wrote {lab.raw / 'test.yaml'}\n")
    assert run("new", campaign).out.startswith(f"kept  {lab.raw / 'test.yaml'}: ")


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


@pytest.mark.slow
def test_several_tests_as_json(run: Run, lab: Lab) -> None:
    one = lab.raw / "test.yaml"
    out = lab.home / "out"
    run("process", one, "--out", out, "--no-figures")
    ran = run("process", one, out / "T1" / "result.h5", "--no-figures", "--json")
    assert [each["test"] for each in json.loads(ran.out)] == ["T1", "T1"]


def test_nothing_is_printed_when_every_test_is_refused(run: Run, lab: Lab) -> None:
    (lab.raw / "force.mat").unlink()
    ran = run("process", lab.raw, "--json")
    assert (ran.status, ran.out) == (2, "")


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


@pytest.mark.slow
def test_a_name_that_the_terminal_cannot_show(lab: Lab) -> None:
    text = lab.sheet.read_text(encoding="utf-8").replace("test: T1", "test: T\u529b1")
    lab.sheet.write_text(text, encoding="utf-8")
    program = "import sys; from labpipe.cli import main; sys.exit(main(sys.argv[1:]))"
    ended = subprocess.run(
        [sys.executable, "-c", program, "process", str(lab.raw), "--no-figures"],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert (ended.returncode, ended.stdout[:10]) == (0, b"T\\u529b1  ")


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


@pytest.mark.parametrize("command", ["process", "report", "bundle", "model", "inspect", "check"])
def test_a_path_that_no_system_takes(run: Run, command: str) -> None:
    ran = run(command, "x" * 300)
    assert ran.status == 2
    assert "Traceback" not in ran.err
    said = "File name too long|file name too long|nothing of that name|expected wires by type"
    assert re.search(said, ran.err)
