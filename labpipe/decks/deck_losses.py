"""The loss card of a deck, in words and numbers: what its form of law loses, and other forms."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache

import numpy as np

from labpipe.law.loss_card import LossCard, TurnLoss, turn_loss
from labpipe.law.table_sliders import table_card
from labpipe.records.wire import WireTable

_WIDE = 120
_NOTHING = 1e-6
_TIED = "~%"


def loss_words(card: LossCard) -> str:
    """Tell in one line what a law loses in forms that programs can hold.

    Parameters
    ----------
    card : of the law
    """
    sliders = ", ".join(f"{number} sliders {percent(lost)}" for number, lost in card.sliders)
    return (
        f"Loss card, largest error of the moment from {card.first:.3g} to {card.last:.4g} 1/m, "
        f"each form at its best: constant stiffness {percent(card.constant)}, Dahl "
        f"{percent(card.dahl.error)}, {sliders}."
    )


def percent(share: float) -> str:
    """A share in per cent, to two digits; all of those of a large one."""
    if share >= 0.995:
        return f"{round(100.0 * share):d} %"
    return f"{100.0 * share:.2g} %" if share > _NOTHING else "0 %"


def own_loss(first: float, way_back: float, turn: float, why: str) -> str:
    """Tell in one line what the form of a deck loses.

    Parameters
    ----------
    first : largest error on first loading, as a share of the moment
    way_back : on the way back from a bend, as a share of the moment at the turn
    turn : 1/m, of that bend
    why : what the program does there
    """
    return (
        f"This deck: first loading within {percent(first)} of the wire's moment. Straightened "
        f"again after bends up to half of the range it is off by up to {percent(way_back)} of the "
        f"moment at the turn (from {turn:.2g} 1/m): {why}."
    )


def forgets(table: WireTable) -> str:
    """What a curve without memory loses, in one line."""
    turn = table_turn(table)
    return own_loss(0.0, turn.curve, turn.curve_at, "a curve forgets, a wire follows Masing's rule")


def hardens(table: WireTable, first: float, why: str) -> str:
    """What isotropic hardening loses, in one line.

    Parameters
    ----------
    table : law of the wire
    first : error of the deck's points on first loading, as a share of the moment
    why : what the program is known to do
    """
    turn = table_turn(table)
    return own_loss(first, turn.isotropic, turn.isotropic_at, why)


def deck_losses(table: WireTable, own: str, *, wide: int = _WIDE) -> tuple[str, ...]:
    """Loss card for the head of a deck: what it loses itself, then what other forms would.

    Parameters
    ----------
    table : law of the wire; one that sliders cannot have gets the reason in place of other forms
    own : of the deck itself
    wide : characters of a line
    """
    try:
        others = loss_words(table_card(table))
    except ValueError as error:
        others = f"No loss card of other forms: {error}."
    return tuple(line for words in (own, others) for line in _wrapped(words, wide))


def _wrapped(words: str, wide: int) -> Iterator[str]:
    """Lines of at most so many characters, a number and its per cent on one."""
    for line in textwrap.wrap(words.replace(" %", _TIED), wide):
        yield line.replace(_TIED, " %")


@lru_cache(maxsize=4)
def table_turn(table: WireTable) -> TurnLoss:
    """What forms without a wire's memory lose on the way back, over the table of a wire."""
    return turn_loss(table.curvature, table.moment)


def constant_loss(table: WireTable, stiffness: float) -> float:
    """Largest error of the moment of a constant stiffness, N m^2, over the table of a wire."""
    return float(np.max(np.abs(stiffness * table.curvature[1:] / table.moment[1:] - 1.0)))


def card_numbers(table: WireTable) -> dict[str, object]:
    """Loss card for a JSON deck.

    Parameters
    ----------
    table : law of the wire; one that sliders cannot have gets the reason and what a way back loses
    """
    way_back = asdict(table_turn(table))
    try:
        card = table_card(table)
    except ValueError as error:
        return {"reason": f"{error}", "way_back": way_back}
    return {
        "curvature": [card.first, card.last],
        "constant": {"stiffness": card.stiffness, "error": card.constant},
        "dahl": card.dahl.error,
        "sliders": {str(number): lost for number, lost in card.sliders},
        "directions": {str(number): lost for number, lost in card.directions},
        "way_back": way_back,
    }
