"""What a line stores and loses, and what its boundaries do to it, J."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Demands, Shape
from labpipe.rod.rotations import conjugate, matrices, multiply, rotation_vectors


def stored_energy(assembly: Assembly, balance: Balance, shape: Shape) -> float:
    """Elastic energy of bending, twist and stretch, J."""
    section, cells = assembly.line.section, balance.cells
    law = section.law
    bent = cells.curvatures[:, None, :2] - balance.memory.rests
    of_sliders = np.einsum("nj,j->n", np.sum(bent**2, axis=2), law.stiffnesses)
    of_spring = law.stiffness * np.sum(cells.curvatures[:, :2] ** 2, axis=1)
    of_twist = section.torsional_stiffness * cells.curvatures[:, 2] ** 2
    energy = 0.5 * float(assembly.supports.lengths @ (of_sliders + of_spring + of_twist))
    if not assembly.is_rigid:
        energy += 0.5 * section.axial_stiffness * float(assembly.line.lengths @ shape.stretches**2)
        energy += assembly.coupled_energy(shape, cells)
    return energy


def lost_energy(assembly: Assembly, before: Floats, behind: Floats) -> float:
    """Energy lost in the sliders, J, from rests before to rests behind a step, both of cells.

    A slider that slides carries K_j kappa_j over the way that its rest goes.
    """
    law = assembly.line.section.law
    ways = np.linalg.norm(behind - before, axis=2)
    return float(assembly.supports.lengths @ ways @ (law.stiffnesses * law.slip_curvatures))


def work_done(
    assembly: Assembly,
    demands: tuple[Demands, Demands],
    shapes: tuple[Shape, Shape],
    balances: tuple[Balance, Balance],
) -> float:
    """Work of grips, loads, weight and strings on the line within a step, J.

    By the mean of the forces at both ends of the step: exact for what does not change, of third
    order in the step else.
    """
    (old, new), (first, last) = demands, shapes
    pulls = [assembly.reactions(b, d) for b, d in zip(balances, demands, strict=True)]
    moved = last.positions - first.positions
    work = 0.5 * float(np.sum((pulls[0][0] + pulls[1][0]) * (new.held - old.held)))
    work += 0.5 * float(np.sum((old.forces + new.forces) * moved))
    work += 0.5 * float(np.sum((pulls[0][1] + pulls[1][1]) * _turned(old.clamps, new.clamps)))
    if np.any(old.moments) or np.any(new.moments):
        turned = _turned(first.frames, last.frames)
        work += 0.5 * float(np.sum((old.moments + new.moments) * turned))
    if len(new.anchors):
        tensions = balances[0].tensions + balances[1].tensions
        work += 0.5 * float(np.sum(tensions * (new.anchors - old.anchors)))
    if len(new.rings):
        pulls_of = [np.array([thread.force for thread in b.threads]) for b in balances]
        work += 0.5 * float(np.sum((pulls_of[0] + pulls_of[1]) * (new.rings - old.rings)))
    return work


def _turned(before: Floats, behind: Floats) -> Floats:
    """Rotation vectors in space, rad, from frames to others."""
    own = rotation_vectors(multiply(conjugate(before), behind))
    return np.asarray(np.einsum("nxy,ny->nx", matrices(before), own))
