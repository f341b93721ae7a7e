"""Synthetic first loadings of cantilevers, by the station-by-station path of `wire.cantilever`.

That path shares nothing with the one that calibration fits by but the law of the wire.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.bending_law import fit_play_law, make_contacts
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import Wire
from labpipe.mechanics.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    make_straight,
)
from labpipe.mechanics.wire.cross_section import CrossSection, place_hexagon
from labpipe.mechanics.wire.materials import RambergOsgood
from labpipe.records.arrays import Floats
from tests.builders.stranded_wires import WIRES, layers_of, tube

PHI, MODULUS, SCALE = 0.0465, 1e9, 1.0
TRUTH = np.array([PHI, MODULUS, SCALE])
"""What the synthetic tests are made with."""
MU_S, MU_P = 0.21, 0.10
WEIGHT = 0.0027 * 9.80665
DEEPEST = 0.05


def rig_of(length: float) -> StringRig:
    return StringRig(0.760, WEIGHT, length, 0.760)


def section_of(name: str, modulus: float = MODULUS, scale: float = SCALE) -> CrossSection:
    copper = RambergOsgood(110e9, 530e6 * scale, 0.44)
    return place_hexagon(layers_of(name, copper), tube(WIRES[name][0], modulus=modulus))


def wire_of(name: str, phi: float = PHI, modulus: float = MODULUS, scale: float = SCALE) -> Wire:
    section = section_of(name, modulus, scale)
    rings = len(section.layers) - 1
    radial = phi / (MU_S + MU_P)
    return Wire(section, make_contacts(rings, strand=MU_S, insulation=MU_P, radial_force=radial))


def law_of(wire: Wire, n_plays: int = 200) -> PlayLaw:
    return fit_play_law(wire.section, wire.contacts, largest_curvature=80.0, n_plays=n_plays)


@lru_cache
def exact_curve(name: str, length: float, *, has_string: bool = True) -> CubicSpline:
    """Force over deflection of the wire as made, N and m."""
    law = law_of(wire_of(name))
    state, rig = make_straight(law), rig_of(length)
    deflections, forces = [0.0], [0.0]
    for goal in 1.06 * DEEPEST * np.linspace(0.0, 1.0, 50)[1:] ** 1.6:
        if has_string:
            shape = bend_to_travel(law, state, length, rig, float(goal))
            forces.append(shape.tension - WEIGHT)
        else:
            shape = bend_to_deflection(law, state, length, float(goal))
            forces.append(float(shape.force[1]))
        state = shape.state
        deflections.append(float(shape.y[-1]))
    return CubicSpline(deflections, forces)


def memory_noise(generator: np.random.Generator, count: int, correlation: float) -> Floats:
    """First-order autoregressive noise of variance 1."""
    kicks = generator.normal(size=count) * np.sqrt(1.0 - correlation**2)
    kicks[0] /= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], kicks), dtype=np.float64)


def measured(
    name: str = "A2",
    lengths: tuple[float, ...] = (0.085,),
    *,
    seed: int = 0,
    samples: int = 3,
    scatter: float = 0.03,
    gain: float = 0.005,
    noise: float = 0.002,
    correlation: float = 0.0,
    n: int = 272,
    has_string: bool = True,
) -> tuple[MeasuredCurve, ...]:
    """A campaign: each sample has its own factor on the force, all share the load cell's gain."""
    generator = np.random.default_rng(seed)
    common = np.exp(gain * generator.normal())
    deflection = np.linspace(0.0, DEEPEST, n)
    curves = []
    for length in lengths:
        exact = exact_curve(name, length, has_string=has_string)(deflection)
        for number in range(samples):
            factor = common * np.exp(scatter * generator.normal())
            force = factor * exact + noise * memory_noise(generator, n, correlation)
            label = f"{name}-{1e3 * length:.0f}-{number + 1}"
            rig = rig_of(length) if has_string else None
            curves.append(MeasuredCurve(name, label, label, length, deflection, force, noise, rig))
    return tuple(curves)
