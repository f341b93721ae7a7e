"""Measurements of others against the models, strict both ways, and the cards they stand on."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from tests.judges.outside.cards import FOLDER, Card, Number, Open, read_card, read_cards
from tests.judges.outside.models import interval
from tests.judges.outside.page import BEGIN, END, PAGE, counted
from tests.judges.outside.three_point import stiffness

CARDS = read_cards()
NUMBERS = [pytest.param(each, id=each.name) for card in CARDS for each in card.numbers]
FILED = [pytest.param(card, id=card.file) for card in CARDS if card.files]
AREA = np.pi * 2.1e-3**2 / 4.0


@pytest.mark.parametrize("number", NUMBERS)
def test_inside_or_said_why_not(number: Number) -> None:
    low, high = number.interval
    where = f"{number.value:.5g} {number.unit}, model {low:.5g} to {high:.5g}"
    if number.is_inside:
        assert not number.miss, f"{where}: inside, and yet the card says why it is outside"
    else:
        assert number.miss.endswith("."), f"{where}: outside, and the card does not say why"


def test_there_are_enough() -> None:
    assert len(NUMBERS) >= 20
    assert len(CARDS) >= 5
    not_mass = [card for card in CARDS if any(each.quantity != "mass" for each in card.numbers)]
    assert len(not_mass) >= 5


@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.file)
def test_cards_say_where_from_and_why(card: Card) -> None:
    said = (card.source, card.read, card.licence, card.specimen, card.method)
    assert all(len(words) > 10 for words in said)
    for each in card.open.values():
        assert each.low < each.high
        assert len(each.why) > 10


def test_an_unknown_key_is_refused(tmp_path: Path) -> None:
    text = (FOLDER / "opgw.toml").read_text(encoding="utf-8")
    path = tmp_path / "card.toml"
    path.write_text(text.replace("quantity =", "quantities ="), encoding="utf-8")
    with pytest.raises(TypeError, match="quantities"):
        read_card(path)
    path.write_text(text.replace('"modulus"\ngiven', '"moduli"\ngiven'), encoding="utf-8")
    with pytest.raises(TypeError, match="moduli"):
        read_card(path)


def test_a_number_outside_is_outside() -> None:
    straight = [{"count": 1, "diameter_mm": 2.1, "material": "x"}]
    given = {"rings": straight, "counted": "x"}
    ranges = {"modulus_x_gpa": (100.0, 110.0)}
    low, high = interval("axial", given, ranges)
    assert (low, high) == pytest.approx((100e9 * AREA, 110e9 * AREA))
    number = Number("n", "q", "MN", 1.001 * high / 1e6, "axial", given, ranges=ranges)
    assert not number.is_inside


def test_the_axial_stiffness_of_seven_wires_by_hand() -> None:
    """E A (1 + 6 cos^3), with the lay length 12 times the outer diameter of the strand."""
    rings = [
        {"count": 1, "diameter_mm": 2.1, "material": "x"},
        {"count": 6, "diameter_mm": 2.1, "material": "x", "lay": "lay_outer"},
    ]
    low, high = interval("axial", {"rings": rings, "modulus_x_gpa": 70.0, "lay_outer": 12.0}, {})
    cosine = 1.0 / np.hypot(1.0, 2.0 * np.pi * 2.1 / (12.0 * 6.3))
    assert low == high == pytest.approx(70e9 * AREA * (1.0 + 6.0 * cosine**3), rel=1e-12)


def test_the_line_through_published_points() -> None:
    found = [each for card in CARDS for each in card.numbers if each.points]
    assert found
    for each in found:
        slope = np.polyfit(each.points["strain"], each.points["force_mn"], 1)[0]
        assert each.value == pytest.approx(slope, rel=1e-3)


def test_the_page_holds_what_is_counted() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.partition(BEGIN)[2].partition(END)[0].strip() == counted(CARDS).strip()


def test_open_ranges_are_of_one_form() -> None:
    with pytest.raises(TypeError):
        Open(low=1.0, high=2.0)  # type: ignore[call-arg]


@pytest.mark.realdata
@pytest.mark.parametrize("card", FILED)
def test_files_are_the_ones_that_were_read(card: Card, realdata: Path) -> None:
    for name, digest in card.files.items():
        assert hashlib.sha256((realdata / name).read_bytes()).hexdigest() == digest, name


@pytest.mark.realdata
@pytest.mark.parametrize(
    "number", [p for p in NUMBERS if isinstance(p.values[0], Number) and p.values[0].bent]
)
def test_three_point_stiffness_is_that_of_the_files(number: Number, realdata: Path) -> None:
    assert stiffness(realdata, number.bent) == pytest.approx(number.value, rel=1e-3)


@pytest.mark.realdata
@pytest.mark.parametrize("card", [p for p in FILED if "harness" in str(p.id)])
def test_masses_stand_in_the_files(card: Card, realdata: Path) -> None:
    texts = [(realdata / name).read_text(encoding="utf-8") for name in card.files]
    parts = [part for text in texts for part in re.split(r"<General_wire|<DocumentVersion ", text)]
    for number in card.numbers:
        wanted = (number.value, number.given["diameter_mm"])
        stated = (
            {float(each) for each in re.findall(r"<Value_?[Cc]omponent>([\d.]+)<", part)}
            for part in parts
        )
        assert any(set(wanted) <= each for each in stated), number.name


def test_the_twist_of_a_cable_without_lay() -> None:
    """Straight strands do not couple: both ends are one GJ, over stick and over slip."""
    given = {
        **{"mass_g_per_m": 20.0, "copper_mass_share": 0.5, "lay_deg": 1e-4, "strands": 19.0},
        **{"density": 1300.0, "modulus_copper_gpa": 110.0, "modulus_insulation_mpa": 20.0},
    }
    (low, high), (slip, stick) = (interval(model, given, {}) for model in ("cord_torsion", "cord"))
    assert low * stick == pytest.approx(high * slip, rel=1e-9)
    strand = 0.25 * (20e-3 * 0.5 / 8960.0) ** 2 / np.pi / 19.0  # sum of I = A^2 / (4 pi n)
    assert high * slip > 2.0 * 110e9 / (2.0 * 1.34) * strand
