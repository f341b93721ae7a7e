"""A kind of result as the how-to says that one is added, in a process of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.builders.small_tests import Lab

ADDED = """
import importlib, sys
import labpipe.results.cycles as module
exec(sys.argv.pop(1), vars(module))
importlib.reload(sys.modules["labpipe.results"])
from labpipe.cli import main
sys.exit(main(sys.argv[1:]))
"""


def test_the_example_of_the_how_to(
    pristine: Lab, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (repository / "docs" / "how-to" / "extend.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```python\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    [example] = [code for code in examples if "CycleKind" in code]
    [asked] = re.findall(r"`(- \{result: end-force.*?\})`", page)
    lab = pristine.copy(tmp_path)
    monkeypatch.chdir(lab.home)
    protocol = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    (lab.home / "protocols").mkdir()
    (lab.home / "protocols" / "wire-cantilever.yaml").write_text(
        protocol.replace("results:\n", f"results:\n  {asked}\n"), encoding="utf-8"
    )
    command = [sys.executable, "-c", ADDED, example, "process", str(lab.sheet), "--no-figures"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    end, peak = (lab.results[f"{name}.1"] for name in ("end_force", "peak_force"))
    assert end["status"] == "ok"
    assert 0.9 * peak["value"] < end["value"] < peak["value"]
