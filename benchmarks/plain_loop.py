"""The wire model in plain loops, as a script is written by hand: what labpipe is compared with.

The order of work is that of appendix A.4 of the source: for every curvature every strand, and in
every strand every lamina; then for every load the wire from the clamp to its tip. The source's
faults are put right (docs/explanations/wire-model.md), so that the numbers are those of labpipe
but for the number of laminae and steps. It shares no code with labpipe. SI units, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

LAMINAE = 40
STEPS = 200
HALVINGS = 40
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlainWire:
    """What the script has at its head: a list entry per layer, the core first; per strand for x, y.

    Strands lie layer by layer, and friction is that of the source's calibration.
    """

    counts: list[int]
    diameters: list[float]
    lay_angles: list[float]
    x: list[float]
    y: list[float]
    wire_diameter: float
    wall: float
    modulus: float = 110e9
    poisson: float = 0.34
    copper_k: float = 530e6
    copper_n: float = 0.44
    insulation_modulus: float = 1e9
    friction_strand: float = 0.21
    friction_insulation: float = 0.10
    radial_force: float = 0.15


def hexagon(counts: list[int], diameter: float) -> tuple[list[float], list[float]]:
    """Strand centres of rings of 1, 6, 12, 18 ... on a lattice of triangles."""
    x, y = [0.0], [0.0]
    for ring in range(1, len(counts)):
        for corner in range(6):
            begin, end = corner * math.pi / 3.0, (corner + 1) * math.pi / 3.0
            for step in range(ring):
                share = step / ring
                across = (1.0 - share) * math.cos(begin) + share * math.cos(end)
                up = (1.0 - share) * math.sin(begin) + share * math.sin(end)
                x.append(ring * diameter * across)
                y.append(ring * diameter * up)
    return x, y


def modulus_table(wire: PlainWire) -> tuple[Floats, Floats]:
    """Strain and secant modulus of the copper, to look up in."""
    strains, moduli = [0.0], [wire.modulus]
    for i in range(2000):
        stress = 1e3 * 10.0 ** (6.0 * i / 1999.0)
        strain = stress / wire.modulus + (stress / wire.copper_k) ** (1.0 / wire.copper_n)
        strains.append(strain)
        moduli.append(stress / strain)
    return np.array(strains), np.array(moduli)


def layer_of(wire: PlainWire) -> list[int]:
    layers: list[int] = []
    for number, count in enumerate(wire.counts):
        layers += [number] * count
    return layers


def mean_radius(wire: PlainWire, layer: int) -> float:
    """Root mean square distance of a layer's strands from the axis."""
    total = 0.0
    for i, own in enumerate(layer_of(wire)):
        if own == layer:
            total += wire.x[i] ** 2 + wire.y[i] ** 2
    return math.sqrt(total / wire.counts[layer])


def axial_force(wire: PlainWire, layer: int, height: float, sine: float, kappa: float) -> float:
    """Stick or slip, whichever is less by size; pressed by the layers outside at this angle."""
    lay = abs(wire.lay_angles[layer])
    area = math.pi * wire.diameters[layer] ** 2 / 4.0
    stick = wire.modulus * area * kappa * height * math.cos(lay) ** 2
    pressure = wire.radial_force * wire.counts[-1] / wire.counts[layer]
    for outer in range(layer + 1, len(wire.counts)):
        above = axial_force(wire, outer, mean_radius(wire, outer) * sine, sine, kappa)
        share = wire.counts[outer] / wire.counts[layer]
        pressure += above * abs(math.sin(wire.lay_angles[outer])) * share
    is_outermost = layer == len(wire.counts) - 1
    outside = wire.friction_insulation if is_outermost else wire.friction_strand
    k = wire.friction_strand * math.sin(lay)
    angle = math.asin(max(-1.0, min(1.0, sine)))
    both = outside + wire.friction_strand
    slip = both * max(pressure, 0.0) * (math.exp(k * angle) - 1.0) / k
    return stick if abs(stick) < abs(slip) else slip


def own_stiffness(
    wire: PlainWire,
    layer: int,
    kappa: float,
    table: tuple[Floats, Floats],
    laminae: int = LAMINAE,
) -> float:
    """Bending stiffness of one strand: secant modulus of each lamina, helix factor."""
    radius, lay = wire.diameters[layer] / 2.0, wire.lay_angles[layer]
    thickness = radius / laminae
    total = 0.0
    for i in range(laminae):
        height = (i + 0.5) * thickness
        modulus = float(np.interp(abs(kappa) * height, table[0], table[1]))
        total += 4.0 * modulus * math.sqrt(radius**2 - height**2) * height**2 * thickness
    twist = math.sin(lay) ** 2 / (1.0 + wire.poisson)
    return total * math.cos(lay) / 2.0 * (1.0 + math.cos(lay) ** 2 + twist)


def moments(wire: PlainWire, curvatures: list[float], laminae: int = LAMINAE) -> list[float]:
    """Bending moment at every curvature, N m."""
    table = modulus_table(wire)
    bore = wire.wire_diameter - 2.0 * wire.wall
    tube = wire.insulation_modulus * math.pi / 64.0 * (wire.wire_diameter**4 - bore**4)
    moment_list = []
    for kappa in curvatures:
        moment = tube * kappa
        for i, layer in enumerate(layer_of(wire)):
            moment += own_stiffness(wire, layer, kappa, table, laminae) * kappa
            radius = math.hypot(wire.x[i], wire.y[i])
            if layer > 0:
                sine = wire.y[i] / radius
                force = axial_force(wire, layer, wire.y[i], sine, kappa)
                moment += force * wire.y[i] * math.cos(wire.lay_angles[layer])
        moment_list.append(moment)
    return moment_list


def tip_deflection(
    load: float, length: float, curvatures: Floats, moments: Floats, steps: int = STEPS
) -> float:
    """Deflection under a load: from the tip back, its angle halved until the clamp is level."""
    lowest, highest = 0.0, math.pi / 2.0
    ds = length / steps
    y = 0.0
    for _ in range(HALVINGS):
        tip_angle = angle = (lowest + highest) / 2.0
        lever = y = 0.0
        for _ in range(steps):
            middle = lever + math.cos(angle) * ds / 2.0
            kappa = float(np.interp(load * middle, moments, curvatures))
            half = angle - kappa * ds / 2.0
            angle -= kappa * ds
            lever += math.cos(half) * ds
            y += math.sin(half) * ds
        if angle > 0.0:
            highest = tip_angle
        else:
            lowest = tip_angle
    return y


def overlap(flat: Floats, strand_radius: float, bore_radius: float) -> float:
    """Energy of overlaps, every pair from both sides."""
    n = len(flat) // 2
    energy = 0.0
    for i in range(n):
        xi, yi = flat[2 * i], flat[2 * i + 1]
        wall = math.sqrt(xi**2 + yi**2) + strand_radius - bore_radius
        if wall > 0.0:
            energy += wall**2
        for j in range(n):
            if j != i:
                apart = math.sqrt((xi - flat[2 * j]) ** 2 + (yi - flat[2 * j + 1]) ** 2)
                if apart < 2.0 * strand_radius:
                    energy += (2.0 * strand_radius - apart) ** 2
    return energy


def packed_energy(n_strands: int, bore_in_radii: float, seed: int, most_steps: int) -> float:
    """Energy after some steps of a quasi-Newton search without a gradient, from a random start."""
    rng = np.random.default_rng(seed)
    radius = (bore_in_radii - 1.0) * np.sqrt(rng.uniform(size=n_strands))
    turn = 2.0 * np.pi * rng.uniform(size=n_strands)
    start = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)]).ravel()
    solution = minimize(
        overlap, start, args=(1.0, bore_in_radii), method="BFGS", options={"maxiter": most_steps}
    )
    return float(solution.fun)
