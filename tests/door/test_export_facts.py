from __future__ import annotations

import json

import pytest

from labpipe.door.export_facts import inspect
from labpipe.errors import ReadError
from tests.builders.small_tests import Lab, Run


def test_an_export_says_what_the_command_prints(pristine: Lab, run: Run) -> None:
    export = pristine.raw / "force.mat"
    found = inspect(export)
    assert f"{found!r}\n" == run("inspect", export).out
    assert found.facts == json.loads(run("inspect", export, "--json").out)
    assert found.file == export


def test_tables_of_an_export(pristine: Lab) -> None:
    found = inspect(str(pristine.raw / "force.mat"))
    texts, numbers = ("clock", "name", "path", "unit", "unit_in_file"), ("first", "last")
    kinds = {str(name): str(kind) for name, kind in found.channels.dtypes.items()}
    wanted = dict.fromkeys(texts, "str") | dict.fromkeys((*numbers, "min", "max"), "float64")
    assert kinds == wanted | {"missing": "int64"}
    assert found.channels["path"][0] == "Model Root/Load Cell/Out1"
    assert found.channels["unit"].isna().all()  # a MAT file does not say it
    assert "units_not_stated" in found.notes["code"].tolist()
    assert list(found.data) == ["force"]
    assert len(found.data["force"]) == found.facts["streams"][0]["samples"]


def test_markers_have_no_channels(pristine: Lab) -> None:
    found = inspect(pristine.raw / "take.csv")
    assert len(found.channels) == 0
    assert found.channels.dtypes["first"] == "float64"
    assert next(iter(found.data)) == "take"


def test_what_is_no_export(pristine: Lab) -> None:
    with pytest.raises(ReadError, match="expected an export of a known format"):
        inspect(pristine.sheet)
