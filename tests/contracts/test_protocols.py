"""Every shipped protocol keeps what DESIGN 5 promises of protocols."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from labpipe.protocol.json_schema import json_schema
from labpipe.protocol.load import (
    dump_protocol,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.results import result_names
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import READERS as NAMED_READERS
from labpipe.readers import READERS

SHIPPED = sorted((Path(__file__).parents[2] / "protocols").glob("*.yaml"))


def test_some_are_shipped() -> None:
    names = {path.stem for path in SHIPPED}
    assert {"wire-cantilever", "markers-only", "force-displacement"} <= names
    assert {"corrugated-tube", "twist-tube", "pet-tape", "tensile", "stiff-bar"} <= names


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_loads_and_is_called_like_its_file(path: Path) -> None:
    protocol = load_protocol(path)

    assert protocol.name == path.stem
    assert protocol.about
    assert parse_protocol(dump_protocol(protocol), "result.h5") == protocol


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_test_sheet_that_names_it_resolves(path: Path, tmp_path: Path) -> None:
    roles = load_protocol(path).sources
    sheet = tmp_path / "test.yaml"
    sheet.write_text(
        f"test: T1\nprotocol: {path.stem}\n"
        "specimen: {type: synthetic, spool: s1, sample: 1, length: 70 mm}\n"
        f"files: {{{', '.join(f'{role}: {role}.x' for role in roles)}}}\n",
        encoding="utf-8",
    )

    protocol = resolve(load_test_sheet(sheet), sheet)

    assert protocol.name == path.stem
    assert protocol.specimen.length == 0.070


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_it_asks_for_is_told_apart_and_shown_in_its_own_units(path: Path) -> None:
    protocol = load_protocol(path)
    entries = [entry.model_dump(by_alias=True) for entry in protocol.results]
    names = [name for entry in entries for name in result_names(entry["result"], entry)]

    assert len(names) == len(set(names))
    assert set(protocol.groups.main) <= set(names)
    shown = set(protocol.report.display)
    assert shown >= ({"force", "displacement"} if protocol.curve else set())
    if any(entry["result"] == "stiffness" for entry in entries):
        assert "stiffness" in shown


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_fits_the_schema_for_editors(path: Path) -> None:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))

    jsonschema.Draft202012Validator(json.loads(json_schema(Protocol))).validate(data)


def test_protocols_can_name_just_the_readers_that_there_are() -> None:
    assert set(NAMED_READERS) == set(READERS)
