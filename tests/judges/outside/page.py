"""The page of the measurements: docs/explanations/outside.md and its picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.judges.outside.cards import Card, Number
from tests.judges.outside.springback import STYLE, tables
from tests.judges.outside.springback import draw as draw_springback

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "explanations" / "outside.md"
PICTURE = ROOT / "docs" / "images" / "outside.png"
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"
SPRINGBACK = ("<!-- springback: begin -->", "<!-- springback: end -->")


def publish(cards: list[Card]) -> None:
    """Put the tables and misses between the marks of the page, and draw the picture."""
    text = PAGE.read_text(encoding="utf-8")
    for (begin, end), found in (((BEGIN, END), counted(cards)), (SPRINGBACK, tables())):
        before, after = text.partition(begin)[0], text.partition(end)[2]
        text = f"{before}{begin}\n{found}\n{end}{after}"
    PAGE.write_text(text, encoding="utf-8")
    draw(cards, PICTURE)
    draw_springback(PICTURE.with_name("springback.png"))


def counted(cards: list[Card]) -> str:
    """What was counted, the table, and a sentence for each miss."""
    numbers = [number for card in cards for number in card.numbers]
    inside = sum(number.is_inside for number in numbers)
    masses = [number for number in numbers if number.quantity == "mass"]
    light = sum(number.is_inside for number in masses)
    lines = [
        f"**{len(numbers)} numbers from {len(cards)} sources: {inside} inside the model's interval,"
        f" {len(numbers) - inside} outside.** Of these, {len(masses)} are masses ({light} inside), "
        f"{len(numbers) - len(masses)} stiffnesses and moduli ({inside - light} inside).",
        "",
        "| source | number | quantity | measured | model | inside |",
        "|---|---|---|---|---|---|",
        *(_row(card, number) for card in cards for number in card.numbers),
        "",
        "Outside, and why:",
        "",
        *_misses(cards),
    ]
    return "\n".join(lines)


def _row(card: Card, number: Number) -> str:
    low, high = number.interval
    unit = "" if number.unit == "1" else f" {number.unit}"
    inside = "yes" if number.is_inside else "**no**"
    model = f"{low:.4g} to {high:.4g}{unit}"
    return (
        f"| [{card.file}](../../tests/judges/outside/cards/{card.file}.toml) | {number.name} "
        f"| {number.quantity} | {number.value:.4g}{unit} | {model} | {inside} |"
    )


def _misses(cards: list[Card]) -> Iterator[str]:
    for card in cards:
        yield from (f"- *{each.name}*: {each.miss}" for each in card.numbers if each.miss)


def draw(cards: list[Card], path: Path) -> None:
    """Dots of measured over the middle of the model's interval, with the interval; misses named.

    The middle is the geometric one, so that a bound is as far from it above as below. Bending,
    whose bounds are far apart, has a panel and a scale of its own.
    """
    numbers = [number for card in cards for number in card.numbers]
    wide = [number for number in numbers if number.quantity.endswith("bending stiffness")]
    narrow = [number for number in numbers if number not in wide]
    heights = [len(narrow) + 1, len(wide) + 1]
    with style.context(STYLE):
        page = Figure(figsize=(6.3, 0.15 * sum(heights) + 1.2), layout="constrained")
        stretch, bend = page.subplots(2, 1, height_ratios=heights)
        _dots(stretch, narrow)
        stretch.set_title("Mass, stretch")
        _dots(bend, wide)
        bend.set_title("Bending, and twist over bending: from slip to stick")
        bend.set_xscale("log")
        bend.set_xticks([0.01, 0.1, 1.0, 10.0, 100.0])
        bend.xaxis.set_major_formatter("{x:g}")
        bend.set_xlabel("Measured over the middle of the model's interval (bar: the interval)")
        page.savefig(path, dpi=150, metadata={"Software": None})


def _dots(axes: Axes, numbers: Sequence[Number]) -> None:
    """One line for each number, the first on top."""
    for place, number in enumerate(reversed(numbers)):
        low, high = number.interval
        middle = (low * high) ** 0.5
        axes.plot([low / middle, high / middle], [place] * 2, color="0.75", linewidth=4.0)
        axes.plot(
            number.value / middle,
            place,
            marker="o" if number.is_inside else "D",
            color=_colour(number, "#0072b2"),
            markersize=3.5,
        )
    names = [each.name if each.is_inside else f"outside: {each.name}" for each in numbers]
    axes.set_yticks(range(len(names)), reversed(names), fontsize=6.0)
    for label, number in zip(axes.get_yticklabels(), reversed(numbers), strict=True):
        label.set_color(_colour(number, "black"))
    axes.set_ylim(-1, len(numbers))
    axes.grid(visible=True, axis="x", linewidth=0.4, color="0.9")


def _colour(number: Number, inside: str) -> str:
    return inside if number.is_inside else "#b34700"
