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
    folders = {
        options.folder: find_shipped_folder("examples"),
        options.folder / "protocols": find_shipped_folder("protocols"),
    }
    copies = {
        folder / source.name: source
        for folder, shipped_folder in folders.items()
        for source in sorted(shipped_folder.iterdir())
        if source.is_file() and source.resolve() != (folder / source.name).resolve()
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
