"""What is built holds all that an installed labpipe needs, and works away from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder


@pytest.fixture(scope="module")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    (built,) = WheelBuilder(str(repository)).build(directory=str(folder))
    return Path(built)


def test_it_holds_the_package_with_its_data_and_nothing_else(repository: Path, wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    package = {
        path.relative_to(repository).as_posix()
        for path in (repository / "labpipe").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    shipped = {
        f"labpipe/shipped/{path.relative_to(repository).as_posix()}"
        for folder in ("protocols", "examples")
        for path in (repository / folder).iterdir()
    }
    about = {name for name in names if name.partition("/")[0].endswith(".dist-info")}
    assert names - about == package | shipped
    assert any(name.endswith("/licenses/LICENSE") for name in about)


@pytest.mark.slow
def test_it_works_away_from_the_checkout(wheel: Path, tmp_path: Path) -> None:
    place, here = tmp_path / "installed", tmp_path / "here"
    here.mkdir()
    zipfile.ZipFile(wheel).extractall(place)
    code = (
        "import sys, labpipe; from labpipe.cli import main;"
        " assert 'installed' in labpipe.__file__;"
        " sys.exit(main(['examples']) or main(['check', 'examples/protocols']))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=here,
        env=os.environ | {"PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.endswith("0 tests: no faults found\n")
    assert (here / "examples" / "wires.xlsx").is_file()
