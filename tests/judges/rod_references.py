"""Shapes of rods by other means: boundary value problems, elliptic integrals, MuJoCo.

Nothing here shares code with `labpipe.mechanics.rod`: its equations are Kirchhoff's, written out
once more and solved by scipy, or formulas of the literature; MuJoCo runs labpipe's decks. Lengths
and stiffnesses are whatever the caller measures in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from labpipe.mechanics.decks.mujoco_sliders import N_SETTLING_STEPS
from labpipe.records.arrays import Floats

TOLERANCE = 1e-9
LEVEL = (0.0, 0.5**0.5, 0.0, 0.5**0.5)
"""Frame of a clamp whose third axis is x and whose first axis is z."""


def buckled_column(angle: float) -> tuple[float, float, float]:
    """Load over the critical one, height and offset of the top, of a column clamped at its foot.

    Parameters
    ----------
    angle : rad, by which the top leans

    Notes
    -----
    P L^2 / EI = K(k)^2, k = sin(angle / 2); height 2 E / K - 1, offset 2 k / K of the length
    (Timoshenko and Gere, Theory of elastic stability, 2.7).
    """
    k = np.sin(0.5 * angle)
    first, second = float(ellipk(k**2)), float(ellipe(k**2))
    return (2.0 * first / np.pi) ** 2, 2.0 * second / first - 1.0, 2.0 * float(k) / first


def pressed_column(shortening: float) -> tuple[float, float]:
    """Force and energy of a column of length and stiffness 1, both ends clamped, pressed together.

    Parameters
    ----------
    shortening : of the distance of its ends, which slide on one axis

    Notes
    -----
    Four columns clamped at the foot, each a quarter as long. It keeps its length, so that the
    energy is the work of the force after buckling, from 4 pi^2 on.
    """
    most = brentq(lambda angle: 1.0 - buckled_column(angle)[1] - shortening, 1e-3, 2.5, xtol=1e-14)
    columns = [buckled_column(float(angle)) for angle in np.linspace(1e-4, most, 2001)]
    forces = 4.0 * np.pi**2 * np.array([load for load, _, _ in columns])
    ways = np.array([1.0 - height for _, height, _ in columns])
    energy = forces[0] * ways[0] + np.sum(0.5 * (forces[1:] + forces[:-1]) * np.diff(ways))
    return float(forces[-1]), float(energy)


def critical_torque(tension: float = 0.0) -> float:
    """Least M L / B that buckles a straight rod, both ends clamped, under T L^2 / B of tension.

    Notes
    -----
    B w'''' - i M w''' - T w'' = 0 across, w = w' = 0 at both ends. Without tension the condition
    is tan(M / 2) = M / 2, 8.9868 (Greenhill, 1883).
    """

    def determinant(moment: float) -> float:
        # w = c0 + c1 s + c2 e^(i p s) + c3 e^(i q s), p and q the roots of r^2 - M r + T = 0.
        root = np.sqrt(complex(moment**2 / 4.0 - tension))
        p, q = moment / 2.0 + root, moment / 2.0 - root
        a, b = np.exp(1j * p), np.exp(1j * q)
        rows = [
            [1.0, 0.0, 1.0, 1.0],
            [0.0, 1.0, 1j * p, 1j * q],
            [1.0, 1.0, a, b],
            [0.0, 1.0, 1j * p * a, 1j * q * b],
        ]
        if tension == 0.0:  # q = 0: the third and the first solution are one; s^2 takes its place
            rows = [
                [1.0, 0.0, 0.0, 1.0],
                [0.0, 1.0, 0.0, 1j * p],
                [1.0, 1.0, 1.0, a],
                [0.0, 1.0, 2.0, 1j * p * a],
            ]
        value = np.linalg.det(np.array(rows)) * np.exp(-0.5j * moment)
        return float((value / (p - q)).real if abs(value.real) > abs(value.imag) else value.imag)

    least = 2.0 * np.sqrt(tension)
    return _first_root(determinant, np.linspace(least + 1e-3, least + 15.0, 1501))


def _first_root(function: Callable[[float], float], scan: Floats) -> float:
    signs = np.sign([function(float(at)) for at in scan])
    at = int(np.flatnonzero(signs[:-1] * signs[1:] < 0.0)[0])
    return float(brentq(function, scan[at], scan[at + 1], xtol=1e-12))


@dataclass(frozen=True)
class Kirchhoff:
    """A rod that keeps its length, clamped at its start in the origin.

    Parameters
    ----------
    stiffness : two bendings and the twist, N m^2
    length : m
    natural : 1/m, the curvature at rest in the rod's own frame, alike along it
    frame : of the clamp, unit quaternion (w, x, y, z); the third axis points along the rod
    """

    stiffness: tuple[float, float, float]
    length: float
    natural: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def _slopes(self, at: Floats, y: Floats, force: Floats, weight: Floats) -> Floats:
        """Of places, quaternions, and moments in space, shape (10, stations)."""
        turn = turns(y[3:7])
        own = np.einsum("ijk,ik->jk", turn, y[7:])
        bend = np.array(self.natural)[:, None] + own / np.array(self.stiffness)[:, None]
        w, v = y[3], y[4:7]
        spin = 0.5 * np.vstack([-np.sum(v * bend, axis=0), w * bend + np.cross(v.T, bend.T).T])
        pull = force[:, None] + weight[:, None] * (self.length - at)
        return np.vstack([turn[:, 2], spin, -np.cross(turn[:, 2].T, pull.T).T])

    def under(
        self, force: Floats, weight: Floats | None = None, *, parts: int = 10, stations: int = 41
    ) -> tuple[Floats, Floats, Floats]:
        """Bend it by a force at its free end and by weight per length, grown in parts.

        Parameters
        ----------
        force, weight : N, N/m, shape (3,), in space
        parts : from zero to the whole
        stations : wanted, evenly spaced

        Returns
        -------
        Places (stations, 3), quaternions (stations, 4), moments in space (stations, 3).
        """
        weight = np.zeros(3) if weight is None else weight
        s = np.linspace(0.0, self.length, 41)
        start = np.concatenate([np.zeros(3), self.frame])

        def ends(a: Floats, b: Floats) -> Floats:
            return np.concatenate([a[:7] - start, b[7:]])

        guess = np.tile(np.concatenate([start, np.zeros(3)])[:, None], (1, len(s)))
        guess[:3] += s * turns(np.array(self.frame)[:, None])[:, 2]
        for share in np.linspace(0.0, 1.0, parts + 1):

            def slopes(at: Floats, y: Floats, share: float = share) -> Floats:
                return self._slopes(at, y, share * force, share * weight)

            found = solve_bvp(slopes, ends, s, guess, tol=TOLERANCE, max_nodes=50_000)
            assert found.success, found.message
            s, guess = found.x, found.y
        y = found.sol(np.linspace(0.0, self.length, stations))
        return y[:3].T, y[3:7].T, y[7:].T

    def to(
        self,
        end: Floats,
        frame: Floats,
        weight: Floats,
        *,
        start: tuple[Floats, Floats, Floats],
        stations: int = 41,
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Hold the far end, too, at a place and in a frame.

        Parameters
        ----------
        end, frame, weight : m, unit quaternion, N/m
        start : places, quaternions and moments, evenly spaced, near the solution
        stations : wanted, evenly spaced

        Returns
        -------
        As `under`; and the force that the far clamp pulls with, N.
        """
        s = np.linspace(0.0, self.length, len(start[0]))
        clamp = np.concatenate([np.zeros(3), self.frame])
        back = frame * np.array([1.0, -1.0, -1.0, -1.0])

        def ends(a: Floats, b: Floats, _: Floats) -> Floats:
            q = b[3:7]
            off = back[0] * q[1:] + q[0] * back[1:] + np.cross(back[1:], q[1:])
            return np.concatenate([a[:7] - clamp, b[:3] - end, off])

        def slopes(at: Floats, y: Floats, force: Floats) -> Floats:
            return self._slopes(at, y, force, weight)

        guess = np.vstack([floats.T for floats in start])
        found = solve_bvp(slopes, ends, s, guess, p=np.zeros(3), tol=TOLERANCE, max_nodes=50_000)
        assert found.success, found.message
        y = found.sol(np.linspace(0.0, self.length, stations))
        return y[:3].T, y[3:7].T, y[7:].T, np.asarray(found.p)


def heavy_cantilever(weight: float) -> tuple[float, float, float]:
    """Tip drop, shortening and angle of a level rod of length and stiffness 1 under its weight.

    Parameters
    ----------
    weight : w L^3 / EI
    """
    rod = Kirchhoff((1.0, 1.0, 1.0), 1.0, frame=LEVEL)
    places, frames, _ = rod.under(np.zeros(3), np.array([0.0, 0.0, -weight]))
    x, _, z = turns(frames[-1][:, None])[:, 2, 0]
    return float(-places[-1, 2]), float(1.0 - places[-1, 0]), float(np.arctan2(-z, x))


def turns(q: Floats) -> Floats:
    """Rotation matrices, shape (3, 3, stations), of quaternions (4, stations)."""
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def bend_of_45_degrees(load: float = 600.0, *, torsion: float = 1.0 / 6.0) -> Floats:
    """Tip of the bend of Bathe and Bolourchi (1979): radius 100, unit square, E 1e7, load across.

    Parameters
    ----------
    load : along z; the bend starts at the origin along x and turns towards y
    torsion : constant of the section; G is E / 2. The codes that are quoted take the polar moment,
        1/6, as if sections stayed plane; a square's own is 0.1406

    Notes
    -----
    Without shear and stretch, which the codes have: worth 0.2 % of the numbers they print.
    """
    stiffness = (1e7 / 12.0, 1e7 / 12.0, 0.5e7 * torsion)
    whole = Kirchhoff(stiffness, 25.0 * np.pi, (0.01, 0.0, 0.0), LEVEL)  # bent about z at rest
    return np.asarray(whole.under(np.array([0.0, 0.0, load]))[0][-1])


def tips(
    deck: str,
    loads: Floats,
    towards: float | Floats = 0.0,
    *,
    ramp: int = 400,
    rest: int = N_SETTLING_STEPS,
) -> Floats:
    """Where the tip comes to rest under each load, shape (loads, 3).

    Parameters
    ----------
    deck : MJCF
    loads : N, one after the other
    towards : rad, direction of the loads from y to z; or of each load
    ramp, rest : steps in which a load grows, and in which it stands
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(deck)
    data = mujoco.MjData(model)
    angles = np.broadcast_to(towards, np.shape(loads))
    pulls = np.asarray(loads)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    places, before = [], np.zeros(model.nu)
    for pull in pulls[:, : model.nu]:
        for step in range(ramp + rest):
            data.ctrl[:] = before + min(1.0, (step + 1) / ramp) * (pull - before)
            mujoco.mj_step(model, data)
        before = pull
        places.append(np.array(data.sensor("tip").data))
    assert not any(warning.number for warning in data.warning)
    assert float(np.max(np.abs(data.qvel))) < 1e-3
    return np.array(places)
