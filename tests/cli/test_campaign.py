from __future__ import annotations

import pytest

from labpipe.cli import BAD_INPUT, main


@pytest.mark.parametrize("action", ["run", "status", "query", "rebuild"])
def test_a_folder_that_is_not_there(action: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["campaign", action, "nowhere"]) == BAD_INPUT
    assert capsys.readouterr().err.startswith("labpipe campaign: ")
