"""A lab's folder with one test in it, and what the program made of that test."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class LabFolder:
    """One test in ``raw/c/<name>`` of a lab's folder, and where its results come."""

    home: Path
    name: str

    @property
    def raw(self) -> Path:
        return self.home / "raw" / "c" / self.name

    @property
    def sheet(self) -> Path:
        return self.raw / "test.yaml"

    @property
    def processed(self) -> Path:
        return self.home / "processed" / "c" / self.name

    @property
    def result(self) -> Path:
        return self.processed / "result.h5"

    @property
    def summary(self) -> dict[str, Any]:
        return _json(self.processed / "summary.json")

    @property
    def results(self) -> dict[str, dict[str, Any]]:
        return {each["name"]: each for each in self.summary["results"]}

    @property
    def notes(self) -> dict[str, str]:
        return {each["code"]: each["message"] for each in self.summary["quality"]}

    @property
    def truth(self) -> dict[str, Any]:
        return _json(self.raw / "truth.json")

    def override(self, key: str, value: str) -> None:
        """Add an override to the test sheet."""
        text = self.sheet.read_text(encoding="utf-8")
        text += "" if "overrides:" in text else "overrides:\n"
        self.sheet.write_text(
            f"{text}  {key}: {{value: {value}, because: a test of the software}}\n", "utf-8"
        )

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace the one occurrence of a text in a file of the test."""
        content = (self.raw / name).read_bytes()
        assert content.count(old.encode()) == 1, (old, content.count(old.encode()))
        (self.raw / name).write_bytes(content.replace(old.encode(), new.encode()))

    def copy(self, home: Path) -> Self:
        shutil.copytree(self.home, home, dirs_exist_ok=True)
        return replace(self, home=home)


def _json(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found
