"""Record of the quasi-static path of a line: its states at all steps, status and lost energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.mechanics.rod.boundaries import Boundary
from labpipe.mechanics.rod.line import Line
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.records.quality import Reason
from labpipe.records.result import Status


@dataclass(frozen=True, slots=True, eq=False)
class RodState(ArrayRecord):
    """A line in equilibrium, with its history.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes
    frames : shape (n, 4), unit quaternions of the elements
    stretches : shape (n,), axial strains of the elements
    forces : shape (n, 3), N, in space axes, force that the line after an element exerts on the line
        before it; a tension is along d3
    moments : shape (n + 1, 2, 3), N m, in space axes, moment that the line after a cell exerts on
        the line before it. The second axis is the side of the node, before and after it; the sides
        differ at a clamp. Zero before the first and after the last node
    curvatures : shape (n + 1, 2, 3), 1/m, curvatures minus those at rest, on both sides of every
        node: two bending components and the twist in the mean frame. At a clamp they are means over
        half an element
    node_curvatures : shape (n + 1, 2, 3), 1/m, as `curvatures`, but extrapolated to the node at
        clamps
    curvature_vectors : shape (n + 1, 2, 2), 1/m, bending components of `node_curvatures` plus those
        at rest
    rests : shape (n + 1, 2, sliders, 2), 1/m, rest curvatures of the sliders, which are the history
    reaction_forces : shape (boundaries, 3), N, total force of each boundary on the line, loads
        included; zero for gravity
    reaction_moments : shape (boundaries, 3), N m, moments of clamps about their node; zero for
        other boundaries
    """

    positions: Annotated[Floats, "nodes", 3]
    frames: Annotated[Floats, "elements", 4]
    stretches: Annotated[Floats, "elements"]
    forces: Annotated[Floats, "elements", 3]
    moments: Annotated[Floats, "nodes", 2, 3]
    curvatures: Annotated[Floats, "nodes", 2, 3]
    node_curvatures: Annotated[Floats, "nodes", 2, 3]
    curvature_vectors: Annotated[Floats, "nodes", 2, 2]
    rests: Annotated[Floats, "nodes", 2, "sliders", 2]
    reaction_forces: Annotated[Floats, "boundaries", 3]
    reaction_moments: Annotated[Floats, "boundaries", 3]

    @property
    def bending_curvatures(self) -> Floats:
        """Return the bending curvature at the nodes minus that at rest, 1/m, shape (n + 1,).

        At a clamp it is the larger curvature of both sides.
        """
        bending = self.node_curvatures[:, :, :2]
        return np.asarray(np.max(np.linalg.norm(bending, axis=2), axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class RodPath(ArrayRecord):
    """Path of a line; lost energies are totals since the start.

    Parameters
    ----------
    line : line in its initial shape
    boundaries : boundaries of the line, in the order of the caller
    states : states of steps 0, 1, ...; fewer than requested if the path failed
    status : `failed` if a step has no equilibrium; `doubtful` for another reason, such as a
        curvature beyond the range of the law
    reasons : reasons of the status, the most important first; empty if `ok`
    snapped : steps in which the line jumped, because it snapped or was released
    lost : shape (states,), J, energy lost in the sliders
    lost_in_jumps : shape (states,), J, energy lost in jumps, included in `lost`
    """

    line: Line
    boundaries: tuple[Boundary, ...]
    states: tuple[RodState, ...]
    status: Status
    reasons: tuple[Reason, ...]
    snapped: tuple[int, ...]
    lost: Annotated[Floats, "states"]
    lost_in_jumps: Annotated[Floats, "states"]

    @property
    def last(self) -> RodState:
        """Return the last state that was reached.

        Raises
        ------
        ValueError
            If step 0 failed, so that there is no state.
        """
        if not self.states:
            raise ValueError(
                format_sentence("mechanics.rod.no_state", reason=self.reasons[0].message)
            )
        return self.states[-1]
