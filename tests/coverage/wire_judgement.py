"""Whether calibrations say too much: counts by kind of campaign, judged together after Holm."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binom

from tests.coverage.judgement import ENOUGH, LEAST, LEVEL, STATED, holm
from tests.coverage.rests_on import ROOT

PAGE = ROOT / "docs" / "explanations" / "calibration.md"
BEGIN, END = "<!-- campaigns: begin -->", "<!-- campaigns: end -->"
NAMES = {
    "radial_friction": "phi",
    "insulation_modulus": "E_ins",
    "copper_scale": "copper",
}
IDENTIFIED = "identified"

Line = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Held:
    """How often something held, of how often it was asked."""

    held: int
    asked: int

    @property
    def share(self) -> float:
        """NaN if it was never asked."""
        return self.held / self.asked if self.asked else float("nan")

    @property
    def chance(self) -> float:
        """Of so few, if each held in `STATED` of all cases."""
        return float(binom.cdf(self.held, self.asked, STATED))

    def __str__(self) -> str:
        return f"{self.held} of {self.asked}" if self.asked else ""


def is_held(parameter: Line) -> bool:
    """Whether some part of an interval holds the truth."""
    return any(low <= parameter["truth"] <= high for low, high in parameter["parts"])


def by_kind(lines: Iterable[Line]) -> dict[str, list[Line]]:
    """Campaigns with a calibration, by the name of their kind, in order."""
    found: dict[str, list[Line]] = {}
    for line in lines:
        if line.get("parameters"):
            found.setdefault(line["kind"], []).append(line)
    return found


def counted(lines: Sequence[Line], name: str, *, identified: bool) -> Held:
    """Intervals of a parameter, all or those that were called identified."""
    said = [line["parameters"][name] for line in lines]
    said = [each for each in said if not identified or each["verdict"] == IDENTIFIED]
    return Held(sum(map(is_held, said)), len(said))


def bands(lines: Sequence[Line]) -> Held:
    """Bands of the mean sample on another length."""
    asked = [low <= truth <= high for line in lines for truth, low, high in line["bands"]]
    return Held(sum(asked), len(asked))


def too_seldom(lines: Iterable[Line]) -> dict[tuple[str, str], bool]:
    """By kind and parameter: whether what was called identified holds too seldom.

    Significantly less often than in 95 % (Holm's family has all that were asked `LEAST` times).
    """
    every = {
        (kind, name): counted(own, name, identified=True)
        for kind, own in by_kind(lines).items()
        for name in NAMES
    }
    family = [key for key, held in every.items() if held.asked >= LEAST]
    seldom = holm([every[key].chance for key in family], LEVEL)
    return dict(zip(family, seldom, strict=True))


def tables(lines: Sequence[Line], rests_on: str) -> str:
    """Everything that was counted, in markdown."""
    return "\n".join([*_summary(lines, rests_on), "", *_table(lines)])


def _summary(lines: Sequence[Line], rests_on: str) -> Iterator[str]:
    judged = too_seldom(lines)
    every = {key: counted(by_kind(lines)[key[0]], key[1], identified=True) for key in judged}
    below = [key for key in judged if every[key].share < ENOUGH]
    seldom = [key for key, is_seldom in judged.items() if is_seldom]
    total = Held(
        sum(each.held for each in every.values()), sum(each.asked for each in every.values())
    )
    errors = sum(bool(line["error"]) or "failed" in line for line in lines)
    yield (
        f"{len(lines)} campaigns of {len(by_kind(lines))} kinds; holds while what the numbers rest"
        f" on is unchanged (`{rests_on}`). {errors} ended without a calibration."
    )
    yield ""
    yield (
        f"Parameters that were called identified in {LEAST} campaigns of a kind or more:"
        f" {len(judged)}. Together their intervals hold in {total}"
        f" ({100.0 * total.share:.1f} %); {len(seldom)} hold significantly less often than in 95 %"
        f" (Holm, 1 %), {len(below)} in less than 90 %{_named(below, every)}."
    )


def _named(keys: Sequence[tuple[str, str]], every: dict[tuple[str, str], Held]) -> str:
    said = [f"{NAMES[key[1]]} of {key[0]}: {every[key]}" for key in keys]
    return f" ({'; '.join(said)})" if said else ""


def _table(lines: Sequence[Line]) -> Iterator[str]:
    names = list(NAMES.values())
    heads = ("campaigns", "n", *names, *(f"{each}, identified" for each in names))
    yield _row(*heads, "bands", "more than one solution")
    yield "|---|" + "---:|" * (len(heads) + 1)
    judged = too_seldom(lines)
    for kind, own in by_kind(lines).items():
        plain = [counted(own, name, identified=False).held for name in NAMES]
        said = [_bold(counted(own, name, identified=True), judged, (kind, name)) for name in NAMES]
        several = sum(line["solutions"] > 1 for line in own)
        share = f"{100.0 * bands(own).share:.0f} %"
        yield _row(kind, len(own), *plain, *said, share, several)


def _bold(held: Held, judged: dict[tuple[str, str], bool], key: tuple[str, str]) -> str:
    return f"**{held}**" if judged.get(key) else str(held)


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def publish(lines: Sequence[Line], rests_on: str, page: Path = PAGE) -> None:
    """Put the tables between their marks on the page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    text = f"{before}{BEGIN}\n\n{tables(lines, rests_on)}\n\n{END}{after}"
    page.write_text(text, encoding="utf-8")
