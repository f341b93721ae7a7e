"""How the package is laid out."""

from __future__ import annotations

import tomllib
from collections import Counter
from pathlib import Path


def test_no_name_of_a_module_twice(repository: Path) -> None:
    files = (repository / "labpipe").rglob("*.py")
    names = Counter(path.name for path in files if path.name != "__init__.py")
    assert not {name for name, count in names.items() if count > 1}


def test_contributing_shows_the_layers_that_are_enforced(repository: Path) -> None:
    settings = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    page = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    lines = [line.strip().partition("  ")[0] for line in page.splitlines()]
    start = lines.index(layers[0])
    assert lines[start : start + len(layers)] == layers
