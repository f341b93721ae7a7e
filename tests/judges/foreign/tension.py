"""Crimps, terminals and conductors pulled off; metals and films with an extensometer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.judges.foreign import specimens
from tests.judges.foreign.exports import write_mts, write_sheet, write_tra
from tests.judges.foreign.frames import broken, off_grid, sheet, slipping
from tests.judges.foreign.rig import Chance, Made, kept, noisy, pulled, scale
from tests.judges.foreign.specimens import Specimen

Array = NDArray[np.float64]
Truth = dict[str, float]
CRIMP_SPEED = 25e-3 / 60.0
"""m/s, as the protocol has it."""


def pull_off(chance: Chance, folder: Path, whole: Specimen) -> Truth:
    """Pull a specimen until it parts; return what is true of it."""
    specimen, truth = slipping(chance, off_grid(chance, whole, CRIMP_SPEED))
    time, travel, force = pulled(chance, specimen, speed=CRIMP_SPEED, rate=100.0, tare=0.0)
    columns = [("Crosshead", "mm", 1e3 * travel), ("Load", "N", force), ("Time", "sec", time)]
    write_mts(folder / "run.csv", columns, quoted=True)
    d, f = specimen.whole()
    d = d - specimens.slack(d, f)
    if truth:
        truth["slip_position.1"] += float(d[0])
    peak = int(np.argmax(f))
    truth |= {"peak_force.1": float(f[peak]), "displacement_at_peak_force.1": float(d[peak])}
    ends = {key: value for key, value in broken(d, f).items() if key.startswith("failure")}
    return {**truth, **ends}


def crimp_pull(chance: Chance, folder: Path) -> Made:
    """A conductor drawn out of its crimp, torn strand by strand in it, or broken beside it.

    Its peak over its limit is its peak force again, and is not counted twice.
    """
    section, whole, kind = (
        ("AWG 22", specimens.ductile(70.0, 3e-3, 7e-3, stretch=1.2e-3), "slip"),
        ("AWG 20", specimens.yarn(45e3, 2.6e-3, 0.3e-3), "conductor broken in crimp"),
        (
            "AWG 18",
            specimens.ductile(160.0, 5e-3, 6.5e-3, stretch=1.2e-3),
            "conductor broken outside",
        ),
    )[chance.variety]
    truth = pull_off(chance, folder, whole)
    seen = {"labels": {"conductor": section}, "observed": {"separation": kind}}
    write_sheet(folder, sheet(chance, seen, {"frame": "run.csv"}))
    return Made(folder, truth)


def terminal_push_out(chance: Chance, folder: Path) -> Made:
    """A terminal whose latch gives way; the housing rubs on."""
    latch = specimens.brittle((22e3, 30e3, 40e3)[chance.variety], 2.6e-3)
    truth = pull_off(chance, folder, replace(latch, torn=0.08))
    write_sheet(folder, sheet(chance, {}, {"frame": "run.csv"}))
    return Made(folder, truth)


def wire_tensile(chance: Chance, folder: Path) -> Made:
    """A conductor that necks and breaks."""
    top = (60.0, 110.0, 190.0)[chance.variety]
    truth = pull_off(chance, folder, specimens.ductile(top, 14e-3, 22e-3, stretch=2.5e-3))
    write_sheet(folder, sheet(chance, {}, {"frame": "run.csv"}))
    return Made(folder, truth)


Curve = Callable[[Array], Array]
"""Stress, Pa, at a strain."""


def hardening(modulus: float, proof: float, exponent: float) -> Curve:
    """Ramberg and Osgood: strain = s / E + 0.2 % (s / Rp)^n."""
    s = proof * np.linspace(0.0, 3.0, 60001)
    e = s / modulus + 0.002 * (s / proof) ** exponent
    return lambda strain: np.asarray(np.interp(strain, e, s), dtype=np.float64)


def yielding(modulus: float, upper: float, lower: float) -> Curve:
    """A steel with a yield point: a fall, a plateau of 1.5 %, then it hardens."""
    at = upper / modulus
    e = [0.0, at, at + 4e-4, at + 0.015, at + 0.03, at + 0.05, at + 0.09, at + 0.14, at + 0.2]
    rise = [0.0, 0.0, 0.11, 0.21, 0.34, 0.43, 0.47]
    s = [0.0, upper, *(lower * (1.0 + x) for x in rise)]
    return lambda strain: np.asarray(np.interp(strain, e, s), dtype=np.float64)


def stretched(
    chance: Chance,
    curve: Curve,
    *,
    gauge: float,
    area: float,
    ends: float,
    knee: float,
    rate: float,
) -> tuple[Array, Array, Array, Array]:
    """Time, travel, extension and force of a specimen between grips.

    The strain rises slowly up to the knee, then forty times as fast. Half a second is recorded
    after the break.

    Parameters
    ----------
    curve : stress up to the break
    gauge : m, of the extensometer
    area : m^2
    ends : strain at the break
    """
    rate = chance.rate(rate)
    slow = knee / 30.0
    turn = knee / slow
    lasts = turn + (ends - knee) / (40.0 * slow)
    time = np.arange(int((lasts + 0.5) * rate)) / rate
    strain = slow * np.minimum(time, turn) + 40.0 * slow * np.maximum(time - turn, 0.0)
    start = 0.01 * knee
    strain = start + strain
    ends = start + ends
    force = area * curve(np.minimum(strain, ends))
    travel = 1.2 * gauge * strain + 2e-8 * force
    force = chance.noisy(np.where(strain <= ends, force, 0.0), 1.0 / rate)
    force = force * (1.0 + chance.error(scale(chance.kind, "frame", "force")))
    extension = gauge * (strain - start)
    extension = noisy(extension, "white", 5e-8, 1.0 / rate, chance.rng)
    extension = extension * (
        1.0 + chance.off("extension", scale(chance.kind, "frame", "extension"))
    )
    first, last = kept(chance.fault, int(lasts * rate), len(time))
    if chance.fault == "counts-down":
        travel = -travel
    part = slice(first, last)
    return time[part], travel[part], extension[part], force[part]


def iso_6892(chance: Chance, folder: Path) -> Made:
    """A round bar of aluminium or copper that hardens, or of a steel with a yield point."""
    chance, gauge, diameter = replace(chance, loud=0.2 * chance.loud), 0.05, 8e-3
    modulus, curve = (
        (70e9, hardening(70e9, 250e6, 14.0)),
        (205e9, yielding(205e9, 420e6, 380e6)),
        (118e9, hardening(118e9, 200e6, 9.0)),
    )[chance.variety]
    necks = 0.09 if chance.variety != 1 else 0.142

    def necking(strain: Array) -> Array:
        beyond = np.maximum(strain - necks, 0.0) / 0.03
        return np.asarray(
            curve(np.minimum(strain, necks)) * (1.0 - 0.2 * beyond**2), dtype=np.float64
        )

    ends = necks + 0.03
    area = np.pi / 4 * diameter**2
    time, travel, extension, force = stretched(
        chance, necking, gauge=gauge, area=area, ends=ends, knee=5e-3, rate=50.0
    )
    columns = [("Prüfzeit", "s", time), ("Standardweg", "mm", 1e3 * travel)]
    columns += [("Dehnung", "%", 1e2 * extension / gauge), ("Standardkraft", "N", force)]
    write_tra(folder / "Zug.TRA", columns)
    size = {"gauge_length": f"{1e3 * gauge:g} mm", "section": {"outer_diameter": "8 mm"}}
    write_sheet(folder, sheet(chance, size, {"frame": "Zug.TRA"}))
    e = np.linspace(0.0, ends, 400001)
    s = necking(e)
    truth = {"elastic_modulus": modulus, "tensile_strength": float(s.max())}
    for name, offset in (("proof_stress_0_2", 0.002), ("proof_stress_1", 0.01)):
        below = s < modulus * (e - offset)
        truth[name] = float(s[int(np.argmax(below))])
    if chance.variety == 1:
        truth |= {"upper_yield_stress": 420e6, "lower_yield_stress": 380e6}
    peak = float(e[int(np.argmax(s))])
    for name, at in (("maximum_force", peak), ("break", ends + 0.01 * 5e-3)):
        truth[f"elongation_at_{name}"] = at
        truth[f"plastic_elongation_at_{name}"] = at - float(necking(np.array(at))) / modulus
    return Made(folder, truth)


def iso_527_tape(chance: Chance, folder: Path) -> Made:
    """A film that stretches under its extensometer until it tears."""
    chance = replace(chance, loud=0.4 * chance.loud)
    modulus, exponent, ends = ((2.4e9, 5.0, 0.3), (3.2e9, 6.0, 0.2), (1.1e9, 4.0, 0.4))[
        chance.variety
    ]
    gauge, width, thickness, knee = 0.05, 19e-3, 0.1e-3, 4e-3

    def curve(strain: Array) -> Array:
        # A straight start, a knee, and a slow rise.
        level = 0.02 * modulus
        knee_stress = (
            modulus * strain / (1.0 + (modulus * strain / level) ** exponent) ** (1.0 / exponent)
        )
        return np.asarray(knee_stress * (1.0 + 0.8 * strain), dtype=np.float64)

    time, travel, extension, force = stretched(
        chance, curve, gauge=gauge, area=width * thickness, ends=ends, knee=knee, rate=40.0
    )
    columns = [("Crosshead", "mm", 1e3 * travel), ("Extensometer", "mm", 1e3 * extension)]
    write_mts(folder / "run.txt", [*columns, ("Load", "N", force), ("Time", "sec", time)])
    size = {"gauge_length": "50 mm", "section": {"width": "19 mm", "thickness": "0.1 mm"}}
    write_sheet(folder, sheet(chance, size, {"frame": "run.txt"}))
    start = 0.01 * knee
    e = np.linspace(0.0, ends, 400001)  # from the first sample
    s = curve(start + e)
    line = (e >= 0.0005) & (e <= 0.0025)
    slope, level = np.polyfit(e[line], s[line], 1)
    toe = -level / slope
    truth = {"elastic_modulus": float(slope), "tensile_strength": float(s[-1])}
    for name in ("maximum_force", "break"):
        truth[f"elongation_at_{name}"] = float(e[-1] - toe)
        truth[f"plastic_elongation_at_{name}"] = float(e[-1] - toe - s[-1] / slope)
    return Made(folder, truth)


TENSION: dict[str, Callable[[Chance, Path], Made]] = {
    "crimp-pull": crimp_pull,
    "terminal-push-out": terminal_push_out,
    "wire-tensile": wire_tensile,
    "iso-6892": iso_6892,
    "iso-527-tape": iso_527_tape,
}
