"""Stored and lost energy of a line, and the work of its boundaries, J."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Demands, Shape
from labpipe.rod.rotations import conjugate, matrices, multiply, rotation_vectors


def stored_energy(assembly: Assembly, balance: Balance, shape: Shape) -> float:
    """Return the elastic energy of bending, twist and stretch, J."""
    section, cells = assembly.line.section, balance.cells
    law = section.law
    slider_strain = cells.curvatures[:, None, :2] - balance.memory.rests
    of_sliders = np.einsum("nj,j->n", np.sum(slider_strain**2, axis=2), law.stiffnesses)
    of_spring = law.stiffness * np.sum(cells.curvatures[:, :2] ** 2, axis=1)
    of_twist = section.torsional_stiffness * cells.curvatures[:, 2] ** 2
    energy = 0.5 * float(assembly.supports.lengths @ (of_sliders + of_spring + of_twist))
    if not assembly.is_rigid:
        energy += 0.5 * section.axial_stiffness * float(assembly.line.lengths @ shape.stretches**2)
        energy += assembly.coupled_energy(shape, cells)
    return energy


def lost_energy(assembly: Assembly, before: Floats, behind: Floats) -> float:
    """Return the energy lost in the sliders in a step, J, from the rests of cells around it.

    A sliding slider carries K_j kappa_j over the path of its rest.
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
    """Return the work of grips, loads, weight and strings on the line within a step, J.

    By the mean of the forces at both ends of the step: exact for constant forces, else of third
    order in the step.
    """
    (old, new), (first, last) = demands, shapes
    pulls = [assembly.reactions(b, d) for b, d in zip(balances, demands, strict=True)]
    moved = last.positions - first.positions
    work = 0.5 * float(np.sum((pulls[0][0] + pulls[1][0]) * (new.held - old.held)))
    work += 0.5 * float(np.sum((old.forces + new.forces) * moved))
    work += 0.5 * float(np.sum((pulls[0][1] + pulls[1][1]) * _turns(old.clamps, new.clamps)))
    if np.any(old.moments) or np.any(new.moments):
        turned = _turns(first.frames, last.frames)
        work += 0.5 * float(np.sum((old.moments + new.moments) * turned))
    if len(new.anchors):
        tensions = balances[0].tensions + balances[1].tensions
        work += 0.5 * float(np.sum(tensions * (new.anchors - old.anchors)))
    if len(new.rings):
        pulls_of = [np.array([thread.force for thread in b.threads]) for b in balances]
        work += 0.5 * float(np.sum((pulls_of[0] + pulls_of[1]) * (new.rings - old.rings)))
    return work


def _turns(before: Floats, behind: Floats) -> Floats:
    """Return rotation vectors in space, rad, between frames."""
    rotation = rotation_vectors(multiply(conjugate(before), behind))
    return np.asarray(np.einsum("nxy,ny->nx", matrices(before), rotation))
