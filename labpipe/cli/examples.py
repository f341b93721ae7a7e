"""``labpipe examples``."""

from __future__ import annotations

import argparse
import shutil

from labpipe.cli.terminal import from_here
from labpipe.errors import UsageError
from labpipe.protocol.load import find_shipped_folder
from labpipe.store.replace import storing


def run(options: argparse.Namespace) -> int:
    """Copy a wire sheet, a calibration plan, harnesses and the protocols."""
    examples, protocols = find_shipped_folder("examples"), find_shipped_folder("protocols")
    files = {options.folder / path.name: path for path in sorted(examples.iterdir())}
    files |= {
        options.folder / "protocols" / path.name: path for path in sorted(protocols.iterdir())
    }
    wanted = {
        goal: source
        for goal, source in files.items()
        if source.is_file() and source.resolve() != goal.resolve()
    }
    for goal, source in wanted.items():
        if goal.exists() and goal.read_bytes() != source.read_bytes():
            raise UsageError.about("cli.other_example", goal)
    with storing(options.folder):
        for goal, source in wanted.items():
            goal.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, goal)
            print(f"wrote {from_here(goal)}")
    return 0
