"""Bands of the response beside as many whole solutions: six lines, 200 draws each.

Of each kind one line of its own, with its calibration, and one of another wire. The response is
asked for the draws that were solved: by chance alone the width between quantiles of 200 draws is
off by 7 %, by 13 % where most of it is the scatter of specimens, of which three samples say little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from labpipe.rod.bands import StateBands, bands_of, bent
from labpipe.rod.path import RodPath
from labpipe.rod.response import Band, Fields, Response, band_of, respond
from tests.line_coverage.drawn_lines import KINDS, LineKind, Numbers, draw
from tests.line_coverage.line_judgement import ASKED
from tests.line_coverage.predicted_lines import Solver, beliefs_of, known_of, solvers_of
from tests.line_coverage.true_lines import held_at

SEED, OTHER_SEED, DRAWS = 42000, 42001, 200
"""Never changed."""
CASES = (*((kind, SEED) for kind in KINDS), (KINDS[0], OTHER_SEED))


@dataclass(frozen=True, slots=True)
class Compared:
    """A band of the response beside draws.

    Parameters
    ----------
    kind, wire : of the line
    name : of what is looked at
    inside : share of the draws inside the band; of an array the mean over its numbers
    width : between the quantiles of the response to the draws over that between those of the draws;
        of an array the median
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
    response : of what is looked at, by name
    solved : of the response, with the draws alone that were solved
    paths : of these draws
    held : number of the state that is held
    """

    wire: str
    states: tuple[StateBands, ...]
    response: Response
    solved: Response
    paths: tuple[RodPath, ...]
    held: int


def drawing(kind: LineKind, *, draws: int = DRAWS, seed: int = SEED) -> Drawing:
    """Predict a line with bands, and solve it for draws of the best solution."""
    drawn, found, held = draw(kind, seed), known_of(seed).calibration, held_at(kind)
    solve, belief = _Once(solvers_of(kind, drawn, found)[0]), beliefs_of(kind, drawn, found)[0]
    bands = bands_of(solve, [belief], at=(held, -1))
    response = respond(lambda inputs: _looked_at(solve(inputs), held), belief)
    if bands is None or response is None:
        raise RuntimeError(kind.name)
    paths = [(amounts, solve(belief.inputs(amounts))) for amounts in belief.amounts[:draws]]
    kept = [(amounts, path) for amounts, path in paths if path.status != "failed"]
    same = replace(belief, amounts=np.array([amounts for amounts, _ in kept]))
    solved = replace(response, belief=same)
    return Drawing(
        drawn.wire, bands.states, response, solved, tuple(path for _, path in kept), held
    )


class _Once:
    """Solves a line, for every set of inputs once."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.known: dict[tuple[float, ...], RodPath] = {}

    def __call__(self, inputs: Mapping[str, float]) -> RodPath:
        key = tuple(inputs.values())
        if key not in self.known:
            self.known[key] = self.solver(inputs)
        return self.known[key]


def _looked_at(path: RodPath, held: int) -> Fields | None:
    """What is looked at; of the bend radius the curvature vectors it is the least of."""
    if path.status == "failed":
        return None
    state = path.states[held]
    seen = state.positions, state.reaction_moments[:1], bent(state), path.last.positions
    return dict(zip(ASKED, seen, strict=True))


def compared(kind: LineKind, made: Drawing) -> Iterator[Compared]:
    """Shares of the draws inside, and widths."""
    seen = [_looked_at(path, made.held) for path in made.paths]
    for name in ASKED:
        measure = _radius if name == "bend radius" else np.asarray
        values = np.array([measure(each[name]) for each in seen if each is not None])
        band, same = (_band(each, name, measure) for each in (made.response, made.solved))
        yield Compared(kind.name, made.wire, name, *_beside(band, same, values), len(values))


def _radius(vectors: Numbers) -> Numbers:
    return np.asarray(1.0 / np.linalg.norm(vectors, axis=-1).max(axis=(-2, -1)))


def _band(response: Response, name: str, measure: Callable[[Numbers], Numbers]) -> Band:
    return band_of([response], lambda each: (measure(each.value[name]), measure(each.drawn(name))))


def _beside(band: Band, same: Band, values: Numbers) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975], axis=0)
    moves = high - low > 1e-3 * float(np.max(high - low))
    inside = (values >= band.lower) & (values <= band.upper)
    width = np.asarray(same.upper - same.lower)[moves] / np.asarray(high - low)[moves]
    return float(inside.mean(axis=0)[moves].mean()), float(np.median(width))


def case_of(case: tuple[LineKind, int]) -> list[Compared]:
    """All that is compared of a line."""
    kind, seed = case
    return list(compared(kind, drawing(kind, seed=seed)))


def all_cases(jobs: int) -> list[Compared]:
    """Solve the draws of all lines; some minutes."""
    with ProcessPoolExecutor(jobs) as pool:
        return [row for rows in pool.map(case_of, CASES) for row in rows]


def table(rows: list[Compared]) -> str:
    """In markdown: of each line the shares inside, and in brackets the widths."""
    names = list(dict.fromkeys(row.name for row in rows))
    lines = ["| line | wire | draws | " + " | ".join(names) + " |"]
    lines.append("|---|---|---:|" + "---:|" * len(names))
    for kind, wire in dict.fromkeys((row.kind, row.wire) for row in rows):
        own = [row for row in rows if (row.kind, row.wire) == (kind, wire)]
        cells = [f"{100.0 * row.inside:.1f} % ({row.width:.2f})" for row in own]
        lines.append(f"| {kind} | {wire} | {own[0].draws} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
