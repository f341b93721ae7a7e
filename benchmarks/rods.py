"""The rod against its bounds, and against other programs in the same run where they can do a case.

In seconds of the processor, the least of some runs. PyElastica is no dependency of the project: it
is asked where it is installed. It and MuJoCo find rest by moving there; PyElastica's first run of a
process, in which numba compiles it, does not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from labpipe.mechanics.law.sliders import SliderLaw, make_linear_law
from labpipe.mechanics.rod.boundaries import Held, Load
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.records.arrays import Floats
from tests.builders.rods import straight_line

SLIDERS = 8
NODES, STEPS, MOST = 100, 200, 2.0
"""The case with a bound: nodes, steps, and seconds."""
LONG = (100, 200, 500, 1000, 2000)
FEW_STEPS = 20
LOAD = 10.0
"""P L^2 / EI of the elastica; its deflection and shortening, of the length."""
ELASTICA = np.array([0.810609, 0.554996])


def least(work: Callable[[], object], *, runs: int = 3) -> float:
    """Least seconds of the processor of several calls."""
    seconds = []
    for _ in range(runs):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def slider_section() -> Section:
    """A law that bends ever more easily, from 1 to 0.2 N m^2."""
    slips = np.geomspace(0.05, 5.0, SLIDERS)
    law = SliderLaw(0.2, np.full(SLIDERS, 0.8 / SLIDERS), slips, 0.0, 1e3)
    return Section(law, 0.8)


def held_line(nodes: int, section: Section) -> tuple[Line, Held]:
    line = straight_line(1.0, nodes - 1, section)
    return line, Held(0, np.zeros(3), line.frames[0])


def loop(nodes: int, steps: int) -> RodPath:
    """A cantilever with sliders, pulled up, down and back, round a screw that leaves its plane."""
    line, clamp = held_line(nodes, slider_section())
    share = np.linspace(0.0, 1.0, steps + 1)
    up, aside = np.sin(2.0 * np.pi * share), 0.5 * np.sin(np.pi * share)
    path = follow(line, [clamp, Load(-1, np.column_stack([0.0 * up, aside, up]))], steps=steps)
    assert path.status == "ok", path.reasons
    return path


def cost_of_a_loop() -> None:
    show(
        f"rod, {NODES} nodes, {STEPS} steps, {SLIDERS} sliders, s",
        least(lambda: loop(NODES, STEPS)),
        f"at most {MOST:g}",
    )
    costs = [least(partial(loop, nodes, FEW_STEPS)) for nodes in LONG]
    for nodes, cost in zip(LONG, costs, strict=True):
        show(f"  a step of {nodes} nodes, ms", 1e3 * cost / FEW_STEPS, "")
    growth = np.polyfit(np.log(LONG[2:]), np.log(costs[2:]), 1)[0]
    show(f"  power of the nodes from {LONG[2]} on", float(growth), "linear: 1")


def elastica(elements: int) -> Floats:
    """Deflection and shortening of a cantilever under a load, of its length."""
    section = Section(make_linear_law(1.0, 1e6), 0.8)
    line, clamp = held_line(elements + 1, section)
    path = follow(
        line, [clamp, Load(-1, np.linspace(0.0, 1.0, 4)[:, None] * [0.0, 0.0, -LOAD])], steps=3
    )
    x, _, z = path.last.positions[-1]
    return np.array([-z, 1.0 - x])


def elastica_by_scipy(tolerance: float) -> Floats:
    """The same as a boundary value problem of four equations."""

    def slopes(_: Floats, y: Floats) -> Floats:
        return np.vstack([y[1], -LOAD * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a: Floats, b: Floats) -> Floats:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 21)
    guess = np.vstack([np.sin(0.5 * np.pi * s) * 1.4, np.cos(0.5 * np.pi * s), s, 0.5 * s])
    solution = solve_bvp(slopes, ends, s, guess, tol=tolerance)
    return np.array([solution.y[3, -1], 1.0 - solution.y[2, -1]])


def against_scipy() -> None:
    """One state of an elastic cantilever in a plane, all that this solver of scipy's can do."""
    for elements in (40, 160):
        cost = 1e3 * least(partial(elastica, elements), runs=9)
        show(f"elastica of {elements} elements, ms", cost, "", _off(elastica(elements)))
    for tolerance in (1e-3, 1e-6):
        cost = 1e3 * least(partial(elastica_by_scipy, tolerance), runs=9)
        remark = _off(elastica_by_scipy(tolerance))
        show(f"  scipy's solve_bvp to {tolerance:g}, ms", cost, "", remark)


def _off(tip: Floats) -> str:
    return f"{np.max(np.abs(tip - ELASTICA)):.1e} of the length off"


def suite() -> None:
    """Cases of cosseratbench, with its own metrics: our rod, and what else is installed of it."""
    if find_spec("cosseratbench") is None:
        print("cosseratbench is not installed")
        return
    from cosseratbench.experiments.cantilever import cantilever
    from cosseratbench.experiments.catenary import catenary

    solvers = _solvers()
    for experiment, elements in ((cantilever, 20), (catenary, 50)):
        for name, solver in solvers.items():
            _judged(experiment, elements, name, solver)


def _solvers() -> dict[str, Any]:
    from benchmarks.cosserat_suite import LabpipeRod

    solvers: dict[str, Any] = {"labpipe": LabpipeRod()}
    if find_spec("elastica") is None:
        print("PyElastica is not installed")
    else:
        from cosseratbench.solvers.pyelastica import PyElasticaSolver

        solvers["PyElastica"] = PyElasticaSolver()
    return solvers


def _judged(experiment: Any, elements: int, name: str, solver: Any) -> None:
    scenario = experiment.scenario
    trajectory = solver.run(scenario, n_elements=elements, n_frames=101)
    cost = least(lambda: solver.run(scenario, n_elements=elements, n_frames=101), runs=2)
    metric = next(iter(experiment.metrics))
    remark = f"{metric} {experiment.metrics[metric](scenario, trajectory):.1e}"
    show(f"cosseratbench's {experiment.name}, {name}, s", cost, "", remark)


def against_mujoco() -> None:
    """A wire there and back, with sliders, by labpipe's own deck."""
    if find_spec("mujoco") is None:
        print("MuJoCo is not installed")
        return
    from labpipe.mechanics.decks.mujoco_sliders import Chain, format_plane_deck
    from labpipe.mechanics.law.loss_card import fit_wire_sliders
    from tests.builders.wire_tables import LENGTH, wire_table
    from tests.judges.rod_references import tips

    table = wire_table("A2")
    loads = np.array([0.2, 0.5, 0.9, 0.5, 0.0])
    deck, section = format_plane_deck(table), Section(fit_wire_sliders(table), 1.0)
    force = np.interp(np.arange(0.0, 5.01, 0.2), np.arange(6), np.append(0.0, loads))

    def ours() -> Floats:
        line = straight_line(LENGTH, Chain.n_nodes, section)
        pull = Load(-1, force[:, None] * np.array([0.0, 1.0, 0.0]))
        clamp = Held(0, np.zeros(3), line.frames[0])
        path = follow(line, [clamp, pull], steps=len(force) - 1)
        return np.array([state.positions[-1, 1] for state in path.states])[5::5]

    theirs = tips(deck, loads)[:, 1]
    remark = f"{100.0 * np.max(np.abs(ours() / theirs - 1.0)):.2g} % apart"
    show(f"a wire there and back, {Chain.n_nodes} elements, s", least(ours), "", remark)
    show("  the same in MuJoCo, s", least(lambda: tips(deck, loads)), "")


def show(what: str, value: float, bound: str, remark: str = "") -> None:
    remark = f"({bound})" if bound else ""
    print(f"{what:<50}{value:>10.3f}   {remark}  {remark}", flush=True)


def main() -> None:
    cost_of_a_loop()
    against_scipy()
    suite()
    against_mujoco()


if __name__ == "__main__":
    main()
