from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.decks.ansys import MOST_POINTS, ansys_deck, shear_stiffness
from labpipe.records.arrays import Floats
from tests.builders.wire_tables import wire_table

COMPONENTS = ("BSAX", "BSM1", "BSM2", "BSTQ", "BSS1", "BSS2")


def parsed(text: str) -> list[tuple[str, list[str]]]:
    """Commands and their fields; what follows ``!`` is a comment."""
    commands = []
    for line in text.splitlines():
        assert line.isascii()
        assert len(line) <= 80
        command = line.partition("!")[0].strip()
        if command:
            name, *fields = command.split(",")
            commands.append((name.upper(), fields))
    return commands


def law_of(text: str, component: str) -> tuple[Floats, Floats]:
    """Strain and force, with the origin that the program understands."""
    points = [[float(v) for v in fields] for name, fields in parsed(text) if name == component]
    strain, force = np.array([[0.0, 0.0], *points]).T
    return strain, force


def test_a_plastic_general_section_is_opened_first() -> None:
    name, fields = parsed(ansys_deck(wire_table(), section=7))[0]
    assert (name, fields) == ("SECTYPE", ["7", "GENB", "PLASTIC", "A2"])


@pytest.mark.parametrize("component", COMPONENTS)
@pytest.mark.parametrize("wire", ["A1", "A2", "A3", "C5"])
def test_every_component_keeps_the_rules_of_the_program(wire: str, component: str) -> None:
    strain, force = law_of(ansys_deck(wire_table(wire)), component)
    assert 2 <= len(strain) - 1 <= MOST_POINTS
    assert np.all(np.diff(strain) > 0.0)
    slopes = np.diff(force) / np.diff(strain)
    if component in ("BSM1", "BSM2"):
        assert np.all(np.diff(slopes) < 0.0)
    else:
        assert np.allclose(slopes, slopes[0], rtol=1e-8)


@pytest.mark.parametrize("component", ["BSM1", "BSM2"])
@pytest.mark.parametrize("wire", ["A1", "A2", "A3", "C5"])
def test_bending_is_kept_within_the_stated_error(wire: str, component: str) -> None:
    table = wire_table(wire)
    text = ansys_deck(table)
    curvature, moment = law_of(text, component)
    assert curvature[-1] == pytest.approx(table.curvature[-1], rel=1e-11)
    off = np.interp(table.curvature[1:], curvature, moment) / table.moment[1:] - 1.0
    stated = float(text.partition("within ")[2].split()[0])
    # stated with two digits
    assert np.max(np.abs(off)) == pytest.approx(stated, rel=0.05)


def test_constant_stiffnesses_have_the_range_that_is_stated() -> None:
    table = wire_table()
    text = ansys_deck(table)
    for component, stiffness, end in (
        ("BSAX", table.axial_stiffness, 0.01),
        ("BSTQ", table.torsional_stiffness, 100.0),
        ("BSS1", shear_stiffness(table), 0.1),
    ):
        strain, force = law_of(text, component)
        assert strain[-1] == end
        assert force[-1] / strain[-1] == pytest.approx(stiffness, rel=1e-8)
    assert "to a strain of 0.01" in text
    assert "to 100 rad/m" in text


def test_shear_adds_a_thousandth_to_ten_diameters() -> None:
    table = wire_table()
    length = 10.0 * table.spec.wire_diameter
    bending = length**3 / (3.0 * table.stick_stiffness)
    assert length / shear_stiffness(table) == pytest.approx(1e-3 * bending)


def test_the_mass_stands_at_the_end() -> None:
    table = wire_table()
    name, (value,) = parsed(ansys_deck(table))[-1]
    assert name == "BSMD"
    assert float(value) == pytest.approx(table.mass_per_length, rel=1e-8)


def test_the_comments_say_range_and_limits() -> None:
    said = ansys_deck(wire_table())
    for words in (
        "Beyond this range the deck is not valid.",
        "Beyond the last point the program has no stiffness",
        "at most 20 allowed",
        "too stiff",
        "not the wire's, which is not known",
    ):
        assert words in said


@pytest.mark.parametrize("name", ["! no", "/EOF\n/EXIT", "0,35 mm²", "x" * 300, '"A2"'])
def test_a_name_breaks_nothing(name: str) -> None:
    text = ansys_deck(replace(wire_table(), name=name))
    usual = parsed(ansys_deck(wire_table()))
    assert parsed(text)[0][1][:3] == ["1", "GENB", "PLASTIC"]
    assert parsed(text)[1:] == usual[1:]


def test_sections_are_counted_from_one() -> None:
    with pytest.raises(ValueError, match=r"section=0: allowed are whole numbers >= 1"):
        ansys_deck(wire_table(), section=0)
