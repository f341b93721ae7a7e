from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import jsonschema
import pytest
import yaml

from labpipe.protocol.load import (
    dump_protocol,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.outline import result_names
from labpipe.protocol.reference import json_schema
from labpipe.protocol.schema import Protocol
from labpipe.readers.channels import find_channel

SHIPPED = sorted((Path(__file__).parents[2] / "protocols").glob("*.yaml"))


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
    names = [
        name for entry in protocol.results for name in result_names(entry.result, asdict(entry))
    ]

    assert len(names) == len(set(names))
    assert set(protocol.groups.main) <= set(names)
    shown = set(protocol.report.display)
    assert shown >= ({"force", "displacement"} if protocol.curve else set())
    if any(entry.result == "stiffness" for entry in protocol.results):
        assert "stiffness" in shown


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_fits_the_schema_for_editors(path: Path) -> None:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))

    jsonschema.Draft202012Validator(json.loads(json_schema(Protocol))).validate(data)


OF_FRAMES = [path for path in SHIPPED if "reader: load-frame" in path.read_text("utf-8")]


COLUMNS = {
    "MTS TestSuite": ("Load", "Crosshead"),
    "MTS TestSuite, names with underscores": ("_Load", "_Crosshead"),
    "MTS TestSuite, extension": ("_Load", "_Extension"),
    "MTS bend template": ("Ch 1 Force", "Ch 1 Displacement"),
    "MTS 793": ("Axial Force", "Axial Displacement"),
    "MTS 793, German": ("Ch 1 Kraft", "Ch 1 Weg"),
    "Instron Bluehill": ("Load", "Extension"),
    "Instron Bluehill, Chinese": ("力", "位移"),
    "Instron 8800, German": ("Kraft", "Maschine"),
    "testXpert": ("Standard force", "Standard travel"),
    "testXpert, absolute": ("Standard force", "Absolute crosshead travel"),
    "testXpert, German": ("Standardkraft", "Standardweg"),
    "testXpert, French": ("Force standard", "Course standard"),
    "testXpert, Spanish": ("Fuerza estándar", "Carrera"),
    "Walter+Bai, French": ("C_1_Force", "C_1_Déplacement"),
    "Trapezium": ("Force", "Stroke"),
    "Nexygen": ("Load", "Machine Extension"),
    "Microtest": ("Force", "Elongation"),
    "DMA": ("Static Force", "Displacement"),
    "Italian": ("Carico", "Spostamento"),
    "Spanish": ("Carga", "Desplazamiento"),
    "capitals": ("FORCE", "POSITION"),
}
"""Force and displacement, as programs call them."""


@pytest.mark.parametrize("path", OF_FRAMES, ids=lambda path: path.stem)
@pytest.mark.parametrize("names", COLUMNS.values(), ids=COLUMNS)
def test_it_knows_what_programs_call_force_and_displacement(
    path: Path, names: tuple[str, str]
) -> None:
    frame = load_protocol(path).sources["frame"]
    known = [(name, name) for name in ("Time", "Kraft Sollwert", *names, "Strain 1")]
    for channel, name in zip(("force", "displacement"), names, strict=True):
        if channel in frame.all_channels:
            found = find_channel(frame.all_channels[channel].channel, known, path)
            assert known[found][0] == name
