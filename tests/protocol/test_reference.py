from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from docs.site.reference_pages import (
    PAGES,
    SCHEMAS,
    format_json_schema,
    replace_tables,
)
from tests.protocol.conftest import WIRE
from tests.protocol.test_harness_file import WHOLE


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_for_editors_is_fresh(name: str, repository: Path) -> None:
    committed = (repository / "docs" / "reference" / name).read_text(encoding="utf-8")

    assert committed == format_json_schema(SCHEMAS[name]), "run: make reference"


TEST_SHEET: dict[str, object] = {
    "test": "A1",
    "protocol": "wire",
    "specimen": {"type": "A", "spool": "s", "sample": 1, "length": "8 mm", "width": "1 mm"},
    "files": {"force": "a.mat", "markers": ["b.csv"]},
    "overrides": {"rig.cycles": {"value": 3, "because": "x"}},
}
HARNESS: dict[str, Any] = yaml.safe_load(WHOLE)
CLIP = HARNESS["boundaries"][0]


@pytest.mark.parametrize(
    ("name", "data", "changes"),
    [
        (
            "protocol.schema.json",
            yaml.safe_load(WIRE),
            [
                {"resluts": []},
                {"specimen": {"length": 85}},
                {"rig": {"cycles": 0}},
                {"steps": [{"step": "smoth"}]},
                {"sources": {"forse": {"reader": "motive-csv"}}},
                {"sources": {"markers": {"reader": "motive-cvs"}}},
                {"report": {"figures": ["wire-shape"]}},
            ],
        ),
        (
            "test-sheet.schema.json",
            TEST_SHEET,
            [{"specimen": {"type": "A", "spool": "s", "sample": 1, "w": 1}}],
        ),
        (
            "harness.schema.json",
            HARNESS,
            [
                {"line": HARNESS["line"] | {"length": 300}},
                {"boundaries": []},
                {"boundaries": [CLIP | {"kind": "clib"}]},
                {"boundaries": [CLIP | {"position": ["0 mm", "0 mm"]}]},
                {"gravity": "down"},
                {"sweep": {"length": ["310 mm"]}},
                {"branches": []},
            ],
        ),
    ],
)
def test_a_schema_takes_and_refuses_as_labpipe_does(
    name: str, data: dict[str, object], changes: list[dict[str, object]]
) -> None:
    schema = json.loads(format_json_schema(SCHEMAS[name]))
    jsonschema.Draft202012Validator.check_schema(schema)
    checker = jsonschema.Draft202012Validator(schema)
    assert checker.is_valid(data)
    for wrong in changes:
        assert not checker.is_valid(data | wrong), wrong


@pytest.mark.parametrize("name", PAGES)
def test_the_tables_of_a_page_are_fresh(name: str, repository: Path) -> None:
    committed = (repository / "docs" / "reference" / name).read_text(encoding="utf-8")

    assert committed == replace_tables(committed), "run: make reference"


@pytest.mark.parametrize(
    ("arguments", "folder"), [(["own"], "own"), ([], "docs/reference")], ids=["named", "default"]
)
def test_the_command_writes_them(
    arguments: list[str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["reference", *arguments])
    monkeypatch.delitem(sys.modules, "docs.site.reference_pages")

    runpy.run_module("docs.site.reference_pages", run_name="__main__")

    assert (tmp_path / folder / "protocol.schema.json").is_file()
