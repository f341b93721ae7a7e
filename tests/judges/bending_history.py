"""A wire bent there and back: sliders for axial forces, kinematic plasticity for strands.

The truth that the laws of plays, which unload by Masing's rule, are compared with. Two things
remember, and both are the first loading of `wire.bending_law` as long as the bending has not
turned:

- the axial force of each strand is that of a Coulomb slider: it follows E A r sin(theta)
  cos^2(alpha) d(kappa) between the two friction limits (3.14) of bending one way and the other,
  with the pressure of the moment;
- each lamina of a strand hardens kinematically (Masing: after a turn the curve of first loading
  at twice its size, closed loops are forgotten). All laminae of a strand turn together, so that the
  strand's moment follows the same rules: with the turns e1, e2, ... that are still remembered,

      m = f(e1) + 2 f((e2 - e1) / 2) + 2 f((e3 - e2) / 2) + ...

Masing (1926); the rules of memory are Madelung's. The law does not depend on rate, and does not
soften or harden from cycle to cycle.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.friction import Bundle, Contacts, arrange, ring_pressure, sines
from labpipe.wire.strand_bending import helix_factor, strand_moment


def bend_along(
    section: CrossSection, contacts: Contacts, path: Floats, *, orientation: float = 0.0
) -> Floats:
    """Moments of a straight wire, never bent before, along a path of curvatures, N m.

    On the first loading the points are exact however far apart they are. After a turn they are
    exact for a single ring, whose pressure does not change; with more rings the limits are those at
    the end of each step.
    """
    sine = sines(section, orientation)
    forward, backward = (arrange(section, contacts, s) for s in (sine, -sine))
    tube = section.insulation.bending_stiffness if section.insulation else 0.0
    return _axial(forward, backward, path) + _own(section, path) + tube * path


def _axial(forward: Bundle, backward: Bundle, path: Floats) -> Floats:
    """Moment of the axial forces along a path, shape (n,)."""
    state = [np.zeros((1, ring.end)) for ring in forward.rings]
    moment = np.zeros(len(path))
    for i, step in enumerate(np.diff(path, prepend=0.0)):
        own = _slide(forward, backward, state, float(step))
        moment[i] = own @ forward.lever
    return moment


def _slide(forward: Bundle, backward: Bundle, state: list[Floats], step: float) -> Floats:
    """Move the sliders by a step, in place; give the strands' own forces, shape (strands,)."""
    own = np.zeros(len(forward.sign))
    outer: list[Floats] = []
    for q in reversed(range(len(forward.rings))):
        there, back = forward.rings[q], backward.rings[q]
        pressure = ring_pressure(forward, q, outer)
        most = pressure * there.per_pressure + there.per_tension
        least = -(pressure * back.per_pressure + back.per_tension)
        state[q] = np.clip(state[q] + step * there.demand, least, most)
        force = state[q] * forward.sign[: there.end]
        own[there.start : there.end] = force[0, there.start :]
        outer.insert(0, force)
    return own


def _own(section: CrossSection, path: Floats) -> Floats:
    """Moment of the strands about their own axes along a path, shape (n,)."""
    point, weight, half = _remembered(path)
    moment = np.zeros(len(path))
    for layer in section.layers:
        straight = strand_moment(layer.material, layer.diameter, half).moment
        share = layer.count * helix_factor(layer.lay_angle, layer.poisson)
        moment += share * np.bincount(point, weight * straight, minlength=len(path))
    return moment


def _remembered(path: Floats) -> tuple[Ints, Floats, Floats]:
    """Terms of the moment at every point: which point, weight, and argument of f."""
    turns: list[float] = []
    point, weight, argument = [], [], []
    present = 0.0
    for i, target in enumerate(path.tolist()):
        if turns or present:
            _turn(turns, present, target)
        chain = [*turns, target]
        point += [i] * len(chain)
        weight += [1.0] + [2.0] * len(turns)
        argument += [chain[0], *((b - a) / 2.0 for a, b in pairwise(chain))]
        present = target
    return np.array(point, dtype=np.int64), np.array(weight), np.array(argument)


def _turn(turns: list[float], present: float, target: float) -> None:
    """Remember the turn at the present curvature if there is one; forget the loops closed."""
    came_from = turns[-1] if turns else 0.0
    if _way(present, target) == -_way(came_from, present) != 0:
        turns.append(present)
    while len(turns) > 1 and _way(turns[-2], target) in {0, _way(turns[-1], turns[-2])}:
        del turns[-2:]
    if turns and abs(target) >= abs(turns[0]):
        turns.clear()


def _way(begin: float, end: float) -> int:
    """1 up, -1 down, 0 nowhere: the product of two steps could be too small to have a sign."""
    return (end > begin) - (end < begin)
