"""The cantilever under an end load in closed form, and by quadrature of its first integral."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.records.arrays import Floats


def closed_form(tip_angle: float) -> tuple[float, float, float]:
    """P L^2 / EI, deflection / L and shortening / L by elliptic integrals.

    Bisshopp and Drucker (1945), with m = (1 + sin(tip angle)) / 2.
    """
    m = (1.0 + np.sin(tip_angle)) / 2.0
    phi = np.arcsin(np.sqrt(0.5 / m))
    root = float(ellipk(m) - ellipkinc(phi, m))
    deflection = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(phi, m)) / root
    return root**2, deflection, 1.0 - float(np.sqrt(2.0 * np.sin(tip_angle))) / root


def complementary_energy(law: PlayLaw, moment: Floats) -> Floats:
    """Integral of kappa dM on first loading, per length, N, shape of `moment`."""
    beyond = np.maximum(np.abs(moment)[..., None] - law.half_widths, 0.0)
    slipped: Floats = 0.5 * beyond**2 @ law.compliances
    return 0.5 * moment**2 / law.stiffness + slipped


def by_first_integral(law: PlayLaw, length: float, load: float) -> tuple[float, float, float]:
    """Deflection, tip angle and clamp's moment of the wire.

    While nothing unloads, W*(M) + P sin(psi) is the same everywhere, W* the integral of the
    curvature over the moment; Gauss's rule between the corners of the law.
    """
    roots, weights = np.polynomial.legendre.leggauss(20)

    def energy(moment: float) -> float:
        return float(complementary_energy(law, np.array(moment)))

    def integrals(clamp: float) -> tuple[float, float]:
        corners = np.append(0.0, law.half_widths[law.half_widths < clamp])
        edges = np.union1d(np.append(corners, clamp), clamp * np.linspace(0.0, 1.0, 40))
        half = np.diff(edges)[:, None] / 2.0
        moment = edges[:-1, None] + half * (roots + 1.0)
        sine = (energy(clamp) - complementary_energy(law, moment)) / load
        share = half * weights / (load * np.sqrt(1.0 - sine**2))
        return float(share.sum()), float((share * sine).sum())

    lever = load * length
    upright = brentq(lambda m: energy(m) - load, 0.0, lever) if energy(lever) > load else lever
    most = upright * (1.0 - 1e-9)
    clamp = brentq(lambda m: integrals(m)[0] - length, 1e-3 * most, most, xtol=1e-16)
    return integrals(clamp)[1], float(np.arcsin(energy(clamp) / load)), float(clamp)
