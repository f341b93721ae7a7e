from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.harness_loading import load_harness
from tests.protocol.test_harness_reach import BETWEEN_CLIPS


def test_a_fault_of_the_grammar_comes_before_one_of_reach(tmp_path: Path) -> None:
    """A line too short is said once its numbers are readable, with the key as it is written."""
    path = tmp_path / "harness.yaml"
    path.write_text(BETWEEN_CLIPS.replace("300 mm", "200 mm"), encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"harness\.yaml, line 11, .*\(boundaries\.1\): "):
        load_harness(path)
    path.write_text(BETWEEN_CLIPS.replace("300 mm", "200 N"), encoding="utf-8")
    with pytest.raises(ProtocolError, match=r"harness\.yaml, line 3, .*\(line\.length\): "):
        load_harness(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"none\.yaml"):
        load_harness(tmp_path / "none.yaml")
