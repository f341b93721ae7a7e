from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.decks.calculix import TIP, calculix_deck
from labpipe.law.equivalent_material import equivalent_material
from labpipe.records.quality import QualityNote, Severity
from tests.builders.wire_tables import wire_table


def blocks_of(text: str) -> list[tuple[str, list[str]]]:
    """Keyword lines, each with its data lines."""
    blocks: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        assert line.isascii()
        assert len(line) <= 132
        if line.startswith("**"):
            assert not blocks
        elif line.startswith("*"):
            blocks.append((line, []))
        else:
            blocks[-1][1].append(line)
    return blocks


def numbers(lines: list[str]) -> list[list[float]]:
    return [[float(part) for part in line.split(",") if part.strip()] for line in lines]


def comments(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if line.startswith("**"))


def test_the_blocks_and_their_order() -> None:
    keywords = [keyword for keyword, _ in blocks_of(calculix_deck(wire_table()))]
    assert keywords == [
        "*NODE, NSET=ALL",
        "*ELEMENT, TYPE=C3D20R, ELSET=WIRE",
        *(f"*NSET, NSET={name}" for name in ("CLAMP", "HINGE", "CUT", TIP)),
        "*BOUNDARY",
        *("*MATERIAL, NAME=WIRE", "*ELASTIC", "*PLASTIC", "*DENSITY"),
        "*SOLID SECTION, ELSET=WIRE, MATERIAL=WIRE",
        *("*STEP, NLGEOM, INC=8000", "*STATIC", "*BOUNDARY"),
        *(f"*NODE PRINT, NSET={TIP}", f"*NODE PRINT, NSET={TIP}, TOTALS=ONLY"),
        "*END STEP",
    ]


def test_nodes_and_elements_are_numbered_without_gaps() -> None:
    blocks = dict(blocks_of(calculix_deck(wire_table(), n_along=3))[:6])
    nodes = numbers(blocks["*NODE, NSET=ALL"])
    assert [row[0] for row in nodes] == list(range(1, len(nodes) + 1))
    lines = blocks["*ELEMENT, TYPE=C3D20R, ELSET=WIRE"]
    whole = numbers([first + second for first, second in zip(lines[::2], lines[1::2], strict=True)])
    assert {len(row) for row in whole} == {21}
    assert [row[0] for row in whole] == list(range(1, 19))
    tip = [int(n) for row in numbers(blocks[f"*NSET, NSET={TIP}"]) for n in row]
    assert {nodes[n - 1][1] for n in tip} == {0.085}
    assert {nodes[n - 1][2] for n in tip} == {0.0}


def test_the_material() -> None:
    table = wire_table("A3")
    blocks = dict(blocks_of(calculix_deck(table)))
    diameter = 2.0 * table.layout.wire_radius
    expected = equivalent_material(table.curvature[1:], table.moment[1:], diameter)
    assert numbers(blocks["*ELASTIC"]) == [[pytest.approx(expected.modulus, rel=1e-8), 0.3]]
    stress, strain = np.array(numbers(blocks["*PLASTIC"])).T
    assert stress == pytest.approx(expected.stress, rel=1e-8)
    assert strain == pytest.approx(expected.plastic_strain, rel=1e-7)
    assert strain[0] == 0.0
    [[density]] = numbers(blocks["*DENSITY"])
    assert density * np.pi / 4.0 * diameter**2 == pytest.approx(table.mass_per_length, rel=1e-8)


def test_the_tip_goes_to_six_tenths_of_the_length() -> None:
    step = blocks_of(calculix_deck(wire_table(), n_steps=40))[-5:]
    assert numbers(step[0][1]) == [[0.025, 1.0, 1e-8, 0.025]]
    assert step[1][1] == [f"{TIP}, 2, 2, 0.051"]


def test_the_tip_goes_no_further_than_the_law() -> None:
    table = wire_table()
    short = replace(table, tip_deflection=table.tip_deflection[:20], tip_force=table.tip_force[:20])
    text = calculix_deck(short)
    reach = f"{table.tip_deflection[19]:.6g}"
    assert f"{TIP}, 2, 2, {table.tip_deflection[19]:.9g}" in text
    assert f"** Free length 0.085 m, tip deflection to {reach} m." in text


def test_a_wire_without_a_cantilever_gets_the_reason_alone() -> None:
    note = QualityNote("cantilever_cut", Severity.WARNING, "row 2", "no curve: the law stiffens")
    table = replace(wire_table(), tip_deflection=np.zeros(1), tip_force=np.zeros(1), notes=(note,))
    text = calculix_deck(table)
    assert text == comments(text) + "\n"
    assert text.endswith("** No model of it:\n** no curve: the law stiffens\n")
    silent = calculix_deck(replace(table, notes=()))
    assert silent.endswith("** No model of it:\n** the table has no cantilever\n")


def test_the_comments_say_range_and_error() -> None:
    text = comments(calculix_deck(wire_table()))
    assert "** Wire A2, made by labpipe" in text
    assert "** Range: curvature from 0 to 125 1/m" in text
    assert "** Diameter 0.0016 m. Linear up to 0.25 1/m:" in text
    assert " % below the wire's (at 0.0125 1/m)." in text
    assert " 1/m to the end of the range it is within 1 %." in text
    assert "Computed, not measured" in text


def test_a_law_that_the_bar_cannot_follow_is_told() -> None:
    table = wire_table()
    stiffening = replace(table, moment=1e-6 * table.curvature**2)
    text = comments(calculix_deck(stiffening))
    assert "% above the wire's (at " in text
    assert "Nowhere up to the end of the range is it within 1 % of the wire's moment." in text


@pytest.mark.parametrize(
    ("options", "message"),
    [({"n_steps": 0}, "n_steps=0: allowed"), ({"n_along": 0}, "n_along=0: allowed")],
)
def test_numbers_out_of_range(options: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        calculix_deck(wire_table(), **options)
