"""Loss card of a deck: errors of its form of the law and of other forms, as text and numbers."""

from __future__ import annotations

import textwrap
from dataclasses import asdict
from functools import lru_cache

import numpy as np

from labpipe.law.loss_card import LossCard, TurnLoss, turn_loss
from labpipe.law.table_sliders import table_card
from labpipe.records.wire import WireTable


def loss_text(card: LossCard) -> str:
    """Describe in one line the errors of a law in forms that programs can represent.

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
    """Format a share in per cent with two digits; 100 % and more with all digits."""
    min_share = 1e-6
    if share >= 0.995:
        return f"{round(100.0 * share):d} %"
    return f"{100.0 * share:.2g} %" if share > min_share else "0 %"


def deck_loss(first: float, way_back: float, turn: float, why: str) -> str:
    """Describe in one line the error of the form of law of a deck.

    Parameters
    ----------
    first : largest error on first loading, as a share of the moment
    way_back : largest error on unloading, as a share of the moment at the reversal
    turn : 1/m, curvature at that reversal
    why : what the program does on unloading
    """
    return (
        f"This deck: error on first loading up to {percent(first)} of the moment; on unloading "
        f"from bends up to half of the range up to {percent(way_back)} of the moment at the "
        f"reversal (from {turn:.2g} 1/m): {why}."
    )


def memoryless_loss(table: WireTable) -> str:
    """Describe in one line the error of a curve without memory."""
    turn = table_turn(table)
    why = "a curve has no memory, a wire follows Masing's rule"
    return deck_loss(0.0, turn.curve, turn.curve_at, why)


def isotropic_loss(table: WireTable, first: float, why: str) -> str:
    """Describe in one line the error of isotropic hardening.

    Parameters
    ----------
    table : law of the wire
    first : error of the deck's points on first loading, as a share of the moment
    why : what the program does on unloading
    """
    turn = table_turn(table)
    return deck_loss(first, turn.isotropic, turn.isotropic_at, why)


def deck_losses(table: WireTable, loss: str, *, wide: int = 120) -> tuple[str, ...]:
    """Return the loss card for the head of a deck: its own error, then those of other forms.

    Parameters
    ----------
    table : law of the wire; without a fit by sliders, the reason instead
    loss : error of the deck itself
    wide : characters of a line
    """
    try:
        other_forms = loss_text(table_card(table))
    except ValueError as error:
        other_forms = f"No loss card of other forms: {error}."
    return tuple(
        line.replace("~%", " %")  # keeps a number and its per cent sign on one line
        for sentence in (loss, other_forms)
        for line in textwrap.wrap(sentence.replace(" %", "~%"), wide)
    )


@lru_cache(maxsize=4)
def table_turn(table: WireTable) -> TurnLoss:
    """Return the errors on unloading of forms without the memory of a wire, over its table."""
    return turn_loss(table.curvature, table.moment)


def constant_loss(table: WireTable, stiffness: float) -> float:
    """Return the largest error of the moment of a constant stiffness, N m^2, over a table."""
    return float(np.max(np.abs(stiffness * table.curvature[1:] / table.moment[1:] - 1.0)))


def card_numbers(table: WireTable) -> dict[str, object]:
    """Return the loss card for a JSON deck.

    Parameters
    ----------
    table : law of the wire; without a fit by sliders, the reason and the errors on unloading
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
