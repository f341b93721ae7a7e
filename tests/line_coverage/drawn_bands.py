"""Bands of the linearised response beside as many whole solutions: five lines, 200 draws each.

Of each kind one line of its own, with its calibration. Draws are those that the bands were made of.
What two samples of 200 quantiles differ by, by chance, is 7 % of a band's width.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labpipe.rod.bands import StateBands, bands_of, bent
from labpipe.rod.path import RodPath
from labpipe.rod.response import Band
from tests.line_coverage.drawn_lines import LineKind, Numbers, draw
from tests.line_coverage.predicted_lines import beliefs_of, known_of, solvers_of
from tests.line_coverage.true_lines import held_at

SEED, DRAWS = 42000, 200
"""Never changed."""


@dataclass(frozen=True, slots=True)
class Compared:
    """A band of the linearised response beside draws.

    Parameters
    ----------
    kind, wire : of the line
    name : of what is looked at
    inside : share of the draws inside the band; of an array the mean over its numbers
    width : of the band over that between the quantiles of the draws; of an array the median
    draws : that were solved
    """

    kind: str
    wire: str
    name: str
    inside: float
    width: float
    draws: int


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A line with its bands and its draws.

    Parameters
    ----------
    wire : name
    states : bands, held and on the way back
    paths : of the draws that were solved
    held : number of the state that is held
    """

    wire: str
    states: tuple[StateBands, ...]
    paths: tuple[RodPath, ...]
    held: int


def drawing(kind: LineKind, *, draws: int = DRAWS, seed: int = SEED) -> Drawing:
    """Predict a line with bands, and solve it for draws of the best solution."""
    drawn, found = draw(kind, seed), known_of(seed).calibration
    solver, belief = solvers_of(kind, drawn, found)[0], beliefs_of(kind, drawn, found)[0]
    bands = bands_of(solver, [belief], at=(held_at(kind), -1))
    if bands is None:
        raise RuntimeError(kind.name)
    paths = (solver(belief.inputs(amounts)) for amounts in belief.amounts[:draws])
    kept = tuple(path for path in paths if path.status != "failed")
    return Drawing(drawn.wire, bands.states, kept, held_at(kind))


def compared(kind: LineKind, made: Drawing) -> Iterator[Compared]:
    """Shares of the draws inside, and widths."""
    held, back = made.states
    there = [path.states[made.held] for path in made.paths]
    most = [1.0 / np.linalg.norm(bent(state), axis=-1).max() for state in there]
    for name, band, values in (
        ("shape", held.positions, [state.positions for state in there]),
        ("moment", held.reaction_moments, [state.reaction_moments[:1] for state in there]),
        ("bend radius", held.smallest_bend_radius, most),
        ("shape on the way back", back.positions, [path.last.positions for path in made.paths]),
    ):
        own = Band(*(each[:1] for each in _ends(band))) if name == "moment" else band
        yield Compared(kind.name, made.wire, name, *_beside(own, np.array(values)), len(there))


def _ends(band: Band) -> tuple[Numbers, Numbers, Numbers]:
    return band.value, band.lower, band.upper


def _beside(band: Band, values: Numbers) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975], axis=0)
    moves = high - low > 1e-3 * float(np.max(high - low))
    inside = (values >= band.lower) & (values <= band.upper)
    width = np.asarray(band.upper - band.lower)[moves] / np.asarray(high - low)[moves]
    return float(inside.mean(axis=0)[moves].mean()), float(np.median(width))


def table(rows: list[Compared]) -> str:
    """In markdown: of each line the shares inside, and in brackets the widths."""
    names = list(dict.fromkeys(row.name for row in rows))
    lines = ["| line | wire | draws | " + " | ".join(names) + " |"]
    lines.append("|---|---|---:|" + "---:|" * len(names))
    for kind in dict.fromkeys(row.kind for row in rows):
        own = [row for row in rows if row.kind == kind]
        cells = [f"{100.0 * row.inside:.1f} % ({row.width:.2f})" for row in own]
        lines.append(f"| {kind} | {own[0].wire} | {own[0].draws} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
