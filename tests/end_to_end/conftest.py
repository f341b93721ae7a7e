from __future__ import annotations

import pytest

from tests.builders.small_tests import Lab, state


@pytest.fixture(scope="session")
def processed(pristine: Lab, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """A cantilever test with its results; not to be changed."""
    from labpipe.process.run import Task, process

    lab = pristine.copy(tmp_path_factory.mktemp("processed"))
    process(Task(lab.sheet))
    assert len(state(lab.home / "processed")) == 8
    return lab
