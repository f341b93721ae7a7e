"""Cards of other people's measurements: `cards/*.toml`, read strictly."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from tests.judges.outside.models import MODELS, Bounds, interval

FOLDER = Path(__file__).resolve().parent / "cards"
UNITS = {"g/m": 1e-3, "kg/m": 1.0, "MN": 1e6, "GPa": 1e9, "N mm2": 1e-6, "1": 1.0}
"""In SI units."""


@dataclass(frozen=True)
class Open:
    """What a source leaves open: a range, and why it is that wide."""

    low: float
    high: float
    why: str


@dataclass(frozen=True)
class Number:
    """A measured value; `miss` says why it lies outside the model's interval, where it does."""

    name: str
    quantity: str
    unit: str
    value: float
    model: str
    given: Mapping[str, Any] = field(default_factory=dict)
    bent: Mapping[str, Any] = field(default_factory=dict)
    points: Mapping[str, Any] = field(default_factory=dict)
    miss: str = ""
    ranges: Mapping[str, Bounds] = field(default_factory=dict)

    @cached_property
    def interval(self) -> Bounds:
        """What the model says, in the number's own unit."""
        low, high = interval(self.model, self.given, self.ranges)
        return low / UNITS[self.unit], high / UNITS[self.unit]

    @property
    def is_inside(self) -> bool:
        low, high = self.interval
        return low <= self.value <= high


@dataclass(frozen=True)
class Card:
    """One source."""

    file: str
    title: str
    source: str
    read: str
    licence: str
    specimen: str
    method: str
    numbers: tuple[Number, ...]
    open: Mapping[str, Open]
    files: Mapping[str, str]


def read_card(path: Path) -> Card:
    """Read a card; an unknown or missing key is a TypeError, an unknown model or unit too."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    ranges = {name: Open(**each) for name, each in table.pop("open").items()}
    shared = table.pop("shared", {})
    ends = {name: (each.low, each.high) for name, each in ranges.items()}
    numbers = []
    for each in table.pop("number"):
        number = Number(**{**each, "given": {**shared, **each.get("given", {})}, "ranges": ends})
        if number.model not in MODELS or number.unit not in UNITS:
            message = f"{path.name}, {number.name}: model {number.model!r}, unit {number.unit!r}"
            raise TypeError(message)
        numbers.append(number)
    files = table.pop("files", {})
    return Card(path.stem, numbers=tuple(numbers), open=ranges, files=files, **table)


def read_cards() -> list[Card]:
    """All cards, by the names of their files."""
    return [read_card(path) for path in sorted(FOLDER.glob("*.toml"))]
