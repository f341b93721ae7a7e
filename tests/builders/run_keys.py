"""Which run the files of a test are of."""

from __future__ import annotations

import json
import re
from pathlib import Path

from labpipe.store.read import read_run


def runs(folder: Path) -> set[str]:
    """Keys of the run that the files of a test show: result, summary, figures as SVG and PNG."""
    found = {json.loads((folder / "summary.json").read_text("utf-8"))["run"]}
    found.add(read_run(folder / "result.h5"))
    for figure in (folder / "figures").iterdir():
        content = figure.read_bytes()
        key = rb"<dc:identifier>(\w{64})</dc" if figure.suffix == ".svg" else rb"run\x00(\w{64})"
        found |= {each.decode() for each in re.findall(key, content)}
        assert re.search(key, content), figure
    return found
