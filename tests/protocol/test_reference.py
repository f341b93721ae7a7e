from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from labpipe.protocol.reference import (
    PAGES,
    SCHEMAS,
    json_schema,
    with_tables,
)
from labpipe.protocol.schema import Protocol


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_for_editors_is_fresh(name: str, repository: Path) -> None:
    kept = (repository / "docs" / "reference" / name).read_text(encoding="utf-8")

    assert kept == json_schema(SCHEMAS[name]), "run: make reference"


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_is_one(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(json_schema(SCHEMAS[name])))


def _refused(data: Any) -> bool:
    return not jsonschema.Draft202012Validator(json.loads(json_schema(Protocol))).is_valid(data)


def test_the_schema_takes_and_refuses_as_labpipe_does(wire: str) -> None:
    data = yaml.safe_load(wire)

    assert not _refused(data)
    assert _refused(data | {"resluts": []})
    assert _refused(data | {"specimen": {"length": 85}})
    assert _refused(data | {"rig": {"cycles": 0}})
    assert _refused(data | {"steps": [{"step": "smoth"}]})
    assert _refused(data | {"sources": {"forse": {"reader": "motive-csv"}}})
    assert _refused(data | {"sources": {"markers": {"reader": "motive-cvs"}}})
    assert _refused(data | {"report": {"figures": ["wire-shape"]}})


def test_a_test_sheet_fits_its_schema() -> None:
    sheet = {
        "test": "A1",
        "protocol": "wire",
        "specimen": {"type": "A", "spool": "s", "sample": 1, "length": "8 mm", "width": "1 mm"},
        "files": {"force": "a.mat", "markers": ["b.csv"]},
        "overrides": {"rig.cycles": {"value": 3, "because": "x"}},
    }
    validator = jsonschema.Draft202012Validator(
        json.loads(json_schema(SCHEMAS["test-sheet.schema.json"]))
    )

    assert validator.is_valid(sheet)
    assert not validator.is_valid(
        sheet | {"specimen": {"type": "A", "spool": "s", "sample": 1, "w": 1}}
    )


@pytest.mark.parametrize("name", PAGES)
def test_the_tables_of_a_page_are_fresh(name: str, repository: Path) -> None:
    kept = (repository / "docs" / "reference" / name).read_text(encoding="utf-8")

    assert kept == with_tables(kept), "run: make reference"


@pytest.mark.parametrize(
    ("arguments", "folder"), [(["own"], "own"), ([], "docs/reference")], ids=["named", "default"]
)
def test_the_command_writes_them(
    arguments: list[str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["reference", *arguments])
    monkeypatch.delitem(sys.modules, "labpipe.protocol.reference")

    runpy.run_module("labpipe.protocol.reference", run_name="__main__")

    assert (tmp_path / folder / "protocol.schema.json").is_file()
