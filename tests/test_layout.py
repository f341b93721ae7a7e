"""How the package is laid out."""

from __future__ import annotations

from collections import Counter
from pathlib import Path


def test_no_name_of_a_module_twice(repository: Path) -> None:
    files = (repository / "labpipe").rglob("*.py")
    names = Counter(path.name for path in files if path.name != "__init__.py")
    assert not {name for name, count in names.items() if count > 1}
