"""The worked examples of the page on bundle extractors say what the code does."""

from __future__ import annotations

import doctest
from pathlib import Path


def test_worked_examples(repository: Path) -> None:
    page = repository / "docs" / "explanations" / "bundle-extractors.md"
    found = doctest.testfile(str(page), module_relative=False)
    assert found.attempted > 15
    assert found.failed == 0
