from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from labpipe.decks.abaqus import abaqus_deck
from labpipe.decks.deck_law import solid_area
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from tests.builders.wire_tables import wire_table


@dataclass
class Block:
    keyword: str
    parameters: dict[str, str]
    data: list[list[float]] = field(default_factory=list)


def parsed(text: str) -> list[Block]:
    """Blocks of an input file, by the syntax rules of its guide."""
    blocks: list[Block] = []
    lines = [line for line in text.splitlines() if not line.startswith("**")]
    while lines:
        line = lines.pop(0)
        assert line.isascii()
        assert len(line) <= 256
        if not line.startswith("*"):
            blocks[-1].data.append([float(value) for value in line.split(",")])
            continue
        while line.rstrip().endswith(","):
            line += lines.pop(0)
        keyword, *parameters = (part.strip() for part in line.split(","))
        pairs = (part.partition("=") for part in parameters)
        blocks.append(Block(keyword, {key.strip(): value.strip() for key, _, value in pairs}))
    return blocks


def law_of(blocks: list[Block], keyword: str) -> tuple[Floats, Floats]:
    block = next(block for block in blocks if block.keyword == keyword)
    assert block.parameters == {}
    moment, curvature = np.array(block.data).T
    return curvature, moment


def comments(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if line.startswith("**"))


def test_the_blocks_and_their_order() -> None:
    blocks = parsed(abaqus_deck(wire_table()))
    assert [block.keyword for block in blocks] == [
        "*BEAM GENERAL SECTION",
        *("*AXIAL", "*M1", "*M2", "*TORQUE"),
    ]
    section, axial, _, _, torque = blocks
    assert set(section.parameters) == {"SECTION", "ELSET", "DENSITY"}
    assert section.parameters["SECTION"] == "NONLINEAR GENERAL"
    assert section.parameters["ELSET"] == "A2"
    assert axial.parameters == torque.parameters == {"LINEAR": ""}


def test_the_section_lines() -> None:
    table = wire_table()
    section = parsed(abaqus_deck(table))[0]
    (area, i11, i12, i22, torsion), direction = section.data
    assert area == pytest.approx(solid_area(table), rel=1e-8)
    assert (i12, i11) == (0.0, i22)
    assert torsion == pytest.approx(2.0 * i11)
    assert direction == [0.0, 0.0, -1.0]


def test_the_constant_stiffnesses() -> None:
    table = wire_table()
    blocks = {block.keyword: block for block in parsed(abaqus_deck(table))}
    assert blocks["*AXIAL"].data == [[pytest.approx(table.axial_stiffness, rel=1e-8)]]
    assert blocks["*TORQUE"].data == [[pytest.approx(table.torsional_stiffness, rel=1e-8)]]


@pytest.mark.parametrize("most", [None, 40, 7])
@pytest.mark.parametrize("keyword", ["*M1", "*M2"])
def test_the_law_is_kept_within_what_is_stated(keyword: str, most: int | None) -> None:
    table = wire_table()
    text = abaqus_deck(table, most_points=most)
    curvature, moment = law_of(parsed(text), keyword)
    assert (curvature[0], moment[0]) == (0.0, 0.0)
    assert curvature[-1] == pytest.approx(table.curvature[-1], rel=1e-11)
    assert most is None or len(curvature) <= most
    off = np.interp(table.curvature[1:], curvature, moment) / table.moment[1:] - 1.0
    stated = float(comments(text).partition("within ")[2].split()[0])
    # stated with two digits
    assert np.max(np.abs(off)) == pytest.approx(stated, rel=0.05, abs=1e-11)
    assert np.all(np.diff(np.diff(moment) / np.diff(curvature)) < 0.0)


def test_density_gives_the_mass_per_length() -> None:
    table = wire_table()
    section = parsed(abaqus_deck(table))[0]
    area = section.data[0][0]
    assert float(section.parameters["DENSITY"]) * area == pytest.approx(
        table.mass_per_length, rel=1e-8
    )


def test_the_comments_say_range_and_limits() -> None:
    said = comments(abaqus_deck(wire_table()))
    for words in (
        "Beyond this range the deck is not valid.",
        "curvature from 0 to 125 1/m",
        "elastic-plastic",
        "too stiff",
        "Units: m, N",
    ):
        assert words in said


@pytest.mark.parametrize("name", ['say "A2"', "*M1\n*STEP", "0,35 mm²", "x" * 300])
def test_a_name_breaks_nothing(name: str) -> None:
    table: WireTable = replace(wire_table(), name=name)
    text = abaqus_deck(table)
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 256
    usual = parsed(abaqus_deck(wire_table()))
    assert [block.data for block in parsed(text)] == [block.data for block in usual]
