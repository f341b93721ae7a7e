"""Every shipped protocol keeps what DESIGN 5 promises of protocols."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from labpipe.protocol.json_schema import json_schema
from labpipe.protocol.load import dump_protocol, load_protocol, parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import READERS as NAMED_READERS
from labpipe.readers import READERS

SHIPPED = sorted((Path(__file__).parents[2] / "protocols").glob("*.yaml"))


def test_some_are_shipped() -> None:
    names = {path.stem for path in SHIPPED}
    assert {"wire-cantilever", "markers-only", "force-displacement"} <= names


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_loads_and_is_called_like_its_file(path: Path) -> None:
    protocol = load_protocol(path)

    assert protocol.name == path.stem
    assert protocol.about
    assert parse_protocol(dump_protocol(protocol), "result.h5") == protocol


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_fits_the_schema_for_editors(path: Path) -> None:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))

    jsonschema.Draft202012Validator(json.loads(json_schema(Protocol))).validate(data)


def test_protocols_can_name_just_the_readers_that_there_are() -> None:
    assert set(NAMED_READERS) == set(READERS)
