"""Fixtures that tests of every layer share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.approved import approved
from tests.builders.small_tests import Lab, Run, make_lab, runner, small_scenario

__all__ = ["approved"]
REPOSITORY = Path(__file__).resolve().parent.parent

settings.register_profile(
    "labpipe", deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("labpipe")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--approve", action="store_true", help="write texts as the tests give them")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The top folder of the project."""
    return REPOSITORY


@pytest.fixture(scope="session")
def realdata() -> Path:
    """The folder of real exports; tests that need it are skipped where it is absent."""
    named = os.environ.get("LABPIPE_REALDATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "realdata"
    if not folder.is_dir():
        pytest.skip("no folder of real exports here (set LABPIPE_REALDATA)")
    return folder


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Two cycles without mishaps; not to be changed."""
    return make_lab(tmp_path_factory.mktemp("lab"), small_scenario())


@pytest.fixture
def lab(pristine: Lab, tmp_path: Path) -> Lab:
    """A copy of the test that may be changed."""
    return pristine.copy(tmp_path)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)
