"""The notebooks of the documentation run, and what they keep is what they say."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.notebooks.running import FOLDER

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
assert NOTEBOOKS
MAX_BYTES = 400_000
RUN = """
import json, sys
from pathlib import Path
from tests.notebooks.running import executed
print(json.dumps(executed(Path(sys.argv[1]))))
"""


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def kinds(notebook: Any) -> list[list[list[str]]]:
    """What kinds of output each cell has; no numbers, which may differ from machine to machine."""
    return [
        [sorted(item.get("data", [item.get("name", "error")])) for item in cell.get("outputs", [])]
        for cell in notebook["cells"]
    ]


def tables(notebook: Any) -> list[list[str]]:
    """Words of the tables: headings and names of rows."""
    pages = [
        "".join(output["data"]["text/html"])
        for cell in notebook["cells"]
        for output in cell.get("outputs", [])
        if "text/html" in output.get("data", {})
    ]
    return [re.findall(r"<th>(\D[^<]*)</th>", page) for page in pages]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_says_what_it_keeps(path: Path, repository: Path) -> None:
    """In a process of its own: what a kernel warns of is no fault of labpipe."""
    command = [sys.executable, "-W", "ignore", "-c", RUN, str(path)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=repository)
    assert ran.returncode == 0, ran.stderr
    made, kept = json.loads(ran.stdout), read(path)
    assert kinds(made) == kinds(kept), "python -m tests.notebooks keeps what they say now"
    assert tables(made) == tables(kept), "python -m tests.notebooks keeps what they say now"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_its_links_lead_somewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text) < MAX_BYTES
    assert "/tmp/" not in text
    cells = read(path)["cells"]
    assert "execution" not in {key for cell in cells for key in cell["metadata"]}
    assert not [cell for cell in cells if cell.get("execution_count", 1) is None]
    words = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    links = re.findall(r"\]\(([^)#]+)", "\n".join(words))
    assert links
    assert [link for link in links if not (path.parent / link).exists()] == []


def test_the_examples_of_mechanics_run(repository: Path) -> None:
    page = (repository / "docs/explanations/mechanics.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL)), names)
    assert 0.0 < names["back"].force[1] < 0.5 * names["there"].force[1]
    assert names["loads"][-1] == pytest.approx(names["there"].force[1], rel=0.02)
    assert names["path"].states[-1].positions[-1][2] < -0.1
