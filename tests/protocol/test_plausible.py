from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import (
    dump_protocol,
    load_harness,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.plausible import PLAUSIBLE
from labpipe.units import parse_quantity
from tests.protocol.conftest import SHEET, Tell, Told

LENGTH = "length: 80 mm"
OVERRIDES = "overrides:\n  {}: {{value: {}, because: x}}\n"


@pytest.mark.parametrize(
    ("written", "key", "wider"),
    [
        ("length: 100 km", "specimen.length", "plausible.length.to: {value: 100 km"),
        ("length: 80 m", "specimen.length", "plausible.length.to: {value: 80 m"),
        ("length: 80 um", "specimen.length", "plausible.length.from: {value: 80 um"),
        ("span: 76 m", "specimen.span", "plausible.span.to: {value: 76 m"),
        ("outer_diameter: 2.1 m", "specimen.outer_diameter", "plausible.diameter.to"),
        ("wall_thickness: 0.4 m", "specimen.wall_thickness", "plausible.wall.to"),
        ("mandrel: 3 km", "specimen.mandrel", "plausible.other.to"),
        ("mass_per_length: 60 kg/m", "specimen.mass_per_length", "plausible.mass_per_length.to"),
        ("bundle: {wires: {B1: {number: 2, diameter: 1.1 m}}}", "wires.B1.diameter", "diameter.to"),
        ("bundle: {wires: 2 B1 (1.1 m)}", "wires.B1.diameter", "plausible.diameter.to"),
        ("bundle: {wires: 2 B1, conduit: x, conduit_bore: 8 m}", "conduit_bore", "diameter.to"),
    ],
)
def test_an_implausible_size_of_a_specimen_is_refused(
    tell: Tell, written: str, key: str, wider: str
) -> None:
    (message,) = tell(SHEET.replace(LENGTH, written))

    place, _, rest = message.partition(": expected a plausible ")
    assert place.startswith(f"{Path('test', 'test.yaml')}, line 3, column ")
    assert place.endswith(f"{key})")
    assert wider in rest
    assert "overrides" in rest


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("length: 760 mm", "length: 760 m", "rig.string.length"),
        ("1 mm/s, cycles", "9 m/s, cycles", "rig.crosshead_speed"),
        ("cycles: 3", "cycles: 3, stroke: 53 m", "rig.stroke"),
        ("counterweight: 2.7 g", "counterweight: 2700 kg", "rig.string.counterweight"),
        ("grip_offset: 6 mm", "grip_offset: -6 m", "markers.grip_offset"),
        ("{length: 85 mm}", "{section: {wall: 3 m}}", "specimen.section.wall"),
        ("{length: 85 mm}", "{section: {area: 5 m^2}}", "specimen.section.area"),
        ("{length: 85 mm}", "{section: {width: 18 m}}", "specimen.section.width"),
    ],
)
def test_an_implausible_dimension_of_a_protocol_is_refused(
    told: Told, old: str, new: str, place: str
) -> None:
    (message,) = told((old, new))

    assert f"({place}): expected a plausible " in message


@pytest.mark.parametrize("ends", ["{from: 1 mm, to: 100 km}", "{to: 100 km}", "{to: 2000 km}"])
def test_a_test_or_a_protocol_widens_a_range(
    lab: Path, wire: str, write: Callable[[str], Path], ends: str
) -> None:
    long = SHEET.replace(LENGTH, "length: 100 km")
    path = write(long + OVERRIDES.format("plausible.length", ends))
    own = resolve(load_test_sheet(path), path, lab / "protocols")
    assert own.specimen.length == 1e5
    assert own.plausible["length"].start == "1 mm"
    assert own.plausible["span"].stop == PLAUSIBLE["span"][2]
    assert parse_protocol(dump_protocol(own), "result.h5") == own

    file = lab / "protocols" / "wire.yaml"
    file.write_text(f"{wire}plausible: {{length: {ends}}}\n", encoding="utf-8")
    path = write(long)
    assert resolve(load_test_sheet(path), path, lab / "protocols").specimen.length == 1e5


def test_a_message_names_the_override_that_lets_a_test_through(
    lab: Path, write: Callable[[str], Path], tell: Tell
) -> None:
    long = SHEET.replace(LENGTH, "length: 100 km")
    (message,) = tell(long)
    override = message.partition("write '")[2].partition("' under")[0].replace("...", "x")

    path = write(f"{long}overrides:\n  {override}\n")

    assert resolve(load_test_sheet(path), path, lab / "protocols").specimen.length == 1e5


@pytest.mark.parametrize(
    ("written", "place", "expected"),
    [
        ("{length: {to: 5}}", "plausible.length.to", "a quantity with a unit such as m"),
        ("{speed: {to: 5 m}}", "plausible.speed.to", "a quantity with a unit such as m/s"),
        ("{length: {from: 2 m, to: 1 m}}", "plausible.length", "'from' of at least zero"),
        ("{length: 5 m}", "plausible.length", "a block of keys"),
        ("{lenght: {from: 1 m, to: 5 m}}", "plausible.lenght", "'length'"),
        ("{length: {to: [5 m]}}", "plausible.length.to", "text"),
        ("{length: {most: 5 m}}", "plausible.length.most", "one of the keys"),
    ],
)
def test_a_wrong_range_is_refused(told: Told, written: str, place: str, expected: str) -> None:
    (message,) = told(("report:\n", f"plausible: {written}\nreport:\n"))

    assert f"({place})" in message
    assert expected in message


@pytest.mark.parametrize(("kind", "ends"), PLAUSIBLE.items())
def test_every_shipped_range_is_one(kind: str, ends: tuple[str, str, str]) -> None:
    unit, least, most = ends

    assert 0.0 <= parse_quantity(least, unit) < parse_quantity(most, unit), kind


HARNESS = """\
version: 1
line: {length: 300 mm, section: {bending_stiffness: 1 N*mm^2, torsional_stiffness: 1 N*mm^2,
  largest_curvature: 20 1/m, diameter: 2 mm}}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
"""


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("length: 300 mm", "length: 300 m", "line.length"),
        ("diameter: 2 mm", "diameter: 2 m", "line.section.diameter"),
        ("boundaries:", "sweep: {length: [310 mm, 320 m]}\nboundaries:", "sweep.length.1"),
    ],
)
def test_a_harness_has_plausible_dimensions_too(
    tmp_path: Path, old: str, new: str, key: str
) -> None:
    path = tmp_path / "harness.yaml"
    path.write_text(HARNESS.replace(old, new), encoding="utf-8")
    with pytest.raises(ProtocolError) as info:
        load_harness(path)
    assert f"({key}): expected a plausible " in str(info.value)

    widened = str(info.value).partition("write '")[2].partition("'")[0]
    path.write_text(f"{HARNESS.replace(old, new)}{widened}\n", encoding="utf-8")
    load_harness(path)
