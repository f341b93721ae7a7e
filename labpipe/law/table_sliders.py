"""Sliders of a wire from its table, and their loss card, for decks and rods."""

from __future__ import annotations

from functools import lru_cache

from labpipe.law.loss_card import COUNTS, LossCard, card_of
from labpipe.law.sliders import SliderLaw, fit_sliders
from labpipe.records.wire import WireTable

SLIDERS = 12
"""With fewer, the error of the residual curvature after unloading exceeds 2 %."""


def sliders_of(table: WireTable, sliders: int = SLIDERS) -> SliderLaw:
    """Fit sliders to a wire over its whole table.

    Parameters
    ----------
    table : law of the wire
    sliders : at most

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return _fitted(table, sliders)


@lru_cache(maxsize=16)  # tables are hashed by identity
def _fitted(table: WireTable, sliders: int) -> SliderLaw:
    return fit_sliders(table.curvature, table.moment, sliders)


@lru_cache(maxsize=4)
def table_card(table: WireTable) -> LossCard:
    """Compute the loss card of a wire over its table.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return card_of(
        table.curvature, table.moment, [sliders_of(table, n_sliders) for n_sliders in COUNTS]
    )
