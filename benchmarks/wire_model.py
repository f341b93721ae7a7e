"""The wire model against its bounds, and against the plain loop in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from openpyxl import Workbook, load_workbook

from benchmarks import plain_loop
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_moment_curve,
    fit_play_law,
    make_contacts,
)
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    lay_up,
    pack_strands,
    place_hexagon,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.materials import ANNEALED_COPPER

RUNS = 9
WALL = 0.3e-3
LENGTH, DEFLECTION = 85e-3, 50e-3
LARGEST = 60.0  # 1/m, beyond what the wires reach at that deflection
FARTHEST, FARTHEST_LARGEST = 0.8 * LENGTH, 125.0
EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "wires.xlsx"
COPIES = 30  # of the ten wires of the examples
CURVATURES = np.linspace(0.0, 35.0, 10_000)
WIRES = {
    7: (1.6e-3, 0.32e-3, [12.0]),
    37: (2.1e-3, 0.21e-3, [12.0, -15.0, 12.0]),
}
"""Strands of the source's A2 and C4: diameter of the wire and of its strands, lay angles in deg."""
BOUNDS = {7: 10, 37: 60}


def best(work: Callable[[], object], *, runs: int = RUNS) -> float:
    """Least seconds of several calls: other work on the machine only adds."""
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def layers_of(strands: int) -> tuple[Layer, ...]:
    _, diameter, lays = WIRES[strands]
    return lay_up(strands, diameter, [float(np.radians(lay)) for lay in lays], ANNEALED_COPPER)


def tube_of(strands: int) -> Insulation:
    return Insulation(WIRES[strands][0] / 2.0 - WALL, WALL, 1e9)


def plain_wire(strands: int) -> plain_loop.PlainWire:
    """The same wire for the plain loop."""
    wire_diameter, diameter, _ = WIRES[strands]
    layers = layers_of(strands)
    counts, lays = [lay.count for lay in layers], [lay.lay_angle for lay in layers]
    x, y = plain_loop.hexagon(counts, diameter)
    sizes = [diameter] * len(layers)
    return plain_loop.PlainWire(counts, sizes, lays, x, y, wire_diameter, WALL)


def section_of(strands: int) -> CrossSection:
    return place_hexagon(layers_of(strands), tube_of(strands))


def contacts_of(strands: int) -> Contacts:
    rings = len(WIRES[strands][2])
    return make_contacts(rings, strand=0.21, insulation=0.10, radial_force=0.15)


def moment_law(strands: int) -> None:
    """10 000 curvatures; the plain loop is timed on 40 of them, for each costs the same."""
    section, contacts = section_of(strands), contacts_of(strands)
    ours = best(lambda: compute_moment_curve(section, contacts, CURVATURES))
    wire, few = plain_wire(strands), CURVATURES[::250].tolist()
    plain = best(lambda: plain_loop.moments(wire, few), runs=3) * len(CURVATURES) / len(few)
    show(f"10 000 curvatures of {strands} strands, ms", 1e3 * ours, f"at most {BOUNDS[strands]}")
    show("  plain loop / labpipe", plain / ours, "")


def cantilever_curve(strands: int) -> None:
    """100 points up to 50 mm on 85 mm; the plain loop goes to every tenth of the loads found."""
    section, contacts = section_of(strands), contacts_of(strands)
    deflections = np.linspace(0.0, DEFLECTION, 101)[1:]
    law = fit_play_law(section, contacts, largest_curvature=LARGEST)
    loads = compute_end_load_path(law, LENGTH, deflections).load[9::10].tolist()
    ours = best(lambda: compute_end_load_path(law, LENGTH, deflections).load, runs=5)
    kappa = np.linspace(0.0, LARGEST, 1000)
    moment = compute_moment_curve(section, contacts, kappa).moment
    plain = 10.0 * best(
        lambda: [plain_loop.tip_deflection(load, LENGTH, kappa, moment) for load in loads], runs=3
    )
    show(f"cantilever, 100 points, {strands} strands, ms", 1e3 * ours, "at most 30")
    show("  plain loop / labpipe", plain / ours, "")
    making = best(lambda: fit_play_law(section, contacts, largest_curvature=LARGEST))
    show("  making its law, ms", 1e3 * making, "")


def far_cantilever_curve(strands: int) -> None:
    """100 points up to 0.8 of the length: the last dozen station by station."""
    law = fit_play_law(
        section_of(strands), contacts_of(strands), largest_curvature=FARTHEST_LARGEST
    )
    deflections = np.linspace(0.0, FARTHEST, 101)[1:]
    ours = best(lambda: compute_end_load_path(law, LENGTH, deflections).load)
    show(f"  up to 0.8 of the length, {strands} strands, ms", 1e3 * ours, "at most 30")


def write_sheet(path: Path) -> Path:
    """The wires of the examples again and again, each time larger by a thousandth."""
    heading, *rows = load_workbook(EXAMPLES).worksheets[0].iter_rows(values_only=True)
    powers = {"mm": 1, "mm2": 2}
    book = Workbook(write_only=True)
    sheet = book.create_sheet("wires")
    sheet.append(heading)
    for number in range(COPIES):
        for name, *cells in rows:
            sizes = [
                cell * (1.0 + 1e-3 * number) ** powers.get(str(head).rsplit("_", 1)[-1], 0)
                if isinstance(cell, int | float)
                else cell
                for head, cell in zip(heading[1:], cells, strict=True)
            ]
            sheet.append((f"{name}-{number}", *sizes))
    book.save(path)
    return path


def packings() -> None:
    """37 strands, all starts; the plain search goes five steps from one, too slow for more."""
    layers, tube = layers_of(37), tube_of(37)
    ours = best(lambda: pack_strands(layers, tube), runs=3)
    bore = 2.0 * tube.bore_radius / layers[0].diameter
    plain = best(lambda: plain_loop.packed_energy(37, bore, 0, 5), runs=3)
    show("packing 37 strands, s", ours, "at most 1")
    show("  five steps of the plain search / labpipe", plain / ours, "")


def show(what: str, value: float, bound: str) -> None:
    print(f"{what:<44}{value:>8.2f}   {f'({bound})' if bound else ''}", flush=True)


def main() -> None:
    for strands in WIRES:
        moment_law(strands)
        cantilever_curve(strands)
        far_cantilever_curve(strands)
    packings()


if __name__ == "__main__":
    main()
