"""Lines in space whose truth is solved once more, by a rod that knows nothing of the package.

Numbers that were asked of them are put beside those of the study, as shares of the bands' widths.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from labpipe.rod.boundaries import EARTH
from labpipe.rod.rotations import frame_from_axes, matrices
from tests.coverage.page import table as markdown
from tests.judges.foreign import wire_section as foreign
from tests.line_coverage.drawn_lines import (
    FIRST_SEED,
    KINDS,
    LAYING,
    LOADING,
    NODES,
    RETURNING,
    Drawn,
    LineKind,
    Numbers,
    draw,
)
from tests.line_coverage.line_judgement import ASKED
from tests.line_coverage.predicted_lines import looked_at, nominal_torsion
from tests.line_coverage.space_rod import SpaceRod, SpaceShape, turned
from tests.line_coverage.true_lines import (
    FINER,
    TrueLine,
    far_end,
    frames_of,
    loads,
    true_length,
    true_stops,
    true_torsion,
    true_weight,
)

CASES = tuple(
    (kind, seed)
    for kind in KINDS
    if not kind.is_planar
    for seed in range(FIRST_SEED, FIRST_SEED + 4)
)
_FRAME = frame_from_axes(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))


def second_truth(
    kind: LineKind, drawn: Drawn, torsional_stiffness: float, *, finer: int = FINER
) -> TrueLine:
    """Solve a line in space as it is.

    Parameters
    ----------
    kind, drawn : the line
    torsional_stiffness : N m^2, before the factor that nobody knows
    finer : steps over those of a prediction
    """
    aside, up = (drawn.off[f"free_curvature_{axis}"] for axis in (1, 2))
    rod = SpaceRod(
        true_length(drawn),
        true_stops(drawn),
        true_torsion(drawn, torsional_stiffness),
        weight=true_weight(drawn) / foreign.GRAVITY * np.array(EARTH),
        natural=(np.array([0.0, -up, aside]) @ matrices(_FRAME))[:2],
        frame=_FRAME,
    )
    fine = finer * LOADING, finer * RETURNING
    held = _pulled(rod, drawn, fine) if kind.is_loaded else _gripped(rod, drawn, fine)
    if kind.lets_go:
        rod.let_go()
    back, every = rod.shape(), (len(rod.along) - 1) // NODES
    return TrueLine(
        held.places[::every],
        back.places[::every],
        held.start_force,
        held.start_moment,
        1.0 / held.most_bent,
    )


def _pulled(rod: SpaceRod, drawn: Drawn, fine: tuple[int, int]) -> SpaceShape:
    """Take the weight, then the load, there and back; the shape there."""
    weight = rod.weight
    for share in np.linspace(0.0, 1.0, LAYING + 1):
        rod.weight = share * weight
        rod.load(np.zeros(3))
    shapes = []
    for force in loads(drawn, *fine)[1:]:
        rod.load(force)
        shapes.append(rod.shape())
    return shapes[fine[0] - 1]


def _gripped(rod: SpaceRod, drawn: Drawn, fine: tuple[int, int]) -> SpaceShape:
    """Lay the line on the circle where its path begins, and take its end there and back."""
    rod.begin(*_circle(rod, drawn))
    places, turns = far_end(drawn, drawn.off, *fine)
    shapes = []
    for place, frame in zip(places[:-1], frames_of(turns, _FRAME)[:-1], strict=True):
        rod.hold(place, frame)
        shapes.append(rod.shape())
    return shapes[fine[0]]


def _circle(rod: SpaceRod, drawn: Drawn) -> tuple[Numbers, Numbers, Numbers]:
    """Places, frames and curvature vectors, to begin with."""
    way, share = drawn.way, rod.along
    turns = np.stack([share * way.first, np.full_like(share, way.side), 0.0 * share], axis=1)
    frames = frames_of(turns, _FRAME)
    ahead = turned(frames.T, np.array([0.0, 0.0, 1.0])[:, None]).T
    steps = 0.5 * (ahead[1:] + ahead[:-1]) * (rod.length / (len(share) - 1))
    axis = np.array([0.0, -np.sin(way.side), np.cos(way.side)])
    bent = np.tile(way.first / rod.length * axis, (len(share), 1))
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), frames, bent


def solved(case: tuple[LineKind, int]) -> dict[str, float]:
    """The numbers that are asked of a line, by the second rod; none where it cannot follow."""
    kind, seed = case
    drawn = draw(kind, seed)
    try:
        return looked_at(drawn, second_truth(kind, drawn, nominal_torsion(drawn.wire)))
    except RuntimeError:
        return {}


def all_solved(jobs: int) -> dict[tuple[str, int], dict[str, float]]:
    """Of all cases; a minute each."""
    with ProcessPoolExecutor(jobs) as pool:
        found = pool.map(solved, CASES)
        return {(kind.name, seed): each for (kind, seed), each in zip(CASES, found, strict=True)}


def table(
    rows: Mapping[str, Mapping[int, dict[str, Any]]],
    second: Mapping[tuple[str, int], dict[str, float]],
) -> str:
    """In markdown: how far both truths are apart, in per cent of the widths of the study's bands.

    Parameters
    ----------
    rows : of the study, by kind and seed; a case that is not among them is left out
    second : numbers of the cases, by kind and seed
    """
    lines = []
    for (kind, seed), numbers in second.items():
        row = rows[kind].get(seed)
        if row is not None and row["rows"]:
            cells = [
                f"{_apart(each, numbers[each['name']]):.2f} %" if numbers else "not followed"
                for each in row["rows"]
            ]
            lines.append((f"{kind} {seed}", row["about"]["wire"], *cells))
    return "\n".join(markdown("ll" + "r" * len(ASKED), ("line", "wire", *ASKED), lines))


def _apart(row: dict[str, Any], number: float) -> float:
    return float(100.0 * abs(number - row["truth"]) / (row["upper"] - row["lower"]))
