"""A shell asks in the environment what may follow, and is told on a file of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from labpipe.cli import DONE
from tests.builders.small_tests import Run


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
