"""``labpipe examples``."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Mapping
from pathlib import Path

from labpipe.cli.terminal import from_here
from labpipe.errors import UsageError, error_text
from labpipe.protocol.load import shipped_folder
from labpipe.store.replace import storing


def run(options: argparse.Namespace) -> int:
    """Copy a wire sheet, a calibration plan, harnesses and the protocols."""
    wanted = _copies(options.folder)
    for goal, source in wanted.items():
        _refuse_different(goal, source)
    with storing(options.folder):
        for goal, source in wanted.items():
            goal.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, goal)
            print(f"wrote {from_here(goal)}")
    return 0


def _copies(folder: Path) -> Mapping[Path, Path]:
    """Return the source of each copy, without files that would be copied onto themselves."""
    examples, protocols = shipped_folder("examples"), shipped_folder("protocols")
    files = {folder / path.name: path for path in sorted(examples.iterdir())}
    files |= {folder / "protocols" / path.name: path for path in sorted(protocols.iterdir())}
    return {
        goal: source
        for goal, source in files.items()
        if source.is_file() and source.resolve() != goal.resolve()
    }


def _refuse_different(goal: Path, source: Path) -> None:
    if goal.exists() and goal.read_bytes() != source.read_bytes():
        message = error_text(
            goal,
            "",
            expected="the example unchanged, or no such file",
            found="a different file",
            remedy="Move it away, or name another folder; nothing was written.",
        )
        raise UsageError(message)
