"""Pictures and the table of docs/explanations/rod.md: ``python -m tests.validation.rod_pictures``.

The table stands between two marks of the page, which this writes afresh. It takes two minutes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import rods
from labpipe.decks.mujoco_sliders import mujoco_plane_deck
from labpipe.law.sliders import as_plays
from labpipe.law.table_sliders import sliders_of
from labpipe.records.arrays import Floats
from labpipe.wire.end_load_path import end_load_path
from tests.builders.wire_tables import LENGTH, wire_table
from tests.judges.compliant import CompliantSettings, compliant_path
from tests.judges.judged_rods import (
    bend_error,
    bend_path,
    buckled_column_error,
    catenary_error,
    elastica_error,
    heavy_cantilever_error,
    moment_that_buckles,
    off_plane,
    posed_rod_error,
    shares_near_one,
    twist_that_buckles_a_ring,
    twisted_ring,
    twisted_rod,
)
from tests.judges.lifted_chains import LiftedChain, lifted_half
from tests.judges.mujoco_chains import tips
from tests.judges.rod_references import bend_of_45_degrees
from tests.validation.test_rod_mujoco import rod_tips

ROOT = Path(__file__).resolve().parents[2]
IMAGES, PAGE = ROOT / "docs" / "images", ROOT / "docs" / "explanations" / "rod.md"
STYLE = ROOT / "labpipe" / "report" / "labpipe.mplstyle"
ELEMENTS = (10, 20, 40, 80)
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "0.55"
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"


def cases() -> dict[str, Callable[[int], float]]:
    """What is judged, and its largest error, as a share of the length or as said."""

    def largest(of: Callable[[int], Floats], scale: float = 1.0) -> Callable[[int], float]:
        return lambda elements: float(np.max(np.abs(of(elements)))) / scale

    chain = LiftedChain(friction=0.5)
    return {
        "end load, P L^2 / EI = 10, deflection 0.81 L": largest(elastica_error),
        "own weight, w L^3 / EI = 1": largest(partial(heavy_cantilever_error, weight=1.0)),
        "own weight, w L^3 / EI = 50": largest(partial(heavy_cantilever_error, weight=50.0)),
        "column after buckling, top leans by 60 deg": largest(
            partial(buckled_column_error, degrees=60.0)
        ),
        "bend of 45 deg": largest(bend_error, 25.0 * np.pi),
        "posed in space, largest distance": lambda n: posed_rod_error(n)[0],
        "posed in space, force of the far clamp": lambda n: posed_rod_error(n)[1],
        "catenary, sag": lambda n: abs(catenary_error(n)),
        "moment that buckles on universal joints, C = 2 B": lambda n: abs(
            1.0 - moment_that_buckles(n, torsion=2.0)
        ),
        "twist that buckles a ring": lambda n: abs(1.0 - twist_that_buckles_a_ring(n, step=2e-4)),
        "chain lifted from a table, pull": lambda n: abs(
            lifted_half(chain, n, 1e-6).last.forces[0, 0] / chain.pull - 1.0
        ),
    }


def main() -> None:
    """Draw the pictures and write the table."""
    errors = {name: [case(n) for n in ELEMENTS] for name, case in cases().items()}
    write_table(errors)
    drawn = {
        "rod-convergence": draw_convergence(errors),
        "rod-shapes": draw_shapes(),
        "rod-chain": draw_chain(),
    }
    for name, figure in drawn.items():
        figure.savefig(IMAGES / f"{name}.png", dpi=150, metadata={"Software": None})


def write_table(errors: dict[str, list[float]]) -> None:
    """Errors, and the order between 20 and 80 elements."""
    head = f"| case | {' | '.join(f'{n} elements' for n in ELEMENTS)} | order |"
    lines = [head, "|---" * (len(ELEMENTS) + 2) + "|"]
    for name, found in errors.items():
        order = np.log(found[1] / found[3]) / np.log(4.0)
        lines.append(f"| {name} | {' | '.join(f'{e:.1e}' for e in found)} | {order:.1f} |")
    made = "\n".join([BEGIN, *lines, END])
    text = PAGE.read_text(encoding="utf-8")
    text = re.sub(f"{BEGIN}.*?{END}", lambda _: made, text, flags=re.DOTALL)
    PAGE.write_text(text, encoding="utf-8")


def draw_convergence(errors: dict[str, list[float]]) -> Figure:
    """Errors over elements; cost of a step over nodes."""
    page = Figure(figsize=(6.3, 3.4), layout="constrained")
    left, right = page.subplots(1, 2, width_ratios=(1.0, 0.8))
    marks = "osD^v<>ph*P"
    for (name, found), mark in zip(errors.items(), marks, strict=True):
        left.loglog(ELEMENTS, found, marker=mark, markersize=3.5, linewidth=0.8, label=name)
    ends = np.array([ELEMENTS[0], ELEMENTS[-1]])
    left.loglog(ends, 3.0 / ends**2, color="black", linestyle="--", label="second order")
    left.set(xlabel="Elements", ylabel="Error", title="(a) Errors", ylim=(1e-9, 1e-1))
    left.set_xticks(ELEMENTS, [str(n) for n in ELEMENTS])
    left.minorticks_off()
    _plain_powers(left, range(-9, 0, 2))
    left.legend(fontsize=4.6, loc="lower left")
    costs = [1e3 * rods.least(partial(rods.loop, n, 20)) / 20 for n in rods.LONG]
    right.loglog(rods.LONG, costs, "o-", color=BLUE, label="a step, 8 sliders")
    right.loglog(rods.LONG, costs[-1] * np.array(rods.LONG) / rods.LONG[-1], "k--", label="linear")
    right.set(xlabel="Nodes", ylabel="Milliseconds", title="(b) Cost")
    right.set_xticks(rods.LONG, [str(n) for n in rods.LONG])
    right.minorticks_off()
    right.set_yticks([5, 10, 20, 50, 100], ["5", "10", "20", "50", "100"])
    right.legend(loc="upper left")
    return page


def _plain_powers(axes: Axes, powers: Iterable[int]) -> None:
    """Powers of ten on the vertical axis, as they are typed."""
    places = [10.0**power for power in powers]
    axes.set_yticks(places, [f"{place:.0e}" for place in places])


def draw_shapes() -> Figure:
    """The bend of 45 degrees, twist that buckles, and a wire's loop."""
    page = Figure(figsize=(6.3, 2.6), layout="constrained")
    bend, twist, loop = page.subplots(1, 3)
    _draw_bend(bend)
    _draw_twist(twist)
    _draw_loop(loop)
    return page


def _draw_bend(axes: Axes) -> None:
    path = bend_path(32)
    for number, state in enumerate(path.states):
        x, y, z = state.positions.T
        shade = str(0.85 - 0.12 * number)
        axes.plot(x, z, color=shade, linewidth=1.2)
        axes.plot(x, -y, color=shade, linewidth=1.2, linestyle=":")
    x, y, z = bend_of_45_degrees()
    axes.plot([x, x], [z, -y], "o", color=ORANGE, markersize=4.0)
    axes.annotate("from the side", (2.0, 40.0), fontsize=6)
    axes.annotate("from above", (2.0, -25.0), fontsize=6)
    axes.set(xlabel="x", ylabel="z, and -y", title="(a) Bend of 45°")
    axes.set_aspect("equal")


def _draw_twist(axes: Axes) -> None:
    shares = shares_near_one(4e-3, last=1.1)
    rod = twisted_rod(40, shares, torsion=0.8)
    aside = [np.max(np.abs(state.positions[:, 1:])) for state in rod.states]
    axes.plot(shares, 100.0 * np.array(aside), color=BLUE, label="rod, aside")
    ring = off_plane(twisted_ring(60, shares, torsion=2.0))
    axes.plot(shares, 100.0 * ring, color=GREEN, label="ring, C = 2 B,\noff its plane")
    axes.axvline(1.0, color="black", linestyle="--", linewidth=0.8)
    axes.set(xlim=(0.9, 1.1), xlabel="Twist / critical twist", ylabel="Percent of the length")
    axes.set_title("(b) Twist that buckles")
    axes.legend(fontsize=6)


def _draw_loop(axes: Axes) -> None:
    table = wire_table("A2")
    corners = 0.15 * np.array([0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0, 0.5, 1.0, 0.5, 0.0])
    chain = tips(mujoco_plane_deck(table), corners)[:, 1]
    loads = np.interp(
        np.arange(0.2, len(corners) + 0.1, 0.2),
        np.arange(len(corners) + 1),
        np.append(0.0, corners),
    )
    rod = rod_tips("A2", loads, parts=1)[:, 1]
    wire = end_load_path(as_plays(sliders_of(table)), LENGTH, rod).load
    axes.plot(1e3 * rod, wire, color=GREY, linewidth=3.0, label="wire model")
    axes.plot(1e3 * rod, loads, color=BLUE, linewidth=0.9, label="rod")
    axes.plot(1e3 * chain, corners, "o", color=ORANGE, markersize=3.0, label="MuJoCo")
    axes.set(xlabel="Deflection (mm)", ylabel="Load (N)", title="(c) A wire there and back")
    axes.legend(fontsize=6)


def draw_chain() -> Figure:
    """The chain of figure B.3: shapes, and how well it keeps its length."""
    page = Figure(figsize=(6.3, 2.6), layout="constrained")
    left, right = page.subplots(1, 2, width_ratios=(1.4, 1.0))
    for friction, color in ((0.0, GREEN), (0.2, ORANGE), (0.5, BLUE)):
        chain = LiftedChain(friction=friction)
        arc = np.linspace(0.0, 0.5, 400)
        across, up = chain.half_shape(arc)
        left.plot(across, up, color=color, label=f"friction {friction:g}")
        left.plot(-across, up, color=color)
        state = lifted_half(chain, 40, 1e-6).last
        left.plot(*state.positions[::2, [0, 2]].T, "o", color=color, markersize=3.0)
        damping = 12.0 if friction == 0.0 else 5.0
        settings = CompliantSettings(4e-3, substeps=4, damping=damping, is_chain=True)
        steps = compliant_path(
            chain.line(40, stiffness=1.0),
            chain.lift(40, 200, rest=60),
            steps=260,
            settings=settings,
        )
        left.plot(*steps.positions[-1, :21, [0, 2]], "x", color=color, markersize=3.5)
        right.plot(np.abs(steps.stretch), color=color, linewidth=0.9)
    left.plot([], [], "ko", markersize=3.0, label="rod at equilibrium")
    left.plot([], [], "kx", markersize=3.5, label="the source's step")
    left.set(xlabel="x (m)", ylabel="z (m)", title="(a) Lifted from a table")
    left.legend(fontsize=6, loc="upper right", bbox_to_anchor=(1.0, 1.0))
    right.set_yscale("log")
    right.set(xlabel="Step", ylabel="Change of length / length", title="(b) The source's step")
    right.set_ylim(1e-16, 1e-3)
    _plain_powers(right, range(-15, -2, 3))
    return page


if __name__ == "__main__":
    with style.context(STYLE):
        main()
