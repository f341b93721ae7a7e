"""Run the notebooks of the documentation and keep their output: ``python -m tests.notebooks``."""

from __future__ import annotations

from tests.notebooks.running import FOLDER, keep

if __name__ == "__main__":
    for path in sorted(FOLDER.glob("*.ipynb")):
        keep(path)
