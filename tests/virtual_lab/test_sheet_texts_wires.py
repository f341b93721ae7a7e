from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.virtual_lab.sheet_texts import write_wire_sheet
from labpipe.virtual_lab.specimens import WIRES
from labpipe.wire.wire_table import build


def test_the_sheet_says_what_the_virtual_wires_are(tmp_path: Path) -> None:
    sheet = write_wire_sheet(tmp_path / "wires")
    specs = {spec.name: spec for spec in read_wire_sheet(sheet)}
    assert list(specs) == list(WIRES)
    for name, wire in WIRES.items():
        section, virtual = build(specs[name]).section, wire.section()
        assert section.kind == virtual.kind
        assert specs[name].wire_diameter == pytest.approx(wire.diameter, rel=1e-6)
        assert section.x == pytest.approx(virtual.x, abs=1e-9)
        assert [layer.area for layer in section.layers] == pytest.approx(
            [layer.area for layer in virtual.layers], rel=1e-6
        )
        assert [layer.lay_angle for layer in section.layers] == pytest.approx(
            [layer.lay_angle for layer in virtual.layers], abs=1e-6
        )
