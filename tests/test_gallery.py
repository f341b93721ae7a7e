"""The examples of the documentation run, and draw what the site shows."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure

SCRIPTS = sorted((Path(__file__).resolve().parents[1] / "docs" / "gallery").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_the_example_runs_and_draws(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with rc_context():
        names = runpy.run_path(str(script))
    figures = [name for name in names.values() if isinstance(name, Figure)]
    assert figures
    assert all(figure.axes[0].has_data() for figure in figures)
    assert all(path.name.startswith("tmp") for path in tmp_path.iterdir()), "it litters"
