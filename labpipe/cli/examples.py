"""``labpipe examples``: copy the example files and the protocols."""

from __future__ import annotations

import argparse
import shutil

from labpipe.cli.terminal import shorten_path
from labpipe.errors import UsageError
from labpipe.protocol.load import find_shipped_folder
from labpipe.store.replace import map_errors


def run(options: argparse.Namespace) -> int:
    """Copy the example files and the protocols; a file with other content is never replaced."""
    examples, protocols = find_shipped_folder("examples"), find_shipped_folder("protocols")
    targets = {options.folder / path.name: path for path in sorted(examples.iterdir())}
    targets |= {
        options.folder / "protocols" / path.name: path for path in sorted(protocols.iterdir())
    }
    copies = {
        target: source
        for target, source in targets.items()
        if source.is_file() and source.resolve() != target.resolve()  # not to itself
    }
    for copy, source in copies.items():
        if copy.exists() and copy.read_bytes() != source.read_bytes():
            raise UsageError.about("cli.other_example", copy)
    with map_errors(options.folder):
        for copy, source in copies.items():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, copy)
            print(f"wrote {shorten_path(copy)}")
    return 0
