from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import jsonschema
import pytest
import yaml

from docs.site.reference_pages import format_json_schema
from labpipe.protocol.load import (
    format_protocol,
    load_protocol,
    load_test_sheet,
    parse_protocol,
    resolve_protocol,
)
from labpipe.protocol.schema import Protocol, list_result_names
from labpipe.readers.channels import find_channel

SHIPPED = sorted((Path(__file__).parents[2] / "protocols").glob("*.yaml"))


SCHEMA = jsonschema.Draft202012Validator(json.loads(format_json_schema(Protocol)))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_it_loads_and_asks_for_what_can_be_shown(path: Path) -> None:
    """By names that differ, in units of its own, and as the schema for editors has it."""
    SCHEMA.validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    protocol = load_protocol(path)
    assert protocol.name == path.stem
    assert protocol.about
    assert parse_protocol(format_protocol(protocol), "result.h5") == protocol
    names = [
        name
        for entry in protocol.results
        for name in list_result_names(entry.result, asdict(entry))
    ]
    assert len(names) == len(set(names))
    assert set(protocol.groups.main) <= set(names)
    shown = set(protocol.report.display)
    assert shown >= ({"force", "displacement"} if protocol.curve else set())
    kinds = {entry.result for entry in protocol.results}
    assert "stiffness" not in kinds or "stiffness" in shown


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

    protocol = resolve_protocol(load_test_sheet(sheet), sheet)

    assert protocol.name == path.stem
    assert protocol.specimen.length == 0.070


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
def test_it_knows_what_programs_call_force_and_displacement(path: Path) -> None:
    channels = load_protocol(path).sources["frame"].all_channels
    for names in COLUMNS.values():
        known = [(name, name) for name in ("Time", "Kraft Sollwert", *names, "Strain 1")]
        for channel, name in zip(("force", "displacement"), names, strict=True):
            # Beside an extensometer, names like Extension are not those of the crosshead.
            if channel in channels and not ("extension" in channels and channel != "force"):
                place = find_channel(channels[channel].names, known, path)
                assert known[place][0] == name
