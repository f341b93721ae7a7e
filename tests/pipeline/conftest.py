"""A small synthetic test, simulated once and copied for whoever changes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.builders.small_tests import Lab, Run, make_lab, runner, small_scenario


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
