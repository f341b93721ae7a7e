"""One test put into a lab's folder, run by ``labpipe process``, and what came out of it."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from labpipe.cli import main


@dataclass(frozen=True)
class Ran:
    """Exit status, what was said on the terminal, and summary.json (empty if there is none)."""

    status: int
    out: str
    err: str
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def results(self) -> dict[str, dict[str, Any]]:
        return {each["name"]: each for each in self.summary.get("results", [])}

    @property
    def notes(self) -> list[dict[str, str]]:
        return list(self.summary.get("quality", []))


CRASHED = -1


def process(home: Path, sheet: str, files: dict[str, bytes]) -> Ran:
    """Write ``test.yaml`` and `files` beside it, and process; the test is called T."""
    folder = home / "raw" / "c" / "T"
    folder.mkdir(parents=True)
    (folder / "test.yaml").write_text(sheet, encoding="utf-8")
    for name, content in files.items():
        (folder / name).write_bytes(content)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = _run(folder)
    summary = home / "processed" / "c" / "T" / "summary.json"
    said = json.loads(summary.read_text(encoding="utf-8")) if summary.is_file() else {}
    return Ran(status, out.getvalue(), err.getvalue(), said)


def _run(folder: Path) -> int:
    """As at a terminal: warnings are printed, and what nobody caught is a traceback."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = _show
        try:
            return int(main(["process", str(folder), "--no-figures"]))
        except SystemExit as end:
            return int(end.code or 0)
        except Exception:  # noqa: BLE001 - what the program let through is what is judged
            traceback.print_exc()
            return CRASHED


def _show(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    sys.stderr.write(f"{category.__name__}: {message} ({Path(filename).name}, line {lineno})\n")
