"""Tests on a load frame, one recorder each: how they are run, and what is true of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.judges.foreign import specimens
from tests.judges.foreign.exports import write_mat, write_mts, write_sheet, write_tra
from tests.judges.foreign.rig import Chance, Made, Way, force_channel, noisy, pulled, scale
from tests.judges.foreign.specimens import Specimen, knives

Array = NDArray[np.float64]
Truth = dict[str, float]


def sheet(
    chance: Chance, specimen: dict[str, Any], files: dict[str, str], **overrides: str
) -> dict[str, Any]:
    """A test.yaml; overrides with `__` for a point. A rig whose zero wanders says so."""
    changed = {
        key.replace("__", "."): {"value": value, "because": "a short synthetic test"}
        for key, value in overrides.items()
    }
    if chance.noise == "drift":
        key = ".".join((*force_channel(chance.kind), "zero_drift"))
        drifts = f"{100.0 * chance.drifts:.2f} %"
        changed[key] = {"value": drifts, "because": "with no specimen in it the rig shows as much"}
    said = {"type": chance.kind, "spool": "s1", "sample": chance.seed, **specimen}
    made = {"test": f"{chance.kind}-{chance.seed}", "protocol": chance.kind, "specimen": said}
    return {**made, "files": files, **({"overrides": changed} if changed else {})}


def measured(chance: Chance, name: str, size: float) -> dict[str, Any]:
    """A length in mm as a person read it."""
    return {name: f"{size + 1e3 * chance.length(name):.4f} mm"}


def slipping(chance: Chance, specimen: Specimen, share: float = 0.03) -> tuple[Specimen, Truth]:
    """The specimen in grips that let go once, if that is what goes wrong."""
    if chance.fault != "slip":
        return specimen, {}
    at = 0.45 * specimen.ends
    drop = share * float(specimen.whole()[1].max())
    slipped = replace(specimen, law=specimens.drops(specimen.law, ((at, drop),)))
    return slipped, {"slip_position.1": at, "slip_drop.1": drop}


def broken(d: Array, f: Array) -> Truth:
    """Failure and energy of a curve that ends where the specimen breaks."""
    return {
        "failure_displacement": float(d[-1]),
        "failure_force": float(f[-1]),
        "energy_to_break": specimens.work(d, f),
    }


def segments(d: Array, f: Array, start: float, end: float) -> Truth:
    first, second, place, _ = specimens.two_segments(d, f, start, end)
    return {
        "segment_stiffness_first": first,
        "segment_stiffness_second": second,
        "break_point": place,
    }


def off_grid(chance: Chance, specimen: Specimen, speed: float) -> Specimen:
    """The specimen breaks anywhere between two samples."""
    share = float(chance.rng.uniform())
    return replace(specimen, ends=specimen.ends + share * speed / chance.rate(100.0))


def tensile(chance: Chance, folder: Path) -> Made:
    """A wire, a brittle fibre, a yarn; testXpert, German."""
    specimen = (
        specimens.ductile(60.0, 5e-3, 8e-3),
        specimens.brittle(40e3, 3.1e-3),
        specimens.yarn(20e3, 3e-3, 0.35e-3),
    )[chance.variety]
    speed = 2e-4 if chance.rate(100.0) > 50.0 else 5e-5
    specimen, truth = slipping(chance, off_grid(chance, specimen, speed))
    time, travel, force = pulled(chance, specimen, speed=speed, rate=100.0, tare=0.0)
    columns = [("Prüfzeit", "s", time), ("Standardweg", "mm", 1e3 * travel)]
    write_tra(folder / "Zug.TRA", [*columns, ("Standardkraft", "N", force)])
    write_sheet(folder, sheet(chance, {}, {"frame": "Zug.TRA"}))
    d, f = specimen.whole()
    loose = specimens.slack(d, f)
    d = d - loose
    window = specimens.window_slope(d, f, 0.5e-3, 1e-3)
    own = {"slack": loose, "peak_force.1": float(f.max()), "stiffness": window}
    if truth:
        truth["slip_position.1"] -= loose
    return Made(folder, {**truth, **own, **broken(d, f)})


def twist_tube(chance: Chance, folder: Path) -> Made:
    """A woven tube; MTS, kN."""
    first = (22e3, 24e3, 27e3)[chance.variety]
    whole = off_grid(chance, specimens.tearing(first, 0.55 * first, 9e-3, 26e-3), 5e-3)
    specimen, truth = slipping(chance, whole)
    time, travel, force = pulled(chance, specimen, speed=5e-3, rate=100.0, tare=1.0)
    columns = [("Crosshead", "mm", 1e3 * travel), ("Load", "kN", 1e-3 * force)]
    write_mts(folder / "run.csv", [*columns, ("Time", "sec", time)], quoted=True)
    write_sheet(folder, sheet(chance, measured(chance, "length", 75.0), {"frame": "run.csv"}))
    d, f = specimen.whole()
    peak = float(f.max())
    one, two = (specimens.window_slope(d, f, *w) for w in ((2e-3, 8e-3), (10e-3, 20e-3)))
    truth |= {"peak_force.1": peak, "stiffness_first": one, "stiffness_second": two}
    truth |= {"stiffness_first_per_peak_force": one / peak}
    truth |= {"stiffness_second_per_peak_force": two / peak}
    return Made(folder, {**truth, **segments(d, f, 2e-3, 20e-3), **broken(d, f)})


def pet_tape(chance: Chance, folder: Path) -> Made:
    """A tape that hangs loose by about a millimetre; MTS, N."""
    loose = (0.6e-3, 0.9e-3, 1.2e-3)[chance.variety]
    regions = specimens.behind(specimens.two_regions(12.2e3, 1.6e3, 9e-3, 0.9e-3), loose, 0.1e-3)
    specimen, truth = slipping(chance, off_grid(chance, Specimen(regions, 56.3e-3), 5e-4))
    time, travel, force = pulled(chance, specimen, speed=5e-4, rate=40.0, tare=1.0)
    columns = [("Crosshead", "mm", 1e3 * travel), ("Load", "N", force), ("Time", "sec", time)]
    write_mts(folder / "run.txt", columns)
    write_sheet(folder, sheet(chance, measured(chance, "length", 300.0), {"frame": "run.txt"}))
    d, f = specimen.whole()
    slack = specimens.slack(d, f)
    d = d - slack
    one = specimens.window_slope(d, f, 1e-3, 4e-3)
    if truth:
        truth["slip_position.1"] -= slack
    truth |= {"slack": slack, "peak_force.1": float(f.max()), "stiffness_first": one}
    truth |= {"stiffness_second": specimens.window_slope(d, f, 15e-3, 35e-3)}
    width, thickness = 18.79e-3 + chance.length("width"), 0.28e-3 + chance.length("thickness")
    truth |= {"modulus": one * 0.3 / (width * thickness)}
    return Made(folder, {**truth, **segments(d, f, 1e-3, 35e-3), **broken(d, f)})


def corrugated_tube(chance: Chance, folder: Path) -> Made:
    """A soft tube stretched by 50 mm; what grips lose is repaired."""
    stiffness = (900.0, 1100.0, 1300.0)[chance.variety]
    whole = specimens.rubbery(stiffness, 50e-3)
    specimen, truth = slipping(chance, whole)
    time, travel, force = pulled(chance, specimen, speed=4.23e-4, rate=40.0, tare=1.0)
    columns = [("Crosshead", "mm", 1e3 * travel), ("Load", "N", force), ("Time", "sec", time)]
    write_mts(folder / "run.txt", columns)
    write_sheet(folder, sheet(chance, measured(chance, "length", 114.3), {"frame": "run.txt"}))
    d, f = whole.whole()
    stiff = specimens.window_slope(d, f, 1e-3, 10e-3)
    truth |= {"peak_force.1": float(f.max()), "peak_displacement.1": 50e-3, "stiffness": stiff}
    sizes = ("outer_diameter", 14.1e-3), ("inner_diameter", 10.7e-3), ("wall", 0.27e-3)
    outer, inner, wall = (size + chance.length(name) for name, size in sizes)
    thin, thick = np.pi * (outer - wall) * wall, np.pi / 4 * (outer**2 - inner**2)
    truth |= {"modulus_thin_wall": stiff * 0.1143 / thin, "modulus_annulus": stiff * 0.1143 / thick}
    return Made(folder, truth)


def stiff_bar(chance: Chance, folder: Path) -> Made:
    """Travel per force of frame and grips; MTS, kN."""
    specimen = specimens.bar((0.18e-6, 0.21e-6, 0.25e-6)[chance.variety], 460.0)
    time, travel, force = pulled(chance, specimen, speed=1e-5, rate=40.0, tare=0.0)
    columns = [("Crosshead", "mm", 1e3 * travel), ("Load", "kN", 1e-3 * force)]
    write_mts(folder / "run.csv", [*columns, ("Time", "sec", time)], quoted=True)
    write_sheet(folder, sheet(chance, {}, {"frame": "run.csv"}))
    d, f = specimen.whole()
    return Made(folder, {"compliance": specimens.window_slope(f, d, 50.0, 400.0)})


def three_point_bend(chance: Chance, folder: Path) -> Made:
    """A rod that yields on knife edges; testXpert, German."""
    span, rigidity = 0.06, (0.5, 0.7, 0.9)[chance.variety]
    specimen = specimens.bent_rod(rigidity, span, 2e-3, 4.6e-3)
    time, travel, force = pulled(chance, specimen, speed=1e-4, rate=40.0, tare=0.0)
    columns = [("Prüfzeit", "s", time), ("Standardweg", "mm", 1e3 * travel)]
    write_tra(folder / "Biegung.TRA", [*columns, ("Standardkraft", "N", force)])
    write_sheet(folder, sheet(chance, measured(chance, "span", 60.0), {"frame": "Biegung.TRA"}))
    d, f = specimen.whole()
    truth = {"peak_force.1": float(f.max()), "peak_displacement.1": specimen.ends}
    truth |= segments(d, f, 0.2e-3, 4e-3)
    elastic = np.interp(d / span, knives().deflection, knives().load) / span**2
    share = specimens.window_slope(d, elastic, 0.2e-3, truth["break_point"])
    return Made(folder, {**truth, "bending_stiffness": truth["segment_stiffness_first"] / share})


def force_displacement(chance: Chance, folder: Path) -> Made:
    """A bundle that slips, to and fro; ControlDesk, one clock for both."""
    slips = ((6.0, 1.5e-3), (3.0, 0.4e-3))
    loop = specimens.Loop((600.0, 800.0, 1000.0)[chance.variety], slips)
    way = Way(12e-3, 2e-3, 3, 1.5, chance.dwell)
    start, end = way.kept(chance.fault)
    time = np.arange(0.0, end - start, 0.99985e-3)
    travel, which = way.travel(start + time), way.stroke_at(start + time)
    laws = loop.strokes((way.stroke, 0.0) * way.cycles)
    force = np.select([which == i for i in range(len(laws))], [law(travel) for law in laws])
    force = chance.noisy(force, 1e-3)
    travel = noisy(travel, "white", min(chance.loud, 1.0) * 1e-6, 1e-3, chance.rng)
    force = force * (1.0 + chance.off("force", scale(chance.kind, "force", "force")))
    travel = travel * (1.0 + chance.off("travel", scale(chance.kind, "force", "displacement")))
    signals = {"Model Root/Force": force, "Model Root/Displacement": 1e3 * travel}
    write_mat(folder / "rec1_007.mat", time, signals)
    write_sheet(folder, sheet(chance, {}, {"force": "rec1_007.mat"}))
    truth: Truth = {}
    there, back = np.linspace(0.0, way.stroke, 8001), np.linspace(way.stroke, 0.0, 8001)
    for cycle in range(way.cycles):
        up, down = laws[2 * cycle](there), laws[2 * cycle + 1](back)
        truth[f"peak_force.{cycle + 1}"] = float(up.max())
        truth[f"peak_displacement.{cycle + 1}"] = way.stroke
        truth[f"energy.{cycle + 1}"] = specimens.work(there, up) + specimens.work(back, down)
    return Made(folder, truth)


FRAMES: dict[str, Callable[[Chance, Path], Made]] = {
    "tensile": tensile,
    "twist-tube": twist_tube,
    "pet-tape": pet_tape,
    "corrugated-tube": corrugated_tube,
    "stiff-bar": stiff_bar,
    "three-point-bend": three_point_bend,
    "force-displacement": force_displacement,
}
