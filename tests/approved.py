"""Texts that a person has approved: one file per folder of tests, ``approved.txt``.

A test gives a text (a message, a note, a printed table) to the fixture ``approved``. The text must
equal what stands in the file under the name of the test. ``pytest tests/readers --approve`` writes
what the tests give now; the reader approves it in the diff. Without ``-n``: one process writes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import pytest

FILE = "approved.txt"
HEAD = re.compile(r"^## (.+)\n", re.MULTILINE)
Approve = Callable[[str | Iterable[object]], None]


def read(file: Path) -> dict[str, str]:
    """Return the texts of a file by the names of their tests."""
    if not file.is_file():
        return {}
    _, *parts = HEAD.split(file.read_text(encoding="utf-8"))
    return {name: text.strip("\n") for name, text in zip(parts[::2], parts[1::2], strict=True)}


def write(file: Path, texts: Mapping[str, str]) -> None:
    """Write texts sorted by the names of their tests."""
    parts = [f"## {name}\n{texts[name]}\n" for name in sorted(texts)]
    file.write_text("\n".join(parts), encoding="utf-8")


@pytest.fixture
def approved(request: pytest.FixtureRequest) -> Approve:
    """Compare one text, or the lines of several, with what is approved for this test.

    The folder ``tmp_path`` of the test is written as ``TMP``.
    """
    file = request.path.parent / FILE
    name = f"{request.path.stem.removeprefix('test_')}: {request.node.name}"
    renew = bool(request.config.getoption("approve"))

    def compare(given: str | Iterable[object]) -> None:
        lines = [given] if isinstance(given, str) else given
        text = "\n".join(str(line) for line in lines).strip("\n")
        if "tmp_path" in request.fixturenames:
            text = text.replace(str(request.getfixturevalue("tmp_path")), "TMP")
        if renew:
            write(file, read(file) | {name: text})
        else:
            assert text == read(file).get(name), f"{file}, {name}: not approved (--approve)"

    return compare
