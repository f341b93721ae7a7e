"""Stretch and torsion of a wire, and their coupling (PHYSICS 9).

A strand at radius r with the lay angle a is strained along itself by eps cos^2 a where the wire is
stretched by eps, and by r tau sin a cos a where it is twisted by tau (rad/m, positive in the sense
of a positive lay). So the pull N and the torque T are

    [N; T] = [EA, C; C, GJ] [eps; tau],
    EA = sum E A cos^3 a + E_ins A_ins,      C = sum E A r sin a cos^2 a,
    GJ = sum E A r^2 sin^2 a cos a + own + G_ins pi/2 (R_o^4 - R_i^4).

Slip does not relieve this: strands keep their radius and stretch as a whole (Costello, *Theory of
Wire Rope*, 1997). Strands that settle into each other make a real wire softer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.wire.cross_section import CrossSection


@dataclass(frozen=True, slots=True)
class StretchTorsion:
    """Symmetric stiffness matrix of stretch and torsion.

    Parameters
    ----------
    axial : EA, N, of a wire that does not turn
    coupling : C, N m, with the sign of the lay
    torsional : GJ, N m^2, of a wire that does not lengthen
    """

    axial: float
    coupling: float
    torsional: float

    @property
    def torsional_free(self) -> float:
        """Return the torsional stiffness of a wire that may lengthen, N m^2: GJ - C^2 / EA."""
        return self.torsional - self.coupling**2 / self.axial


def stretch_torsion(section: CrossSection) -> StretchTorsion:
    """Compute stretch and torsion of elastic strands in their tube.

    Parameters
    ----------
    section : strands in place, with their materials; each counts at its own radius

    Notes
    -----
    own = sum E I cos(a) (cos^2 a / (1 + nu) + sin^2 a), I = pi d^4 / 64: a turn of the wire twists
    a strand by its part along the strand (G J = E I / (1 + nu)) and bends it by the part across
    (Love's thin rod; the energy argument of the helix factor, eq. (3.18) of the dissertation). The
    tube has G = E / (2 (1 + nu)).
    """
    axial = coupling = torsional = 0.0
    square = section.radius**2
    for number, layer in enumerate(section.layers):
        sine, cosine = np.sin(layer.lay_angle), np.cos(layer.lay_angle)
        radius, squared = section.radius[section.layer == number], square[section.layer == number]
        rigidity = layer.material.modulus * layer.area
        axial += layer.count * rigidity * cosine**3
        coupling += rigidity * float(radius.sum()) * sine * cosine**2
        torsional += rigidity * float(squared.sum()) * sine**2 * cosine
        second = np.pi * layer.diameter**4 / 64.0
        turned = cosine**2 / (1.0 + layer.poisson) + sine**2
        torsional += layer.count * layer.material.modulus * second * cosine * turned
    tube = section.insulation
    if tube is not None:
        axial += tube.axial_stiffness
        torsional += tube.torsional_stiffness
    return StretchTorsion(float(axial), float(coupling), float(torsional))
