"""Peak force against the smallest force that a standard or the lab allows for its conductor."""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf, isclose
from typing import Annotated, Any, ClassVar

from labpipe.errors import Fault
from labpipe.records.declarations import Area, Force, FromCard, Output, WholeNumber
from labpipe.records.estimates import UnavailableError
from labpipe.records.result import Result, Status
from labpipe.results.cycles import PeakForce
from labpipe.results.kinds import Computed, Kind
from labpipe.results.reduced_test import ReducedTest
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT, judge_sample
from labpipe.units import parse_quantity

CONDUCTOR = "conductor"
"""Label of the specimen that states the section of its conductor."""
MAX_SECTION_DEVIATION = 0.005
"""Relative difference of two sections that are the same row of a card."""
_AWG = re.compile(r"awg\s*(\d+)|(\d+)\s*awg", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CardRow:
    """Limits for one section of a conductor."""

    awg: Annotated[int, WholeNumber(0, 60), "American wire gauge"]
    section: Area
    limits: Annotated[
        dict[str, Force], "By column; a limit that the source does not give is absent"
    ]

    def __str__(self) -> str:
        return f"AWG {self.awg} ({1e6 * self.section:.4g} mm^2)"


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCard:
    """Smallest forces by section and column, and where they are printed."""

    source: Annotated[str, "Document that prints the limits"]
    rows: tuple[CardRow, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the names of the columns in the order of the rows."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.limits))


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceLimit(Kind):
    """``force_limit`` (N) and ``peak_over_limit`` (1): largest force over the smallest allowed."""

    result: ClassVar = "force-limit"
    outputs: ClassVar = (
        Output(FORCE_LIMIT, "N", "Smallest force allowed", ()),
        Output(PEAK_OVER_LIMIT, "1", "Peak force over its limit", ("force", "observation")),
    )
    card: Annotated[
        LimitCard | None, FromCard(), "A shipped card by its name, or one that is written out"
    ] = None
    column: Annotated[str, "Of the card"] = ""
    at_least: Annotated[Force | None, "Limit of the lab, in place of a card"] = None
    conductor: Annotated[str, "Section that `at_least` holds for, such as AWG 20"] = ""

    @staticmethod
    def find_contradictions(data: Mapping[str, Any]) -> Iterator[Fault]:
        """Find a limit that is missing or stated twice, and a card without its column."""
        if (data.get("card") is None) == (data.get("at_least") is None):
            yield Fault.of("protocol.one_limit")
        elif data.get("card") is not None and not data.get("column"):
            yield Fault.of("protocol.no_card_column", ("card",))

    def list_methods(self, test: ReducedTest) -> tuple[str, str]:
        """Name the source of the limit."""
        del test
        source = "stated by the protocol"
        if self.card is not None:
            source = f"column {self.column} of a card: {self.card.source}"
        return source, "largest force over the smallest force allowed"

    def measure(self, test: ReducedTest) -> Computed:
        """Divide the largest force by the limit for the conductor of the test sheet."""
        limit, section = self._find_limit(test.setup.labels.get(CONDUCTOR, ""))
        (of_limit, of_share), status = self.list_methods(test), Status.OK
        peak = max(PeakForce().compute(test).results, key=lambda peak: peak.value or -inf)
        reasons = tuple(
            dict.fromkeys([*peak.reasons, *test.collect_doubts(("observation",), None)])
        )
        if peak.value is None or reasons:
            status = Status.FAILED if peak.value is None else Status.DOUBTFUL
        share = replace(
            peak,
            name=PEAK_OVER_LIMIT,
            value=None if peak.value is None else peak.value / limit,
            unit="1",
            interval=peak.interval
            and replace(
                peak.interval, lower=peak.interval.lower / limit, upper=peak.interval.upper / limit
            ),
            status=status,
            reasons=reasons,
            method=of_share,
            estimate=None if peak.estimate is None else peak.estimate / limit,
            budget=tuple(replace(part, change=part.change / limit) for part in peak.budget),
        )
        share = replace(share, remark=judge_sample(share).text)
        return Computed((Result(FORCE_LIMIT, limit, "N", method=of_limit, remark=section), share))

    def _find_limit(self, conductor: str) -> tuple[float, str]:
        """Return the limit for a conductor, N, and the section that it holds for."""
        if self.at_least is not None:
            if self.conductor and _read_section(self.conductor) != _read_section(conductor):
                raise UnavailableError.of(
                    "results.other_section", stated=self.conductor, found=conductor or "none"
                )
            return self.at_least, self.conductor
        if self.card is None:
            raise UnavailableError.of("results.no_limit_stated")
        row = _find_row(self.card, conductor)
        if self.column not in row.limits:
            names = ", ".join(row.limits)
            raise UnavailableError.of(
                "results.limit_not_given", row=row, column=self.column, names=names
            )
        return row.limits[self.column], str(row)


def _read_section(conductor: str) -> tuple[str, float]:
    """Read a section such as ``AWG 20`` or ``0.519 mm^2``: its unit and number."""
    if match := _AWG.fullmatch(conductor.strip()):
        return "AWG", float(match[1] or match[2])
    try:
        return "mm^2", 1e6 * parse_quantity(conductor, "m^2")
    except ValueError as error:
        found = repr(conductor) if conductor else "none"
        raise UnavailableError.of("results.no_conductor", found=found) from error


def _find_row(card: LimitCard, conductor: str) -> CardRow:
    """Return the row of a section; there is no interpolation between two rows."""
    unit, number = _read_section(conductor)
    sizes = {row.awg if unit == "AWG" else 1e6 * row.section: row for row in card.rows}
    for size, row in sizes.items():
        if isclose(size, number, rel_tol=MAX_SECTION_DEVIATION):
            return row
    ordered = sorted(sizes)
    place = bisect(ordered, number)
    rows = " and ".join(str(sizes[size]) for size in ordered[max(place - 1, 0) : place + 1])
    raise UnavailableError.of("results.section_not_in_card", conductor=conductor, rows=rows)
