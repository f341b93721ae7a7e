"""Every deck says what its form of law loses."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, replace

import pytest

from labpipe.decks.deck_files import DECKS
from labpipe.decks.deck_losses import percent
from labpipe.law.loss_card import turn_loss
from tests.builders.wire_tables import loss_card, wire_table

OTHERS = "constant stiffness 83 %, Dahl 18 %, 4 sliders 1.8 %, 6 sliders 0.86 %, 8 sliders 0.52 %"


def words_of(deck: str) -> str:
    """The text of a deck on one line, without signs of comments."""
    return " ".join(re.sub(r"<!--|-->|(?m:^\s*(\*\*|!|#))", " ", deck).split())


@pytest.mark.parametrize("ending", [ending for ending in DECKS if not ending.endswith("json")])
def test_every_deck_says_what_forms_of_law_lose(ending: str) -> None:
    assert OTHERS in words_of(DECKS[ending](wire_table("A2")))


@pytest.mark.parametrize(
    ("ending", "said"),
    [
        ("csv", "This deck: first loading within 0 % of the wire's moment. Straightened again"),
        ("csv", "off by up to 108 % of the moment at the turn (from 0.072 1/m): a curve forgets"),
        ("abaqus.inp", "This deck: first loading within 0 % of the wire's moment."),
        (
            "abaqus.inp",
            "off by up to 176 % of the moment at the turn (from 62 1/m): if it hardens alike",
        ),
        ("ansys.inp", "This deck: first loading within 0.2 % of the wire's moment."),
        ("ansys.inp", "176 % of the moment at the turn (from 62 1/m): isotropic hardening."),
        ("calculix.inp", "moment from 0.25 1/m on, within 75 % below it."),
        ("mujoco.xml", "This deck: up to 988 % of the moment off over its range, and it forgets"),
    ],
)
def test_a_deck_says_what_it_loses_itself(ending: str, said: str) -> None:
    assert said in words_of(DECKS[ending](wire_table("A2")))


def test_the_constant_stiffness_by_hand() -> None:
    """988 %: the sticking wire's slope against the last secant."""
    table = wire_table("A2")
    assert table.stick_stiffness / table.secant_stiffness[-1] - 1.0 == pytest.approx(
        9.882, abs=0.01
    )


def test_numbers_in_both_jsons() -> None:
    table = wire_table("A2")
    card = loss_card(table.curvature, table.moment)
    turn = turn_loss(table.curvature, table.moment)
    for ending in ("json", "sliders.json"):
        found = json.loads(DECKS[ending](table))["loss_card"]
        assert found["constant"]["error"] == card.constant
        assert found["sliders"]["12"] == dict(card.sliders)[12]
        assert found["directions"]["16"] == dict(card.directions)[16] < found["directions"]["4"]
        assert found["way_back"] == asdict(turn)


def test_a_law_that_sliders_cannot_have() -> None:
    table = wire_table("A2")
    stiff = replace(table, moment=table.moment * (1.0 + (table.curvature / 50.0) ** 2))
    for ending in ("csv", "abaqus.inp", "ansys.inp", "calculix.inp", "mujoco.xml"):
        words = words_of(DECKS[ending](stiff))
        assert "This deck:" in words
        assert "No loss card of other forms: the law stiffens at curvature=12.3562 1/m" in words
    found = json.loads(DECKS["json"](stiff))["loss_card"]
    assert found["reason"].startswith("the law stiffens")
    assert found["way_back"]["curve"] > 0.0


def test_shares_in_words() -> None:
    shares = (1e-12, 0.00213, 0.0496, 0.83, 0.997, 19.95)
    assert [percent(share) for share in shares] == [
        *("0 %", "0.21 %", "5 %", "83 %", "100 %", "1995 %")
    ]
